"""Statistics of the vectors of a frame, for listings and for the choice of a radius."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float

PERCENTILES = (50.0, 90.0, 99.0, 99.9, 100.0)
RADIUS_STEP = 5
LARGEST_SUGGESTION = 4000
"""Pixels. Every filter takes such a radius."""
PIXELS_AT_ONCE = 1_000_000
"""Pixels whose speeds are computed together, in double precision."""


@dataclasses.dataclass(frozen=True)
class SpeedStatistics:
    """Speeds (lengths of half-spreads, pixels) in one frame.

    Attributes:
        percentiles: speed by percentile of the finite vectors; all 0 if there are none.
        zero_share: share of pixels with exactly zero motion, 0..1.
        non_finite_share: share of pixels with NaN or infinity, 0..1.
        beyond_share: share of pixels with a finite speed above ``radius``, which a filter would
            clamp, 0..1.
        radius: the radius that ``beyond_share`` refers to, pixels.
        suggested_radius: the largest finite speed rounded up to a multiple of `RADIUS_STEP`, at
            least one step and at most the larger side of the image or `LARGEST_SUGGESTION`.
    """

    percentiles: dict[float, float]
    zero_share: float
    non_finite_share: float
    beyond_share: float
    radius: float
    suggested_radius: int


def speed_statistics(
    velocity: Float[np.ndarray, "height width 2"], radius: float = 40.0
) -> SpeedStatistics:
    """Measure the speeds of a frame.

    Args:
        velocity: (H, W, 2) half-spread in pixels; NaN and infinity are counted, not rejected.
        radius: largest speed that the filter keeps, pixels.

    Returns:
        The statistics.
    """
    height, width = velocity.shape[:2]
    rows = max(1, PIXELS_AT_ONCE // max(1, width))
    blocks = (velocity[row : row + rows] for row in range(0, height, rows))
    return speed_statistics_of_blocks(blocks, (height, width), radius)


def speed_statistics_of_blocks(
    blocks: Iterable[Float[np.ndarray, "rows width 2"]], size: tuple[int, int], radius: float = 40.0
) -> SpeedStatistics:
    """Measure the speeds of a frame that comes in blocks of rows; keeps four bytes a pixel.

    Args:
        blocks: (rows, W, 2) half-spreads in pixels, all rows of the frame in any order.
        size: (H, W) of the frame.
        radius: as in `speed_statistics`.

    Returns:
        The statistics.
    """
    pixels = size[0] * size[1]
    finite = np.empty(pixels, np.float32)
    count = zeros = beyond = 0
    for velocity in blocks:
        x, y = np.moveaxis(velocity.astype(np.float64), -1, 0)
        speed = np.sqrt(x * x + y * y)  # Four times as fast as hypot; float64 does not overflow.
        speed = speed[np.isfinite(speed)]
        zeros += np.count_nonzero(speed == 0)
        beyond += np.count_nonzero(speed > radius)
        finite[count : count + speed.size] = np.minimum(speed, np.finfo(np.float32).max)
        count += speed.size
    values = np.zeros(len(PERCENTILES))
    if count:
        values = np.percentile(finite[:count], PERCENTILES, overwrite_input=True)
    steps = max(1, math.ceil(values[-1] / RADIUS_STEP))
    return SpeedStatistics(
        percentiles=dict(zip(PERCENTILES, values.tolist(), strict=True)),
        zero_share=zeros / pixels,
        non_finite_share=(pixels - count) / pixels,
        beyond_share=beyond / pixels,
        radius=radius,
        suggested_radius=min(steps * RADIUS_STEP, max(size), LARGEST_SUGGESTION),
    )
