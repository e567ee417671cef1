"""Figures without global state, and the error message if matplotlib is not installed."""

from typing import TYPE_CHECKING, Any

from jax.typing import ArrayLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage


def new_figure(width: float, height: float) -> "Figure":
    """Make an empty figure.

    Args:
        width: inches.
        height: inches.

    Returns:
        The figure, laid out without overlaps.

    Raises:
        ImportError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise ImportError(
            "`jaxblur.show` draws with matplotlib, which is not installed: "
            "pip install 'jaxblur[plot]'."
        ) from error
    return Figure(figsize=(width, height), layout="constrained")


def figure_and_axes(
    axes: "Axes | None", width: float = 5.0, height: float = 3.5
) -> "tuple[Figure, Axes]":
    """Return the axes to draw in and their figure; make new ones if none are given.

    Args:
        axes: axes to draw in, or None.
        width: width of a new figure, inches.
        height: height of a new figure, inches.

    Returns:
        Figure and axes.

    Raises:
        ValueError: the axes belong to no figure.
    """
    if axes is None:
        figure = new_figure(width, height)
        return figure, figure.subplots()
    figure: Any = axes.get_figure(root=True)
    if figure is None:
        raise ValueError("`axes` must belong to a figure; these were removed from theirs.")
    return figure, axes


def show_pixels(axes: "Axes", display: ArrayLike, title: str = "") -> "AxesImage":
    """Draw display values, one square for each pixel, without ticks.

    Args:
        axes: axes to draw in.
        display: (H, W, 3) sRGB values in [0, 1], or (H, W).
        title: title above the picture.

    Returns:
        The drawn image.
    """
    image = axes.imshow(display, interpolation="nearest")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_title(title, fontsize="medium")
    return image
