"""Camera cuts: frames whose vectors are far longer than those of neighboring frames."""

import dataclasses
import statistics
from collections.abc import Mapping

REACH = 3
"""Number of neighbors on either side with which a frame is compared."""
FACTOR = 4.0
"""Ratio of an outlier's speed to that of its neighbors."""
SLOWEST = 2.0
"""Mean half-spread in pixels up to which no frame is an outlier."""


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
