"""FXAA and MLAA against 256 samples a pixel: error, time, and what they do to the noise of a blur.

    python -m experiments.017_antialiasing.run -o OUT [--quick | --times]

Writes error.csv and .md, scenes.csv and .md, found.csv and .md (edges), noise.csv and .md, time.csv
and .md, edges.png and vegetation.png.
"""

import argparse
import time
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments.common import output_parser, write_table
from experiments.pictures import contact_sheet, write_png
from jaxblur import metrics, posts, scenes
from jaxblur.noise import make_noise

from .vegetation import vegetation

VEGETATION = "vegetation"
SCENES = ("wheels_at_three_depths", "gears", "flagpole", "rotor_over_city", "random_cubes")
SIZE = (180, 320)
LARGE = (720, 1280)
SAMPLES = (2, 4, 8, 16)
CUTS = {
    SCENES[0]: (slice(40, 100), slice(110, 190)),
    VEGETATION: (slice(75, 135), slice(110, 190)),
}
"""Scenes of which a part is shown."""
TIMED = ("random_cubes", VEGETATION)
REPEATS = 25
"""Of each time."""
THRESHOLD = 0.1
"""Of an edge, as `posts.MLAAParameters` has it for luma and depth."""

METHODS: dict[str, Callable[[jaxblur.Frame], Any]] = {
    "1 sample": lambda frame: frame.color,
    "FXAA 12": lambda frame: posts.fxaa(frame.color, quality=12),
    "FXAA 39": lambda frame: posts.fxaa(frame.color),
    "MLAA luma, search 4": lambda frame: posts.mlaa(frame.color, search=4),
    "MLAA luma, search 8": lambda frame: posts.mlaa(frame.color, search=8),
    "MLAA luma, search 12": lambda frame: posts.mlaa(frame.color),
    "MLAA luma, search 24": lambda frame: posts.mlaa(frame.color, search=24),
    "MLAA depth, search 12": lambda frame: posts.mlaa(frame.color, frame, "depth"),
    "MLAA luma, search 12, soft 0.1": lambda frame: posts.mlaa(frame.color, softness=0.1),
}


def make(name: str) -> scenes.Scene:
    """A scene of the catalogue, or the vegetation."""
    return vegetation() if name == VEGETATION else scenes.SCENES[name]()


def errors(names: tuple[str, ...]) -> tuple[list[dict[str, Any]], dict[str, dict[str, Any]]]:
    """Score every method on every scene; the images of each scene, by method."""
    rows, images = [], {}
    for name in names:
        scene = make(name)
        frame = scenes.render(scene, 0, 0, SIZE, subpixels=1)
        made = {method: run(frame) for method, run in METHODS.items()}
        made |= {f"{n} samples": scenes.accumulate(scene, 0, 0, n, SIZE) for n in SAMPLES}
        truth = scenes.accumulate(scene, 0, 0, 256, SIZE)
        for method, image in made.items():
            score = metrics.compare(metrics.rgb(image), metrics.rgb(truth))
            rows.append({"scene": name, "method": method, **score._asdict()})
        images[name] = made | {"256 samples": truth}
    return rows, images


def means(rows: list[dict[str, Any]], scores: tuple[str, ...]) -> list[tuple[Any, ...]]:
    """The mean of each method over the scenes of the catalogue, and its scores on vegetation."""
    methods = dict.fromkeys(row["method"] for row in rows)
    found = []
    for method in methods:
        of_method = [row for row in rows if row["method"] == method]
        catalogue = [row for row in of_method if row["scene"] != VEGETATION]
        (alone,) = (row for row in of_method if row["scene"] == VEGETATION)
        mean = (np.mean([row[score] for row in catalogue]) for score in scores)
        values = (*mean, *(alone[score] for score in scores))
        found.append((method, *(f"{value:.4f}" for value in values)))
    return found


