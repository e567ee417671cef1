"""Statistics of the vectors of a frame, for listings and for the choice of a radius."""

import dataclasses
import math

import numpy as np
from jaxtyping import Float

PERCENTILES = (50.0, 90.0, 99.0, 99.9, 100.0)
RADIUS_STEP = 5


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
            least one step and at most the larger side of the image.
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
    x, y = np.moveaxis(velocity.astype(np.float64), -1, 0)
    speed = np.hypot(x, y)
    finite = speed[np.isfinite(speed)]
    values = np.percentile(finite, PERCENTILES) if finite.size else np.zeros(len(PERCENTILES))
    steps = max(1, math.ceil(values[-1] / RADIUS_STEP))
    return SpeedStatistics(
        percentiles=dict(zip(PERCENTILES, values.tolist(), strict=True)),
        zero_share=float(np.mean(speed == 0)),
        non_finite_share=float(np.mean(~np.isfinite(speed))),
        beyond_share=float(np.mean(np.isfinite(speed) & (speed > radius))),
        radius=radius,
        suggested_radius=min(steps * RADIUS_STEP, max(speed.shape)),
    )
