"""Camera cuts: frames whose vectors have nothing to do with those of their neighbors."""

import dataclasses
import statistics
from collections.abc import Mapping

REACH = 3
"""Neighbors to either side that a frame is held against."""
FACTOR = 4.0
"""How many times as fast as its neighbors an outlier is."""
SLOWEST = 2.0
"""Pixels of mean half-spread below which nothing is an outlier."""


@dataclasses.dataclass(frozen=True)
class Cut:
    """A frame whose vectors are outliers.

    Attributes:
        frame: its number.
        speed: mean half-spread of its vectors in pixels.
        usual: median of that of its neighbors.
    """

    frame: int
    speed: float
    usual: float


def find_cuts(speeds: Mapping[int, float]) -> list[Cut]:
    """Find frames that move far more than the frames around them.

    At a cut between cameras a renderer takes the change of the picture for motion: the vectors
    of one or both frames at the cut are as long as the picture is wide. An outlier is
    `FACTOR` times as fast as the median of the `REACH` frames before and after it, which is not
    moved by a second outlier beside it, and faster than `SLOWEST`.

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
