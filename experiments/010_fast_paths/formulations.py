"""How XLA:CPU takes one gather written in different ways: what was tried before native code.

    python -m experiments.010_fast_paths.formulations [--samples N] [--repeats N]

The sum over samples of guertin2014 (nearest fetch, 1280x720, every tile moving), as one reduction
over the last axis, with lanes of samples or of pixels beside it, row by row, in chunks, unrolled,
one sample after the other, and with fast-math. Prints temporaries, the largest difference from the
first, and times taken in turn.
"""

import argparse
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jaxblur.bench.frames import moving_frame
from jaxblur.bench.timing import time_in_turn

HEIGHT, WIDTH = 720, 1280
LANES = 8
Planes = dict[str, jax.Array]


def make_planes() -> Planes:
    """What a pixel knows of itself and what its taps read."""
    frame = moving_frame(HEIGHT, WIDTH)
    x, y = frame.velocity[..., 0], frame.velocity[..., 1]
    speed = jnp.hypot(x, y)
    colors = {f"color{c}": frame.color[..., c] for c in range(3)}
    return {"x": x / speed, "y": y / speed, "inverse": 1 / speed, "depth": frame.depth} | colors


def terms(index: Any, count: int, planes: Planes, row: Any, column: Any, own: Callable) -> tuple:
    """Weighted color, weight and count of a tap; ``own`` gives a pixel's plane its axes."""
    x, y, inverse, depth = (own(planes[name]) for name in ("x", "y", "inverse", "depth"))
    along = (2 * (index + 1) - (count + 1)) / (count + 1) * 39.0
    second = index % 2 == 1
    direction = jnp.where(second, x, 0.8), jnp.where(second, y, 0.6)
    tap_x = column + jnp.floor(along * direction[0] + 0.5).astype(jnp.int32)
    tap_y = row + jnp.floor(along * direction[1] + 0.5).astype(jnp.int32)
    inside = (tap_x >= 0) & (tap_x < WIDTH) & (tap_y >= 0) & (tap_y < HEIGHT)
    texel = jnp.clip(tap_y, 0, HEIGHT - 1) * WIDTH + jnp.clip(tap_x, 0, WIDTH - 1)
    read = {
        name: plane.reshape(-1).at[texel].get(mode="promise_in_bounds")
        for name, plane in planes.items()
    }
    along_pixel = jnp.where(second, 1, jnp.abs(0.8 * x + 0.6 * y))
    along_sample = jnp.abs(read["x"] * direction[0] + read["y"] * direction[1])
    distance = jnp.abs(along)
    gap = jnp.clip((depth - read["depth"]) / jnp.minimum(depth, read["depth"]), -1, 1)
    slower = jnp.maximum(read["inverse"], inverse)
    weight = (
        (1 + jnp.minimum(gap, 0)) * jnp.clip(1 - distance * read["inverse"], 0, 1) * along_sample
        + (1 - jnp.maximum(gap, 0)) * jnp.clip(1 - distance * inverse, 0, 1) * along_pixel
        + 2 * jnp.clip(10.5 - 10 * distance * slower, 0, 1) * jnp.maximum(along_pixel, along_sample)
    )
    weight = jnp.where(inside, weight, 0)
    colors = (weight * read[f"color{c}"] for c in range(3))
    return (*colors, weight, inside.astype(jnp.float32))


def places(rank: int, row_axis: int, column_axis: int) -> tuple[jax.Array, jax.Array]:
    """Row and column of every pixel, each along its axis."""
    shape = [1] * rank
    shape[row_axis], shape[column_axis] = HEIGHT, WIDTH
    iota = functools.partial(lax.broadcasted_iota, jnp.int32, tuple(shape))
    return iota(row_axis), iota(column_axis)


def add(totals: tuple, more: tuple) -> tuple:
    """Term by term."""
    return tuple(a + b for a, b in zip(totals, more, strict=True))


def reduce(values: tuple, axis: int) -> tuple:
    """All terms in one reduction."""
    return tuple(lax.reduce(values, (jnp.float32(0),) * len(values), add, (axis,)))


def zeros() -> tuple:
    """Sums of nothing."""
    return tuple(jnp.zeros((HEIGHT, WIDTH)) for _ in range(5))


