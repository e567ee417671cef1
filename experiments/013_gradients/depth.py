"""An object's depth: derivative and difference by the step, and what of `layered` makes it.

    python -m experiments.013_gradients.depth --frames DIR --ratios RATIOS -o OUT

DIR is the folder of frames that ``run --frames DIR`` keeps, RATIOS its ``ratios.csv``, which says
where the difference is determined. Writes ``depth``, the derivative and the difference at several
steps; and ``depth_parts``: the difference under `layered` at 2 % if only one of the things that
pass L5 reads is that of the moved frame, who is in front (pass L3), the background (L4) or the
paths (L1 and L2).
"""

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.common import output_parser, write_table
from jaxblur._util.stages import untold
from jaxblur.filters import filter_info
from jaxblur.filters.layered import filter as layered
from jaxblur.gradient_check import check, measure, quantities
from jaxblur.kernels import Image, each_pixel

from .worker import read

DRAWS = 4
STEPS = (0.001, 0.005, 0.02, 0.05)
SPLIT_AT = 0.02
PARTS = {"who is in front": ("owners", "states"), "background": ("background",)}
"""Images of pass L5 by what they are; its others, that is the paths, are the remaining part."""

INFO = filter_info("layered")
SETTINGS = INFO.make_settings(fetch="bilinear")
PARAMETERS = jax.tree.map(jnp.float32, INFO.make_parameters())


def cases_in(ratios: Path) -> Iterator[tuple[str, str, str]]:
    """Filter, fetch and frame where an object's depth is determined; frames as files are named."""
    with ratios.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if row["quantity"] == "object depth":
                name, fetch = row["filter"].split(", ")
                yield name, fetch, row["frame"].replace(", ", "_")


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
    height, width = still.depth.shape
    blurred = each_pixel(
        *(layered.blur_pixel, (height, width), images._replace(**mixed), inputs, plan),
        kept=still.color,
        backend=SETTINGS.backend,
    )
    return check.squared_error(blurred, truth)


def by_step(name: str, fetch: str, frame: Any, truth: jax.Array) -> list[float]:
    """The derivative of a filter, and its difference at each step."""
    info = filter_info(name)
    moved = quantities.object_directions(frame, "fastest")["object depth"]
    parameters = jax.tree.map(jnp.float32, info.make_parameters())
    depth = quantities.frame_quantity("depth", quantities.Point(frame, parameters), moved)
    programs = measure.compile_programs(info, info.make_settings(fetch=fetch), check.squared_error)
    noises = measure.draw_noise(DRAWS, 0, frame)
    found = [
        measure.measure(programs, [depth], truth, noises, step, False, untold)[0] for step in STEPS
    ]
    return [found[0].reverse.mean(), *(each.difference.mean() for each in found)]


def by_part(frame: Any, truth: jax.Array) -> list[float]:
    """The difference of `layered` at `SPLIT_AT`, and that of each part alone."""
    moved = quantities.object_directions(frame, "fastest")["object depth"]
    above, below = moved(SPLIT_AT), moved(-SPLIT_AT)
    noises = measure.draw_noise(DRAWS, 0, frame)

    def difference(takes: list[bool]) -> float:
        changes = [
            error(frame, above, takes, truth, n) - error(frame, below, takes, truth, n)
            for n in noises
        ]
        return float(np.mean(changes)) / (2 * SPLIT_AT)

    count = len(PARTS) + 1
    return [difference([True] * count)] + [
        difference([k == part for k in range(count)]) for part in range(count)
    ]


def main() -> None:
    """Parse the command line, measure, write."""
    parser = output_parser("Differences by an object's depth.")
    parser.add_argument("--frames", type=Path, metavar="DIR", required=True)
    parser.add_argument("--ratios", type=Path, metavar="RATIOS", required=True)
    options = parser.parse_args()
    steps, parts = [], []
    for name, fetch, scene in cases_in(options.ratios):
        frame, truth = read(options.frames / f"{scene}.npz")
        truth, shown = jnp.asarray(truth), scene.replace("_", ", ", 1)
        derivative, *differences = by_step(name, fetch, frame, truth)
        ratios = [f"{derivative / d:.3f}" if d else "no change" for d in differences]
        steps.append((name, shown, f"{1e6 * derivative:.3g}", *ratios))
        if name == "layered":
            parts.append((shown, *(f"{1e6 * d:.3g}" for d in by_part(frame, truth))))
    heads = (f"ratio at {100 * step:g} %" for step in STEPS)
    write_table(options.output, "depth", ("filter", "frame", "derivative", *heads), steps)
    heads = ("frame", "difference", *PARTS, "paths")
    write_table(options.output, "depth_parts", heads, parts)


if __name__ == "__main__":
    main()
