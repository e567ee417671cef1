"""The layered filter: motion blur by slices of time."""

from .filter import (
    LayeredParameters as LayeredParameters,
    layered as layered,
    layered_with_hidden as layered_with_hidden,
)
from .layers import Layer as Layer, blur_layers as blur_layers
