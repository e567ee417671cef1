"""Fit the parameters of the filters to frames whose true motion blur is known.

Imports nothing of jaxblur but `_util`, `batch`, `exr`, `filters`, `frame`, `metrics`, `noise`,
`settings`, `show` and `vectors`.

    result = jaxblur.fit("guertin2014", pairs, free=("kappa", "gamma"), holdout=(3,))
    result.save("fitted.toml")
    blurred = jaxblur.guertin2014(frame, result.filter_parameters)

`fit` descends and evaluates, `profile` scans one parameter, `search_settings` chooses samples and
radius. Names load on first use: a saved result is read without loading jax.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
