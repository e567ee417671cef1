"""How good are the three ways to true motion blur, for how much time?

    python experiments/002_ground_truth/run.py -o OUT            # 12 minutes of CPU time, two cores
    python experiments/002_ground_truth/run.py -o OUT --quick    # under a minute, coarser

Writes results.csv, figures.png and crops.png. Times are processor seconds over all cores, the
shortest of several runs, without compilation: on a busy machine wall time says little.
Stochastic sampling has seed 0; nothing else is random.
"""

import csv
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from experiments import pictures
from experiments.common import output_parser
from jaxblur import metrics, scenes, show
from jaxblur.filters import FILTERS, filter_info

CUBES = 500
CROP = 48
BELOW = 10.0


class Plan(NamedTuple):
    """Sizes, samples and scenes of a run."""

    size: tuple[int, int]
    truth: int
    samples: tuple[int, ...]
    spatial: tuple[int, ...]
    cubes: tuple[int, ...]
    mask_bits: tuple[int, ...]
    converging: tuple[str, ...]
    filters: tuple[str, ...]
    repeats: int


FULL = Plan(
    size=(108, 192),
    truth=3000,
    samples=(1, 2, 4, 8, 12, 16, 32, 64, 128),
    spatial=(1, 2, 4, 8, 16),
    cubes=(50, 200, 500, 1000, 2000),
    mask_bits=(32, 64, 96, 128),
    converging=("random_cubes", "crossing", "gears", "camera_turn"),
    filters=("guertin2014", "mcguire2012", "pixel_velocity"),
    repeats=2,
)
QUICK = Plan(
    size=(54, 96),
    truth=256,
    samples=(4, 16),
    spatial=(1, 8),
    cubes=(400, 500),
    mask_bits=(128,),
    converging=("random_cubes",),
    filters=("guertin2014",),
    repeats=1,
)


class Row(NamedTuple):
    """One measurement; columns that do not apply are empty."""

    part: str
    scene: str
    method: str
    setting: int | str
    seconds: float | str = ""
    psnr: float | str = ""
    ssim: float | str = ""
    flip: float | str = ""
    intervals_per_pixel: float | str = ""
    longest_list: int | str = ""
    sorting_share: float | str = ""


def timed(render: Callable[[], jax.Array], repeats: int) -> tuple[jax.Array, float]:
    """Run once to compile, then `repeats` times: the image and the shortest time."""
    image = jax.block_until_ready(render())
    shortest = np.inf
    for _ in range(repeats):
        start = time.process_time()
        jax.block_until_ready(render())
        shortest = min(shortest, time.process_time() - start)
    return image, shortest


def scored(row: Row, image: jax.Array, truth: jax.Array) -> Row:
    """Fill in PSNR, SSIM and FLIP on display values."""
    scores = metrics.compare(image, truth)
    return row._replace(
        psnr=round(float(scores.psnr), 2),
        ssim=round(float(scores.ssim), 4),
        flip=round(float(scores.flip), 4),
    )


def quality(plan: Plan, truth: jax.Array) -> tuple[list[Row], dict[str, list[jax.Array]]]:
    """Figure 13: image quality against time."""
    scene = scenes.SCENES["random_cubes"](CUBES)
    methods: dict[str, tuple[Sequence[int], Callable[[int], jax.Array]]] = {
        "accumulate": (plan.samples, lambda n: scenes.accumulate(scene, samples=n, size=plan.size)),
        "stochastic": (plan.samples, lambda n: scenes.stochastic(scene, samples=n, size=plan.size)),
        "motion_paths": (
            plan.spatial,
            lambda n: scenes.motion_paths(scene, size=plan.size, spatial_samples=n),
        ),
    }
    rows, images = [], {}
    for name, (settings, render) in methods.items():
        images[name] = []
        for setting in settings:
            image, seconds = timed(lambda r=render, s=setting: r(s), plan.repeats)
            row = Row("quality", scene.name, name, setting, round(seconds, 4))
            rows.append(scored(row, image, truth))
            images[name].append(image)
            print(rows[-1])
    return rows, images


