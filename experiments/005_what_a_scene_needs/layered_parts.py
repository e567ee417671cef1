"""Which parts of `layered` does a scene need? Parts are switched off one at a time.

    python -m experiments.005_what_a_scene_needs.layered_parts -o OUT [--reference-data DIR]

Measures on the scenes of `run`, over the pixels that motion reaches, with random noise: the PSNR
that `layered` loses without each part, by kind of scene, and its lead over guertin2014 and
pixel_velocity as published. Nothing is fitted. Writes ``layered_parts.csv`` and ``.md``.
"""

from typing import Any

import jax
import numpy as np

import jaxblur
from experiments import common
from experiments.common import Example
from jaxblur.filters import FILTERS, filter_info
from jaxblur.fitting.objective import draw_noise
from jaxblur.metrics import display, motion_footprint, psnr

from .run import HALVES, REFERENCE_WIDTH, SHUTTER, SIZE, TRUTH_SAMPLES

SAMPLES, RADIUS = 35, 40
WITHOUT: dict[str, tuple[str, dict[str, float], dict[str, Any]]] = {
    "guesses that hide each other": ("layered", {"distinct": 1e6}, {}),
    "depth order": ("layered", {"front_sharpness": 0.1}, {}),
    "tolerance within a surface": ("layered", {"own_tolerance": 1e-3}, {}),
    "bend of the own way": ("layered", {"bend": 0.0}, {}),
    "vectors of thin things": ("layered", {"thin_coverage": 1.0}, {}),
    "bilinear reading": ("layered", {}, {"fetch": "nearest"}),
    "noise": ("layered", {"jitter": 0.0}, {}),
    "all (guertin2014)": ("guertin2014", {}, {"fetch": "nearest"}),
    "all (pixel_velocity)": ("pixel_velocity", {}, {"fetch": "nearest"}),
}
"""For each part that is left out: the filter, and the parameters and settings that differ."""


def score(example: Example, name: str, values: dict[str, float], changes: dict[str, Any]) -> float:
    """PSNR over the pixels that motion reaches, in dB."""
    record = filter_info(name).make_parameters(**values)
    chosen = {"samples": SAMPLES, "radius": RADIUS, "fetch": "bilinear"} | changes
    height, width = example.frame.depth.shape
    noise = draw_noise(jax.random.key(2), (height, width))
    settings = jaxblur.Settings(**chosen)
    image = FILTERS[name](example.frame, record, settings=settings, noise=noise)
    mask = motion_footprint(example.frame)
    return float(psnr(display(image), display(example.truth), mask=mask))


def main() -> None:
    """Render, judge, and write the table."""
    options = common.output_parser(
        "Gain of each part of layered.", "judge on these too"
    ).parse_args()
    names = [name for half in HALVES for name in half]
    examples = [common.catalogue_example(name, SIZE, SHUTTER, TRUTH_SAMPLES) for name in names]
    if options.reference_data:
        examples += common.cycles_examples(options.reference_data, REFERENCE_WIDTH)
    kinds = sorted({example.kind for example in examples})
    whole = np.array([score(example, "layered", {}, {}) for example in examples])
    rows = []
    for part, change in WITHOUT.items():
        lost = whole - [score(example, *change) for example in examples]
        of_kind = [lost[[e.kind == kind for e in examples]].mean() for kind in kinds]
        rows.append([part, *map(float, of_kind), float(lost.mean())])
    heads = ("without", *(f"{kind}, dB" for kind in kinds), "all, dB")
    common.write_table(options.output, "layered_parts", heads, rows)


if __name__ == "__main__":
    main()
