"""`check_gradient`: derivatives of a filter on somebody's frame, beside what the picture does.

A filter reads texels, so that one image changes by small jumps as a sample moves; the mean over
samples, pixels and noise changes smoothly. The derivative is that of the mean, and is compared
with a central difference over a step at which anybody would see a change,

    (L(x + h) - L(x - h)) / 2h,     L = mean over draws of noise of loss(filter(frame(x)), truth).
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from ._util.stages import Stage, Tell, untold
from .filters.registry import FilterInfo, Parameters, filter_info
from .frame import Frame, check_frame, check_frame_type
from .gradient_table import GradientCheck, GradientRow
from .noise import Noise
from .settings import Settings, checked_settings

Loss = Callable[[jax.Array, jax.Array], jax.Array]
"""Maps image and truth, both (H, W, C), to a number."""
Direction = Callable[[Any], Frame]
"""Maps a number x to a frame; the derivative is taken at x = 0."""

ENOUGH = 0.02
"""Share of the largest difference from which a quantity counts as determined."""
SURE = 5.0
"""Standard errors of the difference from which it counts as determined."""
MOVING = 0.5
"""Speed in pixels above which something moves."""


def squared_error(image: jax.Array, truth: jax.Array) -> jax.Array:
    """Mean squared error over pixels and channels, linear light.

    Args:
        image: (H, W, C).
        truth: (H, W, C).

    Returns:
        A number, at least 0.
    """
    return jnp.mean(jnp.square(image - truth))


TWIST = tuple(f"{motion} {axis}" for motion in ("rotation", "translation") for axis in "xyz")
"""Names of the six numbers of a twist, in their order."""


class _Point(NamedTuple):
    """Everything that a filter differentiates."""

    frame: Frame
    parameters: Any


class _Quantity(NamedTuple):
    """A scalar x that moves frame or parameters; 0 is where the derivative is taken."""

    name: str
    at: float
    move: Callable[[Any], _Point]


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
    chosen = checked_settings(settings or info.settings, info.kind, info.name)
    values = jax.tree.map(
        lambda value: jnp.asarray(value, frame.color.dtype), info.checked_parameters(parameters)
    )
    here = _Point(frame, values)
    quantities = [
        *_of_parameters(info, here, step),
        *(_of_frame("all velocities", here, _scaled(frame, s), s) for s in scales),
        *(_of_frame(n, here, d) for n, d in _of_object(frame, object).items()),
        *(_of_frame(n, here, d) for n, d in _of_camera(frame, camera_velocity).items()),
        *(_of_frame(n, here, d) for n, d in _checked_directions(directions).items()),
    ]
    programs = _compile(info, chosen, loss)
    noises = _draw(draws, seed, frame)
    tell = on_stage or untold
    tell(Stage("compiling", 0, 1))
    start = np.array([float(programs.value(here, image, noise)) for noise in noises])
    tell(Stage("compiling", 1, 1))
    if not np.isfinite(start).all():
        raise ValueError(f"`loss` must be finite, got {start[~np.isfinite(start)][0]}.")
    measured = _measure(programs, quantities, image, noises, step, forward, tell)
    largest = max((abs(m.difference.mean()) for m in measured), default=0.0)
    rows = [
        _row(q, m, largest, float(start.mean())) for q, m in zip(quantities, measured, strict=True)
    ]
    size = frame.color.shape[0], frame.color.shape[1]
    return GradientCheck(info.name, chosen, size, step, draws, float(start.mean()), tuple(rows))


def fastest_object(frame: Frame) -> np.ndarray | None:
    """The pixels of the fastest object: neighbors that agree in depth and velocity belong together.

    Args:
        frame: its depth (H, W) and velocity (H, W, 2) count.

    Returns:
        (H, W) booleans: of all connected regions with at least a thousandth of the pixels the one
        of the largest mean speed; None if none is faster than half a pixel.
    """
    from scipy import sparse

    depth, velocity = np.asarray(frame.depth, np.float64), np.asarray(frame.velocity, np.float64)
    near = np.log(np.clip(depth, 1e-9, 1e18))
    speed = np.linalg.norm(velocity, axis=-1)
    number = np.arange(depth.size).reshape(depth.shape)
    pairs = []
    for one, other in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        apart = np.linalg.norm(velocity[one] - velocity[other], axis=-1)
        alike = apart <= np.maximum(0.25 * np.maximum(speed[one], speed[other]), MOVING)
        alike &= np.abs(near[one] - near[other]) <= 0.1
        pairs.append((number[one][alike], number[other][alike]))
    rows, columns = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    links = sparse.coo_array((np.ones(rows.size), (rows, columns)), shape=(depth.size,) * 2)
    _, regions = sparse.csgraph.connected_components(links, directed=False)
    sizes = np.bincount(regions)
    mean = np.bincount(regions, speed.ravel()) / sizes
    mean[sizes < depth.size / 1000] = 0
    fastest = mean.argmax()
    return (regions == fastest).reshape(depth.shape) if mean[fastest] > MOVING else None


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
    frame = check_frame(frame)
    image = jnp.asarray(truth, frame.color.dtype)
    if image.ndim != 3 or image.shape[:2] != frame.color.shape[:2]:
        raise ValueError(
            f"`truth` must have shape (height, width, channels) like `frame.color` "
            f"{frame.color.shape}, got {image.shape}."
        )
    # Alpha is no light: files hold it beside three channels, and not always in both.
    color, image = (a[..., :3] if a.shape[-1] > 3 else a for a in (frame.color, image))
    if color.shape != image.shape:
        raise ValueError(
            f"`truth` must have {color.shape[-1]} channels like `frame.color`, got "
            f"{image.shape[-1]}."
        )
    frame = frame.replace(color=color)
    known = True if frame.valid is None else np.asarray(frame.valid)[..., None] > 0
    for name, values, counts in (
        ("frame.color", color, known),
        ("frame.velocity", frame.velocity, True),
        ("truth", image, True),
    ):
        if not np.isfinite(np.where(counts, values, 0)).all():
            raise ValueError(f"`{name}` must be finite; repair it: jaxblur.finite_frame(frame).")
    return frame, image


def _checked_directions(directions: Mapping[str, Direction] | None) -> dict[str, Direction]:
    if directions is None:
        return {}
    if not isinstance(directions, Mapping):
        raise ValueError(
            f"`directions` must hold functions by name, got {type(directions).__name__}."
        )
    for name, direction in directions.items():
        if not callable(direction):
            raise ValueError(
                f"`directions[{name!r}]` must be a function of a number that gives a frame, got "
                f"{type(direction).__name__}."
            )
    return dict(directions)


def _of_parameters(info: FilterInfo, here: _Point, step: float) -> list[_Quantity]:
    """One quantity for each parameter."""
    parameters, quantities = here.parameters, []
    if parameters is None:
        return []
    for name, entry in info.parameter_infos.items():
        value = float(getattr(parameters, name))
        if math.isfinite(entry.high):
            value = min(value, entry.high / (1 + step))

        def move(x: Any, name: str = name, value: float = value) -> _Point:
            # Of the type of the others: a weak one would trace the filter anew for each parameter.
            moved = jnp.asarray(value * (1 + x) if value else x, here.frame.color.dtype)
            return here._replace(parameters=dataclasses.replace(parameters, **{name: moved}))

        quantities.append(_Quantity(name, value, move))
    return quantities


def _of_frame(name: str, here: _Point, direction: Direction, at: float = 0.0) -> _Quantity:
    """The quantity of a direction in which the frame changes."""

    def move(x: Any) -> _Point:
        moved = direction(x)
        check_frame_type(moved, f"directions[{name!r}](x)")
        return here._replace(frame=check_frame(moved))

    return _Quantity(name, at, move)


def _with_motion(frame: Frame, change: Callable[[jax.Array], jax.Array]) -> Frame:
    """The frame with a change of its vectors (..., 2), in velocity and path alike."""
    path = None if frame.path is None else change(frame.path)
    return frame.replace(velocity=change(frame.velocity), path=path)


def _scaled(frame: Frame, scale: float) -> Direction:
    return lambda x: _with_motion(frame, lambda vectors: vectors * (scale * (1 + x)))


def _checked_mask(frame: Frame, chosen: Any) -> np.ndarray | None:
    """The pixels of the object, if there is one."""
    if chosen is None:
        return None
    if isinstance(chosen, str):
        if chosen != "fastest":
            raise ValueError(
                f"`object` must be (H, W) booleans, 'fastest' or None, got {chosen!r}."
            )
        return fastest_object(frame)
    mask = np.asarray(chosen)
    if mask.shape != frame.depth.shape or mask.dtype != bool:
        raise ValueError(
            f"`object` must be booleans of shape {frame.depth.shape}, got {mask.dtype} of shape "
            f"{mask.shape}."
        )
    if not mask.any():
        raise ValueError("`object` must select a pixel; None leaves the object out.")
    return mask


def _of_object(frame: Frame, chosen: Any) -> dict[str, Direction]:
    """Speed, direction and depth of an object."""
    mask = _checked_mask(frame, chosen)
    if mask is None:
        return {}

    def inside(vectors: jax.Array) -> np.ndarray:
        return mask.reshape(mask.shape + (1,) * (vectors.ndim - 2))

    def speed(x: Any) -> Frame:
        return _with_motion(frame, lambda v: jnp.where(inside(v), v * (1 + x), v))

    def direction(x: Any) -> Frame:
        def turned(v: jax.Array) -> jax.Array:
            across = jnp.stack([-v[..., 1], v[..., 0]], axis=-1)
            return jnp.where(inside(v), jnp.cos(x) * v + jnp.sin(x) * across, v)

        return _with_motion(frame, turned)

    def depth(x: Any) -> Frame:
        finite = mask & np.isfinite(frame.depth)
        known = jnp.where(finite, frame.depth, 1)
        return frame.replace(depth=jnp.where(finite, known * (1 + x), frame.depth))

    return {"object speed": speed, "object direction": direction, "object depth": depth}


def _of_camera(
    frame: Frame, camera_velocity: Callable[..., jax.Array] | None
) -> dict[str, Direction]:
    """The six numbers of a camera's motion, added to that of the frame."""
    if camera_velocity is None:
        return {}
    if not callable(camera_velocity):
        raise ValueError(
            "`camera_velocity` must be a function of depth and twist, got "
            f"{type(camera_velocity).__name__}."
        )
    root_mean_square = np.sqrt(np.mean(np.square(frame.velocity)))
    directions = {}
    for name, unit in zip(TWIST, np.eye(6, dtype=frame.color.dtype), strict=True):
        added = jnp.asarray(camera_velocity(frame.depth, jnp.asarray(unit)))
        if added.shape != frame.velocity.shape or not np.isfinite(added).all():
            found = "NaN or infinity" if added.shape == frame.velocity.shape else added.shape
            raise ValueError(
                f"`camera_velocity` must give finite half-spreads of shape {frame.velocity.shape}, "
                f"got {found}."
            )
        size = np.sqrt(np.mean(np.square(added)))
        factor = unit * float((root_mean_square or 1.0) / (size or 1.0))

        def moved(x: Any, factor: np.ndarray = factor) -> Frame:
            added = jnp.asarray(camera_velocity(frame.depth, x * jnp.asarray(factor)))
            path = frame.path
            if path is not None:
                path = path + jnp.stack([-added, added], axis=-2)
            return frame.replace(velocity=frame.velocity + added, path=path)

        directions[f"twist {name}"] = moved
    return directions


