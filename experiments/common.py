"""Shared by several experiments: options, frames with their truth, brief fits, tables."""

import argparse
import csv
import dataclasses
import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from jaxblur import exr, scenes
from jaxblur.filters import filter_info
from jaxblur.fitting.constraints import starting_values, to_free
from jaxblur.fitting.descent import State, Task, default_optimizer, descend
from jaxblur.fitting.objective import Objective
from jaxblur.fitting.pairs import make_batches, make_pairs, pixel_weights

GUERTIN = "guertin2014"
FULL_WIDTH = 640
"""Width in pixels of the rendered reference frames."""


class Example(NamedTuple):
    """A sharp frame with its true blur.

    Attributes:
        name: of the scene.
        kind: ``camera``, ``passing`` or ``turning`` for catalogue scenes, else ``cycles``.
        frame: the sharp frame.
        truth: (H, W, 3) linear light.
    """

    name: str
    kind: str
    frame: jaxblur.Frame
    truth: Any


def output_parser(description: str, reference_data: str | None = None) -> argparse.ArgumentParser:
    """Make a parser with the options that most experiments have.

    Args:
        description: of the experiment.
        reference_data: help text of ``--reference-data``; without it there is no such option.

    Returns:
        A parser with ``--output``, a folder that is created if it does not exist, and with
        ``--reference-data`` if it was asked for.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument(
        "-o", "--output", type=_made, required=True, metavar="OUT", help="folder for the results"
    )
    if reference_data:
        parser.add_argument("--reference-data", type=Path, metavar="DIR", help=reference_data)
    return parser


def _made(name: str) -> Path:
    folder = Path(name)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def catalogue_example(
    name: str,
    size: tuple[int, int],
    shutter: float,
    samples: int,
    time: float = 0.0,
    *,
    path: bool = False,
) -> Example:
    """Render a scene of the catalogue, sharp and blurred.

    Args:
        name: a key of `jaxblur.scenes.SCENES`.
        size: (height, width) in pixels.
        shutter: frames.
        samples: images averaged for the truth.
        time: frames.
        path: whether the frame also gets displacements at shutter opening and closing.

    Returns:
        The example; its kind is the name of the module that builds the scene.
    """
    builder = scenes.SCENES[name]
    scene = builder()
    frame = scenes.render(scene, time, shutter, size, path=path)
    truth = scenes.accumulate(scene, time, shutter, samples, size)
    return Example(name, builder.__module__.rpartition("_")[2], frame, truth)


def cycles_examples(folder: Path, width: int, frame: int = 11) -> list[Example]:
    """Read rendered scenes as `full_size_examples` does, but reduced in size, without paths.

    Color is averaged over blocks; depth and velocity are taken from the middle of each block.

    Args:
        folder: as `reference_truths`.
        width: in pixels after the reduction; must divide 640.
        frame: as `reference_truths`.

    Returns:
        One example for each scene.

    Raises:
        SystemExit: as `reference_truths`.
    """
    return [_reduced(example, FULL_WIDTH // width) for example in full_size_examples(folder, frame)]


def full_size_examples(folder: Path, frame: int = 11) -> list[Example]:
    """Read rendered scenes from the folders that `experiments/blender` writes, with curved paths.

    Args:
        folder: as `reference_truths`.
        frame: as `reference_truths`.

    Returns:
        One example for each scene.

    Raises:
        SystemExit: as `reference_truths`.
    """
    return [_full_size(truth) for truth in reference_truths(folder, frame)]


def reference_truths(folder: Path, frame: int = 11) -> list[Path]:
    """Find the true images of rendered scenes.

    Args:
        folder: holds one folder for each scene.
        frame: frame number.

    Returns:
        One file for each scene.

    Raises:
        SystemExit: there is no scene.
    """
    truths = sorted(folder.glob(f"*/truth_{frame:04d}.exr"))
    if not truths:
        raise SystemExit(f"{folder} holds no */truth_{frame:04d}.exr; see experiments/blender.")
    return truths


def reference_shutter(truth: Path) -> float:
    """The shutter of a rendered scene, in frames."""
    camera = json.loads(truth.with_name("camera.json").read_text(encoding="utf-8"))
    return camera["shutter"]


def _full_size(truth: Path) -> Example:
    sharp = truth.with_name(truth.name.replace("truth", "frame"))
    frame = jaxblur.read_frame(sharp, shutter=reference_shutter(truth))
    return Example(truth.parent.name, "cycles", frame, exr.read_image(truth))


def _reduced(example: Example, factor: int) -> Example:
    name, kind, frame, image = example
    middle = slice(factor // 2, None, factor)
    reduced = jaxblur.Frame(
        _block_means(np.asarray(frame.color)[..., :3], factor),
        jnp.asarray(frame.depth)[middle, middle],
        jnp.asarray(frame.velocity)[middle, middle] / factor,
    )
    return Example(name, kind, reduced, _block_means(np.asarray(image)[..., :3], factor))


def _block_means(image: np.ndarray, factor: int) -> jax.Array:
    height, width, channels = image.shape
    blocks = image.reshape(height // factor, factor, width // factor, factor, channels)
    return jnp.asarray(blocks.mean(axis=(1, 3)), jnp.float32)


class Refit(NamedTuple):
    """Result of `refit`.

    Attributes:
        parameters: all of them, by name.
        losses: the loss before each step.
    """

    parameters: dict[str, float]
    losses: tuple[float, ...]


def refit(
    examples: Sequence[Example],
    settings: jaxblur.GuertinSettings,
    free: Sequence[str],
    fixed: Mapping[str, float],
    steps: int,
    seed: int = 0,
) -> Refit:
    """Fit parameters of guertin2014 briefly: Adam from the published values, without scans.

    Minimizes the display error of the pixels that motion reaches. The error is the expected value
    over the choice of tile; the jitter is new at each step. Compiles once for each combination of
    settings and free parameters.

    Args:
        examples: all of one size.
        settings: settings of the filter.
        free: names of the parameters to fit; if empty, nothing is fitted.
        fixed: values that replace published ones.
        steps: number of steps of Adam.
        seed: seed of the noise.

    Returns:
        All parameters, and the loss before each step.
    """
    values = filter_info(GUERTIN).defaults | dict(fixed)
    if not free:
        return Refit(values, ())
    start = values | starting_values(GUERTIN, {name: values[name] for name in free})
    objective = Objective(
        filter_name=GUERTIN,
        free=tuple(free),
        pixel="display",
        over="expected" if settings.tile_choice == "stochastic" else "mean",
        settings=settings,
        noise="fresh",
        noise_draws=1,
    )
    pairs = make_pairs([(e.frame, e.truth) for e in examples], [e.name for e in examples])
    batches = make_batches(pairs, pixel_weights(pairs, "moving", "display"))
    held = {name: value for name, value in start.items() if name not in free}
    task = Task(objective, held, batches, jax.random.key(seed))
    optimizer = default_optimizer(steps)
    vector = to_free(GUERTIN, start, free)
    final, interrupted = descend(task, State(vector, optimizer.init(vector)), steps, optimizer)
    if interrupted:
        raise KeyboardInterrupt
    return Refit(task.parameters(final.free), final.losses)


def mosaic(examples: Sequence[Example], columns: int) -> jaxblur.Frame:
    """Arrange frames of one size in a grid: a larger frame to measure time on.

    Args:
        examples: their frames are repeated until the grid is full.
        columns: number of frames in a row; the grid has as many rows.

    Returns:
        One frame.
    """

    def laid_out(*buffers: jax.Array) -> jax.Array:
        repeated = itertools.islice(itertools.cycle(buffers), columns**2)
        rows = [itertools.islice(repeated, columns) for _ in range(columns)]
        return jnp.concatenate([jnp.concatenate(list(row), axis=1) for row in rows], axis=0)

    plain = [dataclasses.replace(example.frame, path=None) for example in examples]
    return jax.tree.map(laid_out, *plain)


def mean_and_interval(values: Iterable[float]) -> tuple[float, float]:
    """Mean, and half the width of its 95 % confidence interval by Student's t.

    Args:
        values: two or more independent values.

    Returns:
        The mean and the half width.
    """
    from scipy import stats

    array = np.asarray(list(values), float)
    error = array.std(ddof=1) / np.sqrt(array.size)
    return float(array.mean()), float(stats.t.ppf(0.975, array.size - 1) * error)


def write_table(folder: Path, name: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]):
    """Write a table as CSV and as Markdown, and print it.

    Args:
        folder: folder of both files.
        name: name of both files, without suffix.
        columns: column headings.
        rows: cells; floats have all their digits in CSV and three decimals in Markdown.
    """
    with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])
    lines = [columns, ["---"] * len(columns), *[[_cell(value) for value in row] for row in rows]]
    text = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    (folder / f"{name}.md").write_text(text, encoding="utf-8")
    print(text)


def _cell(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)
