"""Causes of the remaining error of `layered`: parts of the filter are replaced by the truth.

    python -m experiments.012_layered.remainder -o OUT [--reference-data DIR] [--quick]

On catalogue scenes the truth is known: curved paths; where in the frame the point lies that is
visible at a given time; and its color at that time, if the frame does not show it. ``remainder.md``
has PSNR in dB of display values, first as the filter runs, then with each of these alone: 350
samples instead of 35; curved paths; where no guess lands, true points that are in the frame
("missed"), and true points that are not ("hidden"). Then these are added one after the other, and
last every point is true, whether a guess lands or not. ``shares.md`` has the share of the squared
error that each removes in that order. The rest is the color of points, which depends on light and
on neighbors in the same pixel.

On rendered scenes (DIR, as ``experiments/blender/render_reference.py`` writes them) ``regions.md``
splits the squared error by region of the picture. Each region excludes those before it:

- unreached: no vector reaches the pixel, so that only light and shadow change there,
- not in the frame: for a tenth of the exposure or more, no guess lands,
- silhouettes: within 1.5 pixels of a jump of depth,
- elsewhere.

``--quick`` takes the first catalogue scene only. Nothing is random.
"""

import argparse
import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import ndimage

import jaxblur
from experiments import common
from jaxblur import metrics, scenes
from jaxblur.filters import filter_info
from jaxblur.filters.layered import layered_with_hidden

SCENES = (
    *("cube_between_crates", "cubes_on_teapot", "flagpole"),
    *("rotor_over_city", "rotation_stress", "crossing"),
)
SIZE, SHUTTER, TRUTH_SAMPLES = (144, 256), 1.0, 192
TIMES, SUBPIXELS, MANY = 33, 8, 350
info = filter_info("layered")
PARAMETERS, SETTINGS = jaxblur.LayeredParameters(), info.settings
XLA = dataclasses.replace(SETTINGS, backend="xla")
MISSING, JUMP = 0.1, 0.05


class Known(NamedTuple):
    """The truth of one exposure, at `TIMES` times spread evenly over it.

    Attributes:
        times: (T,) frames.
        stack: (T, H, W, 3) sharp images, linear light.
    """

    times: np.ndarray
    stack: np.ndarray


def known(scene: scenes.Scene) -> Known:
    """Render the sharp images."""
    times = SHUTTER * ((np.arange(TIMES) + 0.5) / TIMES - 0.5)
    images = [scenes.accumulate(scene, float(t), 0.0, SUBPIXELS, SIZE) for t in times]
    return Known(times, np.stack(images))


def told(stack: np.ndarray | jax.Array, frame: jaxblur.Frame, samples: int) -> jax.Array:
    """Run the filter; where no guess lands, take the color from a stack of sharp images.

    Args:
        stack: (T, H, W, 3) linear light at times spread evenly over the exposure; NaN leaves the
            filter's own color.
        frame: frame to blur.
        samples: samples of the filter.

    Returns:
        (H, W, 3) linear light.
    """
    settings = dataclasses.replace(XLA, samples=samples)
    return layered_with_hidden(frame, PARAMETERS, stack, settings=settings)


def missing(frame: jaxblur.Frame) -> np.ndarray:
    """Share of the exposure for which no guess lands, (H, W)."""
    color = jnp.asarray(frame.color)
    black = dataclasses.replace(frame, color=jnp.zeros_like(color))
    return np.asarray(told(jnp.ones((1, *color.shape)), black, SETTINGS.samples))[..., 0]


def run(frame: jaxblur.Frame, samples: int) -> jax.Array:
    """Run the filter."""
    return jaxblur.layered(frame, PARAMETERS, settings=dataclasses.replace(XLA, samples=samples))


def points_in_frame(scene: scenes.Scene, frame: jaxblur.Frame, truth: Known) -> np.ndarray:
    """Colors, by the sharp frame, of the points visible at each time: (T, H, W, 3).

    The color is NaN if the frame does not show the point. The frame shows it if the same object is
    at the point's position in the frame, and the motion from there leads back to within a pixel.
    """
    objects = np.asarray(scenes.object_ids(scene, 0.0, SIZE))
    color = np.moveaxis(np.asarray(frame.color), -1, 0)
    images = []
    for time in truth.times.tolist():
        way = np.asarray(scenes.displacement(scene, time, -time, SIZE))
        back = np.asarray(scenes.displacement(scene, 0.0, time, SIZE))
        x, y = np.moveaxis(way, -1, 0) + np.mgrid[: SIZE[0], : SIZE[1]][::-1]
        row, column = (np.floor(place + 0.5).astype(int) for place in (y, x))
        inside = (row >= 0) & (row < SIZE[0]) & (column >= 0) & (column < SIZE[1])
        row, column = np.where(inside, row, 0), np.where(inside, column, 0)
        same = objects[row, column] == np.asarray(scenes.object_ids(scene, time, SIZE))
        returns = np.linalg.norm(back[row, column] + way, axis=-1) < 1
        read = [ndimage.map_coordinates(c, (y, x), order=1, mode="nearest") for c in color]
        seen = (inside & same & returns)[..., None]
        images.append(np.where(seen, np.stack(read, axis=-1), np.nan))
    return np.stack(images).astype(np.float32)


