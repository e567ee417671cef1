"""What a class of coherent tiles would save in guertin2014, and what it would cost.

    python -m experiments.010_fast_paths.coherent -o OUT [--reference-data DIR]

A tile is coherent if the velocities in its ring of 3 x 3 tiles differ by no more than a quarter of
the fastest [Guertin et al. 2014, 3.6.1: one direction and fewer samples will do there]. Frames are
blurred whole in the cheap way, and coherent tiles taken from that: what a class of its own would
give. DIR holds scenes as ``experiments/blender/render_reference.py`` writes them; six catalogue
scenes at 640x360 are always in. Writes ``coherent.csv`` and ``coherent.md``: change of PSNR in dB
of display values, and the share of all samples that is left out.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import jaxblur
from experiments import common
from jaxblur import metrics
from jaxblur.filters import filter_info
from jaxblur.safe_math import safe_norm

SCENES = ("uniform_pan", "camera_turn", "flagpole", "camera_dolly", "tracked_car", "zoom")
SIZE, SHUTTER, TRUTH_SAMPLES = (360, 640), 0.5, 96
SPREAD = 0.25
"""Difference of two velocities of a ring, as a share of its fastest, up to which it is coherent."""
STILL = 0.5
info = filter_info("guertin2014")
PARAMETERS, SETTINGS = info.make_parameters(), info.settings
WAYS = {
    "one direction": {"directions": "one"},
    "a sample every 0.7 px": {"spacing": 0.7},
    "every 1 px": {"spacing": 1.0},
    "every 1 px, no noise": {"spacing": 1.0, "noise": "none"},
    "every 2 px": {"spacing": 2.0},
}


def ring_extreme(plane: jax.Array, largest: bool) -> jax.Array:
    """Largest or smallest value in the ring of each tile, (rows, columns)."""
    start, combine = (-jnp.inf, lax.max) if largest else (jnp.inf, lax.min)
    radius = SETTINGS.radius
    padding = [(0, -length % radius) for length in plane.shape]
    tiles = lax.reduce_window(plane, start, combine, (radius,) * 2, (radius,) * 2, padding)
    return lax.reduce_window(tiles, start, combine, (3, 3), (1, 1), "SAME")


def coherent_pixels(frame: jaxblur.Frame) -> tuple[np.ndarray, np.ndarray]:
    """Pixels in coherent tiles, and the reach of all pixels in pixels, both (H, W)."""
    x, y = frame.velocity[..., 0], frame.velocity[..., 1]
    reach = ring_extreme(safe_norm(x, y), largest=True)
    spread = [ring_extreme(part, True) - ring_extreme(part, False) for part in (x, y)]
    coherent = (reach > STILL) & (jnp.hypot(*spread) <= SPREAD * reach)
    height, width = frame.depth.shape

    def spread_out(tiles: jax.Array) -> np.ndarray:
        pixels = np.repeat(np.repeat(tiles, SETTINGS.radius, 0), SETTINGS.radius, 1)
        return pixels[:height, :width]

    return spread_out(coherent), spread_out(jnp.minimum(reach, SETTINGS.radius))


def samples_left_out(coherent: np.ndarray, reach: np.ndarray, spacing: float) -> float:
    """Share of all samples that moving pixels take which a spacing leaves out, coherent only."""
    taken = np.minimum(np.maximum(2 * np.ceil(reach / spacing) + 1, 5), SETTINGS.samples)
    missing = np.where(coherent, 1 - taken / SETTINGS.samples, 0)
    return float(missing.sum() / max((reach > STILL).sum(), 1))


def row_of(example: common.Example) -> list[Any]:
    """Shares, then for each way the change of PSNR in dB."""

    def blur(**settings: Any) -> np.ndarray:
        chosen = dataclasses.replace(SETTINGS, **settings)
        return np.asarray(jaxblur.guertin2014(example.frame, PARAMETERS, settings=chosen))

    def psnr(image: np.ndarray) -> float:
        return float(metrics.psnr(metrics.display(image), metrics.display(example.truth)))

    coherent, reach = coherent_pixels(example.frame)
    usual = blur()
    mixed = [np.where(coherent[..., None], blur(**way), usual) for way in WAYS.values()]
    left_out = [100 * samples_left_out(coherent, reach, spacing) for spacing in (0.7, 1.0, 2.0)]
    share = 100 * coherent.sum() / max((reach > STILL).sum(), 1)
    return [example.name, share, *(psnr(image) - psnr(usual) for image in mixed), *left_out]


def main() -> None:
    """Blur, compare, write."""
    options = common.output_parser(
        "Measure a class of coherent tiles.", reference_data="rendered scenes to judge on too"
    ).parse_args()
    examples = common.full_size_examples(options.reference_data) if options.reference_data else []
    for name in SCENES:
        examples.append(common.catalogue_example(name, SIZE, SHUTTER, TRUTH_SAMPLES))
    columns = ["scene", "coherent, % of what moves", *(f"{way}, dB" for way in WAYS)]
    columns += [f"left out every {spacing} px, %" for spacing in (0.7, 1, 2)]
    common.write_table(options.output, "coherent", columns, [row_of(e) for e in examples])


if __name__ == "__main__":
    main()
