"""How much does fitting improve the published filter on scenes that were not fitted?

    python -m experiments.006_fit_published.run -o OUT [--reference-data DIR] [--quick]

guertin2014, with 15 samples and a radius for small frames, is fitted with each catalogue scene left
out in turn and judged on that scene. A fit to all of them is judged on the rendered scenes.
Profiles and standard errors are of a fit to three scenes. Scores are over the pixels that motion
reaches. Seeds are fixed.
"""

import argparse
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments import common, pictures
from experiments.common import GUERTIN, Example
from jaxblur import fitting, metrics, report, show
from jaxblur.filters import filter_info
from jaxblur.fitting.objective import draw_noise

SCENES = ("camera_turn", "zoom", "crossing", "cube_between_crates", "gears", "rotor_over_city")
MOVIES = ("cube_between_crates", "gears")
SIZE, SHUTTER, TRUTH_SAMPLES = (72, 128), 2.0, 96
FRAMES, INTERVAL = 8, 2.0
SETTINGS = jaxblur.GuertinSettings(samples=15, radius=16)
FREE = ("kappa", "gamma", "tau", "phi", "depth_sharpness")
REFERENCE_WIDTH = 320
SEEDS = (11, 12, 13)
PROFILED = ("zoom", "crossing", "gears")
STEPS, PROFILED_STEPS, POINTS = 30, 6, 7
ENLARGE = 2
UNMENDED = {
    "hidden background": "cube_between_crates",
    "curved motion": "gears",
    "moving shadows": "cube_over_crates",
}

Parameters = Mapping[str, float]


class Judged(NamedTuple):
    """Scores of one picture, with its scene, its parameters and its noise seed."""

    scene: str
    parameters: str
    seed: int
    psnr: float
    ssim: float
    flip: float


def blur(frame: jaxblur.Frame, parameters: Parameters, seed: int) -> jax.Array:
    """Run the filter with noise drawn from a seed."""
    noise = draw_noise(jax.random.key(seed), (frame.depth.shape[0], frame.depth.shape[1]))
    record = jaxblur.GuertinParameters(**parameters)
    return jaxblur.guertin2014(frame, record, settings=SETTINGS, noise=noise)


def judge(example: Example, label: str, parameters: Parameters) -> list[Judged]:
    """Score a scene with every noise seed, over the pixels that motion reaches."""
    mask = metrics.motion_footprint(example.frame)
    rows = []
    for seed in SEEDS:
        image = blur(example.frame, parameters, seed)
        rows.append(Judged(example.name, label, seed, *metrics.compare(image, example.truth, mask)))
    return rows


def leave_one_out(examples: Sequence[Example], steps: int) -> dict[str, common.Refit]:
    """For each scene, fit to all other scenes."""
    fits = {}
    for example in examples:
        training = [other for other in examples if other.name != example.name]
        fits[example.name] = common.refit(training, SETTINGS, FREE, {}, steps)
        values = ", ".join(f"{k} {fits[example.name].parameters[k]:.3g}" for k in FREE)
        print(f"without {example.name}: {values}", flush=True)
    return fits


def scene_means(judged: Sequence[Judged], label: str, figure: str) -> dict[str, float]:
    """Mean score of each scene over noise seeds."""
    values: dict[str, list[float]] = {}
    for row in judged:
        if row.parameters == label:
            values.setdefault(row.scene, []).append(getattr(row, figure))
    return {scene: float(np.mean(figures)) for scene, figures in values.items()}


def seed_spread(judged: Sequence[Judged], scene: str, figure: str) -> float:
    """Half the 95 % interval of one scene's gain, over noise seeds."""
    by_label = {
        label: [getattr(r, figure) for r in judged if (r.scene, r.parameters) == (scene, label)]
        for label in ("published", "fitted")
    }
    gains = np.subtract(by_label["fitted"], by_label["published"])
    return common.mean_and_interval(gains)[1]


def summary(judged: Sequence[Judged], catalogue: Sequence[str]) -> list[Any]:
    """One row for each scene and measure, and the gain pooled over the catalogue scenes."""
    rows = []
    for figure in ("psnr", "ssim", "flip"):
        before, after = (scene_means(judged, label, figure) for label in ("published", "fitted"))
        for scene, value in before.items():
            gain, spread = after[scene] - value, seed_spread(judged, scene, figure)
            rows.append((scene, figure, value, after[scene], gain, spread, "noise seeds"))
        gains = [after[scene] - before[scene] for scene in catalogue]
        mean, spread = common.mean_and_interval(gains)
        pooled = [float(np.mean([part[scene] for scene in catalogue])) for part in (before, after)]
        rows.append(("pooled, held out", figure, *pooled, mean, spread, "scenes"))
    return rows


