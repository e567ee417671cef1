"""Results beside their truth: named pictures, and error heat maps with a scale."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np

from .. import metrics
from .buffers import display
from .figures import figure_and_axes, new_figure, show_pixels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 10.0
"""Width of a sheet of pictures, inches."""
TITLE = 0.3
"""Room for the title above each picture, inches."""


def image_grid(
    images: Mapping[str, metrics.Image], columns: int | None = None, *, width: float = WIDTH
) -> "Figure":
    """Draw pictures under their names.

    Args:
        images: (H, W, C) linear light by name.
        columns: number of pictures in a row; all in one row if None.
        width: width of the figure, inches.

    Returns:
        The figure.

    Raises:
        ValueError: there is no image, or less than one column.
    """
    if not images:
        raise ValueError("`images` must hold at least one image.")
    columns = len(images) if columns is None else columns
    if columns < 1:
        raise ValueError(f"`columns` must be at least 1, got {columns}.")
    rows = -(-len(images) // columns)
    height, across = np.shape(next(iter(images.values())))[:2]
    figure = new_figure(width, rows * (width / columns * height / across + TITLE))
    grid = figure.subplots(rows, columns, squeeze=False).flat
    for axes, (name, image) in zip(grid, images.items(), strict=False):
        show_pixels(axes, display(image), name)
    for axes in list(grid)[len(images) :]:
        axes.axis("off")
    return figure


def error_map(
    image: metrics.Image,
    truth: metrics.Image,
    *,
    kind: Literal["flip", "display"] = "flip",
    limit: float | None = None,
    axes: "Axes | None" = None,
) -> "Figure":
    """Draw the error of each pixel as a heat map with its scale.

    Args:
        image: (H, W, C) linear light.
        truth: (H, W, C) linear light.
        kind: ``flip`` for the visibility of the difference, ``display`` for the mean absolute
            difference of the three display values.
        limit: error at the upper end of the scale; 1 for FLIP, the largest error otherwise.
        axes: axes to draw in; new ones if None.

    Returns:
        The figure.

    Raises:
        ValueError: the kind is unknown, shapes differ, or values are not finite.
    """
    if kind not in ("flip", "display"):
        raise ValueError(f"`kind` must be 'flip' or 'display', got {kind!r}.")
    shown, expected = display(image), display(truth)
    if kind == "flip":
        error = metrics.flip_map(shown, expected)
    elif shown.shape != expected.shape:
        raise ValueError(f"`image` and `truth` differ in shape: {shown.shape}, {expected.shape}.")
    else:
        error = np.abs(shown - expected).mean(axis=-1)
    largest = 1.0 if kind == "flip" else max(float(error.max()), 1e-6)
    figure, axes = figure_and_axes(axes)
    name = "FLIP" if kind == "flip" else "|difference|"
    picture = show_pixels(axes, error, f"{name}, mean {error.mean():.4f}")
    picture.set(cmap="magma", clim=(0, largest if limit is None else limit))
    figure.colorbar(picture, ax=axes, shrink=0.8)
    return figure


def before_after(
    sharp: metrics.Image,
    blurred: metrics.Image,
    truth: metrics.Image,
    *,
    name: str = "blurred",
    limit: float | None = None,
) -> "Figure":
    """Draw the sharp frame, the result, the truth, and the FLIP map of the result.

    Args:
        sharp: (H, W, C) linear light.
        blurred: (H, W, C) linear light.
        truth: (H, W, C) linear light.
        name: name of the result.
        limit: FLIP at the upper end of the scale; 1 if None.

    Returns:
        The figure; titles give PSNR against the truth.

    Raises:
        ValueError: shapes differ, or values are not finite.
    """
    height, width = np.shape(sharp)[:2]
    figure = new_figure(WIDTH, WIDTH * height / width + 2 * TITLE)
    (before, after), (expected, error) = figure.subplots(2, 2)
    reference = display(truth)
    for axes, image, label in ((before, sharp, "sharp"), (after, blurred, name)):
        score = float(metrics.psnr(display(image), reference))
        show_pixels(axes, display(image), f"{label}, {score:.2f} dB")
    show_pixels(expected, reference, "truth")
    error_map(blurred, truth, limit=limit, axes=error)
    return figure