class _Programs(NamedTuple):
    """Compiled functions of (point, truth, noise), forward modes with a tangent after the point."""

    value: Callable[..., jax.Array]
    gradient: Callable[..., _Point]
    forward: Callable[..., jax.Array]
    forward_of_parameters: Callable[..., jax.Array]


@functools.lru_cache(maxsize=8)
def _compile(info: FilterInfo, settings: Settings, loss: Loss) -> _Programs:
    def value(point: _Point, truth: jax.Array, noise: Noise) -> jax.Array:
        image = info.call(point.frame, point.parameters, settings=settings, noise=noise)
        result = jnp.asarray(loss(image, truth))
        if result.shape:
            raise ValueError(f"`loss` must give a number, got shape {result.shape}.")
        return result

    def forward(point: _Point, tangent: _Point, truth: jax.Array, noise: Noise) -> jax.Array:
        return jax.jvp(lambda p: value(p, truth, noise), (point,), (tangent,))[1]

    def of_parameters(point: _Point, tangent: _Point, truth: jax.Array, noise: Noise) -> jax.Array:
        def moved(parameters: Parameters | None) -> jax.Array:
            return value(point._replace(parameters=parameters), truth, noise)

        return jax.jvp(moved, (point.parameters,), (tangent.parameters,))[1]

    return _Programs(*map(jax.jit, (value, jax.grad(value), forward, of_parameters)))


