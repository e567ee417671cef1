"""What follows the blur: antialiasing of images, and the defocus of a lens.

Imports nothing of jaxblur but `frame`, `kernels`, `lens`, `noise`, `optics`, `safe_math`
and `settings`.

    post(image or frame, ...) -> (H, W, C)

Each is differentiable and jitted; the functions load on first use. The README describes them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
