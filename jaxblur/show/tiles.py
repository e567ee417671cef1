"""Drawings of tiles, taps and texel weights: how a filter reads a frame."""

import dataclasses
import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..filters.guertin2014 import GuertinParameters
from ..filters.registry import FilterInfo, Parameters, filter_info
from ..filters.taps import taps_at
from ..filters.tiles import dominant_velocity, tile_max
from ..frame import Frame
from ..noise import Noise
from ..safe_math import clamp_speed
from ..settings import GuertinSettings, Settings, checked_settings
from .buffers import display, draw_streaks, fastest
from .colors import velocity_colors
from .figures import figure_and_axes, show_pixels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TINT = 0.45
"""Opacity of a tile's color over the picture."""
MARGIN = 6
"""Margin around the taps of a pixel, pixels."""
LARGEST_DOT = 250.0
"""Area of the dot for the largest weight, in square points."""

DOMINANT_COLOR, CENTER_COLOR, OWN_COLOR = "tab:blue", "tab:orange", "tab:red"


def tile_velocities(
    frame: Frame, settings: Settings, stage: Literal["tile", "neighbor"] = "neighbor"
) -> Float[np.ndarray, "rows columns 2"]:
    """Compute the velocity of each tile, with the functions that the filters use.

    Args:
        frame: one frame.
        settings: radius, and the rule for diagonal tiles.
        stage: ``tile`` for the fastest vector of the tile itself, ``neighbor`` for the dominant
            one of its 3 x 3 neighborhood.

    Returns:
        (ceil(H / r), ceil(W / r), 2) half-spread in pixels, clamped to the radius.

    Raises:
        ValueError: the stage is unknown.
    """
    if stage not in ("tile", "neighbor"):
        raise ValueError(f"`stage` must be 'tile' or 'neighbor', got {stage!r}.")
    settings = checked_settings(settings, GuertinSettings)
    velocity, _ = clamp_speed(jnp.asarray(frame.velocity), settings.radius)
    if stage == "tile":
        return np.asarray(tile_max(velocity, settings.radius))
    return np.asarray(
        dominant_velocity(
            velocity, settings.radius, settings.diagonal_tiles, settings.soft_temperature
        )
    )


def tile_overlay(
    frame: Frame,
    settings: Settings = GuertinSettings(),
    *,
    stage: Literal["tile", "neighbor"] = "neighbor",
    axes: "Axes | None" = None,
) -> "Figure":
    """Draw the grid of tiles over the color; each tile has the tint and the arrow of its velocity.

    Args:
        frame: one frame.
        settings: radius, and the rule for diagonal tiles.
        stage: see `tile_velocities`.
        axes: axes to draw in; new ones if None.

    Returns:
        The figure.

    Raises:
        ValueError: the stage is unknown.
    """
    tiles = tile_velocities(frame, settings, stage)
    figure, axes = figure_and_axes(axes)
    height, width = frame.depth.shape
    radius = settings.radius
    colors = velocity_colors(tiles, fastest(tiles)).repeat(radius, 0).repeat(radius, 1)
    gray = display(frame.color).mean(axis=-1, keepdims=True)
    name = {"tile": "TileMax", "neighbor": "NeighborMax"}[stage]
    tinted = (1 - TINT) * gray + TINT * colors[:height, :width]
    show_pixels(axes, tinted, f"{name}, tiles of {radius} px")
    for border in range(0, width + 1, radius):
        axes.axvline(border - 0.5, color="white", linewidth=0.6)
    for border in range(0, height + 1, radius):
        axes.axhline(border - 0.5, color="white", linewidth=0.6)
    rows, columns = np.mgrid[: tiles.shape[0], : tiles.shape[1]]
    # A tile at the border ends where the picture ends.
    x, y = (
        (start * radius + np.minimum((start + 1) * radius, size)) / 2 - 0.5
        for start, size in ((columns, width), (rows, height))
    )
    moving = np.linalg.norm(tiles, axis=-1) > 0
    draw_streaks(axes, x[moving], y[moving], tiles[moving], color="black", width=0.004)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    return figure


def texel_weights(
    name: str,
    frame: Frame,
    row: int,
    column: int,
    *,
    parameters: Parameters | None = None,
    settings: Settings | None = None,
    noise: Noise | None = None,
) -> Float[np.ndarray, "height width"]:
    """Compute the contribution of each texel of the frame to one pixel of the result.

    The result of a filter whose weights do not depend on color is linear in color, so the weights
    are the derivative of the pixel with respect to color. `layered` is linear as long as color
    tells the same of which surface each pixel is.

    Args:
        name: name of a registered filter.
        frame: one frame.
        row: row of the pixel.
        column: column of the pixel.
        parameters: parameters of the filter; its defaults if None.
        settings: settings of the filter; its defaults if None.
        noise: noise of the filter.

    Returns:
        (H, W) weights that sum to 1; they are at least 0 for nearest fetch.

    Raises:
        ValueError: the filter is unknown, its weights depend on color, or the pixel lies outside
            the frame.
    """
    info = filter_info(name)
    if info.reads_color:
        raise ValueError(
            f"`name` must be a filter whose weights do not depend on color, got {name!r}: its "
            "result is not a weighted sum of the frame's colors."
        )
    height, width = frame.depth.shape
    if not (0 <= row < height and 0 <= column < width):
        raise ValueError(
            f"`row`, `column` must lie in a frame of {height} rows and {width} columns, got "
            f"{row}, {column}."
        )
    parameters = info.make_parameters() if parameters is None else parameters
    settings = info.settings if settings is None else settings
    return np.asarray(_texel_weights(info, frame, row, column, parameters, settings, noise))


