"""The published filters, all with one signature; `FILTERS` names them.

filter(frame, parameters, *, settings=Settings(), noise=None) -> (H, W, C)
"""

from collections.abc import Callable
from typing import Any

from ..settings import Settings
from .guertin2014 import (
    GuertinParameters as GuertinParameters,
    guertin2014 as guertin2014,
    luma_hint as luma_hint,
)
from .layered import LayeredParameters as LayeredParameters, layered as layered
from .mcguire2012 import McGuireParameters as McGuireParameters, mcguire2012 as mcguire2012
from .pixel_velocity import pixel_velocity as pixel_velocity

FILTERS: dict[str, Callable[..., Any]] = {
    "guertin2014": guertin2014,
    "mcguire2012": mcguire2012,
    "pixel_velocity": pixel_velocity,
    "layered": layered,
}

PUBLISHED: dict[str, tuple[Any, Settings]] = {
    "guertin2014": (GuertinParameters(), Settings()),
    "mcguire2012": (McGuireParameters(), Settings(samples=15, radius=20)),
    "pixel_velocity": (None, Settings()),
    "layered": (LayeredParameters(), Settings(radius=160, fetch="bilinear")),
}
"""Parameters and settings of each filter as published."""