def _draw(draws: int, seed: int, frame: Frame) -> list[Noise]:
    """Independent, uniform noise."""
    size, kind = frame.depth.shape, frame.color.dtype
    noises = []
    for key in jax.random.split(jax.random.key(seed), draws):
        tap, tile = jax.random.split(key)
        noises.append(
            Noise(
                tap=jax.random.uniform(tap, size, kind, -1, 1),
                tile=jax.random.uniform(tile, (*size, 2), kind, -0.5, 0.5),
            )
        )
    return noises


class _Measured(NamedTuple):
    """By draw of noise (n,); forward is empty where it was not asked for."""

    reverse: np.ndarray
    forward: np.ndarray
    difference: np.ndarray


def _measure(
    programs: _Programs,
    quantities: Sequence[_Quantity],
    truth: jax.Array,
    noises: Sequence[Noise],
    step: float,
    forward: bool,
    tell: Tell,
) -> list[_Measured]:
    """Derivatives and differences by every quantity."""
    places = [jax.jvp(quantity.move, (0.0,), (1.0,)) for quantity in quantities]
    slopes = _reverse(programs, places, truth, noises, tell)
    measured = []
    tell(Stage("differences", 0, len(quantities)))
    for quantity, (point, tangent), slope in zip(quantities, places, slopes, strict=True):
        above, below = quantity.move(step), quantity.move(-step)
        steps = [
            float(programs.value(above, truth, n)) - float(programs.value(below, truth, n))
            for n in noises
        ]
        along = []
        if forward:
            of_frame = any(np.any(leaf) for leaf in jax.tree.leaves(tangent.frame))
            program = programs.forward if of_frame else programs.forward_of_parameters
            along = [float(program(point, tangent, truth, noise)) for noise in noises]
        measured.append(_Measured(slope, np.array(along), np.array(steps) / (2 * step)))
        tell(Stage("differences", len(measured), len(quantities)))
    return measured


