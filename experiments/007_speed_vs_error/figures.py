"""The plots: time against error, and growth of time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from jaxblur import bench, show
from jaxblur.bench import Row
from jaxblur.bench.fronts import Point, drawn
from jaxblur.bench.scaling import FACTORS

ERROR_LABELS = {"flip": "FLIP where it moves", "rmse": "RMS error where it moves"}
COLUMNS = 2


def draw_fronts(path: Path, groups: Mapping[str, Sequence[Point]], error: str) -> None:
    """Plot time against error on logarithmic axes, one plot for each group.

    Args:
        path: path of the PNG.
        groups: points by title of the plot.
        error: ``flip`` or ``rmse``.
    """
    lines = -(-len(groups) // COLUMNS)
    figure = Figure(figsize=(8 * COLUMNS, 5.4 * lines), layout="constrained")
    cells = figure.subplots(lines, COLUMNS, squeeze=False).ravel()
    for cell in cells[len(groups) :]:
        cell.remove()
    for cell, (title, found) in zip(cells, groups.items(), strict=False):
        measurements = [p.measurement(error) for p in drawn(found, error)]
        show.pareto(measurements, error_label=ERROR_LABELS[error], axes=cell)
        cell.legend(fontsize="x-small", loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=4)
        cell.set_title(title)
        for point in found:
            if point.case.method == bench.UNBLURRED:
                cell.axhline(getattr(point, error), color="gray", linestyle=":", linewidth=1)
                cell.annotate(
                    "unblurred",
                    (1, getattr(point, error)),
                    fontsize="x-small",
                    xycoords=("axes fraction", "data"),
                    ha="right",
                    va="bottom",
                )
    figure.savefig(path, dpi=80)


def draw_growth(path: Path, rows: Sequence[Row]) -> None:
    """Plot time against pixels, samples and radius; a line joins cases that differ only in those.

    Args:
        path: path of the PNG.
        rows: results on the scene in which everything moves.
    """
    figure = Figure(figsize=(13, 6.5), layout="constrained")
    for cell, (name, factor) in zip(figure.subplots(1, len(FACTORS)), FACTORS.items(), strict=True):
        lines: dict[Any, list[tuple[float, float, float]]] = {}
        for row in rows:
            if row.figures.ms:
                point = factor(row), row.figures.ms, row.figures.ms_iqr or 0.0
                lines.setdefault(_but(row, name), []).append(point)
        methods = sorted({key[0] for key in lines})
        for key, points in lines.items():
            if len({x for x, *_ in points}) > 1:
                x, y, spread = np.array(sorted(points)).T
                number = methods.index(key[0])
                label = " ".join(key[:1]) + _others(key, name)
                cell.errorbar(
                    x,
                    y,
                    spread / 2,
                    marker="o",
                    markersize=3,
                    linewidth=1,
                    color=f"C{number}",
                    alpha=0.5 + 0.5 * (len(points) > 3),
                    label=label,
                )
        cell.set(xscale="log", yscale="log", xlabel=name, ylabel="ms")
        cell.tick_params(which="minor", labelbottom=False)
        cell.grid(which="both", alpha=0.2)
        cell.legend(fontsize="x-small", loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2)
    figure.savefig(path, dpi=90)


def _but(row: Row, factor: str) -> tuple[str, ...]:
    """Key of a line of a plot: the method and all factors but one."""
    parts = {
        "pixels": f"{row['width']}x{row['height']}",
        "samples": f"N={row['samples']}",
        "radius": f"r={row['radius']}",
    }
    parts[factor] = ""
    return (row["method"], *parts.values())


def _others(key: tuple[str, ...], factor: str) -> str:
    return "".join(f", {part}" for part in key[1:] if part)
