"""Where the defaults of `layered` come from: fits to catalogue scenes, one left out at a time.

    python -m experiments.012_layered.fit_defaults -o OUT [--steps N] [--scenes NAME ...]

Each scene is left out in turn; a last fit takes all of them. Writes ``fits.csv`` and ``fits.md``:
what was fitted, and PSNR of the scene left out with the defaults and as fitted. Seeds are fixed.
"""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import jaxblur
from experiments import common
from jaxblur import metrics
from jaxblur.filters import PUBLISHED

SCENES = ("zoom", "crossing", "cubes_on_teapot", "rotor_over_city")
SIZE, SHUTTER, TRUTH_SAMPLES = (72, 128), 2.0, 64
FREE = ("front_sharpness", "landing_tolerance", "own_tolerance")
START, SETTINGS = PUBLISHED["layered"]


def fit(examples: Sequence[common.Example], steps: int) -> jaxblur.LayeredParameters:
    """Fit the free parameters to some examples, by the error that is shown."""
    pairs = [(example.frame, example.truth) for example in examples]
    result = jaxblur.fit(
        "layered",
        pairs,
        free=FREE,
        pixel="display",
        noise="builtin",
        settings=SETTINGS,
        steps=steps,
    )
    return dataclasses.replace(START, **{name: result.parameters[name] for name in FREE})


def psnr(example: common.Example, parameters: jaxblur.LayeredParameters) -> float:
    """PSNR of display values in dB."""
    blurred = jaxblur.layered(example.frame, parameters, settings=SETTINGS)
    return float(metrics.psnr(metrics.display(blurred), metrics.display(example.truth)))


def main() -> None:
    """Fit, write the tables, print them."""
    parser = argparse.ArgumentParser(description="Fit the defaults of layered.")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT")
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--scenes", nargs="+", default=SCENES, metavar="NAME")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    examples = [
        common.catalogue_example(name, SIZE, SHUTTER, TRUTH_SAMPLES) for name in options.scenes
    ]
    rows = []
    for held in (None, *examples):
        rest = [example for example in examples if example is not held]
        fitted = fit(rest, options.steps)
        values = [float(getattr(fitted, name)) for name in FREE]
        judged = rest if held is None else [held]
        scores = [
            sum(psnr(example, parameters) for example in judged) / len(judged)
            for parameters in (START, fitted)
        ]
        rows.append(["none" if held is None else held.name, *values, *scores])
        columns = ["left out", *FREE, "defaults, dB", "fitted, dB"]
        common.write_table(options.output, "fits", columns, rows)


if __name__ == "__main__":
    main()