@functools.partial(jax.jit, static_argnames=("info", "settings"))
def _texel_weights(
    info: FilterInfo,
    frame: Frame,
    row: jax.Array,
    column: jax.Array,
    parameters: Parameters | None,
    settings: Settings,
    noise: Noise | None,
) -> jax.Array:
    """Compiled once for all pixels of frames of one size."""

    def pixel(color: jax.Array) -> jax.Array:
        colored = dataclasses.replace(frame, color=color)
        return info.call(colored, parameters, settings=settings, noise=noise)[row, column, 0]

    return jax.grad(pixel)(jnp.asarray(frame.color))[..., 0]


def tap_diagram(
    frame: Frame,
    row: int,
    column: int,
    *,
    name: str = "guertin2014",
    parameters: Parameters | None = None,
    settings: Settings | None = None,
    noise: Noise | None = None,
    axes: "Axes | None" = None,
) -> "Figure":
    """Draw the texels that contribute to one pixel of the result, and their weights.

    The area of a dot is the weight of its texel, from `texel_weights`; the ring marks the pixel
    itself. For guertin2014, crosses mark the taps along the dominant direction and along the center
    direction, and the lines are as long as their reach; taps without a dot have no weight. With the
    expected tile choice every tile that may be read is drawn, less likely ones fainter.

    Args:
        frame: one frame.
        row: row of the pixel.
        column: column of the pixel.
        name: name of a registered filter.
        parameters: parameters of the filter; its defaults if None.
        settings: settings of the filter; its defaults if None.
        noise: noise of the filter.
        axes: axes to draw in; new ones if None.

    Returns:
        The figure.

    Raises:
        ValueError: the filter is unknown, its weights depend on color, or the pixel lies outside
            the frame.
    """
    options = {"parameters": parameters, "settings": settings, "noise": noise}
    weights = texel_weights(name, frame, row, column, **options)
    figure, axes = figure_and_axes(axes, 5.5, 4.5)
    gray = display(frame.color).mean(axis=-1)
    own = weights[row, column]
    title = f"{name} at row {row}, column {column}: {100 * own:.0f} % its own color"
    show_pixels(axes, gray, title).set(cmap="gray", clim=(-0.8, 1.2))
    if name == "guertin2014":
        _draw_taps(axes, frame, row, column, options)
    rows, columns = np.nonzero(weights)
    area = LARGEST_DOT * weights[rows, columns] / weights.max()
    axes.scatter(columns, rows, s=np.abs(area), color="gold", edgecolors="black", linewidths=0.5)
    axes.scatter([column], [row], s=90, facecolors="none", edgecolors="white", linewidths=1.5)
    _show_around(axes, frame, np.append(columns, column), np.append(rows, row))
    return figure


def _draw_taps(axes: Any, frame: Frame, row: int, column: int, options: Mapping[str, Any]) -> None:
    """Draw the two lines of guertin2014 with their taps, and the pixel's own velocity."""
    info = filter_info("guertin2014")
    parameters, settings = options["parameters"], options["settings"]
    parameters = GuertinParameters() if parameters is None else parameters
    settings = info.settings if settings is None else settings
    taps: Any = taps_at(frame, parameters, row, column, settings=settings, noise=options["noise"])
    taps = jax.tree.map(np.asarray, taps)
    middle = np.array([column, row])
    for choice in np.flatnonzero(taps.chance > 0):
        reach = np.linalg.norm(taps.dominant[choice])
        alpha = 0.25 + 0.75 * float(taps.chance[choice])
        for label, unit, mine, color in (
            ("dominant direction", taps.along[choice], ~taps.second, DOMINANT_COLOR),
            ("center direction", taps.center[choice], taps.second, CENTER_COLOR),
        ):
            ends = middle + reach * np.array([-unit, unit])
            named = label if choice == np.argmax(taps.chance) else None
            axes.plot(*ends.T, color=color, alpha=alpha, linewidth=1.2, label=named)
            axes.plot(*(middle + taps.offset[choice, mine]).T, "x", color=color, alpha=alpha)
    velocity = np.asarray(frame.velocity)[row, column]
    draw_streaks(
        axes, [column], [row], velocity[None], color=OWN_COLOR, label="own velocity", zorder=3
    )
    axes.legend(fontsize="x-small", loc="upper right")


def _show_around(axes: Any, frame: Frame, columns: Any, rows: Any) -> None:
    """Zoom to the texels with a weight and to the lines drawn, inside the frame."""
    height, width = frame.depth.shape
    for line in axes.lines:
        columns, rows = np.append(columns, line.get_xdata()), np.append(rows, line.get_ydata())
    left, right = columns.min() - MARGIN, columns.max() + MARGIN
    top, bottom = rows.min() - MARGIN, rows.max() + MARGIN
    axes.set(
        xlim=(max(left, -0.5), min(right, width - 0.5)),
        ylim=(min(bottom, height - 0.5), max(top, -0.5)),
    )