def one_reduction(planes: Planes, count: int) -> tuple:
    """Samples on the last axis: what the filters do without native code."""
    row, column = places(3, 0, 1)
    sums = terms(jnp.arange(count), count, planes, row, column, lambda p: p[..., None])
    return reduce(sums, 2)


def samples_first(planes: Planes, count: int) -> tuple:
    """Samples between rows and columns."""
    row, column = places(3, 0, 2)
    index = jnp.arange(count)[:, None]
    return reduce(terms(index, count, planes, row, column, lambda p: p[:, None]), 1)


def sample_lanes(planes: Planes, count: int) -> tuple:
    """Eight samples beside one another, summed at the end."""
    row, column = places(4, 0, 1)
    index = jnp.arange(-(-count // LANES) * LANES).reshape(-1, LANES)
    sums = terms(index, count, planes, row, column, lambda p: p[..., None, None])
    sums = tuple(jnp.where(index < count, value, 0) for value in sums)
    return tuple(jnp.sum(value, axis=-1) for value in reduce(sums, 2))


def pixel_lanes(planes: Planes, count: int) -> tuple:
    """Eight pixels beside one another on the last axis."""
    shape = (HEIGHT, WIDTH // LANES, 1, LANES)
    row, column = (place.reshape(shape) for place in jnp.mgrid[:HEIGHT, :WIDTH])
    index = jnp.arange(count)[:, None]
    sums = reduce(terms(index, count, planes, row, column, lambda p: p.reshape(shape)), 2)
    return tuple(value.reshape(HEIGHT, WIDTH) for value in sums)


def chunks(planes: Planes, count: int) -> tuple:
    """Five samples at a time in a loop."""
    row, column = places(3, 0, 2)

    def body(k: jax.Array, totals: tuple) -> tuple:
        index = 5 * k + jnp.arange(5)[:, None]
        values = terms(index, count, planes, row, column, lambda p: p[:, None])
        return add(totals, reduce(values, 1))

    return lax.fori_loop(0, count // 5, body, zeros())


def one_by_one(planes: Planes, count: int) -> tuple:
    """A loop over samples; each sum is an operation of its own."""
    row, column = places(2, 0, 1)

    def body(index: jax.Array, totals: tuple) -> tuple:
        return add(totals, terms(index, count, planes, row, column, lambda p: p))

    return lax.fori_loop(0, count, body, zeros())


FORMULATIONS: dict[str, tuple[Callable[..., tuple], dict[str, Any]]] = {
    "one reduction": (one_reduction, {}),
    "one reduction, fast-math": (one_reduction, {"xla_cpu_enable_fast_math": True}),
    "samples before columns": (samples_first, {}),
    "lanes of samples": (sample_lanes, {}),
    "lanes of pixels": (pixel_lanes, {}),
    "chunks of five": (chunks, {}),
    "one by one": (one_by_one, {}),
}


def main() -> None:
    """Parse the command line, compile, time in turn, print."""
    parser = argparse.ArgumentParser(description="One gather, written in different ways.")
    parser.add_argument("--samples", type=int, default=35)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    planes = make_planes()
    runs, notes = {}, {}
    expected = None
    for name, (function, flags) in FORMULATIONS.items():
        lowered = jax.jit(functools.partial(function, count=options.samples)).lower(planes)
        program = lowered.compile(compiler_options=flags or None)
        result = program(planes)
        expected = result if expected is None else expected
        difference = max(
            float(jnp.max(jnp.abs(a - b))) for a, b in zip(result, expected, strict=True)
        )
        memory = program.memory_analysis()
        size = float("nan") if memory is None else memory.temp_size_in_bytes / 1e6
        notes[name] = f"{size:.0f} MB, differs by {difference:.1g}"
        runs[name] = functools.partial(lambda run: jax.block_until_ready(run(planes)), program)
    for name, timing in time_in_turn(runs, options.repeats).items():
        cpu, wall = 1e3 * timing.cpu_median, 1e3 * timing.median
        print(f"{name:28} {wall:6.0f} ms {cpu:6.0f} CPU ms  {notes[name]}", flush=True)


if __name__ == "__main__":
    main()