def mse(image: Any, truth: Any) -> float:
    """Mean squared error of display values."""
    return float(metrics.mse(metrics.display(image), metrics.display(truth)))


def decibel(error: float) -> float:
    """PSNR in dB of a mean squared error of display values."""
    return -10 * float(np.log10(error))


def catalogue_errors(name: str) -> dict[str, float]:
    """Squared errors on one scene, by which parts of the filter are replaced by the truth."""
    scene = scenes.SCENES[name]()
    curved = scenes.render(scene, 0.0, SHUTTER, SIZE, path=True)
    straight = dataclasses.replace(curved, path=None)
    image = scenes.accumulate(scene, 0.0, SHUTTER, TRUTH_SAMPLES, SIZE)
    truth = known(scene)
    points = points_in_frame(scene, straight, truth)
    everything = np.where(np.isfinite(points), points, truth.stack)
    usual = SETTINGS.samples
    images = {
        "as it runs": run(straight, usual),
        "samples": run(straight, MANY),
        "paths": run(curved, usual),
        "missed": told(points, straight, usual),
        "hidden": told(np.where(np.isfinite(points), np.nan, truth.stack), straight, usual),
        "samples and paths": run(curved, MANY),
        "and missed": told(points, curved, MANY),
        "and hidden": told(everything, curved, MANY),
        "and every point": everything.mean(axis=0),
    }
    jax.clear_caches()
    return {part: mse(shown, image) for part, shown in images.items()}


def ladder(errors: dict[str, float]) -> list[float]:
    """Share of the squared error that each part removes, when added to those before it."""
    steps = ("as it runs", "samples", "samples and paths", "and missed", "and hidden")
    left = [errors[step] / errors[steps[0]] for step in (*steps, "and every point")]
    return [before - after for before, after in itertools.pairwise(left)] + left[-1:]


def regions(frame: jaxblur.Frame) -> dict[str, np.ndarray]:
    """Masks (H, W) of the regions in the module docstring, by name."""
    log_depth = np.log(np.minimum(np.asarray(frame.depth), 1e9))
    around = ndimage.maximum_filter(log_depth, 3) - ndimage.minimum_filter(log_depth, 3)
    parts = {
        "unreached": ~metrics.motion_footprint(frame),
        "not in the frame": missing(frame) >= MISSING,
        # The 3 x 3 neighborhood reaches 1.5 pixels from the jump.
        "silhouettes": around > JUMP,
        "elsewhere": np.ones_like(log_depth, bool),
    }
    taken = np.zeros_like(log_depth, bool)
    for name, part in parts.items():
        parts[name], taken = part & ~taken, taken | part
    return parts


def region_rows(example: common.Example) -> list[list[Any]]:
    """One row for each region of a rendered scene: shares of pixels and of the error."""
    shown = [metrics.display(image) for image in (run(example.frame, 35), example.truth)]
    error = np.square(np.asarray(shown[0]) - np.asarray(shown[1])).mean(axis=-1)
    rows = []
    for name, part in regions(example.frame).items():
        share = float(error[part].sum() / error.sum())
        inside = decibel(error[part].mean()) if part.any() else float("nan")
        rows.append([example.name, name, 100 * float(part.mean()), 100 * share, inside])
    jax.clear_caches()
    return rows


def write_catalogue(output: Path, names: Sequence[str]) -> None:
    """Measure catalogue scenes and write the two tables."""
    errors = {}
    for name in names:
        errors[name] = catalogue_errors(name)
        print(name, *(f"{part} {decibel(e):.2f}" for part, e in errors[name].items()), flush=True)
    parts = list(next(iter(errors.values())))
    rows = [[name, *map(decibel, row.values())] for name, row in errors.items()]
    rows.append(["mean", *np.mean([row[1:] for row in rows], axis=0).tolist()])
    common.write_table(output, "remainder", ["scene", *parts], rows)
    heads = ["noise of 35 samples", "bends", "missed", "hidden", "wrong guesses", "color"]
    shares = [[name, *(100 * s for s in ladder(row))] for name, row in errors.items()]
    shares.append(["mean", *np.mean([row[1:] for row in shares], axis=0).tolist()])
    common.write_table(output, "shares", ["scene", *(f"{head}, %" for head in heads)], shares)


def main() -> None:
    """Measure and write the tables."""
    parser = argparse.ArgumentParser(description="Causes of the remaining error of layered.")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT")
    parser.add_argument(
        "--reference-data", type=Path, metavar="DIR", help="split errors on these too"
    )
    parser.add_argument("--quick", action="store_true", help="the first catalogue scene only")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    write_catalogue(options.output, SCENES[: 1 if options.quick else None])
    if options.reference_data:
        examples = common.full_size_examples(options.reference_data)
        rows = [row for example in examples for row in region_rows(example)]
        columns = ["scene", "region", "pixels, %", "squared error, %", "PSNR there, dB"]
        common.write_table(options.output, "regions", columns, rows)


if __name__ == "__main__":
    main()
