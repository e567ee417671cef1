"""Does FLIP put shutter times and sampling levels into the groups that viewers do?

    python experiments/003_perception/run.py -o OUT            # about 10 minutes
    python experiments/003_perception/run.py -o OUT --quick    # part of the grid, about a minute

The grid of Navarro 2012, table 5.1: a rolling sphere with 3 materials, 3 speeds, 5 shutter times
and 5 sampling levels. Every cell is scored against the cell with the most samples (A5) of the same
material, speed and shutter time, over the pixels that the sphere's motion reaches with the longest
shutter. Every level has its own seed. Writes results.csv, results.md and figure.png.
"""

import csv
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.common import output_parser
from jaxblur import metrics, perception, scenes, show

MATERIALS = {"M1": "flat", "M2": "checker", "M3": "noise"}
SPEEDS = {"S1": "slow", "S2": "medium", "S3": "fast"}
SHUTTERS = {"T1": 0.0, "T2": 0.25, "T3": 0.5, "T4": 0.75, "T5": 1.0}
LEVELS = {"A1": 4, "A2": 128, "A3": 256, "A4": 384, "A5": 512}

VOTES_LEVEL = {"A1": 8, "A2": 34, "A3": 48, "A4": 51, "A5": 59}
"""Times each level was preferred, section 5.6.3; a difference below 24 is not significant."""
SIGNIFICANT_LEVEL = perception.least_significant_difference(5, rounds=20)

VOTES_BOTH = {
    "T3A3": 124,
    "T3A4": 125,
    "T3A5": 119,
    "T4A3": 78,
    "T4A4": 90,
    "T4A5": 96,
    "T5A3": 38,
    "T5A4": 40,
    "T5A5": 46,
}
"""Times each pair was preferred, section 5.7.2; a difference below 36 is not significant."""
SIGNIFICANT_BOTH = perception.least_significant_difference(9, rounds=21)


class Cell(NamedTuple):
    """One setting of the grid and its scores against its gold standard."""

    material: str
    speed: str
    shutter: str
    level: str
    flip: float
    ssim: float


class Plan(NamedTuple):
    """The part of the grid that is rendered."""

    size: tuple[int, int]
    materials: tuple[str, ...]
    speeds: tuple[str, ...]
    shutters: tuple[str, ...]
    levels: tuple[str, ...]


FULL = Plan((90, 160), tuple(MATERIALS), tuple(SPEEDS), tuple(SHUTTERS), tuple(LEVELS))
QUICK = Plan((36, 64), ("M2", "M3"), ("S2",), ("T3", "T5"), ("A1", "A2", "A3", "A5"))


Images = dict[tuple[str, str], np.ndarray]
Groups = list[tuple[str, ...]]


def render(plan: Plan, material: str, speed: str) -> Images:
    """Render all shutter times and levels of one material and speed."""
    scene = scenes.SCENES["rolling_sphere"](MATERIALS[material], SPEEDS[speed])
    return {
        (shutter, level): np.asarray(
            scenes.stochastic(
                scene,
                shutter=SHUTTERS[shutter],
                samples=LEVELS[level],
                size=plan.size,
                seed=LEVELS[level],
            )
        )
        for shutter, level in itertools.product(plan.shutters, plan.levels)
    }


def footprint(plan: Plan, material: str, speed: str) -> np.ndarray:
    """The pixels (H, W) that the sphere's motion reaches in the longest exposure."""
    scene = scenes.SCENES["rolling_sphere"](MATERIALS[material], SPEEDS[speed])
    return metrics.motion_footprint(
        scenes.render(scene, shutter=max(SHUTTERS.values()), size=plan.size)
    )


def score(plan: Plan, material: str, speed: str, images: Images) -> list[Cell]:
    """Score every cell against the cell with the most samples."""
    cells = []
    mask = footprint(plan, material, speed)
    for (shutter, level), image in images.items():
        scores = metrics.compare(image, images[shutter, plan.levels[-1]], mask)
        cells.append(Cell(material, speed, shutter, level, float(scores.flip), float(scores.ssim)))
    return cells


