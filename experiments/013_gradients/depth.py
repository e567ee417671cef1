"""An object's depth under `layered`: the difference by its step, and what makes it.

    python -m experiments.013_gradients.depth --frames DIR --ratios RATIOS -o OUT

DIR is the folder of frames that ``run --frames DIR`` keeps, RATIOS its ``ratios.csv``, which says
for which frames the difference is determined. Writes ``depth``: the derivative, the difference at
several steps, and the difference at 2 % if only one of the things that pass L5 reads is that of the
moved frame: who is in front (passes L3), the background (L4), or the paths (L1 and L2).
"""

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.common import output_parser, write_table
from jaxblur.filters import filter_info
from jaxblur.filters.layered import filter as layered
from jaxblur.gradient_check import check, measure, quantities
from jaxblur.kernels import Image, each_pixel

from .worker import read

DRAWS = 4
STEPS = (0.002, 0.005, 0.01, 0.02, 0.05)
SPLIT_AT = 0.02
PARTS = {"who is in front": ("owners", "states"), "background": ("background",)}
"""Images of pass L5 by what they are; its others, that is the paths, are the remaining part."""

INFO = filter_info("layered")
SETTINGS = INFO.make_settings(fetch="bilinear")
PARAMETERS = jax.tree.map(jnp.float32, INFO.make_parameters())


def frames_in(ratios: Path) -> Iterator[str]:
    """The frames for which an object's depth is determined, as files are named."""
    with ratios.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if row["filter"].startswith("layered") and row["quantity"] == "object depth":
                yield row["frame"].replace(", ", "_")


@jax.jit
def error(still: Any, moved: Any, takes: Any, truth: jax.Array, noise: Any) -> jax.Array:
    """The squared error of a blur of `still`, of which some parts are those of `moved`.

    Args:
        still: frame.
        moved: frame.
        takes: whether each of `PARTS`, and last the paths, is that of `moved`.
        truth: (H, W, C).
        noise: of the filter.
    """
    others = layered.Others(None, None, jnp.float32(0.5), None)
    (images, inputs, plan), (other, _, _) = (
        layered.passes_before(SETTINGS, frame, PARAMETERS, noise, others)
        for frame in (still, moved)
    )
    chosen = {"paths": takes[-1]}
    for take, names in zip(takes, PARTS.values(), strict=False):
        chosen |= dict.fromkeys(names, take)
    mixed = {
        name: Image(jnp.where(take, getattr(other, name).values, getattr(images, name).values))
        for name, take in chosen.items()
    }
    blurred = each_pixel(
        *(layered.blur_pixel, truth.shape[:2], images._replace(**mixed), inputs, plan),
        kept=still.color,
        backend=SETTINGS.backend,
    )
    return check.squared_error(blurred, truth)


def row_of(frame: Any, truth: jax.Array) -> list[float]:
    """Derivative, differences by step, and differences by part."""
    here = quantities.Point(frame, PARAMETERS)
    moved = quantities.object_directions(frame, "fastest")["object depth"]
    noises = measure.draw_noise(DRAWS, 0, frame)
    programs = measure.compile_programs(INFO, SETTINGS, check.squared_error)
    place = jax.jvp(quantities.frame_quantity("depth", here, moved).move, (0.0,), (1.0,))
    (slope,) = measure.reverse(programs, [place], truth, noises)

    def difference(step: float, takes: list[bool]) -> float:
        ends = (moved(side * step) for side in (1, -1))
        above, below = (
            np.mean([error(frame, end, takes, truth, noise) for noise in noises]) for end in ends
        )
        return float(above - below) / (2 * step)

    whole = [True] * (len(PARTS) + 1)
    return [
        float(slope.mean()),
        *(difference(step, whole) for step in STEPS),
        *(difference(SPLIT_AT, list(map(bool, part))) for part in np.eye(len(whole))),
    ]


def main() -> None:
    """Parse the command line, measure, write."""
    parser = output_parser("Differences by an object's depth.")
    parser.add_argument("--frames", type=Path, metavar="DIR", required=True)
    parser.add_argument("--ratios", type=Path, metavar="RATIOS", required=True)
    options = parser.parse_args()
    rows = []
    for name in frames_in(options.ratios):
        frame, truth = read(options.frames / f"{name}.npz")
        cells = row_of(frame, jnp.asarray(truth))
        rows.append((name.replace("_", ", ", 1), *(f"{1e6 * cell:.3g}" for cell in cells)))
    steps = (f"step {100 * step:g} %" for step in STEPS)
    heads = ("frame", "derivative", *steps, *PARTS, "paths")
    write_table(options.output, "depth", heads, rows)


if __name__ == "__main__":
    main()