def complexity(plan: Plan) -> list[Row]:
    """Figures 15 and 16: time, intervals per pixel and sorting against the number of cubes."""
    rows = []
    for count in plan.cubes:
        scene = scenes.SCENES["random_cubes"](count)
        _, seconds = timed(lambda s=scene: scenes.motion_paths(s, size=plan.size), plan.repeats)
        runs = [
            scenes.motion_paths(scene, size=plan.size, with_statistics=True)[1]
            for _ in range(plan.repeats)
        ]
        statistics = sorted(runs, key=lambda run: run.sorting_share)[len(runs) // 2]
        rows.append(
            Row(
                "complexity",
                scene.name,
                "motion_paths",
                count,
                round(seconds, 4),
                intervals_per_pixel=round(statistics.intervals_per_pixel, 3),
                longest_list=statistics.longest_list,
                sorting_share=round(statistics.sorting_share, 3),
            )
        )
        print(rows[-1])
        for name, method in (("stochastic", scenes.stochastic), ("accumulate", scenes.accumulate)):
            _, seconds = timed(
                lambda m=method, s=scene: m(s, samples=8, size=plan.size), plan.repeats
            )
            rows.append(Row("complexity", scene.name, name, count, round(seconds, 4)))
            print(rows[-1])
    return rows


def mask_width(plan: Plan) -> list[Row]:
    """Section 4.1: time and quality against bits of the mask; the truth has a mask of 512 bits.

    All are sampled at pixel centers, so that only the mask differs.
    """
    scene = scenes.SCENES["random_cubes"](CUBES)
    truth = scenes.motion_paths(scene, size=plan.size, mask_bits=512)
    rows = []
    for bits in plan.mask_bits:
        image, seconds = timed(
            lambda b=bits: scenes.motion_paths(scene, size=plan.size, mask_bits=b), plan.repeats
        )
        row = Row("mask", scene.name, "motion_paths", bits, round(seconds, 4))
        rows.append(scored(row, image, truth))
        print(rows[-1])
    return rows


def convergence(plan: Plan, name: str, truth: jax.Array) -> list[Row]:
    """Error of accumulation by number of samples, and errors of the filters on the same scene."""
    scene = scenes.SCENES[name](CUBES) if name == "random_cubes" else scenes.SCENES[name]()
    rows = []
    for samples in [2**k for k in range(1, 10) if 2**k <= plan.truth // 4]:
        image = scenes.accumulate(scene, samples=samples, size=plan.size)
        rows.append(scored(Row("convergence", name, "accumulate", samples), image, truth))
    frame = scenes.render(scene, size=plan.size)
    for filter_name in plan.filters:
        info = filter_info(filter_name)
        parameters, settings = info.make_parameters(), info.settings
        image = FILTERS[filter_name](frame, parameters, settings=settings)
        rows.append(scored(Row("convergence", name, filter_name, ""), image, truth))
    rows.append(scored(Row("convergence", name, "sharp", ""), frame.color, truth))
    best = max(float(r.psnr) for r in rows if r.method in FILTERS)
    enough = [r.setting for r in rows if r.method == "accumulate" and float(r.psnr) >= best + BELOW]
    wanted = enough[0] if enough else "more"
    rows.append(Row("needed", name, "accumulate", wanted, psnr=round(best + BELOW, 2)))
    print(*rows, sep="\n")
    return rows


def draw(rows: Sequence[Row], target: Path) -> None:
    """Plot quality, complexity, mask bits and convergence."""
    figure = show.new_figure(15, 8.5)
    axes = figure.subplots(2, 3)
    draw_methods(rows, axes[0])
    pick = _picker(rows)
    part = pick("complexity", "motion_paths")
    counts = [r.setting for r in part]
    show.curves(
        {"intervals per pixel": (counts, [r.intervals_per_pixel for r in part])},
        x="cubes",
        y="intervals per pixel",
        title="depth complexity and sorting [fig. 16]",
        axes=axes[1, 0],
    )
    second_axis(axes[1, 0], counts, [r.sorting_share for r in part], "share of sorting", 1)
    part = pick("mask", "motion_paths")
    bits = [r.setting for r in part]
    show.curves(
        {"PSNR, dB": (bits, [r.psnr for r in part])},
        x="bits",
        y="PSNR, dB",
        title="bits of the mask, against 512 [section 4.1]",
        axes=axes[1, 1],
    )
    second_axis(axes[1, 1], bits, [r.seconds for r in part], "seconds")
    draw_convergence(rows, axes[1, 2])
    figure.savefig(target, dpi=70)


def draw_methods(rows: Sequence[Row], axes: Sequence[Any]) -> None:
    """Quality against time, twice, and time against the number of cubes."""
    pick = _picker(rows)
    names = ("accumulate", "stochastic", "motion_paths")

    def lines(part: str, x: str, y: str) -> dict[str, tuple[list[Any], list[Any]]]:
        found = {name: pick(part, name) for name in names}
        return {
            name: ([getattr(r, x) for r in part], [getattr(r, y) for r in part])
            for name, part in found.items()
        }

    title = f"quality, {CUBES} cubes [fig. 13]"
    quality = lines("quality", "seconds", "psnr")
    show.curves(quality, x="seconds", y="PSNR, dB", title=title, log="x", axes=axes[0])
    visible = lines("quality", "seconds", "flip")
    show.curves(visible, x="seconds", y="FLIP", title="the same in FLIP", log="xy", axes=axes[1])
    title = "time, 8 samples, or paths at centers [fig. 15]"
    times = lines("complexity", "setting", "seconds")
    show.curves(times, x="cubes", y="seconds", title=title, axes=axes[2])


def draw_convergence(rows: Sequence[Row], axis: Any) -> None:
    """PSNR of accumulation by number of samples; dotted lines 10 dB above the best filter."""
    part = _picker(rows)("convergence", "accumulate")
    scene_names = list(dict.fromkeys(r.scene for r in rows if r.part == "convergence"))
    lines = {name: [r for r in part if r.scene == name] for name in scene_names}
    show.curves(
        {name: ([r.setting for r in own], [r.psnr for r in own]) for name, own in lines.items()},
        x="samples",
        y="PSNR, dB",
        title="accumulate; dotted: 10 dB above the best filter",
        log="x",
        axes=axis,
    )
    for number, name in enumerate(scene_names):
        level = next(float(r.psnr) for r in rows if r.part == "needed" and r.scene == name)
        axis.axhline(level, color=f"C{number}", ls=":", lw=1)


def second_axis(axis: Any, x: Any, y: Any, label: str, top: float | None = None) -> None:
    """Draw a dashed line of values in another unit, with an axis on the right that starts at 0."""
    twin = axis.twinx()
    twin.plot(x, y, "s--", color="gray")
    twin.set_ylabel(f"{label} (dashed)")
    twin.set_ylim(0, top)


def _picker(rows: Sequence[Row]) -> Callable[[str, str], list[Any]]:
    return lambda part, method: [r for r in rows if r.part == part and r.method == method]


def write_crops(
    rows: Sequence[Row], images: dict[str, list[jax.Array]], truth: jax.Array, target: Path
) -> None:
    """Write the middle of the truth and of each method, at the settings closest in time."""
    pick = _picker(rows)
    paths = pick("quality", "motion_paths")
    budget = float(paths[0].seconds)
    shown = [truth]
    for name in ("accumulate", "stochastic", "motion_paths"):
        seconds = np.array([float(r.seconds) for r in pick("quality", name)])
        best = int(np.argmin(np.abs(np.log(seconds / budget))))
        print("crop:", pick("quality", name)[best])
        shown.append(images[name][best])
    height, width = truth.shape[:2]
    top, left = (height - 2 * CROP) // 2 if height > 2 * CROP else 0, (width - 2 * CROP) // 2
    crops = [np.asarray(i)[top : top + 2 * CROP, left : left + 2 * CROP] for i in shown]
    crops = [np.kron(crop, np.ones((3, 3, 1))) for crop in crops]
    pictures.write_png(target, pictures.contact_sheet([crops]))


def main() -> None:
    """Run all parts, and write the table and the pictures."""
    parser = output_parser("Compare ways to ground truth.")
    parser.add_argument("--quick", action="store_true", help="small and coarse")
    options = parser.parse_args()
    plan = QUICK if options.quick else FULL
    cubes = scenes.SCENES["random_cubes"](CUBES)
    truth = scenes.accumulate(cubes, samples=plan.truth, size=plan.size)
    rows, images = quality(plan, truth)
    rows += complexity(plan)
    rows += mask_width(plan)
    for name in plan.converging:
        own = truth
        if name != "random_cubes":
            own = scenes.accumulate(scenes.SCENES[name](), samples=plan.truth, size=plan.size)
        rows += convergence(plan, name, own)
    with (options.output / "results.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(Row._fields)
        writer.writerows(rows)
    draw(rows, options.output / "figures.png")
    write_crops(rows, images, truth, options.output / "crops.png")


if __name__ == "__main__":
    main()