def temporal(name: str, parameters: Mapping[str, Parameters]) -> list[Any]:
    """Flicker and FLIP over a short sequence, one row for each set of parameters."""
    times = INTERVAL * (np.arange(FRAMES) - (FRAMES - 1) / 2)
    examples = [
        common.catalogue_example(name, SIZE, SHUTTER, TRUTH_SAMPLES, time)
        for time in times.tolist()
    ]
    truths = jnp.stack([metrics.display(example.truth) for example in examples])
    rows = []
    for label, values in parameters.items():
        shown = jnp.stack(
            [
                metrics.display(blur(example.frame, values, seed))
                for seed, example in enumerate(examples)
            ]
        )
        flicker = np.asarray(metrics.temporal_difference_error(shown, truths))
        visible = [metrics.flip(*pair) for pair in zip(shown, truths, strict=True)]
        pooled = float(np.sqrt(np.mean(np.square(flicker))))
        spread = float(np.std(visible, ddof=1))
        rows.append((name, label, pooled, float(np.mean(visible)), spread))
    return rows


def enlarged(image: Any) -> np.ndarray:
    """Repeat pixels, to enlarge small frames for viewing."""
    return np.asarray(image).repeat(ENLARGE, axis=0).repeat(ENLARGE, axis=1)


def sheet_row(example: Example, candidates: Sequence[Parameters]) -> list[np.ndarray]:
    """Sharp frame, one picture for each set of parameters, truth, and the pictures' errors."""
    images = [blur(example.frame, parameters, SEEDS[0]) for parameters in candidates]
    errors = [pictures.error_image(image, example.truth) for image in images]
    return [enlarged(part) for part in (example.frame.color, *images, example.truth, *errors)]


def unmended(
    output: Path, examples: Sequence[Example], others: Mapping[str, Parameters], steps: int
) -> list[Any]:
    """Fit to each scene of `UNMENDED` alone: no parameters correct the rest. Writes pictures."""
    rows = []
    known = {example.name: example for example in examples}
    for cause, name in UNMENDED.items():
        if name not in known:
            continue
        example = known[name]
        own = common.refit([example], SETTINGS, FREE, {}, steps).parameters
        compared = {"published": _published(), "fitted": others[name], "fitted to itself": own}
        figures = [
            float(np.mean([row.psnr for row in judge(example, label, values)]))
            for label, values in compared.items()
        ]
        rows.append((cause, name, *figures))
        row = sheet_row(example, [others[name], own])
        picture = pictures.contact_sheet([row[:3], row[3:]])
        pictures.write_png(output / f"unmended_{cause.replace(' ', '_')}.png", picture)
    return rows


def _published() -> dict[str, float]:
    return filter_info(GUERTIN).defaults


def whole_fit(examples: Sequence[Example]) -> fitting.FitResult:
    """Run `jaxblur.fit` as a user would, with scans and standard errors."""
    pairs = [(example.frame, example.truth) for example in examples]
    return jaxblur.fit(
        GUERTIN,
        pairs,
        free=FREE,
        pixel="display",
        mask="moving",
        settings=SETTINGS,
        steps=PROFILED_STEPS,
        patience=0,
        names=[example.name for example in examples],
    )


def draw_curves(path: Path, fits: Mapping[str, common.Refit]) -> None:
    """Draw the loss of every fold by step, as a share of the first loss."""
    lines = {
        f"without {name}": (range(len(fit.losses)), np.array(fit.losses) / fit.losses[0])
        for name, fit in fits.items()
    }
    show.curves(lines, x="step", y="training loss / first loss").savefig(path, dpi=100)


