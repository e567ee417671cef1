"""What does a scene need? Components of guertin2014, switched on and off and refitted.

    python -m experiments.005_what_a_scene_needs.run -o OUT [--reference-data DIR] [--quick]

Scenes are split into two halves with the same kinds of motion. Every variant is fitted on each half
and judged on the other half and on the rendered scenes, whose scores are means over both fits.
Times are medians over interleaved runs on one mosaic of all frames. Seeds are fixed.
"""

import argparse
import dataclasses
import itertools
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxblur
from experiments import common
from experiments.common import GUERTIN, Example
from jaxblur import show
from jaxblur.fitting.evaluation import evaluate
from jaxblur.fitting.pairs import make_pairs

HALVES = (
    ("camera_dolly", "zoom", "cube_between_crates", "flagpole", "gears", "rotor_over_city"),
    (
        "camera_turn",
        "uniform_pan",
        "crossing",
        "cubes_on_teapot",
        "rotation_stress",
        "rolling_sphere",
    ),
)
SIZE, SHUTTER, TRUTH_SAMPLES, DRAWS = (72, 128), 2.0, 96, 2
SAMPLES, RADIUS = 15, 16
REFERENCE_WIDTH = 320
STRONGEST_KAPPA = 1e6


@dataclasses.dataclass(frozen=True)
class Component:
    """A part of the filter that can be switched off.

    Attributes:
        on: settings that switch it on.
        off: settings that switch it off.
        free: parameters that have an effect only when it is on.
        fixed: values of parameters that switch it off.
    """

    on: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    off: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    free: tuple[str, ...] = ()
    fixed: Mapping[str, float] = dataclasses.field(default_factory=dict)


COMPONENTS = {
    "second direction": Component({"directions": "two"}, {"directions": "one"}, ("gamma",)),
    "depth comparison": Component(free=("depth_sharpness",), fixed={"depth_sharpness": 0.0}),
    "direction weights": Component({"direction_weights": "on"}, {"direction_weights": "off"}),
    "center sample": Component(free=("kappa",), fixed={"kappa": STRONGEST_KAPPA}),
    "jitter": Component(free=("phi",), fixed={"phi": 0.0}),
    "off-axis cull": Component({"diagonal_tiles": "reaching"}, {"diagonal_tiles": "all"}),
    "tile jitter": Component({"tile_choice": "stochastic"}, {"tile_choice": "own"}, ("tau",)),
    "variance split": Component({"split": "variance"}, {"split": "even"}),
}
"""In nested order: components that were expected to matter most come first."""


class Variant(NamedTuple):
    """The filter with some components.

    Attributes:
        label: name in tables.
        present: names of the components that are on.
    """

    label: str
    present: frozenset[str]

    @property
    def settings(self) -> jaxblur.GuertinSettings:
        """Settings that switch each component on or off."""
        chosen: dict[str, Any] = {}
        for name, component in COMPONENTS.items():
            chosen |= component.on if name in self.present else component.off
        return jaxblur.GuertinSettings(samples=SAMPLES, radius=RADIUS, **chosen)

    @property
    def free(self) -> tuple[str, ...]:
        """Parameters of the components that are on."""
        return tuple(
            p for name in COMPONENTS if name in self.present for p in COMPONENTS[name].free
        )

    @property
    def fixed(self) -> dict[str, float]:
        """Values of parameters that switch the other components off."""
        absent = [c for name, c in COMPONENTS.items() if name not in self.present]
        return {key: value for component in absent for key, value in component.fixed.items()}


def variants() -> list[Variant]:
    """No component, each alone, the first n, all but one, and all; no set occurs twice."""
    names = list(COMPONENTS)
    sets = {"nothing": frozenset(), "all": frozenset(names)}
    sets |= {f"only {name}": frozenset([name]) for name in names}
    sets |= {f"first {n}": frozenset(names[:n]) for n in range(2, len(names) - 1)}
    sets |= {f"all but {name}": frozenset(names) - {name} for name in names}
    return [Variant(label, present) for label, present in sets.items()]


class Judged(NamedTuple):
    """Held-out scores of one variant on one scene, over the pixels that motion reaches."""

    variant: str
    scene: str
    kind: str
    psnr: float
    ssim: float
    flip: float


def judge(
    label: str,
    parameters: Mapping[str, float],
    settings: jaxblur.GuertinSettings,
    examples: Sequence[Example],
) -> list[Judged]:
    """Score the filter on scenes that it was not fitted to."""
    record = jaxblur.GuertinParameters(**parameters)
    pairs = make_pairs([(e.frame, e.truth) for e in examples], [e.name for e in examples])
    key = jax.random.key(1)
    scores = evaluate(GUERTIN, record, pairs, settings, key, DRAWS, ("held-out", label))
    kinds = {example.name: example.kind for example in examples}
    return [
        Judged(label, score.pair, kinds[score.pair], score.psnr, score.ssim, score.flip)
        for score in scores
        if score.region == "moving"
    ]


def cross_validate(
    variant: Variant, halves: Sequence[Sequence[Example]], others: Sequence[Example], steps: int
) -> tuple[list[Judged], list[dict[str, float]]]:
    """Fit on each half and judge on the other; judge rendered scenes by both fits."""
    settings, fits, judged = variant.settings, [], []
    for training, held_out in (halves, halves[::-1]):
        fit = common.refit(training, settings, variant.free, variant.fixed, steps)
        fits.append(fit.parameters)
        judged += judge(variant.label, fits[-1], settings, [*held_out, *others])
    return judged, fits


