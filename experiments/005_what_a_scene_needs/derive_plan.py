"""Derive the constants of `jaxblur.plan`: fit the candidates, measure their loss, fit the rules.

    python -m experiments.005_what_a_scene_needs.derive_plan -o OUT

Candidates of guertin2014 are fitted to catalogue scenes at 15 samples. All candidates are scored on
these scenes at several numbers of samples and two shutters, and a ridge regression predicts the
loss of each. Writes ``constants.json``, which belongs in the package, with the rules in JOD that
the package has; ``derive_perceptual`` then makes these anew, and ``validate_plan`` tries it.
"""

import dataclasses
import itertools
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

import jaxblur
from experiments import common
from experiments.common import Example
from jaxblur.filters import FILTERS, filter_info
from jaxblur.fitting.objective import draw_noise
from jaxblur.metrics import display, motion_footprint, psnr
from jaxblur.planning import FrameStatistics, constants, frame_statistics

DERIVED_FROM = (
    *("camera_dolly", "camera_turn", "zoom", "uniform_pan", "cube_between_crates", "crossing"),
    *("cubes_on_teapot", "flagpole", "gears", "rotor_over_city", "rotation_stress"),
    "rolling_sphere",
)
SIZE, TRUTH_SAMPLES, STEPS = (72, 128), 96, 15
FITTED_AT, FITTED_RADIUS = 15, 16
SHUTTERS = (1.0, 2.0)
SAMPLES = (9, 15, 35)
RIDGE = 0.1
"""Penalty on the slopes of a rule, but not on its constant; features are of size one."""
FULL = "layered"
RADIUS_STEP = 16
"""Radii are rounded up to multiples of this, so that few programs are compiled."""
COMMAND = "python -m experiments.005_what_a_scene_needs.derive_plan -o OUT"


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A filter that a plan may choose, at any number of samples.

    Attributes:
        filter: a key of `jaxblur.FILTERS`.
        settings: settings that differ from the published ones.
        free: names of the parameters that are fitted.
        fixed: values of parameters that are not fitted and differ from the published ones.
    """

    filter: str
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    free: tuple[str, ...] = ()
    fixed: Mapping[str, float] = dataclasses.field(default_factory=dict)


CANDIDATES = {
    "pixel_velocity": Candidate("pixel_velocity"),
    "guertin2014, one direction": Candidate(
        "guertin2014",
        {"directions": "one", "direction_weights": "off", "tile_choice": "own"},
        ("kappa", "phi", "depth_sharpness"),
    ),
    "guertin2014, two directions": Candidate(
        "guertin2014",
        {"direction_weights": "off", "tile_choice": "own"},
        ("kappa", "gamma", "phi", "depth_sharpness"),
    ),
    "guertin2014, all components": Candidate(
        "guertin2014", {}, ("kappa", "gamma", "tau", "phi", "depth_sharpness")
    ),
    FULL: Candidate("layered", {"fetch": "bilinear"}),
}


def fitted(candidate: Candidate, examples: Sequence[Example]) -> dict[str, float]:
    """Parameters of a candidate, fitted at `FITTED_AT` samples, or published if not guertin2014."""
    if candidate.filter != common.GUERTIN:
        return filter_info(candidate.filter).defaults
    settings = jaxblur.GuertinSettings(
        samples=FITTED_AT, radius=FITTED_RADIUS, **candidate.settings
    )
    return common.refit(examples, settings, candidate.free, candidate.fixed, STEPS).parameters


def at_samples(parameters: Mapping[str, float], samples: int) -> dict[str, float]:
    """Adapt parameters to another number of samples: jitter keeps its size in sample spacings."""
    if "phi" not in parameters:
        return dict(parameters)
    return dict(parameters) | {"phi": parameters["phi"] * samples / FITTED_AT}


Run = Callable[..., jax.Array]


def runs(parameters: Mapping[str, Mapping[str, float]], radius: int) -> dict[tuple[str, int], Run]:
    """Every candidate at every number of samples, as a function of frame and noise."""
    table = {}
    for (label, candidate), samples in itertools.product(CANDIDATES.items(), SAMPLES):
        info = filter_info(candidate.filter)
        record = info.make_parameters(**at_samples(parameters[label], samples))
        settings = info.kind(samples=samples, radius=radius, **candidate.settings)
        table[label, samples] = _run(candidate.filter, record, settings)
    return table


def _run(name: str, record: Any, settings: jaxblur.Settings) -> Run:
    def run(frame: jaxblur.Frame, noise: Any = None) -> jax.Array:
        return FILTERS[name](frame, record, settings=settings, noise=noise)

    return run


def moving_psnr(run: Run, example: Example) -> float:
    """PSNR over the pixels that motion reaches, with random noise."""
    noise = draw_noise(
        jax.random.key(2), (example.frame.depth.shape[0], example.frame.depth.shape[1])
    )
    mask = motion_footprint(example.frame)
    return float(psnr(display(run(example.frame, noise)), display(example.truth), mask=mask))


def losses(
    parameters: Mapping[str, Mapping[str, float]], examples: Sequence[Example]
) -> tuple[list[FrameStatistics], dict[tuple[str, int], np.ndarray]]:
    """Statistics of every frame, and the loss of every run against the full filter on it, in dB."""
    statistics = [frame_statistics(example.frame) for example in examples]
    measured: dict[tuple[str, int], list[float]] = {}
    for example, known in zip(examples, statistics, strict=True):
        radius = -(-known.radius // RADIUS_STEP) * RADIUS_STEP
        for key, run in runs(parameters, radius).items():
            measured.setdefault(key, []).append(moving_psnr(run, example))
    best = np.array(measured[FULL, max(SAMPLES)])
    return statistics, {key: best - np.array(values) for key, values in measured.items()}


def regress(features: np.ndarray, loss: np.ndarray) -> np.ndarray:
    """Ridge regression: least squares with a penalty on all but the constant."""
    penalty = RIDGE * np.eye(features.shape[1])
    penalty[0, 0] = 0
    return np.linalg.solve(features.T @ features + penalty, features.T @ loss)


def left_out_spread(features: np.ndarray, loss: np.ndarray, groups: Sequence[str]) -> float:
    """RMS error of the rule on scenes left out one at a time."""
    names, errors = np.array(groups), []
    for name in dict.fromkeys(groups):
        out = names == name
        rule = regress(features[~out], loss[~out])
        errors += (loss[out] - features[out] @ rule).tolist()
    return float(np.sqrt(np.mean(np.square(errors))))


def rates(
    parameters: Mapping[str, Mapping[str, float]], examples: Sequence[Example], repeats: int
) -> dict[tuple[str, int], float]:
    """Milliseconds per megapixel: the shortest of interleaved runs on one mosaic.

    Processor time over the number of cores, which other programs hardly disturb: the time that the
    run takes where all cores are free.
    """
    frame = common.mosaic(examples, 5)
    times: dict[tuple[str, int], list[float]] = {}
    table = runs(parameters, FITTED_RADIUS)
    for turn, (key, run) in itertools.product(range(repeats + 1), table.items()):
        started = time.process_time()
        run(frame).block_until_ready()
        if turn:
            times.setdefault(key, []).append(time.process_time() - started)
    scale = 1000 / (os.cpu_count() or 1) / (frame.depth.size / 1e6)
    return {key: scale * min(taken) for key, taken in times.items()}


def derive(
    parameters: Mapping[str, Mapping[str, float]],
    examples: Sequence[Example],
    speed: Mapping[tuple[str, int], float],
) -> dict[str, Any]:
    """Derive the constants of the rules, one record for each run."""
    statistics, lost = losses(parameters, examples)
    features = np.stack([known.features for known in statistics])
    groups = [example.name for example in examples]
    records = {}
    for (label, samples), loss in lost.items():
        candidate = CANDIDATES[label]
        values = at_samples(parameters[label], samples)
        records[f"{label}, {samples} samples"] = {
            "filter": candidate.filter,
            "settings": {"samples": samples, **candidate.settings},
            "parameters": {name: _rounded(value) for name, value in values.items()},
            "loss": [_rounded(value) for value in regress(features, loss)],
            "spread": _rounded(left_out_spread(features, loss, groups)),
            "milliseconds_per_megapixel": _rounded(speed[label, samples]),
        }
    return {
        "command": COMMAND,
        "machine": "two cores of a server CPU, shared, jax " + jax.__version__,
        "scenes": list(dict.fromkeys(groups)),
        "candidates": records,
    }


def with_rules_in_jod(known: Mapping[str, Any], earlier: Mapping[str, Any]) -> dict[str, Any]:
    """Constants with the rules in JOD of earlier ones, until `derive_perceptual` makes them anew.

    Args:
        known: as `derive` gives them.
        earlier: those of the package.
    """
    candidates = {
        label: record
        | {k: v for k, v in earlier["candidates"].get(label, {}).items() if k.startswith("jod")}
        for label, record in known["candidates"].items()
    }
    command = {k: v for k, v in earlier.items() if k.startswith("jod")}
    return {**known, **command, "candidates": candidates}


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def main() -> None:
    """Fit, measure, derive, and write the constants."""
    options = common.output_parser("Derive the constants of jaxblur.plan.").parse_args()
    examples = [
        common.catalogue_example(name, SIZE, shutter, TRUTH_SAMPLES)
        for shutter, name in itertools.product(SHUTTERS, DERIVED_FROM)
    ]
    training = examples[-len(DERIVED_FROM) :]
    parameters = {label: fitted(c, training) for label, c in CANDIDATES.items()}
    known = derive(parameters, examples, rates(parameters, training, 9))
    known = with_rules_in_jod(known, constants())
    text = json.dumps(known, indent=1) + "\n"
    (options.output / "constants.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