def draw_profiles(path: Path, result: fitting.FitResult, examples: Sequence[Example]) -> None:
    """Draw the loss along each parameter, with the others fixed."""
    pairs = [(example.frame, example.truth) for example in examples]
    figure = show.new_figure(13, 2.8)
    for axis, name in zip(figure.subplots(1, len(FREE), sharey=True), FREE, strict=True):
        around = result.parameters[name] * np.geomspace(1 / 3, 3, POINTS)
        values = np.linspace(0.1, 0.95, POINTS) if name == "tau" else around
        scan = fitting.profile(result, pairs, name, values=values, mask="moving")
        line = scan.values, scan.losses / scan.losses.min()
        show.curves({"": line}, x=name, y="", marks={"": scan.fitted}, axes=axis)
    figure.supylabel("loss / least loss")
    figure.savefig(path, dpi=100)


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = common.output_parser("Gain of fitting the published filter.", "judge on these too")
    parser.add_argument("--quick", action="store_true", help="two scenes, two steps, tables only")
    return parser.parse_args()


def shots(
    examples: Sequence[Example], candidates: Mapping[str, Mapping[str, Parameters]]
) -> Iterator[report.Shot]:
    """Every scene with every set of parameters, for ``jaxblur report``."""
    for example in examples:
        found = [
            report.Picture(
                label,
                blur(example.frame, values[example.name], SEEDS[0]),
                settings=values[example.name],
            )
            for label, values in candidates.items()
        ]
        sharp = report.Picture("sharp", example.frame.color)
        yield report.Shot(example.name, example.truth, [sharp, *found])


def write_scores(output: Path, judged: Sequence[Judged], names: Sequence[str]) -> None:
    """Write the summary and all scores."""
    heads = ("scene", "figure", "published", "fitted", "gain", "± 95 %", "over")
    common.write_table(output, "summary", heads, summary(judged, names))
    common.write_table(output, "scores", Judged._fields, judged)


def run_rest(
    output: Path,
    examples: Sequence[Example],
    others: Sequence[Example],
    fits: Mapping[str, common.Refit],
) -> list[Judged]:
    """Judge the rendered scenes, and write curves, profiles, sequences and pictures."""
    published = _published()
    all_scenes = common.refit(examples, SETTINGS, FREE, {}, STEPS).parameters
    compared = {"published": published, "fitted": all_scenes}
    used = {name: fit.parameters for name, fit in fits.items()}
    used |= dict.fromkeys((other.name for other in others), all_scenes)
    judged = [
        row
        for other, (label, values) in itertools.product(others, compared.items())
        for row in judge(other, label, values)
    ]
    draw_curves(output / "curves.png", fits)
    candidates = {"published": dict.fromkeys(used, published), "fitted": used}
    report.write_result(
        output / "result",
        "Fitting the published filter, each scene left out in turn",
        shots([*examples, *others], candidates),
        {
            "filter": GUERTIN,
            "shutter": SHUTTER,
            "samples": SETTINGS.samples,
            "radius": SETTINGS.radius,
        },
    )
    rows = [sheet_row(example, [published, used[example.name]]) for example in examples]
    pictures.write_png(output / "sheet.png", pictures.contact_sheet(rows))
    movies = [temporal(n, {"published": published, "fitted": used[n]}) for n in MOVIES]
    heads = ("scene", "parameters", "temporal difference error", "mean FLIP", "spread of FLIP")
    common.write_table(output, "temporal", heads, list(itertools.chain(*movies)))
    rows = unmended(output, [*examples, *others], used, STEPS)
    heads = ("cause", "scene", "published dB", "fitted dB", "fitted to itself dB")
    common.write_table(output, "unmended", heads, rows)
    profiled = [example for example in examples if example.name in PROFILED]
    result = whole_fit(profiled)
    result.save(output / "fitted.toml")
    draw_profiles(output / "profiles.png", result, profiled)
    return judged


def main() -> None:
    """Fit every fold, judge the fits, and write tables and pictures."""
    options = parse_arguments()
    output = options.output
    names = SCENES[2:4] if options.quick else SCENES
    samples = 16 if options.quick else TRUTH_SAMPLES
    examples = [common.catalogue_example(name, SIZE, SHUTTER, samples) for name in names]
    fits = leave_one_out(examples, 2 if options.quick else STEPS)
    judged = []
    for example in examples:
        judged += judge(example, "published", _published())
        judged += judge(example, "fitted", fits[example.name].parameters)
    write_scores(output, judged, names)
    if not options.quick:
        folder = options.reference_data
        others = common.cycles_examples(folder, REFERENCE_WIDTH) if folder else []
        judged += run_rest(output, examples, others, fits)
        write_scores(output, judged, names)
        rows = [(name, *(fit.parameters[k] for k in FREE)) for name, fit in fits.items()]
        common.write_table(output, "fits", ("left out", *FREE), rows)


if __name__ == "__main__":
    main()