def milliseconds(
    runs: Mapping[str, tuple[Any, jaxblur.GuertinSettings]], frame: jaxblur.Frame, repeats: int
) -> dict[str, float]:
    """Median time of each run on one frame; runs are interleaved so that load affects all alike."""
    times: dict[str, list[float]] = {label: [] for label in runs}
    for turn, (label, (record, settings)) in itertools.product(range(repeats + 1), runs.items()):
        started = time.perf_counter()
        jaxblur.guertin2014(frame, record, settings=settings).block_until_ready()
        if turn:
            times[label].append(1000 * (time.perf_counter() - started))
    return {label: float(np.median(values)) for label, values in times.items()}


def mean_psnr(judged: Sequence[Judged], variant: str, kind: str | None) -> float:
    """Mean PSNR of a variant over the scenes of a kind, or over all if `kind` is None."""
    wanted = [j for j in judged if j.variant == variant]
    return float(np.mean([j.psnr for j in wanted if j.kind == kind or not kind]))


def gains(
    judged: Sequence[Judged], times: Mapping[str, float], kinds: Sequence[str | None]
) -> list[Any]:
    """One row for each component, each way of adding it, and each kind of scene; None is all."""
    names, rows = list(COMPONENTS), []
    nested = ["nothing", f"only {names[0]}", *[f"first {n}" for n in range(2, len(names) - 1)]]
    nested += [f"all but {names[-1]}", "all"]
    for index, name in enumerate(names):
        ways = {
            "alone": ("nothing", f"only {name}"),
            "nested": (nested[index], nested[index + 1]),
            "last": (f"all but {name}", "all"),
        }
        for (way, (without, with_it)), kind in itertools.product(ways.items(), kinds):
            gain = mean_psnr(judged, with_it, kind) - mean_psnr(judged, without, kind)
            cost = times[with_it] - times[without]
            rows.append((name, way, kind or "all", gain, cost, per_millisecond(gain, cost)))
    return rows


def per_millisecond(gain: float, cost: float) -> float | str:
    """Gain per millisecond, or "free" if the cost is below the timing noise."""
    return gain / cost if cost > 0.5 else "free"


def draw(path: Path, rows: Sequence[Any], kinds: Sequence[str]) -> None:
    """Draw bars: gain of each component by kind of scene, for the three ways of adding it."""
    figure = show.new_figure(11, 4.2)
    axes = figure.subplots(1, 3, sharey=True)
    titles = {"alone": "added to nothing", "nested": "added in this order", "last": "added last"}
    for axis, (way, title) in zip(axes, titles.items(), strict=True):
        groups = {
            kind: {
                name: next(r[3] for r in rows if r[:3] == (name, way, kind)) for name in COMPONENTS
            }
            for kind in kinds
        }
        show.bars(groups, x="held-out gain, dB", title=title, axes=axis)
    axes[0].legend()
    figure.savefig(path, dpi=110)


def load(options: argparse.Namespace) -> tuple[list[list[Example]], list[Example]]:
    """The two halves of the catalogue, and the rendered scenes if there are any."""
    chosen = [half[2:4] if options.quick else half for half in HALVES]
    arguments = SIZE, SHUTTER, 16 if options.quick else TRUTH_SAMPLES
    halves = [[common.catalogue_example(name, *arguments) for name in half] for half in chosen]
    folder = options.reference_data
    return halves, common.cycles_examples(folder, REFERENCE_WIDTH) if folder else []


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = common.output_parser("Gain of each component of guertin2014.", "judge on these too")
    parser.add_argument("--steps", type=int, default=12, help="steps per fit (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="four scenes, three variants")
    return parser.parse_args()


def main() -> None:
    """Fit, judge, time, and write tables and the figure."""
    options = parse_arguments()
    halves, others = load(options)
    steps = 2 if options.quick else options.steps
    judged, fits, runs = [], [], {}
    for variant in variants()[:3] if options.quick else variants():
        figures, fitted = cross_validate(variant, halves, others, steps)
        judged += figures
        fits += [
            (variant.label, half, *parameters.values()) for half, parameters in enumerate(fitted)
        ]
        runs[variant.label] = jaxblur.GuertinParameters(**fitted[0]), variant.settings
        print(f"{variant.label}: {mean_psnr(figures, variant.label, None):.2f} dB", flush=True)
    times = milliseconds(
        runs, common.mosaic([*halves[0], *halves[1]], 5), 3 if options.quick else 15
    )
    timed = [(*row, times[row.variant]) for row in judged]
    common.write_table(options.output, "scores", (*Judged._fields, "milliseconds"), timed)
    names = vars(jaxblur.GuertinParameters())
    common.write_table(options.output, "fits", ("variant", "half", *names), fits)
    if not options.quick:
        kinds = sorted({row.kind for row in judged})
        rows = gains(judged, times, [None, *kinds])
        heads = ("component", "added", "kind", "gain dB", "cost ms", "dB per ms")
        common.write_table(options.output, "components", heads, rows)
        draw(options.output / "components.png", rows, kinds)


if __name__ == "__main__":
    main()
