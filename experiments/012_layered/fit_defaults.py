"""Are the defaults of `layered` the best? Joint fits to catalogue scenes.

    python -m experiments.012_layered.fit_defaults -o OUT [--reference-data DIR] [--steps N]

There are ten scenes, every other one with curved paths. The parameters that these scenes determine
are fitted to all of them, from two starts. With ``--halves`` more parameters are fitted to each
half of the scenes too, from both starts, and the fit that gains most is judged on the other half;
this takes much longer. The fits are also judged on the rendered scenes in DIR (as
``experiments/blender/render_reference.py`` writes them). For judging, fits are rounded to two
digits, as defaults would be. Writes ``fits.csv`` and ``fits.md`` (fitted values),
``validation.csv`` and ``validation.md`` (PSNR in dB of display values, mean and worst change
against the defaults). Seeds are fixed.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

import jaxblur
from experiments import common
from jaxblur import metrics
from jaxblur.filters import filter_info

HALVES = (
    ("zoom", "tracked_car", "crossing", "rotor_over_city", "cubes_on_teapot"),
    ("flagpole", "wheels_at_three_depths", "cube_between_crates", "gears", "rotation_stress"),
)
SIZE, SHUTTER, TRUTH_SAMPLES = (72, 128), 1.5, 96
TOLD = ("front_sharpness", "landing_tolerance", "own_tolerance")
ALL = (*TOLD, "surface_sharpness", "distinct")
info = filter_info("layered")
DEFAULTS, SETTINGS = jaxblur.LayeredParameters(), info.settings
STARTS = {
    "round values": {"front_sharpness": 10.0, "landing_tolerance": 1.0, "own_tolerance": 0.35},
    "soft": {"front_sharpness": 3.0, "landing_tolerance": 2.0, "own_tolerance": 1.0},
}


def fit(
    examples: Sequence[common.Example], free: Sequence[str], start: dict[str, float], steps: int
) -> Any:
    """Fit free parameters to some examples, by the error of display values."""
    return jaxblur.fit(
        "layered",
        [(example.frame, example.truth) for example in examples],
        initial=start,
        free=free,
        pixel="display",
        noise="builtin",
        settings=SETTINGS,
        steps=steps,
        patience=0,
    )


def rounded(values: dict[str, float]) -> jaxblur.LayeredParameters:
    """The defaults, with fitted values rounded to two digits."""
    return dataclasses.replace(
        DEFAULTS, **{k: float(f"{value:.2g}") for k, value in values.items()}
    )


def psnr(example: common.Example, parameters: jaxblur.LayeredParameters) -> float:
    """PSNR of display values in dB."""
    blurred = jaxblur.layered(example.frame, parameters, settings=SETTINGS)
    return float(metrics.psnr(metrics.display(blurred), metrics.display(example.truth)))


def changes(
    examples: Sequence[common.Example], parameters: jaxblur.LayeredParameters
) -> tuple[float, float, float]:
    """Mean PSNR with the defaults, and the mean and the worst change against it, in dB."""
    before = np.array([psnr(example, DEFAULTS) for example in examples])
    after = np.array([psnr(example, parameters) for example in examples])
    return float(before.mean()), float((after - before).mean()), float((after - before).min())


def best_fit(
    label: str, examples: Sequence[common.Example], free: Sequence[str], steps: int
) -> tuple[dict[str, float], list[list[Any]]]:
    """Fit from all starts: the fit that gains most, and one row of the table for each start."""
    fits, rows = [], []
    for name, start in STARTS.items():
        fitted = fit(examples, free, start, steps).parameters
        fits.append({k: fitted[k] for k in free})
        _, gain, _ = changes(examples, dataclasses.replace(DEFAULTS, **fits[-1]))
        rows.append([label, name, *(fits[-1].get(k, "") for k in ALL), gain])
        print(*rows[-1], flush=True)
    best = max(range(len(fits)), key=lambda index: rows[index][-1])
    jax.clear_caches()
    return fits[best], rows


def load(name: str, index: int) -> common.Example:
    """A scene of the catalogue, with curved paths if the index is even."""
    return common.catalogue_example(name, SIZE, SHUTTER, TRUTH_SAMPLES, path=index % 2 == 0)


def main() -> None:
    """Fit, judge, and write the tables."""
    parser = common.output_parser("Fit the defaults of layered.", "judge on these too")
    parser.add_argument("--steps", type=int, default=30, help="steps per fit (%(default)s)")
    parser.add_argument("--halves", action="store_true", help="fit to each half too")
    options = parser.parse_args()
    first, second = ([load(name, i) for i, name in enumerate(half)] for half in HALVES)
    folder = options.reference_data
    others = {"reference frames": common.full_size_examples(folder)} if folder else {}
    fits, validation = [], []
    parts = {"all scenes": (TOLD, first + second, [])}
    if options.halves:
        parts |= {"first half": (ALL, first, second), "second half": (ALL, second, first)}
    for label, (free, training, rest) in parts.items():
        values, rows = best_fit(label, training, free, options.steps)
        fits += rows
        judged = {"fitted": training} | ({"held out": rest} if rest else {}) | others
        for kind, examples in judged.items():
            validation.append([label, kind, *changes(examples, rounded(values))])
    columns = ["fitted to", "from", *ALL, "gain there, dB"]
    common.write_table(options.output, "fits", columns, fits)
    columns = ["fitted to", "judged on", "defaults, dB", "mean change, dB", "worst change, dB"]
    common.write_table(options.output, "validation", columns, validation)


if __name__ == "__main__":
    main()
