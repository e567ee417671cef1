"""Brightness as an eye compares it, in which antialiasing looks for edges."""

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

RED, GREEN, BLUE = 0.2126, 0.7152, 0.0722
TOE = 1 / 1024
"""Added under the root, so that its slope at black is 16, not infinite."""


def perceived_luma(image: ArrayLike) -> Float[Array, "height width"]:
    """Compress the luma of linear light to [0, 1), about evenly in what an eye distinguishes.

    ``L = sqrt(x + 1/1024) - 1/32`` with ``x = Y / (1 + Y)``, where Y is the luma of Rec. 709, at
    least 0. Antialiasing was published for images as screens show them; this is such a curve for
    light without an upper bound: white (Y = 1) is 0.68, a highlight of 100 is 0.96.

    Args:
        image: (H, W, C) linear light; the luma of one with fewer than three channels is its first
            channel. Or (H, W) linear luma itself.

    Returns:
        (H, W) in [0, 1). Differentiable; the derivative is 0 below black.
    """
    values = jnp.asarray(image)
    if values.ndim == 2:
        linear = values
    elif values.shape[-1] < 3:
        linear = values[..., 0]
    else:
        linear = RED * values[..., 0] + GREEN * values[..., 1] + BLUE * values[..., 2]
    linear = jnp.maximum(linear, 0)
    return jnp.sqrt(linear / (1 + linear) + TOE) - TOE**0.5
