"""Blur then defocus, defocus then blur, or both at once, against the truth over time and lens.

    python -m experiments.016_order.run -o OUT [--quick | --scores scenes.csv]

Writes order.csv and .md (means), gains.csv and .md (of one pass over the better order), both of the
scenes that chose between variants, and for the others order_others and gains_others; scenes.csv and
.md, times.csv and .md, and order.png. With ``--scores`` nothing is rendered: means and gains of
the scores that a former run has written.
"""

import csv
import dataclasses
import functools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments.common import output_parser, write_table
from experiments.pictures import contact_sheet, error_image, write_png
from jaxblur import metrics, posts, scenes
from jaxblur.filters import filter_info

SIZE = (180, 320)
SHUTTER = 1.0
SAMPLES = 128
LARGE = (720, 1280)
REPEATS = 9
"""Of each time."""
DISC = 7.0
"""Radius in pixels of the largest discs (of 2 % of the pixels)."""
FILTERS = ("layered", "guertin2014")
AT_ONCE = (35, 105)
"""Samples of one pass for both."""
ORDERS = ("blur, then defocus", "defocus, then blur")
MEASURES = ("psnr", "ssim", "flip")


class Score(NamedTuple):
    """What an order scores on a scene, with a filter; the measures as `MEASURES`."""

    scene: str
    name: str
    order: str
    measures: tuple[float, ...]


class Case(NamedTuple):
    """A scene and the share of its pixels that lie before the plane in focus."""

    scene: str
    before: float


CASES = (
    # The middle wheel, whose center is 7.5 away, as in figure 3.14.
    Case("wheels_at_three_depths", 0.25),
    Case("rotor_over_city", 0.2),
    Case("crossing", 0.5),
    Case("camera_dolly", 0.5),
)
"""Scenes on which ways to do both in one pass were compared."""

OTHERS = tuple(
    Case(scene, 0.35)
    for scene in ("gears", "flagpole", "cubes_on_teapot", "rotation_stress", "cube_between_crates")
)
"""Scenes that chose nothing."""


def lens_of(case: Case, scene: scenes.Scene, depth: np.ndarray) -> posts.Lens:
    """Focus on a part of the scene, with an aperture that gives the wanted discs."""
    known = depth[np.isfinite(depth)]
    focus = 7.5 if case.scene == CASES[0].scene else float(np.quantile(known, case.before))
    focal = float(scene.world.camera.focal)
    spread = focal * depth.shape[1] * np.abs(1 / focus - 1 / depth)
    return posts.Lens.of_aperture(DISC / float(np.quantile(spread, 0.98)), focus, focal)


def blur(frame: jaxblur.Frame, name: str, color: Any, samples: int = 35, **more: Any) -> Any:
    """Blur some color by the motion of a frame."""
    info = filter_info(name)
    call: Any = info.call
    settings = dataclasses.replace(info.settings, samples=samples, radius=40)
    return call(frame.replace(color=color), info.make_parameters(), settings=settings, **more)


def _joint(samples: int) -> str:
    return f"both at once, {samples} samples"


def at_once(frame: jaxblur.Frame, lens: posts.Lens, name: str) -> dict[str, Any]:
    """Motion and defocus in one pass, where the filter takes a lens."""
    if not filter_info(name).takes_lens:
        return {}
    return {
        _joint(samples): blur(frame, name, frame.color, samples, lens=lens) for samples in AT_ONCE
    }


def images_of(frame: jaxblur.Frame, lens: posts.Lens, name: str) -> dict[str, Any]:
    """Every order, and each of the two alone."""

    def defocus(color: Any) -> Any:
        return posts.defocus(frame.replace(color=color), lens)

    blurred, defocused = blur(frame, name, frame.color), defocus(frame.color)
    return {
        "neither": frame.color,
        "blur alone": blurred,
        "defocus alone": defocused,
        ORDERS[0]: defocus(blurred),
        ORDERS[1]: blur(frame, name, defocused),
        **at_once(frame, lens, name),
    }


def milliseconds(sizes: tuple[tuple[int, int], ...], repeats: int) -> list[tuple[str, ...]]:
    """Processor time of each part on the first scene, median of several in turn, at each size."""
    scene = scenes.SCENES[CASES[0].scene]()
    columns: list[dict[str, float]] = []
    for size in sizes:
        frame = jax.tree.map(jnp.asarray, scenes.render(scene, 0, SHUTTER, size, path=True))
        lens = lens_of(CASES[0], scene, np.asarray(frame.depth))
        parts = parts_of(frame, lens)
        for run in parts.values():
            jax.block_until_ready(run())
        spent: dict[str, list[float]] = {name: [] for name in parts}
        for _ in range(repeats):
            for name, run in parts.items():
                started = time.process_time()
                jax.block_until_ready(run())
                spent[name].append(time.process_time() - started)
        columns.append({name: 1000 * float(np.median(each)) for name, each in spent.items()})
    return [(name, *(f"{column[name]:.1f}" for column in columns)) for name in columns[0]]


