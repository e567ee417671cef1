"""Camera cuts: frames whose vectors are far longer than usual, pairs that show different things."""

import dataclasses
import math
import statistics
import weakref
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxblur import exr

REACH = 3
"""Number of neighbors on either side with which a frame is compared."""
FACTOR = 4.0
"""Ratio of an outlier's speed to that of its neighbors."""
SLOWEST = 2.0
"""Mean half-spread in pixels up to which no frame is an outlier."""
CELLS = 64
"""Width in cells of the small pictures that `is_cut` compares."""
UNRELATED = 0.65
"""Share of the difference between unrelated places from which two frames are of different shots."""
ALIKE = 0.01
"""Difference of compressed colors below which pictures are alike."""
FEWEST = 0.1
"""Share of cells that must stay in the picture."""
SHIFTS = 12
"""Shifts by which unrelated places are found."""


@dataclasses.dataclass(frozen=True)
class Cut:
    """A frame whose vectors are outliers.

    Attributes:
        frame: its number.
        speed: mean half-spread of its vectors in pixels.
        usual: median of the same over its neighbors.
    """

    frame: int
    speed: float
    usual: float


def find_cuts(speeds: Mapping[int, float]) -> list[Cut]:
    """Find frames that move far more than the frames around them.

    At a cut between cameras a renderer mistakes the change of the picture for motion: the vectors
    of one or both frames at the cut are as long as the picture is wide. An outlier is more than
    `FACTOR` times as fast as the median of the `REACH` frames before and after it, which a second
    outlier beside it hardly changes, and faster than `SLOWEST`.

    Args:
        speeds: mean half-spread of the vectors in pixels, by frame.

    Returns:
        The outliers in order.
    """
    frames = sorted(speeds)
    cuts = []
    for index, frame in enumerate(frames):
        around = frames[max(0, index - REACH) : index] + frames[index + 1 : index + 1 + REACH]
        if len(around) < 2:
            continue
        usual = statistics.median(speeds[neighbor] for neighbor in around)
        if speeds[frame] > max(FACTOR * usual, SLOWEST):
            cuts.append(Cut(frame, speeds[frame], usual))
    return cuts


def is_cut(first: exr.Buffers, second: exr.Buffers, shutter: float) -> bool:
    """Whether the second of two consecutive frames does not show what the first one shows.

    The vectors of each frame predict where its points are in the other one. Colors there differ, in
    the mean, by a share of the difference between colors at unrelated places. Over consecutive
    frames of four path-traced scenes this share is 0.37 at most, between these scenes 0.71 at
    least. There is a cut if the share of either frame exceeds `UNRELATED`, or if the vectors carry
    nearly everything out of the picture. Frames of different data windows are compared where both
    are known, see `jaxblur.exr.common_window`; there is a cut if that is nowhere. Only the two
    frames decide, so that every run agrees.

    Args:
        first: a frame.
        second: the next one, of the same display window and channels.
        shutter: exposure in frames by which their vectors were scaled; above 0.

    Returns:
        True also where long vectors, as renderers write them at a cut, bring nothing into place.
    """
    window = exr.common_window(first, second)
    if 0 in window[2:]:
        return True
    a, b = (_cells_of(exr.buffers_in(frame, window)) for frame in (first, second))
    usual = _difference_elsewhere(a.color, b.color)
    return any(
        differs > UNRELATED * max(usual, ALIKE)
        for differs in (_difference(a, b, 2 / shutter), _difference(b, a, -2 / shutter))
    )


class _Cells(NamedTuple):
    """Means over square cells of a frame.

    Attributes:
        color: (H, W, C), compressed to 0..1.
        velocity: (H, W, 2) half-spread in cells.
    """

    color: np.ndarray
    velocity: np.ndarray


_KNOWN: dict[int, tuple[weakref.ref[exr.Buffers], _Cells]] = {}
"""Cells of frames that are still in memory: a frame is compared with the one before and the one
after."""


def _cells_of(buffers: exr.Buffers) -> _Cells:
    """The cells of a frame, which are found once."""
    key = id(buffers)
    known = _KNOWN.get(key)
    if known is not None and known[0]() is buffers:
        return known[1]
    cells = _in_cells(buffers)
    _KNOWN[key] = weakref.ref(buffers, lambda _: _KNOWN.pop(key, None)), cells
    return cells


def _in_cells(buffers: exr.Buffers) -> _Cells:
    height, width = buffers.depth.shape
    size = max(1, min(width // CELLS, height))

    def means(image: np.ndarray) -> np.ndarray:
        rows, columns = height // size, width // size
        whole = np.ascontiguousarray(image[: rows * size, : columns * size])
        # Whole rows first: NumPy adds long runs of memory fast, and short ones slowly.
        bands = whole.reshape(rows, size, -1).sum(axis=1)
        return bands.reshape(rows, columns, size, -1).sum(axis=2) / size**2

    light = np.maximum(np.nan_to_num(buffers.color, posinf=1e6), 0)
    return _Cells(means(light / (1 + light)), means(buffers.velocity) / size)


def _difference(here: _Cells, there: _Cells, frames: float) -> float:
    """Mean difference of the cells from the cells that they move to; infinite if few land."""
    height, width = here.color.shape[:2]
    row, column = np.indices((height, width))
    x = column + frames * here.velocity[..., 0]
    y = row + frames * here.velocity[..., 1]
    lands = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    if lands.mean() < FEWEST:
        return math.inf
    x, y = x[lands], y[lands]
    left, top = x.astype(int), y.astype(int)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    across, down = (x - left)[:, None], (y - top)[:, None]
    upper = there.color[top, left] * (1 - across) + there.color[top, right] * across
    lower = there.color[bottom, left] * (1 - across) + there.color[bottom, right] * across
    return float(np.abs(upper * (1 - down) + lower * down - here.color[lands]).mean())


def _difference_elsewhere(first: np.ndarray, second: np.ndarray) -> float:
    """Mean difference of cells from cells at unrelated places of the other frame."""
    a, b = (cells.reshape(-1, cells.shape[-1]) for cells in (first, second))
    shifts = {len(b) * k // SHIFTS for k in range(1, SHIFTS)}
    return float(np.mean([np.abs(a - np.roll(b, shift, axis=0)).mean() for shift in shifts]))
