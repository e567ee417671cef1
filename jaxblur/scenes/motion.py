"""Rigid motion as data: transforms of time for objects and for the camera.

Time is in frames, angles in radians, lengths in scene units. Motions are arrays instead of Python
functions, so that scenes with the same number of objects share compiled code.

The world is right-handed with y up. Camera space has x right, y down and z forward, so that its
x and y have the signs of the image.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Vector = Sequence[float] | np.ndarray

NO_AXIS = (0.0, 1.0, 0.0)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Motion:
    """One rigid motion, or many with a leading axis: spin, place, travel, then orbit.

    A point ``x`` of the object is at
    ``orbit(t) (orientation spin(t) x + position(t) - pivot) + pivot``, where each of position,
    spin angle and orbit angle is ``value + rate t + acceleration max(t - start, 0)^2 / 2``.

    Attributes:
        orientation: (..., 3, 3) rotation from object to world axes.
        travel: (..., 3, 3) rows: position, velocity per frame, acceleration per frame squared.
        spin_axis: (..., 3) unit axis through the object's origin, in object axes.
        spin: (..., 3) angle, radians per frame, radians per frame squared.
        orbit_axis: (..., 3) unit axis in world axes.
        orbit_pivot: (..., 3) a point on the orbit axis, scene units.
        orbit: (..., 3) angle, radians per frame, radians per frame squared.
        start: (...) frame at which the accelerations begin; before it they are zero.
    """

    orientation: jax.Array
    travel: jax.Array
    spin_axis: jax.Array
    spin: jax.Array
    orbit_axis: jax.Array
    orbit_pivot: jax.Array
    orbit: jax.Array
    start: jax.Array


def rigid(
    position: Vector = (0.0, 0.0, 0.0),
    *,
    orientation: np.ndarray | None = None,
    velocity: Vector = (0.0, 0.0, 0.0),
    acceleration: Vector = (0.0, 0.0, 0.0),
    spin_axis: Vector = NO_AXIS,
    spin: Vector = (0.0, 0.0, 0.0),
    orbit_axis: Vector = NO_AXIS,
    orbit_pivot: Vector = (0.0, 0.0, 0.0),
    orbit: Vector = (0.0, 0.0, 0.0),
    start: float = 0.0,
) -> Motion:
    """Describe one rigid motion; parts that are left out do not move.

    Args:
        position: (3,) position of the object's origin at time 0, scene units.
        orientation: (3, 3) rotation from object to world axes; identity if None.
        velocity: (3,) scene units per frame.
        acceleration: (3,) scene units per frame squared, from `start` on.
        spin_axis: (3,) axis through the object's origin, object axes, any length but zero.
        spin: angle, rate and acceleration in radians and frames; missing ones are zero.
        orbit_axis: (3,) axis in world axes, any length but zero.
        orbit_pivot: (3,) point on the orbit axis.
        orbit: angle, rate and acceleration in radians and frames; missing ones are zero.
        start: frame at which the accelerations begin.

    Returns:
        A motion without leading axes.

    Raises:
        ValueError: an axis has no length.
    """
    return Motion(
        orientation=jnp.asarray(np.eye(3) if orientation is None else orientation, np.float32),
        travel=jnp.asarray([position, velocity, acceleration], np.float32),
        spin_axis=_unit("spin_axis", spin_axis),
        spin=_angles(spin),
        orbit_axis=_unit("orbit_axis", orbit_axis),
        orbit_pivot=jnp.asarray(orbit_pivot, np.float32),
        orbit=_angles(orbit),
        start=jnp.asarray(start, np.float32),
    )


def _angles(values: Vector) -> Float[Array, " 3"]:
    return jnp.asarray(np.pad(np.asarray(values, np.float32), (0, 3 - len(values))))


def _unit(name: str, axis: Vector) -> Float[Array, " 3"]:
    length = np.linalg.norm(axis)
    if length == 0:
        raise ValueError(f"`{name}` must not be the zero vector, got {tuple(axis)}.")
    return jnp.asarray(np.asarray(axis) / length, jnp.float32)


def axis_rotation(axis: Float[Array, " 3"], angle: Float[Array, ""]) -> Float[Array, "3 3"]:
    """Rotate about an axis by the right-hand rule (Rodrigues).

    ``R = I + sin(angle) K + (1 - cos(angle)) K K`` with ``K x = axis cross x``.

    Args:
        axis: (3,) unit vector.
        angle: () radians.

    Returns:
        (3, 3) rotation matrix.
    """
    x, y, z = axis
    zero = jnp.zeros_like(x)
    cross = jnp.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]])
    return jnp.eye(3) + jnp.sin(angle) * cross + (1 - jnp.cos(angle)) * (cross @ cross)


def transform(
    motion: Motion, time: Float[Array, ""]
) -> tuple[Float[Array, "3 3"], Float[Array, " 3"]]:
    """Evaluate one motion at one time; use `jax.vmap` for several motions or times.

    Args:
        motion: a motion without leading axes.
        time: () frames.

    Returns:
        rotation (3, 3) and translation (3,): ``world = rotation @ point + translation``.
    """
    ramp = jnp.maximum(time - motion.start, 0.0)
    powers = jnp.array([1.0, time, 0.5 * ramp**2])
    spin = axis_rotation(motion.spin_axis, motion.spin @ powers)
    orbit = axis_rotation(motion.orbit_axis, motion.orbit @ powers)
    position = powers @ motion.travel - motion.orbit_pivot
    return orbit @ motion.orientation @ spin, orbit @ position + motion.orbit_pivot


def stack(motions: Sequence[Motion]) -> Motion:
    """Stack motions along a new leading axis."""
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *motions)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Camera:
    """A moving pinhole camera with square pixels, whose axis passes through the image center.

    Attributes:
        motion: rigid motion from camera space (x right, y down, z forward) to the world.
        focal: () focal length in image **widths**: a point at camera space ``(x, y, z)`` is at
            column ``width/2 + focal width x/z`` and row ``height/2 + focal width y/z``.
        offset: (3,) shift of the eye in camera axes, scene units, such as half the distance
            between two eyes.
    """

    motion: Motion
    focal: jax.Array
    offset: jax.Array = dataclasses.field(default_factory=lambda: jnp.zeros(3, jnp.float32))


def camera(
    position: Vector,
    target: Vector,
    *,
    field_of_view: float = 50.0,
    velocity: Vector = (0.0, 0.0, 0.0),
    turn: float = 0.0,
    turn_axis: Vector = (0.0, -1.0, 0.0),
    orbit: float = 0.0,
) -> Camera:
    """Place a camera that looks at a target at time 0 and then travels, turns or orbits.

    Args:
        position: (3,) eye, scene units.
        target: (3,) point that is seen in the image center at time 0.
        field_of_view: horizontal angle in degrees, in (0, 180).
        velocity: (3,) scene units per frame (dolly, track).
        turn: radians per frame about `turn_axis` through the eye.
        turn_axis: (3,) in camera axes; the default turns the view to the left.
        orbit: radians per frame about the vertical axis through the target.

    Returns:
        The camera.

    Raises:
        ValueError: the field of view is out of range, or the eye is at or above the target.
    """
    if not 0 < field_of_view < 180:
        raise ValueError(f"`field_of_view` must lie in (0, 180) degrees, got {field_of_view}.")
    motion = rigid(
        position,
        orientation=look_at(position, target),
        velocity=velocity,
        spin_axis=turn_axis,
        spin=(0.0, turn),
        orbit_pivot=target,
        orbit=(0.0, orbit),
    )
    return Camera(motion, jnp.float32(0.5 / np.tan(np.radians(field_of_view) / 2)))


def twisting(camera: Camera, twist: Vector) -> Camera:
    """Let a camera move on a screw, from where it is at time 0.

    The twist is that of `jaxblur.camera_path`, which has another way to compute it: here the motion
    is an orbit about the axis of the screw, and travel along it (Chasles).

    Args:
        camera: placed; its own motion is replaced.
        twist: (6,) rotation vector in radians per frame and translation in scene units per frame,
            in camera axes (x right, y down, z forward).

    Returns:
        The camera, seen at time 0 as before.
    """
    rotation, position = (np.asarray(a, float) for a in transform(camera.motion, jnp.float32(0)))
    turn, travel = rotation @ twist[:3], rotation @ twist[3:]
    squared = turn @ turn
    if squared == 0:
        straight = rigid(position, orientation=rotation, velocity=travel)
        return dataclasses.replace(camera, motion=straight)
    motion = rigid(
        position,
        orientation=rotation,
        velocity=(turn @ travel / squared) * turn,
        orbit_axis=turn,
        orbit_pivot=position + np.cross(turn, travel) / squared,
        orbit=(0.0, float(np.sqrt(squared))),
    )
    return dataclasses.replace(camera, motion=motion)


def look_at(position: Vector, target: Vector) -> np.ndarray:
    """Orient a camera so that z points from `position` to `target` and the image is upright.

    Args:
        position: (3,) eye.
        target: (3,) point to look at.

    Returns:
        (3, 3) rotation whose columns are the camera's right, down and forward axes.

    Raises:
        ValueError: the view direction is vertical or has no length.
    """
    forward = np.asarray(target, float) - np.asarray(position, float)
    right = np.cross(forward, (0.0, 1.0, 0.0))
    if np.linalg.norm(right) < 1e-9:
        raise ValueError(
            f"`position` {tuple(position)} must not lie on the vertical through `target` "
            f"{tuple(target)}; move it a little to the side."
        )
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward], axis=1)
