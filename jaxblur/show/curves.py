"""Plots of numbers: curves with marks, and bars by group."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .figures import figure_and_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


Values = Sequence[float] | np.ndarray


def curves(
    lines: Mapping[str, tuple[Values, Values]],
    *,
    x: str,
    y: str,
    title: str = "",
    log: str = "",
    marks: Mapping[str, float] | None = None,
    levels: Mapping[str, float] | None = None,
    axes: "Axes | None" = None,
) -> "Figure":
    """Draw one or more curves.

    Args:
        lines: horizontal and vertical values by name; an empty name does not appear in the legend.
        x: label of the horizontal axis, with its unit.
        y: label of the vertical axis, with its unit.
        title: title above the plot.
        log: the axes with a logarithmic scale: ``x``, ``y``, ``xy`` or none.
        marks: dashed vertical lines by name.
        levels: dotted horizontal lines by name.
        axes: axes to draw in; new ones if None.

    Returns:
        The figure.

    Raises:
        ValueError: there is no line, or ``log`` names another axis.
    """
    if not lines:
        raise ValueError("`lines` must hold at least one line.")
    if set(log) - {"x", "y"}:
        raise ValueError(f"`log` may hold only the letters x and y, got {log!r}.")
    figure, axes = figure_and_axes(axes)
    for name, (across, up) in lines.items():
        axes.plot(np.asarray(across), np.asarray(up), "o-", markersize=3, label=name or None)
    for number, (name, place) in enumerate((marks or {}).items(), start=len(lines)):
        axes.axvline(place, linestyle="--", color=f"C{number % 10}", label=name or None)
    for name, level in (levels or {}).items():
        axes.axhline(level, linestyle=":", color="gray", label=name or None)
    axes.set(xlabel=x, ylabel=y, title=title)
    axes.set_xscale("log" if "x" in log else "linear")
    axes.set_yscale("log" if "y" in log else "linear")
    axes.grid(alpha=0.3)
    if any([*lines, *(marks or {}), *(levels or {})]):
        axes.legend(fontsize="small")
    return figure


def bars(
    groups: Mapping[str, Mapping[str, float]],
    *,
    x: str,
    title: str = "",
    axes: "Axes | None" = None,
) -> "Figure":
    """Draw horizontal bars, the groups side by side at each name.

    Args:
        groups: values by name, by group; all groups hold the same names.
        x: label of the values, with their unit.
        title: title above the plot.
        axes: axes to draw in; new ones if None.

    Returns:
        The figure; the first name is on top.

    Raises:
        ValueError: there is no group, or their names differ.
    """
    names: list[Any] = list(next(iter(groups.values()), {}))
    if not names or any(list(values) != names for values in groups.values()):
        raise ValueError("`groups` must hold at least one group, all with the same names.")
    figure, axes = figure_and_axes(axes)
    thickness = 0.8 / len(groups)
    for number, (group, values) in enumerate(groups.items()):
        place = np.arange(len(names)) + (number - (len(groups) - 1) / 2) * thickness
        axes.barh(place, list(values.values()), thickness, label=group)
    axes.set(title=title, xlabel=x)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.axvline(0, color="black", linewidth=0.6)
    axes.grid(axis="x", alpha=0.3)
    return figure
