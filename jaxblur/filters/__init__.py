"""Filters, all with one signature; `FILTERS` holds them by name, `filter_info` describes each.

Imports nothing of jaxblur but `frame`, `kernels`, `lens`, `noise`, `nonfinite`, `optics`,
`safe_math`, `settings` and `shutter`.

    filter(frame, parameters, *, settings, noise=None) -> (H, W, C)

The functions load on first use; the registry and the records of parameters load no jax.
"""

import lazy_loader

from . import builtin as builtin

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
