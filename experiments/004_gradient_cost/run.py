"""The cost of gradients of guertin2014, in forward passes and in memory.

    python experiments/004_gradient_cost/run.py -o OUT [--quick]

Measures for each fetch and tile choice: the loss alone; its value and gradient with respect to
kappa, gamma, tau and phi in reverse mode, and in forward mode; and the gradient with respect to
color, depth, velocity and every parameter. The loss is the expected squared error over the tile
choices. All variants run in turn; times are medians without compilation. Writes cost.csv and
cost.md.
"""

import argparse
import csv
import dataclasses
import functools
import itertools
import pathlib
import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from jaxblur.filters.guertin2014 import tile_outcomes

SIZES = ((360, 640), (720, 1280))
FREE = ("kappa", "gamma", "tau", "phi")
COLUMNS = (
    "size",
    "fetch",
    "tile_choice",
    "what",
    "ms",
    "forward_passes",
    "temporary_mb",
    "compile_s",
)


def moving_frame(height: int, width: int) -> jaxblur.Frame:
    """A frame in which every tile moves, in directions that vary smoothly."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    velocity = np.stack([25 * np.cos(y / 80) + 8 * np.sin(x / 50), 20 * np.sin(x / 90)], axis=-1)
    color = np.random.default_rng(0).random((height, width, 3), np.float32)
    depth = 5 + np.sin(x / 33) + np.cos(y / 21)
    return jaxblur.Frame(*(jnp.asarray(buffer) for buffer in (color, depth, velocity)))


def expected_error(settings, parameters, frame, truth):
    """``sum_k P_k |c_k - truth|^2``, the mean over pixels and channels."""
    colors, chances = tile_outcomes(frame, parameters, settings=settings)
    return jnp.mean(jnp.sum(chances[..., None] * (colors - truth) ** 2, axis=0))


def variants(settings):
    """Jitted functions of (parameters, frame, truth), by name."""
    loss = functools.partial(expected_error, settings)

    def of_free(free, parameters, frame, truth):
        return loss(dataclasses.replace(parameters, **free), frame, truth)

    def with_free(derivative):
        def function(parameters, frame, truth):
            free = {name: getattr(parameters, name) for name in FREE}
            return derivative(of_free)(free, parameters, frame, truth)

        return function

    functions = {
        "loss": loss,
        "four parameters, reverse": with_free(jax.value_and_grad),
        "four parameters, forward": with_free(jax.jacfwd),
        "every input, reverse": jax.value_and_grad(loss, argnums=(0, 1)),
    }
    return {name: jax.jit(function) for name, function in functions.items()}


def measure(size, settings, repeats):
    """Measure all variants at one size with one choice of settings: rows of the table."""
    frame = moving_frame(*size)
    parameters = jax.tree.map(jnp.float32, jaxblur.GuertinParameters(tau=0.9))
    arguments = parameters, frame, jnp.zeros_like(frame.color)
    functions, compiled, rows = variants(settings), {}, []
    for name, function in functions.items():
        start = time.perf_counter()
        program = function.lower(*arguments).compile()
        compiled[name] = program, time.perf_counter() - start
        jax.block_until_ready(program(*arguments))
    times = {name: [] for name in functions}
    for _, name in itertools.product(range(repeats), functions):
        start = time.perf_counter()
        jax.block_until_ready(compiled[name][0](*arguments))
        times[name].append(time.perf_counter() - start)
    forward = statistics.median(times["loss"])
    for name, (program, compile_time) in compiled.items():
        median = statistics.median(times[name])
        temporary = program.memory_analysis().temp_size_in_bytes / 1e6
        values = (1e3 * median, median / forward, temporary, compile_time)
        texts = [f"{value:.{digits}f}" for value, digits in zip(values, (0, 2, 0, 1), strict=True)]
        label = f"{size[1]}x{size[0]}"
        rows.append((label, settings.fetch, settings.tile_choice, name, *texts))
        print("  ".join(rows[-1]), flush=True)
    return rows


def write_tables(folder: pathlib.Path, rows) -> None:
    """Write the rows as CSV and as Markdown."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "cost.csv").open("w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *rows])
    lines = [COLUMNS, ["---"] * len(COLUMNS), *rows]
    text = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    (folder / "cost.md").write_text(text, encoding="utf-8")


def main() -> None:
    """Parse the command line, measure, and write the tables."""
    parser = argparse.ArgumentParser(description="The cost of gradients of guertin2014.")
    parser.add_argument("-o", "--output", type=pathlib.Path, required=True, metavar="DIR")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--quick", action="store_true", help="one size, stochastic, 3 repeats")
    options = parser.parse_args()
    sizes = SIZES[:1] if options.quick else SIZES
    choices = ("stochastic",) if options.quick else ("stochastic", "expected")
    repeats = 3 if options.quick else options.repeats
    rows = []
    for size, fetch, choice in itertools.product(sizes, ("nearest", "bilinear"), choices):
        settings = jaxblur.GuertinSettings(fetch=fetch, tile_choice=choice)
        rows += measure(size, settings, repeats)
    write_tables(options.output, rows)


if __name__ == "__main__":
    main()