def _reverse(
    programs: _Programs,
    places: Sequence[tuple[_Point, _Point]],
    truth: jax.Array,
    noises: Sequence[Noise],
    tell: Tell = untold,
) -> list[np.ndarray]:
    """Derivatives by reverse mode at points along tangents, each (n,)."""
    slopes: list[list[float]] = [[] for _ in places]
    waiting = list(range(len(places)))
    while waiting:
        tell(Stage("derivatives", len(places) - len(waiting), len(places)))
        # Most quantities change from the same place, where one gradient serves all of them.
        point = places[waiting[0]][0]
        together = [k for k in waiting if _same(places[k][0], point)]
        waiting = [k for k in waiting if k not in together]
        for noise in noises:
            gradient = programs.gradient(point, truth, noise)
            for k in together:
                slopes[k].append(_product(gradient, places[k][1]))
    return [np.array(values) for values in slopes]


def _same(one: _Point, other: _Point) -> bool:
    """Whether two points are equal to the bit."""
    leaves, others = jax.tree.leaves(one), jax.tree.leaves(other)
    same_kind = jax.tree.structure(one) == jax.tree.structure(other)
    return same_kind and all(map(np.array_equal, leaves, others))


def _product(gradient: _Point, tangent: _Point) -> float:
    """The derivative along a tangent."""
    return sum(
        float(np.sum(np.multiply(slope, change, dtype=np.float64)))
        for slope, change in zip(jax.tree.leaves(gradient), jax.tree.leaves(tangent), strict=True)
        if np.any(change)
    )


def _row(quantity: _Quantity, measured: _Measured, largest: float, loss: float) -> GradientRow:
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
