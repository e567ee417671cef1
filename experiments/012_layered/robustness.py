"""Does `layered` flicker, and are its tiles visible?

    python -m experiments.012_layered.robustness -o OUT

Flicker, on sequences of eight frames: RMS of the change of a filter's error from frame to frame, in
display values (`jaxblur.metrics.temporal_difference_error`), with the built-in noise, which is the
same in every frame, and with new noise in each frame; beside it the change of the truth itself.
Seams, on scenes that turn, over five frames: the tiles are moved over the picture, and the squared
error of pixels on tile borders is divided by that of the same pixels elsewhere. Writes ``flicker``
and ``seams``, ``.csv`` and ``.md``. Seeds are fixed.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments import common
from jaxblur import metrics
from jaxblur.filters import FILTERS, filter_info
from jaxblur.fitting.objective import draw_noise

SEAM_PERIOD = 8
"""Pixels between the lines at which a seam is looked for."""
SCENES = ("cube_between_crates", "gears", "rotation_stress", "flagpole", "camera_dolly", "crossing")
SIZE, SHUTTER, TRUTH_SAMPLES, FRAMES = (90, 160), 1.0, 96, 8
BLURS = ("layered", "guertin2014")
TURNING, SEAM_SIZE, SEAM_FRAMES = ("gears", "rotation_stress"), (184, 320), 5


def blur(name: str, frame: jaxblur.Frame, seed: int | None) -> Any:
    """Display values of a filter as published, with built-in noise or with noise from a seed."""
    info = filter_info(name)
    parameters, settings = info.make_parameters(), info.settings
    noise = None if seed is None else draw_noise(jax.random.key(seed), SIZE)
    return metrics.display(FILTERS[name](frame, parameters, settings=settings, noise=noise))


def rows_of(name: str) -> list[list[Any]]:
    """One row for each filter, and one for the sharp frames."""
    times = (np.arange(FRAMES) - (FRAMES - 1) / 2).tolist()
    examples = [common.catalogue_example(name, SIZE, SHUTTER, TRUTH_SAMPLES, t) for t in times]
    truths = jnp.stack([metrics.display(example.truth) for example in examples])
    motion = float(jnp.sqrt(jnp.mean(jnp.square(jnp.diff(truths, axis=0)))))

    def flicker(images: list[Any]) -> float:
        pairs = metrics.temporal_difference_error(jnp.stack(images), truths)
        return float(jnp.sqrt(jnp.mean(jnp.square(pairs))))

    rows = []
    for chosen in BLURS:
        still = flicker([blur(chosen, example.frame, None) for example in examples])
        fresh = flicker([blur(chosen, e.frame, seed) for seed, e in enumerate(examples)])
        rows.append([name, chosen, still, fresh, motion])
    sharp = flicker([metrics.display(example.frame.color) for example in examples])
    jax.clear_caches()
    return [*rows, [name, "sharp", sharp, sharp, motion]]


def on_borders(shape: tuple[int, int], size: int) -> np.ndarray:
    """Mask (H, W) of the pixels on the border of a square tile."""
    lines = [np.isin(np.arange(length) % size, (0, size - 1)) for length in shape]
    return lines[0][:, None] | lines[1]


def seam_ratio(
    error: Callable[[tuple[slice, slice]], np.ndarray], picture: tuple[int, int], size: int
) -> float:
    """Error of pixels when they lie on tile borders, divided by their error when they do not.

    The picture is cropped by 0 to size - 1 pixels, which moves the tiles over it, so that every
    pixel lies on a border in some of the crops and not in the others.

    Args:
        error: maps a part of the picture to its errors, (h, w).
        picture: height and width in pixels.
        size: side of a tile in pixels.

    Returns:
        The ratio; 1 if borders have no effect.
    """
    height, width = (length - size for length in picture)
    border = on_borders((height, width), size)
    sums = np.zeros((2, 2))
    for down, right in np.ndindex(size, size):
        # The same pixels of every crop, away from edges, beyond which content is missing.
        inner = (
            slice(3 * size - down, height - 2 * size - down),
            slice(3 * size - right, width - 2 * size - right),
        )
        errors = error(np.s_[down : down + height, right : right + width])[inner]
        for side, chosen in enumerate((border[inner], ~border[inner])):
            sums[side] += errors[chosen].sum(), chosen.sum()
    on, off = sums[:, 0] / sums[:, 1]
    return float(on / off)


def seams_of(name: str, time: float) -> float:
    """The seam ratio of `layered` on one frame of a scene."""
    example = common.catalogue_example(name, SEAM_SIZE, SHUTTER, TRUTH_SAMPLES, time)

    def error(part: tuple[slice, slice]) -> np.ndarray:
        frame = jax.tree.map(lambda image: image[part], example.frame)
        difference = blur("layered", frame, None) - metrics.display(example.truth[part])
        return np.square(np.asarray(difference)).mean(axis=-1)

    return seam_ratio(error, SEAM_SIZE, SEAM_PERIOD)


def seam_row(name: str) -> list[Any]:
    """One row: the mean seam ratio over some frames, and its standard error."""
    ratios = [seams_of(name, time) for time in range(SEAM_FRAMES)]
    jax.clear_caches()
    return [name, float(np.mean(ratios)), float(np.std(ratios, ddof=1) / np.sqrt(SEAM_FRAMES))]


def main() -> None:
    """Render, blur, measure, and write the tables."""
    options = common.output_parser("Measure flicker and seams of layered.").parse_args()
    seams = [seam_row(name) for name in TURNING]
    columns = ["scene", "error on borders of tiles / elsewhere", "standard error"]
    common.write_table(options.output, "seams", columns, seams)
    rows = [row for name in SCENES for row in rows_of(name)]
    columns = ["scene", "method", "same noise", "fresh noise", "change of the truth"]
    common.write_table(options.output, "flicker", columns, rows)


if __name__ == "__main__":
    main()
