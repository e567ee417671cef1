"""Time functions in turn, so that what else the machine does falls on all of them alike."""

import dataclasses
import functools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

FEWEST_ROUNDS = 3


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

    @property
    def cpu_spread(self) -> float:
        """Interquartile range of the processor times in seconds."""
        return interquartile_range(self.cpu_seconds)


def interquartile_range(values: Sequence[float]) -> float:
    """Width of the middle half of some values, in their unit.

    Examples:
        >>> interquartile_range([1.0, 2.0, 3.0, 4.0, 5.0])
        2.0
    """
    low, high = np.percentile(values, (25, 75))
    return float(high - low)


def time_in_turn(
    runs: Mapping[str, Callable[[], object]],
    repeats: int,
    limit: float = math.inf,
    settle: bool = False,
) -> dict[str, Timing]:
    """Time functions in rounds: each once, then each once more.

    Every function runs once before the first round, untimed. A run counts until its result is
    there; functions must wait for theirs (``block_until_ready``).

    Args:
        runs: functions without arguments, by name.
        repeats: number of rounds, 1 or more.
        limit: seconds after which no round starts, once there were three.
        settle: run each once more, untimed, before it is timed: memory that the one before it gave
            back to the system is then there again, as it is in a sequence of frames.

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
    started = time.perf_counter()
    for turn in range(repeats):
        if turn >= FEWEST_ROUNDS and time.perf_counter() - started > limit:
            break
        for name, run in runs.items():
            if settle:
                run()
            measured[name].append(_time_once(run))
    columns = {name: tuple(zip(*pairs, strict=True)) for name, pairs in measured.items()}
    return {name: Timing(*pair) for name, pair in columns.items()}


def _time_once(run: Callable[[], Any]) -> tuple[float, float]:
    """Wall-clock and processor seconds of one run."""
    wall, processor = time.perf_counter(), time.process_time()
    run()
    return time.perf_counter() - wall, time.process_time() - processor


@functools.cache
def calibration() -> Callable[[], Any]:
    """A fixed piece of work that shares no code with the filters: reads at scattered places.

    Timed in the same rounds as what is measured, it tells how quick the machine was just then, so
    that runs of different days can be compared.

    Returns:
        A function without arguments that waits for its result.
    """
    table = jnp.asarray(np.random.default_rng(0).random(1 << 16, np.float32))

    @jax.jit
    def work(table: jax.Array) -> jax.Array:
        pixel = jnp.arange(400 * 640, dtype=jnp.int32).reshape(400, 640, 1)
        index = (pixel * 40503 + jnp.arange(32, dtype=jnp.int32) * 30011) & 0xFFFF
        return jnp.sum(jnp.clip(1 - table[index] * table[pixel & 0xFFFF], 0, 1), axis=-1)

    return lambda: work(table).block_until_ready()