def groups(values: dict[str, float], limit: float) -> Groups:
    """Groups of settings whose values differ by less than a limit, the best first, names sorted."""
    return [tuple(sorted(group)) for group in perception.equivalent_groups(values, limit)]


def agreement(found: Groups, wanted: Groups) -> float:
    """Share of the pairs of settings on which two groupings agree: same group, or not."""
    names = sorted({name for group in wanted for name in group})
    pairs = list(itertools.combinations(names, 2))

    def together(pair: tuple[str, str], where: Groups) -> bool:
        return any(set(pair) <= set(group) for group in where)

    return sum(together(p, found) == together(p, wanted) for p in pairs) / len(pairs)


def best_limit(values: dict[str, float], wanted: Groups) -> tuple[float, float, Groups]:
    """Find the limit at which the groups agree best: limit, agreement and groups.

    The groups change only where the limit passes a difference between two values, so the limits
    midway between neighboring differences are tried. Among equally good limits the middle one wins.
    """
    steps = {abs(a - b) for a, b in itertools.combinations(values.values(), 2)} | {0.0}
    edges = np.array(sorted(steps))
    limits = np.append((edges[1:] + edges[:-1]) / 2, 2 * edges[-1])
    scores = np.array([agreement(groups(values, limit), wanted) for limit in limits])
    ties = np.flatnonzero(scores == scores.max())
    limit = float(limits[ties[len(ties) // 2]])
    return limit, float(scores.max()), groups(values, limit)


def badness(cells: Sequence[Cell], material: str, shutter: str | None = None) -> dict[str, float]:
    """Negative FLIP by level, or by shutter and level, at medium speed."""
    mine = [c for c in cells if (c.material, c.speed) == (material, "S2")]
    if shutter:
        return {c.level: -c.flip for c in mine if c.shutter == shutter}
    return {c.shutter + c.level: -c.flip for c in mine if c.shutter + c.level in VOTES_BOTH}


def cheapest(cells: Sequence[Cell], limit: float) -> dict[tuple[str, str, str], str]:
    """The lowest level of each material, speed and shutter whose FLIP is below the limit."""
    found: dict[tuple[str, str, str], str] = {}
    for cell in cells:
        if cell.flip < limit:
            found.setdefault((cell.material, cell.speed, cell.shutter), cell.level)
    return found


def across(images: Images, mask: np.ndarray) -> tuple[float, float]:
    """Mean FLIP between two levels of one shutter time, and between two shutter times of a level.

    Only cells of test #3 count: T3 to T5 with A3 to A5.
    """
    names = [key for key in images if "".join(key) in VOTES_BOTH]
    levels, shutters = [], []
    for one, other in itertools.combinations(names, 2):
        if one[0] == other[0] or one[1] == other[1]:
            distance = float(metrics.compare(images[one], images[other], mask).flip)
            (levels if one[0] == other[0] else shutters).append(distance)
    return float(np.mean(levels)), float(np.mean(shutters))


def report(cells: Sequence[Cell], images: Images, plan: Plan) -> tuple[str, float]:
    """Return the table and the answers as Markdown, and the fitted limit."""
    lines = ["| material | speed | shutter | " + " | ".join(plan.levels) + " |"]
    lines.append("|---|---|---|" + "---|" * len(plan.levels))
    for key in dict.fromkeys((c.material, c.speed, c.shutter) for c in cells):
        mine = [c for c in cells if (c.material, c.speed, c.shutter) == key]
        scores = " | ".join(f"{c.flip:.4f} / {c.ssim:.4f}" for c in mine)
        lines.append(f"| {' | '.join(key)} | {scores} |")
    lines += ["", "FLIP / SSIM against A5 where the sphere moves.", ""]
    levels = {name: float(VOTES_LEVEL[name]) for name in plan.levels}
    wanted = groups(levels, SIGNIFICANT_LEVEL)
    limit, share, found = best_limit(badness(cells, "M3", "T3"), wanted)
    lines += [
        f"Levels (M3 S2 T3). Viewers: {wanted}. FLIP at its best limit {limit:.4f}: {found}; "
        f"{share:.0%} of the pairs agree.",
        "",
    ]
    both = badness(cells, "M2")
    votes = {name: float(VOTES_BOTH[name]) for name in both}
    wanted = groups(votes, SIGNIFICANT_BOTH)
    own_limit, share, found = best_limit(both, wanted)
    lines += [
        f"Shutter and level (M2 S2). Viewers: {wanted}. FLIP at its best limit {own_limit:.4f}: "
        f"{found}; {share:.0%} of the pairs agree.",
        "",
    ]
    between_levels, between_shutters = across(images, footprint(plan, "M2", "S2"))
    lines += [
        f"Mean FLIP between levels of one shutter time {between_levels:.4f}, between shutter "
        f"times of one level {between_shutters:.4f} (M2 S2).",
        "",
        f"Cheapest level with FLIP below {limit:.4f}:",
        "",
        "| | " + " | ".join(plan.shutters) + " |",
        "|---|" + "---|" * len(plan.shutters),
    ]
    best = cheapest(cells, limit)
    for material, speed in itertools.product(plan.materials, plan.speeds):
        row = [best.get((material, speed, shutter), "none") for shutter in plan.shutters]
        lines.append(f"| {material} {speed} | " + " | ".join(row) + " |")
    return "\n".join(lines) + "\n", limit


def draw(cells: Sequence[Cell], images: Images, plan: Plan, limit: float, target: Path) -> None:
    """Plot FLIP against samples for each shutter time, beside pictures of the extreme cells."""
    figure = show.new_figure(15, 6.5)
    axes = figure.subplots(2, 4)
    corners = itertools.product(
        (plan.levels[-1], plan.levels[0]), (plan.shutters[0], plan.shutters[-1])
    )
    for axis, (level, shutter) in zip(axes[:, :2].flat, corners, strict=True):
        show.show_pixels(axis, np.asarray(metrics.display(images[shutter, level])), shutter + level)
    for axis, material in zip(axes[:, 2:].flat, plan.materials, strict=False):
        lines = {shutter: _above_zero(cells, material, shutter) for shutter in plan.shutters}
        show.curves(
            lines,
            x="samples",
            y="FLIP against A5",
            title=f"{material} S2",
            log="xy",
            levels={"": limit},
            axes=axis,
        )
    for axis in axes[:, 2:].flat[len(plan.materials) :]:
        axis.axis("off")
    figure.savefig(target, dpi=70)


def _above_zero(
    cells: Sequence[Cell], material: str, shutter: str
) -> tuple[list[float], list[float]]:
    """Samples and FLIP at medium speed, without zeros: a logarithmic axis cannot show them."""
    key = (material, "S2", shutter)
    mine = [c for c in cells if (c.material, c.speed, c.shutter) == key and c.flip > 0]
    return [float(LEVELS[c.level]) for c in mine], [c.flip for c in mine]


def main() -> None:
    """Render and score every cell, and write the tables and the figure."""
    parser = output_parser("Score shutter times and samples.")
    parser.add_argument("--quick", action="store_true", help="small, and part of the grid")
    options = parser.parse_args()
    plan = QUICK if options.quick else FULL
    cells, shown = [], {}
    for material, speed in itertools.product(plan.materials, plan.speeds):
        images = render(plan, material, speed)
        cells += score(plan, material, speed, images)
        print(*cells[-len(images) :], sep="\n", flush=True)
        if (material, speed) == ("M2", "S2"):
            shown = images
    with (options.output / "results.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(Cell._fields)
        writer.writerows(c._replace(flip=round(c.flip, 5), ssim=round(c.ssim, 5)) for c in cells)
    table, limit = report(cells, shown, plan)
    (options.output / "results.md").write_text(table, encoding="utf-8")
    print(table)
    draw(cells, shown, plan, limit, options.output / "figure.png")


if __name__ == "__main__":
    main()
