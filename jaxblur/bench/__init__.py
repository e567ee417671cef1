"""Speed against error: measure filters on frames with their truth, and guard against regressions.

Imports nothing of jaxblur but `_util`, `exr`, `filters`, `frame`, `metrics`, `scenes`, `settings`
and `vectors`.

`measure` times cases (a method with its settings) in turn on a subject (a frame); `write_rows`
keeps the rows in a CSV file that is whole at every moment; `report` makes the front that nothing
beats; `compare` tells two files apart by more than noise; `fit_power_law` says how time grows.
Names load on first use, so that timing needs no image library.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
