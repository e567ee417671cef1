"""The front of time against error.

Both `bench`, which measures, and `show`, which draws, need it; neither imports the other. It needs
neither jax nor matplotlib.
"""

import dataclasses
from collections.abc import Sequence


@dataclasses.dataclass(frozen=True)
class Measurement:
    """The time and the error of one run.

    Attributes:
        label: short text next to the point.
        time: above 0, such as milliseconds.
        error: above 0, less is better, such as FLIP.
        group: points of one group share a color; for example the name of the filter.
        published: whether the settings are those of the authors; drawn as a star.
        time_range: (low, high) of the time, such as a confidence interval, or None.
        error_range: (low, high) of the error, or None.
    """

    label: str
    time: float
    error: float
    group: str = ""
    published: bool = False
    time_range: tuple[float, float] | None = None
    error_range: tuple[float, float] | None = None


def pareto_front(points: Sequence[Measurement]) -> list[Measurement]:
    """Find the Pareto front: the points that no other point beats in both time and error.

    Args:
        points: in any order. Of points that are equal in both, the first is kept.

    Returns:
        From fast to accurate: time strictly rises and error strictly falls.

    Examples:
        >>> slow, fast = Measurement("slow", 2.0, 0.1), Measurement("fast", 1.0, 0.2)
        >>> [point.label for point in pareto_front([slow, Measurement("bad", 2.0, 0.2), fast])]
        ['fast', 'slow']
    """
    front: list[Measurement] = []
    for point in sorted(points, key=lambda point: (point.time, point.error)):
        if not front or point.error < front[-1].error:
            front.append(point)
    return front
