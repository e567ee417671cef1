"""The layered filter: motion blur by slices of time."""

from .slices import (
    LayeredParameters as LayeredParameters,
    layered as layered,
    layered_with_hidden as layered_with_hidden,
)
