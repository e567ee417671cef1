"""Does `layered` flicker, and do its tiles show?

    python -m experiments.012_layered.robustness -o OUT

Flicker, on sequences of eight frames: the RMS over pixels of how the error of a filter changes from
frame to frame, in display values (`jaxblur.metrics.temporal_difference_error`), with the built-in
noise, which is the same in every frame, and with noise drawn anew for each; and how much the truth
itself changes. Seams, on scenes that turn: squared error on the borders of the tiles against
elsewhere, and the range of that ratio for the same grid in other places, which is what chance
gives; over five frames. Writes ``flicker`` and ``seams``, ``.csv`` and ``.md``. Seeds are fixed.
"""

import argparse
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments import common
from jaxblur import metrics
from jaxblur.filters import FILTERS, PUBLISHED
from jaxblur.filters.reaching import fine_tile
from jaxblur.fitting.objective import draw_noise

SCENES = ("cube_between_crates", "gears", "rotation_stress", "flagpole", "camera_dolly", "crossing")
SIZE, SHUTTER, TRUTH_SAMPLES, FRAMES = (90, 160), 1.0, 96, 8
BLURS = ("layered", "guertin2014")
TURNING, SEAM_SIZE, SEAM_FRAMES = ("gears", "rotation_stress"), (184, 320), 5


def blur(name: str, frame: jaxblur.Frame, seed: int | None) -> Any:
    """A filter as published, with the built-in noise or with noise of a seed, as displayed."""
    parameters, settings = PUBLISHED[name]
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


def border_ratio(error: np.ndarray, size: int, shift: int = 0) -> float:
    """Mean of an image along the borders of square tiles, over its mean elsewhere.

    Args:
        error: (..., H, W).
        size: side of a tile in pixels.
        shift: of the grid of tiles in pixels, right and down.

    Returns:
        1 where borders are like everything else.
    """
    lines = [np.isin((np.arange(n) - shift) % size, (0, size - 1)) for n in error.shape[-2:]]
    borders = lines[0][:, None] | lines[1]
    return float(error[..., borders].mean() / error[..., ~borders].mean())


def seam_row(name: str) -> list[Any]:
    """Ratio at the borders of the tiles, and the least and largest elsewhere."""
    size = fine_tile(PUBLISHED["layered"][1].radius)
    # What comes in from outside is not known at the edges of the picture, where tiles end too.
    inner = (..., slice(2 * size, -2 * size), slice(2 * size, -2 * size))
    squared = np.stack([squared_error(name, time) for time in range(SEAM_FRAMES)])[inner]
    ratios = [border_ratio(squared, size, shift) for shift in range(size)]
    # Shifted by one pixel the grid shares a line with itself.
    elsewhere = ratios[2:-1]
    return [name, ratios[0], min(elsewhere), max(elsewhere)]


def squared_error(name: str, time: float) -> np.ndarray:
    """Of `layered` on one frame, (H, W), in display values."""
    example = common.catalogue_example(name, SEAM_SIZE, SHUTTER, TRUTH_SAMPLES, time)
    error = np.asarray(blur("layered", example.frame, None) - metrics.display(example.truth))
    return np.square(error).mean(axis=-1)


def main() -> None:
    """Render, blur, measure, write."""
    parser = argparse.ArgumentParser(description="Measure flicker and seams of layered.")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    seams = [seam_row(name) for name in TURNING]
    columns = ["scene", "on borders of tiles", "least elsewhere", "largest elsewhere"]
    common.write_table(options.output, "seams", columns, seams)
    rows = [row for name in SCENES for row in rows_of(name)]
    columns = ["scene", "method", "same noise", "fresh noise", "change of the truth"]
    common.write_table(options.output, "flicker", columns, rows)


if __name__ == "__main__":
    main()
