"""Studies of what people prefer: a page that asks, and the analysis of the answers.

Imports nothing of jaxblur but `_util`, `exr`, `report` and `srgb`.

`read_study` and `build_study` make the page of ``jaxblur study``, `read_votes` reads what it saves,
and `analyze` says which pictures are told apart.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
