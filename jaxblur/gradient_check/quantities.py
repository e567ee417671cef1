"""What a filter is differentiated by: parameters, all velocities, one object, the camera."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..filters.registry import FilterInfo
from ..frame import Frame, check_frame, check_frame_type

Direction = Callable[[Any], Frame]
"""Maps a number x to a frame; the derivative is taken at x = 0."""

MOVING = 0.5
"""Speed in pixels above which something moves."""

TWIST = tuple(f"{motion} {axis}" for motion in ("rotation", "translation") for axis in "xyz")
"""Names of the six numbers of a twist, in their order."""


class Point(NamedTuple):
    """Everything that a filter differentiates."""

    frame: Frame
    parameters: Any


class Quantity(NamedTuple):
    """A scalar x that moves frame or parameters; 0 is where the derivative is taken."""

    name: str
    at: float
    move: Callable[[Any], Point]


def parameter_quantities(info: FilterInfo, here: Point, step: float) -> list[Quantity]:
    """One quantity for each parameter.

    Args:
        info: the filter.
        here: frame and parameters.
        step: half the interval of a difference; a parameter at the end of its range is moved inside
            by it.
    """
    parameters, quantities = here.parameters, []
    if parameters is None:
        return []
    for name, entry in info.parameter_infos.items():
        value = float(getattr(parameters, name))
        if math.isfinite(entry.high):
            value = min(value, entry.high / (1 + step))

        def move(x: Any, name: str = name, value: float = value) -> Point:
            # Of the type of the others: a weak one would trace the filter anew for each parameter.
            moved = jnp.asarray(value * (1 + x) if value else x, here.frame.color.dtype)
            return here._replace(parameters=dataclasses.replace(parameters, **{name: moved}))

        quantities.append(Quantity(name, value, move))
    return quantities


def frame_quantity(name: str, here: Point, direction: Direction, at: float = 0.0) -> Quantity:
    """The quantity of a direction in which the frame changes.

    Args:
        name: of the quantity.
        here: frame and parameters, which stay.
        direction: gives the frame.
        at: value to list.
    """

    def move(x: Any) -> Point:
        moved = direction(x)
        check_frame_type(moved, f"directions[{name!r}](x)")
        moved = check_frame(moved)
        # Alpha does not count, as in the frame itself.
        shape = here.frame.color.shape
        color = moved.color[..., : shape[2]]
        if color.shape != shape:
            raise ValueError(
                f"`directions[{name!r}](x)` must give a frame like `frame`, of color {shape}, got "
                f"{moved.color.shape}."
            )
        return here._replace(frame=moved.replace(color=color))

    return Quantity(name, at, move)


def checked_directions(directions: Mapping[str, Direction] | None) -> dict[str, Direction]:
    """The directions of a caller by name; none for None.

    Raises:
        ValueError: they are not functions by name.
    """
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


def scaled(frame: Frame, scale: float) -> Direction:
    """All velocities of a frame times ``scale * (1 + x)``."""
    return lambda x: _with_motion(frame, lambda vectors: vectors * (scale * (1 + x)))


def _with_motion(frame: Frame, change: Callable[[jax.Array], jax.Array]) -> Frame:
    """The frame with a change of its vectors (..., 2), in velocity and path alike."""
    path = None if frame.path is None else change(frame.path)
    return frame.replace(velocity=change(frame.velocity), path=path)


def object_directions(frame: Frame, chosen: Any) -> dict[str, Direction]:
    """Speed, direction and depth of an object.

    Args:
        frame: the frame.
        chosen: (H, W) booleans, ``fastest`` for `fastest_object`, or None.

    Returns:
        Directions by name; none without an object.

    Raises:
        ValueError: the mask has another shape or type, or selects no pixel.
    """
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


def camera_directions(
    frame: Frame, camera_velocity: Callable[..., jax.Array] | None
) -> dict[str, Direction]:
    """The six numbers of a camera's motion, added to that of the frame.

    Args:
        frame: the frame.
        camera_velocity: maps depth and twist to half-spreads, see `jaxblur.check_gradient`; or
            None.

    Returns:
        Directions by name; none without a camera.

    Raises:
        ValueError: the function gives another shape, or NaN or infinity.
    """
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
