"""Recover motion from a blurred frame, and compare the filter with averaged virtual frames.

    python -m experiments.014_inverse.run -o OUT [--only camera,object,shutter,network] [--quick]

For each problem and model: Adam from a start 40 % off, the same for all; the models take their
steps in turn, so that other work on the machine delays all alike. Writes NAME.csv, NAME.md,
NAME_steps.csv and NAME.png, and shutter.md and shutter.png.
"""

import itertools
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

import jaxblur
from experiments import common
from jaxblur import metrics, scenes, show

from . import models, problems

SIZE, QUICK_SIZE = (180, 320), (45, 80)
TRUTH_SAMPLES = 128
WANTED = 0.3
"""Pixels of half-spread."""

SMOOTH = 1e-3
"""The loss is the mean of ``sqrt(d^2 + SMOOTH^2)``: what no motion explains counts little."""

COLORS = 160
"""Of a committed picture."""


class Descent(NamedTuple):
    """What one model reached.

    Attributes:
        unknowns: at the end.
        errors: pixels, before each step and at the end.
        losses: before each step.
        times: seconds of each step, without compilation.
        compiling: seconds of the first call.
    """

    unknowns: Any
    errors: list[float]
    losses: list[float]
    times: list[float]
    compiling: float


def descend(problem: problems.Problem, chosen: Mapping[str, models.Model]) -> dict[str, Descent]:
    """Run the descents of all models, one step of each in turn."""
    color, depth = problem.frame.color, problem.frame.depth
    optimizer = optax.adam(optax.cosine_decay_schedule(problem.rate, problem.steps))
    error = jax.jit(problem.error)

    def step_of(model: models.Model):
        def loss(unknowns: Any) -> jax.Array:
            apart = model(color, depth, problem.path_of(unknowns)) - problem.blurred
            return jnp.mean(jnp.sqrt(apart**2 + SMOOTH**2))

        @jax.jit
        def step(unknowns: Any, state: Any) -> Any:
            value, gradient = jax.value_and_grad(loss)(unknowns)
            change, state = optimizer.update(gradient, state)
            return optax.apply_updates(unknowns, change), state, value

        return step

    found = {}
    for name, model in chosen.items():
        step, state = step_of(model), optimizer.init(problem.start)
        start = time.perf_counter()
        jax.block_until_ready(step(problem.start, state))
        compiling = time.perf_counter() - start
        found[name] = [step, problem.start, state, Descent(None, [], [], [], compiling)]
    for _, name in itertools.product(range(problem.steps), found):
        step, unknowns, state, record = found[name]
        record.errors.append(float(error(unknowns)))
        start = time.perf_counter()
        unknowns, state, value = jax.block_until_ready(step(unknowns, state))
        record.times.append(time.perf_counter() - start)
        record.losses.append(float(value))
        found[name][1:3] = unknowns, state
    results = {}
    for name, (_, unknowns, _, record) in found.items():
        record.errors.append(float(error(unknowns)))
        results[name] = record._replace(unknowns=unknowns)
    return results


def steps_to(errors: list[float], wanted: float) -> int | None:
    """The step from which on the error stays below a bound; None if it does not."""
    above = [i for i, error in enumerate(errors) if error > wanted]
    first = above[-1] + 1 if above else 0
    return first if first < len(errors) else None


def rows_of(descents: Mapping[str, Descent]) -> list[list[Any]]:
    """The table of a problem."""
    rows = []
    for name, record in descents.items():
        steps, median = steps_to(record.errors, WANTED), float(np.median(record.times))
        reached = "-" if steps is None else f"{steps * median:.2f}"
        errors = record.errors[0], record.errors[-1], min(record.errors)
        milliseconds = 1e3 * median, 1e3 * float(np.min(record.times))
        rows.append([name, *errors, steps or "-", *milliseconds, reached, record.compiling])
    return rows


COLUMNS = ["model", "start, px", "end, px", "least, px", f"steps to {WANTED} px", "ms a step"]
COLUMNS += ["fastest step, ms", f"s to {WANTED} px", "compiling, s"]


