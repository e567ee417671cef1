"""Time functions in turn, so that what else the machine does falls on all of them alike."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True)
class Timing:
    """Repeated times of one function.

    Attributes:
        seconds: wall-clock time of each run.
        cpu_seconds: processor time of each run, summed over threads.
    """

    seconds: tuple[float, ...]
    cpu_seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median wall-clock time in seconds."""
        return float(np.median(self.seconds))

    @property
    def cpu_median(self) -> float:
        """Median processor time in seconds."""
        return float(np.median(self.cpu_seconds))

    @property
    def spread(self) -> float:
        """Interquartile range of the wall-clock times in seconds."""
        return interquartile_range(self.seconds)


def interquartile_range(values: Sequence[float]) -> float:
    """Width of the middle half of some values, in their unit."""
    low, high = np.percentile(values, (25, 75))
    return float(high - low)


def time_in_turn(runs: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, Timing]:
    """Time functions in rounds: each once, then each once more.

    Every function runs once before the first round, untimed. A run counts until its result is
    there; functions must wait for theirs (``block_until_ready``).

    Args:
        runs: functions without arguments, by name.
        repeats: number of rounds, 1 or more.

    Returns:
        Times by name.

    Raises:
        ValueError: ``repeats`` is below 1.
    """
    if repeats < 1:
        raise ValueError(f"`repeats` must be at least 1, got {repeats}.")
    for run in runs.values():
        run()
    measured: dict[str, list[tuple[float, float]]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            wall, processor = time.perf_counter(), time.process_time()
            run()
            measured[name].append((time.perf_counter() - wall, time.process_time() - processor))
    columns = {name: tuple(zip(*pairs, strict=True)) for name, pairs in measured.items()}
    return {name: Timing(*pair) for name, pair in columns.items()}
