"""The tables of the report."""

import itertools
from collections.abc import Sequence
from pathlib import Path

from jaxblur import bench
from jaxblur.bench import Row
from jaxblur.bench.fronts import Point
from jaxblur.filters import FILTERS

from . import figures, plan
from .claims import claims
from .plan import Extent

BLENDER = {
    # scene: (seconds, PSNR where it moves, PSNR of the sharp frame there).
    "cube_over_crates": (0.27, 30.03, 15.85),
    "falling_cubes": (1.47, 28.39, 19.31),
    "flagpole": (3.13, 33.57, 23.26),
    "sky_car": (0.89, 22.84, 21.93),
}
"""Vector Blur node of Blender 5.0.1, 32 samples, 640x360, two cores of which it used about one.
The figures are from the notes of the reference frames, measured on another day and machine."""


FEWEST = 5
"""Fewest rows to which three exponents and a scale are fitted."""
TIMES = {"ms": "wall", "cpu_ms": "processor"}


def write_all(folder: Path, rows: Sequence[Row], extent: Extent, reference: Path | None) -> None:
    """Write every table and figure.

    Args:
        folder: output folder.
        rows: results, each case once on each subject.
        extent: extent of the run.
        reference: folder of the rendered reference frames, or None.
    """
    (folder / "pareto.md").write_text(bench.report(rows), encoding="utf-8")
    for error in ("flip", "rmse"):
        figures.draw_fronts(folder / f"pareto_{error}.png", _groups(rows, extent), error)
    timed = [row for row in rows if _shows_growth(row)]
    figures.draw_growth(folder / "growth.png", timed)
    texts = {
        "growth.md": _growth_table(timed),
        "claims.md": _claims_table(rows, extent),
        "alternatives.md": _alternatives_table(rows),
    }
    if reference is not None:
        texts["blender.md"] = _blender_table(rows)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
        print(text)


def _table(heads: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    everything = [heads, ["---"] * len(heads), *lines]
    return "".join(f"| {' | '.join(line)} |\n" for line in everything)


def _groups(rows: Sequence[Row], extent: Extent) -> dict[str, list[Point]]:
    """Points by title: each scene, then the catalogue scenes pooled."""
    scenes = {key: bench.points(same) for key, same in bench.by_scene(rows).items()}
    groups = {f"{name} {w}x{h}": found for (name, w, h), found in scenes.items() if found}
    height, width = map(str, extent.size)
    catalogue = [scenes[name, width, height] for name in extent.scenes]
    return groups | {f"mean of {len(catalogue)} catalogue scenes": bench.pooled(catalogue)}


def _shows_growth(row: Row) -> bool:
    """Whether a row has a filter on the moving scene with only N and r not as published."""
    timed = row["scene"] == plan.MOVING_SCENE and row["source"] == plan.NO_TRUTH
    if not timed or row["method"] not in FILTERS:
        return False
    case = row.case
    same = plan.make_case(case.method, samples=case.settings.samples, radius=case.settings.radius)
    return case == same


def _growth_table(rows: Sequence[Row]) -> str:
    heads = ("filter", "time", "pixels", "samples", "radius", "scatter", "rows")
    lines = []
    for method, (figure, label) in itertools.product(FILTERS, TIMES.items()):
        own = [row for row in rows if row["method"] == method]
        if len(own) < FEWEST:
            lines.append((method, label, "", "", "", "too few", str(len(own))))
            continue
        law = bench.fit_power_law(own, figure)
        cells = [
            f"{law.exponents[name]:.2f} ± {law.errors[name]:.2f}" if name in law.exponents else ""
            for name in ("pixels", "samples", "radius")
        ]
        lines.append((method, label, *cells, f"{100 * law.residual:.0f} %", str(law.rows)))
    return _table(heads, lines)


def _claims_table(rows: Sequence[Row], extent: Extent) -> str:
    small, large = (f"{w}x{h}" for h, w in extent.claim_sizes)
    heads = ("ratio of times", "published", f"ours ({small}, {large})", "IQR", "ours, processor")
    lines = [
        (claim.what, *(_number(value) for value in claim[1:]))
        for claim in claims(rows, extent.claim_sizes)
    ]
    return _table(heads, lines)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _alternatives_table(rows: Sequence[Row]) -> str:
    same = [row for row in rows if row["scene"] == plan.EVERY_TILE]
    base = {
        row["samples"]: row.figures
        for row in same
        if row["backend"] == "auto" and row["method"] == "guertin2014"
    }
    heads = (
        "guertin2014 in",
        "N",
        "size",
        "ms",
        "IQR",
        "processor ms",
        "time to ours",
        "processor to ours",
    )
    lines = []
    for row in same:
        f, ours = row.figures, base.get(row["samples"])
        if not (f.ms and f.cpu_ms and ours and ours.ms and ours.cpu_ms):
            continue
        name = row["method"]
        if name in FILTERS:
            name = f"jaxblur, backend {row['backend']}"
        lines.append(
            (
                name,
                row["samples"],
                f"{row['width']}x{row['height']}",
                f"{f.ms:.0f}",
                f"{f.ms_iqr or 0:.0f}",
                f"{f.cpu_ms:.0f}",
                f"{f.ms / ours.ms:.2f}",
                f"{f.cpu_ms / ours.cpu_ms:.2f}",
            )
        )
    return _table(heads, lines)


def _blender_table(rows: Sequence[Row]) -> str:
    """Table of the Vector Blur node, by the notes, beside the filters as published."""
    heads = (
        "scene",
        "Vector Blur s (given)",
        "PSNR dB where it moves (given)",
        "filter",
        "s",
        "PSNR dB where it moves",
    )
    lines = []
    for scene, (seconds, psnr, _) in BLENDER.items():
        for row in rows:
            ours = row.figures
            if row["scene"] == scene and row.case.is_published and ours.ms and ours.moving_psnr:
                lines.append(
                    (
                        scene,
                        f"{seconds:.2f}",
                        f"{psnr:.2f}",
                        row["method"],
                        f"{ours.ms / 1e3:.3f}",
                        f"{ours.moving_psnr:.2f}",
                    )
                )
    return _table(heads, lines)