def edges_found(names: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Edges by luma and by depth, percent of all boundaries between pixels, at the larger size."""
    rows = []
    for name in names:
        frame = scenes.render(make(name), 0, 0, LARGE, subpixels=1)
        luma = np.asarray(posts.perceived_luma(frame.color))
        nearness = 1 / np.asarray(frame.depth)
        shares = []
        for plane, relative in ((luma, False), (nearness, True)):
            edges = 0
            for one, other in ((plane[1:], plane[:-1]), (plane[:, 1:], plane[:, :-1])):
                scale = np.maximum(np.maximum(one, other), 1e-9) if relative else 1
                edges += np.sum(np.abs(one - other) >= THRESHOLD * scale)
            shares.append(100 * edges / (2 * plane.size))
        rows.append((name, *(f"{share:.1f}" for share in shares)))
    return rows


def noise(names: tuple[str, ...]) -> list[tuple[Any, ...]]:
    """What antialiasing does to the noise of guertin2014, where the filter blurs.

    Noise is the difference from the mean of 16 blurs with other noise, and the error that from the
    truth, both as PSNR on a display; the last column is that of the truth alone.
    """
    total: dict[str, list[tuple[float, float]]] = {}
    settings = jaxblur.GuertinSettings(samples=15, radius=40)
    parameters = jaxblur.GuertinParameters()
    for name in names:
        scene = scenes.SCENES[name]()
        frame = scenes.render(scene, 0, 1.0, SIZE)
        truth = metrics.display(scenes.accumulate(scene, 0, 1.0, 256, SIZE))
        blurs = [
            jaxblur.guertin2014(
                frame, parameters, settings=settings, noise=make_noise("ign", *SIZE, seed)
            )
            for seed in range(16)
        ]
        mean = metrics.display(jnp.mean(jnp.stack(blurs), axis=0))
        hint = jaxblur.luma_hint(frame, parameters, settings=settings)
        moving = np.isin(np.asarray(hint), (0, 1))
        images: Mapping[str, Any] = {
            "the blur": blurs[0],
            "FXAA": posts.fxaa(blurs[0]),
            "FXAA with the hint": posts.fxaa(blurs[0], hint),
            "MLAA luma": posts.mlaa(blurs[0]),
        }
        for method, image in images.items():
            shown = metrics.display(image)
            values = [
                float(-10 * np.log10(np.mean(np.asarray(shown - other)[moving] ** 2)))
                for other in (mean, truth)
            ]
            total.setdefault(method, []).append((values[0], values[1]))
    return [
        (method, *(f"{value:.2f}" for value in np.mean(values, axis=0)))
        for method, values in total.items()
    ]


def times(names: tuple[str, ...], repeats: int) -> list[tuple[Any, ...]]:
    """Processor time on a frame of each scene at 1280x720, median of several in turn."""
    frames = {name: scenes.render(make(name), 0, 0, LARGE, subpixels=1) for name in names}
    frames = jax.tree.map(jnp.asarray, frames)
    methods = {method: run for method, run in METHODS.items() if method != "1 sample"}
    spent: dict[tuple[str, str], list[float]] = {}
    for run in methods.values():
        jax.block_until_ready(run(frames[names[0]]))
    for _ in range(repeats):
        for method, run in methods.items():
            for name, frame in frames.items():
                started = time.process_time()
                jax.block_until_ready(run(frame))
                spent.setdefault((method, name), []).append(time.process_time() - started)
    return [
        (method, *(f"{1000 * np.median(spent[method, name]):.1f}" for name in names))
        for method in methods
    ]


def enlarged(image: Any, cut: tuple[slice, slice]) -> np.ndarray:
    """A part of an image, every pixel three wide."""
    return np.asarray(image)[cut].repeat(3, axis=0).repeat(3, axis=1)


def main() -> None:
    """Run the experiment."""
    parser = output_parser("Antialiasing against 256 samples a pixel.")
    parts = parser.add_mutually_exclusive_group()
    parts.add_argument("--quick", action="store_true", help="three scenes")
    parts.add_argument("--times", action="store_true", help="times alone")
    arguments = parser.parse_args()
    if not arguments.times:
        write_errors(arguments)
    columns = ("method", *(f"{name}, CPU ms" for name in TIMED))
    write_table(arguments.output, "time", columns, times(TIMED, REPEATS))


def write_errors(arguments: argparse.Namespace) -> None:
    """Write everything but times."""
    moving = SCENES[:2] if arguments.quick else SCENES
    names = (*moving, VEGETATION)
    rows, images = errors(names)
    scores = ("psnr", "ssim", "flip")
    both = (*scores, *(f"{VEGETATION}: {score}" for score in scores))
    write_table(arguments.output, "error", ("method", *both), means(rows, scores))
    each = [(row["scene"], row["method"], *(f"{row[s]:.4f}" for s in scores)) for row in rows]
    write_table(arguments.output, "scenes", ("scene", "method", *scores), each)
    picks = (
        ("1 sample", "FXAA 39", "MLAA luma, search 12"),
        ("4 samples", "8 samples", "256 samples"),
    )
    for name, picture in zip(CUTS, ("edges.png", "vegetation.png"), strict=True):
        shown, cut = images[name], CUTS[name]
        sheet = contact_sheet([[enlarged(shown[pick], cut) for pick in row] for row in picks])
        write_png(arguments.output / picture, sheet)
    columns = ("scene", "luma, % of boundaries", "depth, % of boundaries")
    write_table(arguments.output, "found", columns, edges_found(names))
    columns = ("image", "PSNR to the mean of 16 blurs", "PSNR to the truth")
    write_table(arguments.output, "noise", columns, noise(moving))


if __name__ == "__main__":
    main()
