# pyright: strict, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false
"""The strength of the blur: functions from a frame to a frame with another motion.

All compose, and are differentiable and jitted like any function of arrays. None looks at color or
depth. What is scaled is time: a point whose motion is scaled by s moves as it does in an exposure s
times as long. So with l half of the way from the opening to the closing of its path, and c the
middle of these two,

    velocity -> s velocity,    l -> s l,    c -> s^2 c,

and a point on a wheel stays on its circle.

Source: McGuire et al. 2012, section 4.1, "Artistic Controls".
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from .frame import Frame, check_frame
from .safe_math import safe_norm


class SplitMotion(NamedTuple):
    """A frame with each part of its motion.

    Attributes:
        camera: the frame with the motion that the camera gives a scene at rest.
        objects: the frame with what is left, as seen by a camera at rest.
    """

    camera: Frame
    objects: Frame


@dataclasses.dataclass(frozen=True)
class MotionLimits:
    """How much blur is to be seen at most.

    Attributes:
        shutter: longest exposure in frames.
        width: longest blur, from its one end to the other, as a share of the width of the frame,
            which is that of its arrays: where they hold another data window than the display
            window of a file, scale it by the widths of the two.
        source: who recommends it.
    """

    shutter: float
    width: float
    source: str


MOTION_LIMITS = {
    "valve": MotionLimits(
        shutter=0.15,
        width=0.04,
        source="Vlachos 2008, as McGuire et al. 2012, section 1, report it",
    ),
}
"""Published limits by name, for `within_limits`."""


def scale_motion(frame: Frame, by: ArrayLike) -> Frame:
    """Scale the motion of a frame, as if the exposure were ``by`` times as long.

    Args:
        frame: with velocity (H, W, 2) in pixels and perhaps a path (H, W, 2, 2).
        by: a factor, or one for each pixel (H, W): an object's strength is ``1 + matte (s - 1)``.

    Returns:
        The frame with another velocity and path. Differentiable in both and in ``by``.

    Raises:
        ValueError: a shape is wrong.

    Source: McGuire et al. 2012, section 4.1.

    Examples:
        >>> frame = Frame(jnp.ones((1, 2, 3)), jnp.ones((1, 2)), jnp.full((1, 2, 2), 6.0))
        >>> scale_motion(frame, jnp.asarray([[1.0, 0.5]])).velocity[0, :, 0].tolist()
        [6.0, 3.0]
    """
    frame = check_frame(frame)
    factor = _map(by, "by", frame)[..., None]
    return _moving(frame, factor * frame.velocity, _slowed(frame.path, factor))


def limit_motion(frame: Frame, longest: ArrayLike) -> Frame:
    """Shorten what moves farther than a limit: ``v min(1, longest / ||v||)``, keeping directions.

    Args:
        frame: with velocity (H, W, 2) in pixels and perhaps a path, whose half length counts where
            it is longer.
        longest: longest half-spread in pixels, >= 0; a number, or one for each pixel (H, W).

    Returns:
        The frame with another velocity and path. Differentiable in all; at the limit the derivative
        is that of the identity.

    Raises:
        ValueError: a shape is wrong.
    """
    frame = check_frame(frame)
    limit = _map(longest, "longest", frame)
    speed = safe_norm(frame.velocity[..., 0], frame.velocity[..., 1])
    if frame.path is not None:
        half = (frame.path[..., 1, :] - frame.path[..., 0, :]) / 2
        speed = jnp.maximum(speed, safe_norm(half[..., 0], half[..., 1]))
    too_fast = speed > limit
    return scale_motion(frame, jnp.where(too_fast, limit / jnp.where(too_fast, speed, 1), 1))


def within_limits(frame: Frame, limits: MotionLimits | str, shutter: ArrayLike) -> Frame:
    """Shorten exposure and motion to recommended limits.

    The motion is scaled by ``min(1, limits.shutter / shutter)``, then cut to blurs that are
    ``limits.width`` of the frame's width long, that is, to half-spreads of half of that.

    Args:
        frame: as `scale_motion`.
        limits: a `MotionLimits`, or a key of `MOTION_LIMITS`: "valve" is 15 % of the frame's time
            and 4 % of its width.
        shutter: exposure of the frame's motion, frames.

    Returns:
        The frame with another velocity and path.

    Raises:
        ValueError: no limits have that name.

    Source: McGuire et al. 2012, section 1, "Camera Parameters", after Vlachos 2008.
    """
    if isinstance(limits, str):
        if limits not in MOTION_LIMITS:
            known = ", ".join(MOTION_LIMITS)
            raise ValueError(f"`limits` must be MotionLimits or one of {known}; got {limits!r}.")
        limits = MOTION_LIMITS[limits]
    exposed = jnp.asarray(shutter, float)
    shorter = exposed > limits.shutter
    factor = jnp.where(shorter, limits.shutter / jnp.where(shorter, exposed, 1), 1)
    width = jnp.shape(frame.color)[1]
    return limit_motion(scale_motion(frame, factor), limits.width * width / 2)


def split_motion(frame: Frame, camera: ArrayLike) -> SplitMotion:
    """Split the motion into that of the camera and that of the objects, which add up to it.

    Args:
        frame: as `scale_motion`.
        camera: the motion that the camera gives a scene at rest, as `camera_path`,
            `path_between_cameras` or `fit_camera_motion` give it: half-spread (H, W, 2), or
            displacement at opening and closing (H, W, 2, 2).

    Returns:
        Two frames. Differentiable in the motion and in ``camera``.

    Raises:
        ValueError: a shape is wrong.
    """
    frame = check_frame(frame)
    velocity, path = _motion(camera, "camera", frame)
    still = jnp.zeros_like(frame.velocity)
    return SplitMotion(
        camera=_moving(frame, velocity, None if frame.path is None else path),
        objects=replace_camera_motion(frame, camera, still),
    )


def without_camera(frame: Frame, camera: ArrayLike, keep: ArrayLike = 0.0) -> Frame:
    """Remove the motion of the camera, or keep a share of it.

    ``motion - camera + camera scaled by keep``. A share of 0 to 0.15 is what McGuire et al.
    recommend for games in which the camera follows somebody.

    Args:
        frame: as `scale_motion`.
        camera: as `split_motion`.
        keep: share that stays, 0 to 1; a number, or one for each pixel (H, W).

    Returns:
        The frame with another velocity and path. Differentiable in motion, ``camera`` and ``keep``.

    Raises:
        ValueError: a shape is wrong.

    Source: McGuire et al. 2012, section 4.1.
    """
    frame = check_frame(frame)
    factor = _map(keep, "keep", frame)[..., None]
    _, path = _motion(camera, "camera", frame)
    return replace_camera_motion(frame, camera, _scaled_path(path, factor))


def replace_camera_motion(frame: Frame, camera: ArrayLike, by: ArrayLike) -> Frame:
    """Exchange the motion of the camera for that of another one: ``motion - camera + by``.

    Args:
        frame: as `scale_motion`.
        camera: as `split_motion`.
        by: the same of the other camera.

    Returns:
        The frame with another velocity and path. Differentiable in all.

    Raises:
        ValueError: a shape is wrong.
    """
    frame = check_frame(frame)
    old_velocity, old_path = _motion(camera, "camera", frame)
    new_velocity, new_path = _motion(by, "by", frame)
    path = None if frame.path is None else frame.path + (new_path - old_path)
    return _moving(frame, frame.velocity + (new_velocity - old_velocity), path)


def add_velocity(frame: Frame, velocity: ArrayLike, mask: ArrayLike = 1.0) -> Frame:
    """Add a velocity where a sprite is, whose color and depth are not drawn.

    The picture smears inside the sprite, as in the hot air above a fire, behind a cloaked figure,
    or around an explosion. ``velocity + mask * sprite``; both ends of a path move likewise.

    Args:
        frame: as `scale_motion`.
        velocity: (H, W, 2) half-spread in pixels, x right, y down, or (2,) for all pixels.
        mask: coverage of the sprite, 0 to 1; a number, or one for each pixel (H, W).

    Returns:
        The frame with another velocity and path. Differentiable in all.

    Raises:
        ValueError: a shape is wrong.

    Source: McGuire et al. 2012, section 4.1 and figure 10: particles drawn into the velocity buffer
    alone.
    """
    frame = check_frame(frame)
    sprite = jnp.asarray(velocity, frame.velocity.dtype)
    if sprite.shape not in ((2,), frame.velocity.shape):
        raise ValueError(
            f"`velocity` must have shape (2,) or {frame.velocity.shape}, got {sprite.shape}."
        )
    added = _map(mask, "mask", frame)[..., None] * sprite
    path = None if frame.path is None else frame.path + jnp.stack([-added, added], axis=-2)
    return _moving(frame, frame.velocity + added, path)


def _moving(frame: Frame, velocity: Array, path: Array | None) -> Frame:
    return dataclasses.replace(frame, velocity=velocity, path=path)


def _map(values: ArrayLike, name: str, frame: Frame) -> Array:
    """A number or a map, as an array that broadcasts to (H, W)."""
    array, size = jnp.asarray(values, frame.velocity.dtype), frame.depth.shape
    if array.shape not in ((), size):
        raise ValueError(f"`{name}` must be a number or have shape {size}, got {array.shape}.")
    return array


def _motion(
    motion: ArrayLike, name: str, frame: Frame
) -> tuple[Float[Array, "height width 2"], Float[Array, "height width 2 2"]]:
    """The half-spread and the path of a motion that is given as one of the two."""
    array = jnp.asarray(motion, frame.velocity.dtype)
    height, width = frame.depth.shape
    if array.shape == (height, width, 2):
        return array, jnp.stack([-array, array], axis=-2)
    if array.shape == (height, width, 2, 2):
        return (array[..., 1, :] - array[..., 0, :]) / 2, array
    raise ValueError(
        f"`{name}` must have shape {(height, width, 2)} or {(height, width, 2, 2)}, got "
        f"{array.shape}."
    )


def _slowed(path: jax.Array | None, factor: Array) -> Array | None:
    return None if path is None else _scaled_path(path, factor)


def _scaled_path(path: Array, factor: Array) -> Array:
    """The path of an exposure ``factor`` times as long."""
    line = factor * (path[..., 1, :] - path[..., 0, :]) / 2
    middle = jnp.square(factor) * (path[..., 1, :] + path[..., 0, :]) / 2
    return jnp.stack([middle - line, middle + line], axis=-2)
