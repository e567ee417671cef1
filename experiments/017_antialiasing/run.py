"""FXAA and MLAA against 256 samples a pixel: error, time, and what they do to the noise of a blur.

    python -m experiments.017_antialiasing.run -o OUT [--quick]

Writes error.csv and .md, noise.csv and .md, time.csv and .md, and edges.png.
"""

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

SCENES = ("wheels_at_three_depths", "gears", "flagpole", "rotor_over_city", "random_cubes")
SIZE = (180, 320)
LARGE = (720, 1280)
SAMPLES = (2, 4, 8, 16)
CUT = (slice(40, 100), slice(110, 190))

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


def errors(names: tuple[str, ...]) -> tuple[list[dict[str, Any]], dict[str, dict[str, Any]]]:
    """Score every method on every scene; the images of each scene, by method."""
    rows, images = [], {}
    for name in names:
        scene = scenes.SCENES[name]()
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
    """The mean of each method over the scenes."""
    methods = dict.fromkeys(row["method"] for row in rows)
    return [
        (
            method,
            *(
                f"{np.mean([row[score] for row in rows if row['method'] == method]):.4f}"
                for score in scores
            ),
        )
        for method in methods
    ]


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


def times(repeats: int) -> list[tuple[Any, ...]]:
    """Processor time on a frame of 1280x720, least of several in turn."""
    frame = scenes.render(scenes.SCENES["random_cubes"](), 0, 0, LARGE, subpixels=1)
    frame = jax.tree.map(jnp.asarray, frame)
    methods = {name: run for name, run in METHODS.items() if name != "1 sample"}
    spent: dict[str, list[float]] = {name: [] for name in methods}
    for run in methods.values():
        jax.block_until_ready(run(frame))
    for _ in range(repeats):
        for name, run in methods.items():
            started = time.process_time()
            jax.block_until_ready(run(frame))
            spent[name].append(time.process_time() - started)
    return [(name, f"{1000 * min(values):.1f}") for name, values in spent.items()]


def enlarged(image: Any) -> np.ndarray:
    """A part of an image, every pixel three wide."""
    return np.asarray(image)[CUT].repeat(3, axis=0).repeat(3, axis=1)


def main() -> None:
    """Run the experiment."""
    parser = output_parser("Antialiasing against 256 samples a pixel.")
    parser.add_argument("--quick", action="store_true", help="two scenes")
    arguments = parser.parse_args()
    names = SCENES[:2] if arguments.quick else SCENES
    rows, images = errors(names)
    scores = ("psnr", "ssim", "flip")
    write_table(arguments.output, "error", ("method", *scores), means(rows, scores))
    each = [(row["scene"], row["method"], *(f"{row[s]:.4f}" for s in scores)) for row in rows]
    write_table(arguments.output, "scenes", ("scene", "method", *scores), each)
    shown = images[names[0]]
    picks = (
        ("1 sample", "FXAA 39", "MLAA luma, search 12"),
        ("4 samples", "8 samples", "256 samples"),
    )
    sheet = contact_sheet([[enlarged(shown[name]) for name in row] for row in picks])
    write_png(arguments.output / "edges.png", sheet)
    columns = ("image", "PSNR to the mean of 16 blurs", "PSNR to the truth")
    write_table(arguments.output, "noise", columns, noise(names))
    write_table(arguments.output, "time", ("method", "CPU ms"), times(7))


if __name__ == "__main__":
    main()
