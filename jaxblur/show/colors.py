"""The color wheel of velocities: hue shows direction, saturation shows speed."""

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

UNKNOWN = 0.5
"""Gray of vectors that are not finite; no velocity has that color."""


def velocity_colors(velocity: ArrayLike, limit: float) -> Float[np.ndarray, "*shape 3"]:
    """Color each velocity: white at 0, fully saturated from ``limit`` on.

    Hue follows the angle on the screen: right is red, down is yellow-green, left is cyan and up
    is violet, so that opposed velocities have opposed colors. (Opposed velocities give the same
    blur; the sign matters when vectors of two sources are compared.)

    Args:
        velocity: (..., 2) half-spread in pixels, x right, y down.
        limit: pixels, above 0; the speed of full saturation.

    Returns:
        (..., 3) display values in [0, 1]; gray where the velocity is not finite.

    Raises:
        ValueError: the last axis is not 2, or the limit is not above 0.

    Examples:
        >>> velocity_colors([[0.0, 0.0], [8.0, 0.0], [-4.0, 0.0]], limit=8.0).tolist()
        [[1.0, 1.0, 1.0], [1.0, 0.0, 0.0], [0.5, 1.0, 1.0]]
    """
    vectors = np.asarray(velocity, np.float64)
    if vectors.shape[-1:] != (2,):
        raise ValueError(f"`velocity` must have shape (..., 2), got {vectors.shape}.")
    if not limit > 0:
        raise ValueError(f"`limit` must be above 0, got {limit}.")
    finite = np.isfinite(vectors).all(axis=-1, keepdims=True)
    x, y = np.moveaxis(np.where(finite, vectors, 0.0), -1, 0)
    hue = np.arctan2(y, x) / (2 * np.pi) % 1.0
    saturation = np.clip(np.hypot(x, y) / limit, 0.0, 1.0)
    # Hue, saturation, value 1 to red, green, blue: three shifted trapezoids.
    sector = (hue[..., None] * 6 + np.array([0.0, 4.0, 2.0])) % 6
    pure = np.clip(np.abs(sector - 3) - 1, 0.0, 1.0)
    colors = 1 - saturation[..., None] * (1 - pure)
    return np.where(finite, colors, UNKNOWN)


def wheel(size: int) -> Float[np.ndarray, "{size} {size} 4"]:
    """Draw the legend: a disc of all velocities up to the limit.

    Args:
        size: pixels of its diameter.

    Returns:
        (size, size, 4) display values and opacity; transparent outside the disc.
    """
    axis = (np.arange(size) + 0.5) * 2 / size - 1
    x, y = np.meshgrid(axis, axis)
    inside = np.hypot(x, y) <= 1
    return np.dstack([velocity_colors(np.dstack([x, y]), 1.0), inside])