def write(folder: Path, problem: problems.Problem, descents: Mapping[str, Descent]) -> None:
    """Write the tables and the picture of a problem."""
    common.write_table(folder, problem.name, COLUMNS, rows_of(descents))
    lines = ["step," + ",".join(f'"{name}"' for name in descents)]
    columns = [record.errors for record in descents.values()]
    for i, errors in enumerate(zip(*columns, strict=True)):
        lines.append(f"{i}," + ",".join(f"{error:.4f}" for error in errors))
    (folder / f"{problem.name}_steps.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    figure = show.new_figure(9.5, 4.4)
    rows: Any = figure.subfigures(2, 1, height_ratios=[1.5, 1])
    by_step, by_time = rows[0].subplots(1, 2)
    for name, record in descents.items():
        by_step.plot(record.errors, label=name)
        # Every step of a model does the same work.
        times = float(np.median(record.times)) * np.arange(len(record.errors))
        by_time.plot(times, record.errors, label=name)
    for axes, label in ((by_step, "step"), (by_time, "seconds, without compilation")):
        axes.axhline(WANTED, color="gray", linewidth=0.8, linestyle=":")
        axes.set(xlabel=label, ylabel="error of the flow, px", yscale="log")
        axes.legend(fontsize=7)
    blur = jax.jit(
        lambda unknowns: models.MODELS["layered"](
            problem.frame.color, problem.frame.depth, problem.path_of(unknowns)
        )
    )
    start, end = blur(problem.start), blur(descents["layered"].unknowns)
    pictures = {
        "the true blur": problem.blurred,
        "reblurred, start": start,
        "reblurred, end": end,
        "4 x difference, start | end": jnp.concatenate(
            [
                jnp.abs(4 * (image - problem.blurred))[:, half]
                for image, half in _halves(start, end)
            ],
            axis=1,
        ),
    }
    cells = rows[1].subplots(1, len(pictures))
    for axes, (title, image) in zip(cells, pictures.items(), strict=True):
        axes.imshow(np.asarray(metrics.display(image)))
        axes.set_title(title, fontsize=8)
        axes.set(xticks=[], yticks=[])
    save(figure, folder / f"{problem.name}.png")


def _halves(start: jax.Array, end: jax.Array) -> list[tuple[jax.Array, slice]]:
    half = start.shape[1] // 2
    return [(start, slice(half)), (end, slice(half, None))]


def save(figure: Any, path: Path) -> None:
    """Write a figure with few colors, so that it stays small."""
    from PIL import Image

    figure.savefig(path, dpi=80)
    Image.open(path).convert("RGB").quantize(COLORS, dither=Image.Dither.NONE).save(
        path, optimize=True
    )


def shutter_curve(folder: Path, camera: problems.Problem, size: tuple[int, int], samples: int):
    """Find the curve of a triangular shutter while the motion is known.

    The filter exposes each of ten equal parts of the exposure by itself. These images, and those of
    ten warps, are weighted one by one.
    """
    scene, intrinsics = problems.court(size)
    blurred = scenes.accumulate(scene, 0.0, 1.0, samples, size, "triangle")
    color, depth = camera.frame.color, camera.frame.depth
    edges = jnp.linspace(-1, 1, models.TIMES + 1)

    @jax.jit
    def exposures() -> jax.Array:
        frame = jaxblur.Frame.from_motion(color, depth, path=known_path(depth, 1.0, intrinsics))

        def part(ends: jax.Array) -> jax.Array:
            exposure = jaxblur.Shutter(ends[0], ends[1])
            return jaxblur.layered(frame, jaxblur.LayeredParameters(), exposure=exposure)

        return jax.lax.map(part, jnp.stack([edges[:-1], edges[1:]], axis=1))

    @jax.jit
    def frames() -> jax.Array:
        path = known_path(depth, 1.0, intrinsics)
        return jax.lax.map(lambda t: models.warped(color, path, t), models.times_of())

    position = (np.arange(200) + 0.5) / 100 - 1
    apart = np.digitize(position, np.linspace(-1, 1, models.TIMES + 1)[1:-1])
    basis = models.TIMES * np.eye(models.TIMES)[apart]
    images_by = {"layered": exposures, "10 warps": frames}
    true = 2 * (1 - np.abs(position))
    rows, curves = [], {"true": true}
    for name, images_of in images_by.items():
        jax.block_until_ready(images_of())
        start = time.perf_counter()
        images = jax.block_until_ready(images_of())
        making = time.perf_counter() - start
        curve, descent = _weights(images, blurred, jnp.asarray(basis))
        rows.append([name, np.abs(1 - true).mean(), np.abs(curve - true).mean(), making, descent])
        curves[name] = curve
    columns = ["model", "box, error", "found, error", "making images, s", "descent, s"]
    common.write_table(folder, "shutter", columns, rows)
    figure = show.new_figure(5, 2.6)
    axes = figure.subplots()
    for name, curve in curves.items():
        axes.plot(position / 2, curve, label=name, drawstyle="steps-mid")
    axes.set(xlabel="time, exposures", ylabel="transmission")
    axes.legend()
    save(figure, folder / "shutter.png")


def known_path(depth: jax.Array, share: Any, intrinsics: jaxblur.Intrinsics) -> jax.Array:
    """The path of the known camera during a share of the exposure."""
    return jaxblur.camera_path(depth, problems.TWIST.astype(np.float32), intrinsics, share)


def _weights(images: jax.Array, blurred: jax.Array, basis: jax.Array) -> tuple[np.ndarray, float]:
    """The curve whose weights explain a picture, and the seconds of 300 steps of Adam."""
    optimizer = optax.adam(optax.cosine_decay_schedule(0.1, 300))

    def loss(free: jax.Array) -> jax.Array:
        image = jnp.tensordot(jax.nn.softmax(free), images, 1)
        return jnp.mean(jnp.sqrt((image - blurred) ** 2 + SMOOTH**2))

    def step(carry: Any, _: None) -> tuple[Any, None]:
        free, state = carry
        change, state = optimizer.update(jax.grad(loss)(free), state)
        return (optax.apply_updates(free, change), state), None

    run = jax.jit(lambda c: jax.lax.scan(step, c, None, length=300)[0])
    first = jnp.zeros(len(images))
    first = first, optimizer.init(first)
    jax.block_until_ready(run(first))
    start = time.perf_counter()
    free, _ = jax.block_until_ready(run(first))
    return np.asarray(basis @ jax.nn.softmax(free)), time.perf_counter() - start


def main() -> None:
    """Parse the command line and run the problems."""
    parser = common.output_parser("Motion from a blurred frame.")
    parser.add_argument("--only", default="camera,object,shutter,network", metavar="NAMES")
    parser.add_argument("--models", default=";".join(models.MODELS), metavar="A;B")
    parser.add_argument("--quick", action="store_true", help="80 x 45 and three steps")
    options = parser.parse_args()
    names, chosen = options.only.split(","), options.models.split(";")
    chosen = {name: models.MODELS[name] for name in chosen}
    size, samples = (QUICK_SIZE, 16) if options.quick else (SIZE, TRUTH_SAMPLES)
    steps = 3 if options.quick else 60
    folder = options.output
    camera = problems.camera_problem(size, samples, steps)
    if "camera" in names:
        write(folder, camera, descend(camera, chosen))
        low = problems.camera_problem(size, samples, steps, 0.6)._replace(name="camera_low")
        common.write_table(folder, low.name, COLUMNS, rows_of(descend(low, chosen)))
        first = {"layered": models.MODELS["layered"]}
        known = problems.camera_problem(size, samples, steps, 1.0).start
        own = first["layered"](camera.frame.color, camera.frame.depth, camera.path_of(known))
        own = camera._replace(name="camera_own", blurred=own)
        common.write_table(folder, own.name, COLUMNS, rows_of(descend(own, first)))
    if "object" in names:
        cube = problems.object_problem(size, samples, steps)
        write(folder, cube, descend(cube, chosen))
    if "shutter" in names:
        shutter_curve(folder, camera, size, samples)
    if "network" in names:
        network = problems.network_problem(camera, 3 * steps)
        write(folder, network, descend(network, chosen))


if __name__ == "__main__":
    main()
