"""Motion blur as a screen-space post-process: jit-compiled, differentiable JAX ops.

The public names are listed in ``__init__.pyi``; each loads on first use, so that the command
line answers ``--help`` and path errors without importing jax.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
