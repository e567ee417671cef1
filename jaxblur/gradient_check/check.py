"""`check_gradient`: derivatives of a filter on somebody's frame, beside what the picture does.

A filter reads texels, so that one image changes by small jumps as a sample moves; the mean over
samples, pixels and noise changes smoothly. The derivative is that of the mean, and is compared
with a central difference over a step at which anybody would see a change,

    (L(x + h) - L(x - h)) / 2h,     L = mean over draws of noise of loss(filter(frame(x)), truth).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from .._util.stages import Stage, Tell, untold
from ..filters.registry import Parameters, filter_info
from ..frame import Frame, check_frame_type, without_alpha
from ..settings import Settings, checked_settings
from .measure import Loss, Measured, compile_programs, draw_noise, measure
from .quantities import (
    Direction,
    Point,
    Quantity,
    camera_directions,
    checked_directions,
    frame_quantity,
    object_directions,
    parameter_quantities,
    scaled,
)
from .table import GradientCheck, GradientRow

ENOUGH = 0.02
"""Share of the largest difference from which a quantity counts as determined."""

SURE = 5.0
"""Standard errors of the difference from which it counts as determined."""


def squared_error(image: jax.Array, truth: jax.Array) -> jax.Array:
    """Mean squared error over pixels and channels, linear light.

    Args:
        image: (H, W, C).
        truth: (H, W, C).

    Returns:
        A number, at least 0.
    """
    return jnp.mean(jnp.square(image - truth))


def check_gradient(
    filter: str | Callable[..., jax.Array],
    frame: Frame,
    truth: ArrayLike,
    parameters: Parameters | None = None,
    *,
    settings: Settings | None = None,
    loss: Loss = squared_error,
    step: float = 0.02,
    draws: int = 16,
    scales: Sequence[float] = (0.8, 1.0, 1.2),
    object: ArrayLike | Literal["fastest"] | None = "fastest",
    camera_velocity: Callable[[jax.Array, jax.Array], jax.Array] | None = None,
    directions: Mapping[str, Direction] | None = None,
    forward: bool = False,
    seed: int = 0,
    on_stage: Tell | None = None,
) -> GradientCheck:
    """Compare derivatives of a filter with central differences on a frame.

    For a quantity x, relative to its value, and n draws of independent, uniform noise u:

        derivative = mean_u dL_u/dx,    difference = mean_u (L_u(x + h) - L_u(x - h)) / 2h

    The quantities are: each parameter; all velocities times s, at each of `scales`; speed,
    direction (x in radians) and depth of one object; the six numbers of a camera's motion that is
    added to the frame's; and directions of your own. Velocity and path change together, since
    `layered` follows the path of a frame that has one. A parameter at an end of its range
    is moved inside by one step, one that is 0 changes by x itself.

    Derivatives are those of `jax.grad`; ``forward=True`` adds those of `jax.jvp`. They leave out
    changes of the winner in a tile maximum, of the number of samples, and at the border of the
    frame. ``tau`` has none but under ``tile_choice="expected"``.

    Args:
        filter: a registered filter or its name.
        frame: (H, W), without NaN.
        truth: (H, W, C) true image like `frame.color`, linear light. Of four or more channels
            the first three count.
        parameters: of the filter; None takes the defaults.
        settings: of the filter; None takes its defaults.
        loss: maps image and truth, both (H, W, C), to a number. A function that is passed again is
            compiled once.
        step: h, half the interval of a difference; 0.02 is two percent.
        draws: n, at least 2.
        scales: factors of all velocities, above 0.
        object: (H, W) booleans, ``fastest`` for `fastest_object`, or None.
        camera_velocity: maps depth (H, W) and a twist (6,), three rotations and three translations
            as in `jaxblur.camera_velocity`, to half-spreads (H, W, 2) in pixels.
            Each number of the twist is scaled so that x = 1 adds, in the root mean square over
            pixels, the speed of the frame. None leaves the camera out.
        directions: functions of x that give a frame, by name, built of JAX operations; the
            derivative is taken at x = 0, and x is stepped by h.
        forward: whether to compute forward mode too. In images it runs without native code and
            is slow.
        seed: of the noise.
        on_stage: called with a `jaxblur.fitting.Stage` as the work goes on: compiling,
            derivatives, differences; ``on_stage=print`` will do.

    Returns:
        The table.

    Raises:
        ValueError: an argument is of the wrong kind, size or range, or the loss is not finite.

    Examples:
        >>> shift = jnp.arange(24.0) / 24
        >>> color = jnp.broadcast_to(jnp.sin(9 * shift)[None, :, None] + 1, (16, 24, 1))
        >>> frame = Frame(color, jnp.ones((16, 24)), jnp.full((16, 24, 2), 3.0))
        >>> table = check_gradient("pixel_velocity", frame, color, scales=(1.0,), object=None)
        >>> [(row.name, row.determined) for row in table.rows]
        [('all velocities', True)]
    """
    info = filter_info(filter)
    _check_numbers(step, draws, scales)
    frame, image = _checked_pair(frame, truth)
    given = info.settings if settings is None else settings
    chosen = checked_settings(given, info.kind, info.name)
    values = jax.tree.map(
        lambda value: jnp.asarray(value, frame.color.dtype), info.checked_parameters(parameters)
    )
    here = Point(frame, values)
    quantities = [
        *parameter_quantities(info, here, step),
        *(frame_quantity("all velocities", here, scaled(frame, s), s) for s in scales),
        *(frame_quantity(n, here, d) for n, d in object_directions(frame, object).items()),
        *(frame_quantity(n, here, d) for n, d in camera_directions(frame, camera_velocity).items()),
        *(frame_quantity(n, here, d) for n, d in checked_directions(directions).items()),
    ]
    programs = compile_programs(info, chosen, loss)
    noises = draw_noise(draws, seed, frame)
    tell = on_stage or untold
    tell(Stage("compiling", 0, 1))
    start = np.array([float(programs.value(here, image, noise)) for noise in noises])
    tell(Stage("compiling", 1, 1))
    if not np.isfinite(start).all():
        raise ValueError(f"`loss` must be finite, got {start[~np.isfinite(start)][0]}.")
    measured = measure(programs, quantities, image, noises, step, forward, tell)
    largest = max((abs(m.difference.mean()) for m in measured), default=0.0)
    rows = [
        _row(q, m, largest, float(start.mean())) for q, m in zip(quantities, measured, strict=True)
    ]
    size = frame.color.shape[0], frame.color.shape[1]
    return GradientCheck(info.name, chosen, size, step, draws, float(start.mean()), tuple(rows))


def _check_numbers(step: float, draws: int, scales: Sequence[float]) -> None:
    if not 0 < step < 1:
        raise ValueError(f"`step` must be above 0 and below 1, got {step!r}; 0.02 is two percent.")
    if isinstance(draws, bool) or not isinstance(draws, int) or draws < 2:
        raise ValueError(f"`draws` must be a whole number, at least 2, got {draws!r}.")
    for scale in scales:
        if not 0 < scale < math.inf:
            raise ValueError(f"`scales` must be numbers above 0, got {scale!r}.")


def _checked_pair(frame: Frame, truth: ArrayLike) -> tuple[Frame, jax.Array]:
    """Frame and truth as arrays of one type, color channels alone."""
    check_frame_type(frame)
    if not isinstance(truth, np.ndarray | jax.Array | list | tuple):
        raise ValueError(
            "`truth` must be the true image, (height, width, channels), got "
            f"{type(truth).__name__}; read a file by jaxblur.exr.read_image(path)."
        )
    frame, image = without_alpha(frame, truth)
    known = True if frame.valid is None else np.asarray(frame.valid)[..., None] > 0
    for name, values, counts in (
        ("frame.color", frame.color, known),
        ("frame.velocity", frame.velocity, True),
        ("truth", image, True),
    ):
        if not np.isfinite(np.where(counts, values, 0)).all():
            raise ValueError(f"`{name}` must be finite; repair it: jaxblur.finite_frame(frame).")
    return frame, image


def _row(quantity: Quantity, measured: Measured, largest: float, loss: float) -> GradientRow:
    reverse, forward, difference = measured
    slope, change = float(reverse.mean()), float(difference.mean())
    ratio = slope / change if change else math.nan
    error = _standard_error(difference)
    determined = change != 0 and abs(change) >= max(ENOUGH * largest, SURE * error)
    return GradientRow(
        name=quantity.name,
        at=quantity.at,
        reverse=slope,
        reverse_error=_standard_error(reverse),
        forward=float(forward.mean()) if forward.size else None,
        difference=change,
        difference_error=error,
        ratio=ratio,
        ratio_error=_standard_error(reverse - ratio * difference) / abs(change)
        if change
        else math.nan,
        sensitivity=change / loss if loss else math.nan,
        determined=bool(determined),
    )


def _standard_error(values: np.ndarray) -> float:
    return float(values.std(ddof=1) / math.sqrt(values.size))
