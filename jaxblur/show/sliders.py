"""Sliders in a live notebook; elsewhere the picture at their starting values."""

from collections.abc import Callable
from typing import Any


def sliders(draw: Callable[..., object], **ranges: tuple[float, float, float]) -> object:
    """Call a drawing function with values from sliders.

    In a live notebook with ipywidgets (``jaxblur[notebook]``) each value has a slider, and the
    picture is drawn again when one is released. Elsewhere the function is called once, with the
    starting values. Values that are passed on as filter parameters do not recompile anything,
    because parameters are traced.

    Args:
        draw: function that takes the values by name and returns a figure.
        ranges: (low, high, start) for each value; logarithmic if low is above 0 and high is at
            least 100 times low.

    Returns:
        The widgets, or the result of ``draw``.

    Raises:
        ValueError: a start lies outside its range.

    Examples:
        >>> sliders(lambda x: 2 * x, x=(0.0, 1.0, 0.5))
        1.0
    """
    for name, (low, high, start) in ranges.items():
        if not low <= start <= high:
            raise ValueError(f"`{name}` must start between {low:g} and {high:g}, got {start:g}.")
    if not _alive():
        return draw(**{name: start for name, (_, _, start) in ranges.items()})
    import ipywidgets

    return ipywidgets.interactive(
        draw, **{name: _slider(name, *limits) for name, limits in ranges.items()}
    )


def _alive() -> bool:
    """Return whether this runs in a notebook kernel with widgets."""
    try:
        import ipywidgets  # noqa: F401
        from IPython.core.getipython import get_ipython
    except ModuleNotFoundError:
        return False
    return hasattr(get_ipython(), "kernel")


def _slider(name: str, low: float, high: float, start: float) -> Any:
    import ipywidgets
    from numpy import log10

    # Only on release, because drawing is slower than the slider moves.
    common = {"value": start, "description": name, "continuous_update": False}
    if low > 0 and high >= 100 * low:
        return ipywidgets.FloatLogSlider(min=log10(low), max=log10(high), **common)
    return ipywidgets.FloatSlider(min=low, max=high, step=(high - low) / 100, **common)