def parts_of(frame: jaxblur.Frame, lens: posts.Lens) -> dict[str, Callable[[], Any]]:
    """What is timed."""

    def two_passes(samples: int) -> Any:
        blurred = blur(frame, FILTERS[0], frame.color, samples)
        return posts.defocus(frame.replace(color=blurred), lens)

    parts: dict[str, Callable[[], Any]] = {
        "guertin2014, 35 samples": functools.partial(blur, frame, "guertin2014", frame.color),
        "defocus, 64 samples": functools.partial(posts.defocus, frame, lens),
    }
    for samples in AT_ONCE:
        alone = functools.partial(blur, frame, FILTERS[0], frame.color, samples)
        parts |= {
            f"layered, {samples} samples": alone,
            f"layered, {samples} samples, then defocus": functools.partial(two_passes, samples),
            f"layered, {_joint(samples)}": functools.partial(alone, lens=lens),
        }
    return parts


def render(output: Path, cases: tuple[Case, ...], samples: int) -> list[Score]:
    """Score every order on every scene; write the picture of the first one."""
    scores = []
    for case in cases:
        scene = scenes.SCENES[case.scene]()
        frame = jax.tree.map(jnp.asarray, scenes.render(scene, 0, SHUTTER, SIZE, path=True))
        lens = lens_of(case, scene, np.asarray(frame.depth))
        thin = scenes.ThinLens(float(lens.aperture_radius), float(lens.focus))
        truth = scenes.accumulate(scene, 0, SHUTTER, samples, SIZE, lens=thin)
        for name in FILTERS:
            made = images_of(frame, lens, name)
            for order, image in made.items():
                score = metrics.compare(metrics.rgb(image), metrics.rgb(truth))
                scores.append(Score(case.scene, name, order, tuple(map(float, score))))
                print(*scores[-1], flush=True)
            if case == CASES[0] and name == FILTERS[0]:
                shown = (*ORDERS, _joint(AT_ONCE[0]))
                sheet = [
                    [truth, *(made[order] for order in shown)],
                    [frame.color, *(error_image(made[order], truth) for order in shown)],
                ]
                write_png(output / "order.png", contact_sheet(sheet))
    each = [(*score[:3], *(f"{value:.4f}" for value in score.measures)) for score in scores]
    write_table(output, "scenes", ("scene", "filter", "order", *MEASURES), each)
    return scores


def read_scores(path: Path) -> list[Score]:
    """The scores of a former run."""
    with path.open(encoding="utf-8", newline="") as lines:
        return [
            Score(
                *(row["scene"], row["filter"], row["order"]),
                tuple(float(row[measure]) for measure in MEASURES),
            )
            for row in csv.DictReader(lines)
        ]


def means(scores: list[Score]) -> list[tuple[str, ...]]:
    """The mean over the scenes of every filter and order."""
    rows = []
    for name, order in dict.fromkeys((score.name, score.order) for score in scores):
        found = [score.measures for score in scores if (score.name, score.order) == (name, order)]
        rows.append((name, order, *(f"{value:.4f}" for value in np.mean(found, axis=0))))
    return rows


def gains(scores: list[Score]) -> list[tuple[str, ...]]:
    """PSNR of the better order of each scene, and what one pass gains over it; then the means."""
    psnr = {score[:3]: score.measures[0] for score in scores}
    rows = []
    for scene in dict.fromkeys(score.scene for score in scores):
        better = max(psnr[scene, FILTERS[0], order] for order in ORDERS)
        joint = [psnr[scene, FILTERS[0], _joint(samples)] for samples in AT_ONCE]
        rows.append((scene, better, *(value - better for value in joint)))
    rows.append(("mean", *np.mean([row[1:] for row in rows], axis=0)))
    return [(scene, f"{better:.2f}", *(f"{v:+.2f}" for v in gain)) for scene, better, *gain in rows]


def main() -> None:
    """Run the experiment."""
    parser = output_parser("The order of blur and defocus against the truth of both.")
    parts = parser.add_mutually_exclusive_group()
    parts.add_argument("--quick", action="store_true", help="the wheels alone, 64 samples")
    parts.add_argument("--scores", type=Path, metavar="CSV", help="scenes.csv of a former run")
    arguments = parser.parse_args()
    if arguments.scores is not None:
        scores = read_scores(arguments.scores)
    else:
        cases, samples = (CASES[:1], 64) if arguments.quick else (CASES + OTHERS, SAMPLES)
        scores = render(arguments.output, cases, samples)
        sizes = (SIZE,) if arguments.quick else (SIZE, LARGE)
        timed = milliseconds(sizes, REPEATS)
        columns = ("what", *(f"CPU ms, {width}x{height}" for height, width in sizes))
        write_table(arguments.output, "times", columns, timed)
    columns = ("scene", "better order", *(f"gain, {samples} samples" for samples in AT_ONCE))
    for cases, end in ((CASES, ""), (OTHERS, "_others")):
        names = [case.scene for case in cases]
        if part := [score for score in scores if score.scene in names]:
            order = means(part)
            write_table(arguments.output, f"order{end}", ("filter", "order", *MEASURES), order)
            write_table(arguments.output, f"gains{end}", columns, gains(part))


if __name__ == "__main__":
    main()
