"""Plots of speed against error, to choose settings that are worth their time."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .._util.pareto import Measurement, pareto_front
from .figures import figure_and_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS = 72
"""Typographic points per inch; the unit of label sizes."""
LABEL_WIDTH, LABEL_HEIGHT = 3.6, 8
"""Width and height of a character in a label, points."""


def pareto(
    points: Sequence[Measurement],
    *,
    time_label: str = "time, ms",
    error_label: str = "FLIP, less is better",
    labels: str = "front",
    axes: "Axes | None" = None,
) -> "Figure":
    """Draw time against error on logarithmic axes, with the front as a line.

    Groups have a color and a marker each, published settings are stars with a black rim, and
    ranges are drawn as bars.

    Args:
        points: at least one.
        time_label: label of the horizontal axis.
        error_label: label of the vertical axis.
        labels: the points that are labeled: ``front`` (also the published ones, unless labels
            overlap), ``all`` or ``none``.
        axes: where to draw.

    Returns:
        The figure.

    Raises:
        ValueError: there is no point, a time or an error is not a finite number above 0, or
            ``labels`` is unknown.
    """
    _check(points, labels)
    figure, axes = figure_and_axes(axes, 7.0, 4.5)
    front = pareto_front(points)
    # Ranges may extend to 0, which does not exist on a logarithmic axis.
    axes.set_xscale("log", nonpositive="clip")
    axes.set_yscale("log", nonpositive="clip")
    axes.plot(
        [point.time for point in front],
        [point.error for point in front],
        drawstyle="steps-post",
        color="gray",
        linewidth=1,
        zorder=1,
        label="front",
    )
    groups = list(dict.fromkeys(point.group for point in points))
    for number, group in enumerate(groups):
        _draw_group(axes, [p for p in points if p.group == group], group, number)
    axes.autoscale_view()
    told = [p for p in points if p in front or p.published]
    wanted = {"all": points, "none": (), "front": _legible(axes, told)}
    for point in wanted[labels]:
        _draw_label(axes, point)
    axes.set(xlabel=time_label, ylabel=error_label)
    axes.grid(which="both", alpha=0.2)
    axes.legend(fontsize="small")
    return figure


MARKERS = "osD^vPX<>h"


def _check(points: Sequence[Measurement], labels: str) -> None:
    if labels not in ("front", "all", "none"):
        raise ValueError(f"`labels` must be 'front', 'all' or 'none', got {labels!r}.")
    if not points:
        raise ValueError("`points` must hold at least one measurement.")
    for point in points:
        for name in ("time", "error"):
            value = getattr(point, name)
            if not 0 < value < math.inf:
                raise ValueError(
                    f"`points` must have a finite {name} above 0 for logarithmic axes, got "
                    f"{value:g} for {point.label!r}; leave it out."
                )


def _draw_group(axes: Any, points: Sequence[Measurement], group: str, number: int) -> None:
    """Draw a group in one color with one marker; published settings are stars."""
    color, marker = f"C{number % 10}", MARKERS[number % len(MARKERS)]
    plain = [point for point in points if not point.published]
    stars = [point for point in points if point.published]
    for part, style in (
        (plain, {"marker": marker, "s": 30, "label": group or None}),
        (stars, {"marker": "*", "s": 160, "edgecolors": "black", "linewidths": 0.8}),
    ):
        if part:
            if part is stars:
                style["label"] = f"{group} as published".strip()
            axes.scatter(
                [p.time for p in part], [p.error for p in part], color=color, zorder=3, **style
            )
    for point in points:
        if point.time_range:
            axes.plot(point.time_range, [point.error] * 2, color=color, linewidth=1, zorder=2)
        if point.error_range:
            axes.plot([point.time] * 2, point.error_range, color=color, linewidth=1, zorder=2)


def _legible(axes: Any, points: Sequence[Measurement]) -> list[Measurement]:
    """Choose points whose labels do not overlap; published ones first, then the fastest."""
    chosen: list[tuple[Measurement, float, float]] = []
    for point in sorted(points, key=lambda p: (not p.published, p.time)):
        x, y = axes.transData.transform((point.time, point.error)) * POINTS / axes.figure.dpi
        if all(
            abs(y - other_y) > LABEL_HEIGHT
            or not -LABEL_WIDTH * len(point.label) < x - other_x < LABEL_WIDTH * len(other.label)
            for other, other_x, other_y in chosen
        ):
            chosen.append((point, x, y))
    return [point for point, _, _ in chosen]


def _draw_label(axes: Any, point: Measurement) -> None:
    axes.annotate(
        point.label,
        (point.time, point.error),
        xytext=(5, 4),
        textcoords="offset points",
        fontsize="x-small",
        # Labels may come from files: a dollar sign in them must not start a formula.
        parse_math=False,
    )
