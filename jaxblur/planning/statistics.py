"""Statistics of a frame: speeds, directions and layers of its tiles."""

import dataclasses
import math
from typing import Any

import numpy as np
from jaxtyping import Float

from ..filters.tiles import fastest_pixels, neighbor_max, tile_max, tile_variance
from ..frame import Frame, check_frame
from ..vectors import speed_statistics

MOVING = 0.5
"""Half-spread in pixels above which the filters blur."""
DIFFERENT = 1.0
"""Pixels by which half-spreads in a tile must differ for its depths to matter."""
LAYERED = 1.1
"""Ratio of depths that makes two layers."""


@dataclasses.dataclass(frozen=True)
class FrameStatistics:
    """The statistics of a frame that `plan` uses; tiles are squares of ``radius`` pixels.

    Attributes:
        pixels: of the frame.
        median_speed: half-spread in pixels that half of the pixels reach.
        fast_speed: half-spread in pixels that one pixel in a hundred exceeds.
        radius: the largest half-spread in pixels, rounded up.
        moving_tiles: share of tiles with a half-spread above half a pixel.
        angular_variance: mean of `jaxblur.tile_variance`, 0 (aligned) to 1, over the tiles that
            guertin2014 blurs: of the fastest velocities of neighborhoods (NeighborMax), as in its
            pass 12 [Guertin et al. 2014, eq. 3.2].
        layered_tiles: share of the moving tiles that hold a pixel of another velocity and
            depth than their fastest one.
    """

    pixels: int
    median_speed: float
    fast_speed: float
    radius: int
    moving_tiles: float
    angular_variance: float
    layered_tiles: float

    @property
    def features(self) -> Float[np.ndarray, " features"]:
        """Factors of the linear rules' constants: one, variance, layers, logarithm of speed."""
        speed = math.log2(max(self.fast_speed, MOVING))
        return np.array([1.0, self.angular_variance, self.layered_tiles, speed])

    @property
    def moves(self) -> bool:
        """Whether any filter would change the frame."""
        return self.moving_tiles > 0


def frame_statistics(frame: Frame) -> FrameStatistics:
    """Measure the statistics that `plan` uses.

    Args:
        frame: depth (H, W) and velocity (H, W, 2) half-spread in pixels are looked at.

    Returns:
        The statistics.

    Raises:
        ValueError: shapes disagree, or a velocity is NaN or infinite.
    """
    frame = check_frame(frame)
    velocity, depth = np.asarray(frame.velocity), np.asarray(frame.depth)
    speeds = speed_statistics(velocity)
    if speeds.non_finite_share > 0:
        raise ValueError(
            f"`frame.velocity` must be finite, got NaN or infinity in "
            f"{100 * speeds.non_finite_share:.3g} % of the pixels; repair the vectors first."
        )
    radius = speeds.suggested_radius
    tiles = np.asarray(tile_max(velocity, radius))
    dominant = np.asarray(neighbor_max(tiles))
    moving = _speed(tiles) > MOVING
    return FrameStatistics(
        pixels=depth.size,
        median_speed=speeds.percentiles[50.0],
        fast_speed=speeds.percentiles[99.0],
        radius=radius,
        moving_tiles=float(moving.mean()),
        angular_variance=_mean_where(_speed(dominant) > MOVING, tile_variance(dominant)),
        layered_tiles=_mean_where(moving, _layered(velocity, depth, radius)),
    )


def _speed(velocity: np.ndarray) -> np.ndarray:
    return np.hypot(velocity[..., 0], velocity[..., 1])


def _mean_where(chosen: np.ndarray, values: Any) -> float:
    return float(np.mean(values, where=chosen)) if chosen.any() else 0.0


def _layered(velocity: np.ndarray, depth: np.ndarray, radius: int) -> np.ndarray:
    """Whether a tile holds a pixel that differs from its fastest one in velocity and depth."""
    height, width = depth.shape
    # The velocity and depth of the fastest pixel of its tile, for every pixel.
    found = np.asarray(fastest_pixels(velocity, radius))
    found = found.repeat(radius, axis=0).repeat(radius, axis=1)[:height, :width]
    row, column = found[..., 0], found[..., 1]
    away = _speed(velocity - velocity[row, column]) > DIFFERENT
    other = depth[row, column]
    # Two depths of sky are equal: infinity does not exceed infinity.
    apart = np.maximum(depth, other) > LAYERED * np.minimum(depth, other)
    marked = np.pad(away & apart, ((0, -height % radius), (0, -width % radius)))
    rows, columns = marked.shape[0] // radius, marked.shape[1] // radius
    return np.any(marked.reshape(rows, radius, columns, radius), axis=(1, 3))
