"""Drawings of a frame's buffers: color, depth, and velocity as colors and as arrows."""

from typing import TYPE_CHECKING, Any

import numpy as np

from .. import metrics
from ..frame import Frame
from .colors import velocity_colors, wheel
from .figures import figure_and_axes, new_figure, show_pixels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ARROWS_ACROSS = 20
SKY_COLOR = "lightsteelblue"
WHEEL_SHARE = 0.28
"""Height of the velocity legend, as a share of the picture's height."""


def frame_sheet(frame: Frame) -> "Figure":
    """Draw all buffers of a frame: color, depth, velocity as colors and as arrows.

    Args:
        frame: one frame.

    Returns:
        The figure.
    """
    height, width = frame.depth.shape
    figure = new_figure(9.0, 8.6 * height / width + 0.6)
    (color, depth), (colors, arrows) = figure.subplots(2, 2)
    show_pixels(color, display(frame.color), f"color, {width} x {height}, linear light")
    depth_map(frame, axes=depth)
    velocity_wheel(frame, axes=colors)
    velocity_arrows(frame, axes=arrows)
    return figure


def display(image: metrics.Image) -> np.ndarray:
    """Convert linear light to display values as the whole package does; see `metrics.display`.

    Args:
        image: (H, W, C) linear light.

    Returns:
        (H, W, 3) sRGB values in [0, 1].
    """
    return np.asarray(metrics.display(image))


def depth_map(frame: Frame, *, axes: "Axes | None" = None) -> "Figure":
    """Draw depth on a logarithmic scale; sky, at infinity, has its own color.

    Args:
        frame: one frame.
        axes: axes to draw in; new ones if None.

    Returns:
        The figure.
    """
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm, Normalize

    figure, axes = figure_and_axes(axes)
    depth = np.asarray(frame.depth, np.float64)
    surface = np.isfinite(depth) & (depth > 0)
    near, far = (depth[surface].min(), depth[surface].max()) if surface.any() else (1.0, 1.0)
    kind = LogNorm if far > 4 * near else Normalize
    colors = colormaps["viridis_r"].with_extremes(bad=SKY_COLOR)
    shown = np.ma.masked_where(~surface, depth)
    title = "depth, scene units" + (", sky blue" if not surface.all() else "")
    picture = show_pixels(axes, shown, title)
    picture.set_cmap(colors)
    picture.set_norm(kind(near, max(far, near * (1 + 1e-6))))
    figure.colorbar(picture, ax=axes, shrink=0.8)
    return figure


def fastest(velocity: metrics.Image) -> float:
    """Find the speed of full saturation: that of the fastest finite vector, at least 1.

    Args:
        velocity: (H, W, 2) in pixels.

    Returns:
        Pixels.
    """
    speed = np.linalg.norm(np.asarray(velocity, np.float64), axis=-1)
    return max(1.0, float(np.max(speed, initial=0.0, where=np.isfinite(speed))))


def velocity_wheel(
    frame: Frame, *, limit: float | None = None, axes: "Axes | None" = None
) -> "Figure":
    """Draw velocity by `velocity_colors`, with the wheel as legend.

    Args:
        frame: one frame.
        limit: half-spread of full saturation in pixels; that of the fastest pixel if None.
        axes: axes to draw in; new ones if None.

    Returns:
        The figure.

    Raises:
        ValueError: the limit is not above 0.
    """
    figure, axes = figure_and_axes(axes)
    limit = fastest(frame.velocity) if limit is None else limit
    title = "velocity: half-spread by color"
    show_pixels(axes, velocity_colors(np.asarray(frame.velocity), limit), title)
    _draw_wheel(axes, limit, frame.depth.shape)
    return figure


def _draw_wheel(axes: Any, limit: float, size: tuple[int, ...]) -> None:
    """Draw the legend in the lower left corner on white, with the limit below the disc."""
    share = WHEEL_SHARE
    legend = axes.inset_axes((0.01, 0.02, share * size[0] / size[1] / 1.25, share))
    legend.imshow(wheel(128), extent=(-1, 1, 1, -1), zorder=2)
    legend.set(xlim=(-1.1, 1.1), ylim=(1.65, -1.1), xticks=[], yticks=[])
    legend.plot([0, 1], [0, 0], color="black", linewidth=1)
    legend.text(0, 1.32, f"{limit:.3g} px", ha="center", va="center", fontsize="x-small")


def velocity_arrows(
    frame: Frame, *, spacing: int | None = None, axes: "Axes | None" = None
) -> "Figure":
    """Draw velocities as arrows over the color, each as long as its pixel's streak.

    An arrow runs from ``p - velocity`` to ``p + velocity``, the path of the point while the shutter
    is open, and is centered on its pixel. Pixels that move by at most half a pixel have none.

    Args:
        frame: one frame.
        spacing: pixels between arrows; 20 arrows across the picture if None.
        axes: axes to draw in; new ones if None.

    Returns:
        The figure.

    Raises:
        ValueError: the spacing is below 1.
    """
    figure, axes = figure_and_axes(axes)
    height, width = frame.depth.shape
    spacing = max(1, width // ARROWS_ACROSS) if spacing is None else spacing
    if spacing < 1:
        raise ValueError(f"`spacing` must be at least 1, got {spacing}.")
    picture = display(frame.color).mean(axis=-1)
    show_pixels(axes, picture, "velocity: from p - v to p + v").set(cmap="gray", clim=(-0.5, 1.2))
    middle = spacing // 2
    rows, columns = np.mgrid[middle:height:spacing, middle:width:spacing]
    velocity = np.asarray(frame.velocity)[rows, columns]
    moving = np.linalg.norm(velocity, axis=-1) > 0.5
    draw_streaks(axes, columns[moving], rows[moving], velocity[moving], color="orangered")
    return figure


def draw_streaks(axes: Any, x: Any, y: Any, velocity: Any, **style: Any) -> None:
    """Draw arrows of length 2 ||v||, centered on their pixels, in pixels of the axes.

    Args:
        axes: axes with a picture, row 0 on top.
        x: (n,) columns.
        y: (n,) rows.
        velocity: (n, 2) half-spread in pixels.
        style: options of `Axes.quiver`.
    """
    units = {"angles": "xy", "scale_units": "xy", "scale": 0.5, "pivot": "mid"}
    axes.quiver(x, y, velocity[..., 0], velocity[..., 1], **units, **{"width": 0.003} | style)
