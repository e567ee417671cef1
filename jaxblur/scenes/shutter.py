"""Shutter functions: transmission as a curve from opening to closing.

A curve holds the transmission at evenly spaced times and is linear in between, so that box,
triangle and trapezoid are exact. Positions are in shutter units: -1/2 at opening, 1/2 at closing.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

GAUSSIAN_WIDTH = 1 / 6
GAUSSIAN_POINTS = 129

ShutterFunction = str | np.ndarray


def _gaussian() -> np.ndarray:
    position = np.linspace(-0.5, 0.5, GAUSSIAN_POINTS)
    return np.exp(-0.5 * (position / GAUSSIAN_WIDTH) ** 2)


SHUTTER_FUNCTIONS: dict[str, Callable[[], np.ndarray]] = {
    "box": lambda: np.array([1.0, 1.0]),
    "trapezoid": lambda: np.array([0.0, 1.0, 1.0, 1.0, 0.0]),
    "triangle": lambda: np.array([0.0, 1.0, 0.0]),
    "gaussian": _gaussian,
}

PLACEMENTS = {"centered": 0.0, "leading": 0.5, "trailing": -0.5}


def shutter_curve(shutter_function: ShutterFunction = "box") -> Float[np.ndarray, " points"]:
    """Return a shutter function as a curve of mean 1.

    ``box`` opens and closes at once. ``trapezoid`` is a mechanical shutter, which needs time to
    open and to close [Navarro 2012, 4.3.8]; that these take a quarter each is our choice.
    ``triangle`` is a rotating disc as wide as its window. ``gaussian`` has a standard deviation of
    a sixth of the shutter time.

    Args:
        shutter_function: one of these names, or a sampled curve: at least two values, evenly
            spaced from opening to closing, not negative and not all zero.

    Returns:
        (K,) transmission relative to its mean.

    Raises:
        ValueError: the name is unknown, or the values are not a curve.
    """
    if isinstance(shutter_function, str):
        if shutter_function not in SHUTTER_FUNCTIONS:
            raise ValueError(
                f"`shutter_function` must be one of {', '.join(SHUTTER_FUNCTIONS)} or an array, "
                f"got {shutter_function!r}."
            )
        curve = SHUTTER_FUNCTIONS[shutter_function]()
    else:
        curve = np.asarray(shutter_function, float)
    if curve.ndim != 1 or len(curve) < 2:
        raise ValueError(
            f"`shutter_function` must be one row of at least 2 values, got shape {curve.shape}."
        )
    if not np.all(np.isfinite(curve)) or curve.min() < 0 or curve.max() == 0:
        raise ValueError("`shutter_function` must be finite, not negative and not all zero.")
    return curve / np.mean((curve[1:] + curve[:-1]) / 2)


def exposure_positions(
    curve: Float[np.ndarray, " points"], samples: int
) -> Float[np.ndarray, " samples"]:
    """Place equal-weight samples at the middles of `samples` equal shares of the light.

    Inverts the integral of the curve, which is quadratic between two points.

    Args:
        curve: curve of mean 1, from `shutter_curve`.
        samples: number of samples.

    Returns:
        (samples,) increasing positions in (-1/2, 1/2).
    """
    step = 1 / (len(curve) - 1)
    areas = step * (curve[1:] + curve[:-1]) / 2
    light = np.concatenate([[0.0], np.cumsum(areas)])
    wanted = (np.arange(samples) + 0.5) / samples * light[-1]
    segment = np.clip(np.searchsorted(light, wanted, side="right") - 1, 0, len(areas) - 1)
    low, rise = curve[segment], (curve[segment + 1] - curve[segment]) / step
    rest = wanted - light[segment]
    # The root of rise/2 x^2 + low x = rest, in the form that also holds for rise = 0.
    x = 2 * rest / np.maximum(low + np.sqrt(np.maximum(low**2 + 2 * rise * rest, 0)), 1e-300)
    return -0.5 + segment * step + np.clip(x, 0, step)


def exposure_center(time: float, shutter: float, placement: str) -> float:
    """Find the middle of the exposure.

    Args:
        time: frames.
        shutter: exposure time in frames.
        placement: "centered" on `time`, "leading" (opens at `time`) or "trailing" (closes then).

    Returns:
        Frames.

    Raises:
        ValueError: the placement is unknown.
    """
    if placement not in PLACEMENTS:
        raise ValueError(f"`placement` must be one of {', '.join(PLACEMENTS)}, got {placement!r}.")
    return time + PLACEMENTS[placement] * shutter
