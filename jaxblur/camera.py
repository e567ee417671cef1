# pyright: strict, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownLambdaType=false
"""The motion that a moving camera gives a static scene, differentiable in camera and depth.

Camera space has x right, y down and z forward, so that its x and y have the signs of the image. A
**twist** is the motion of the camera in its own axes, six numbers: a rotation vector in radians, by
the right-hand rule, and a translation in the units of depth.

================ =============================== ==========================
positive         the camera                      the image
================ =============================== ==========================
rotation about x tilts up                        moves down
rotation about y turns right                     moves left
rotation about z rolls clockwise                 turns counterclockwise
translation x    moves right                     moves left, near points more
translation y    moves down                      moves up, near points more
translation z    moves forward                   moves away from the center
================ =============================== ==========================
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
from jax import core
from jax.typing import ArrayLike
from jaxtyping import Array, Float

NEAREST = 0.05
"""Share of its depth to which a point comes near the camera at most."""

_TERMS = 14
"""Terms of the series of sine and cosine: up to a full turn in half of the exposure."""


class Intrinsics(NamedTuple):
    """A pinhole camera: a point (x, y, z) is at column ``center_x + focal_x x/z``, rows likewise.

    A pytree of scalars, all differentiable.

    Attributes:
        focal_x: focal length in pixels, horizontally.
        focal_y: the same vertically; equal to `focal_x` where pixels are square.
        center_x: column where the optical axis meets the image, from the left *edge*: width / 2 for
            the middle. Pixel centers are at half integers.
        center_y: row, from the upper edge.
    """

    focal_x: float | jax.Array
    focal_y: float | jax.Array
    center_x: float | jax.Array
    center_y: float | jax.Array

    @classmethod
    def from_field_of_view(cls, degrees: float | jax.Array, size: tuple[int, int]) -> "Intrinsics":
        """A camera with square pixels whose axis meets the middle of the image.

        ``focal = width / (2 tan(angle / 2))``. For a lens and a sensor as wide as the image the
        focal length in pixels is ``width lens / sensor``.

        Args:
            degrees: horizontal field of view, in (0, 180).
            size: (height, width) in pixels.

        Returns:
            The camera; focal lengths are differentiable in the angle.

        Raises:
            ValueError: the angle is out of range (not checked while it is traced).
        """
        if not isinstance(degrees, core.Tracer) and not 0 < float(degrees) < 180:
            raise ValueError(f"`degrees` must lie in (0, 180), got {degrees}.")
        height, width = size
        focal = width / 2 / jnp.tan(jnp.radians(degrees) / 2)
        return cls(focal, focal, width / 2, height / 2)


jax.export.register_namedtuple_serialization(Intrinsics, serialized_name="jaxblur.Intrinsics")


class CameraMove(NamedTuple):
    """The way from one camera to another one, in the axes of the first.

    A pytree of arrays, all differentiable.

    Attributes:
        rotation: (3,) rotation vector in radians.
        translation: (3,) way of the camera's center in the units of depth.
        intrinsics: those of the other camera.
    """

    rotation: ArrayLike
    translation: ArrayLike
    intrinsics: Intrinsics

    @classmethod
    def between(cls, start: ArrayLike, end: ArrayLike, intrinsics: Intrinsics) -> "CameraMove":
        """Find the move from one matrix to another one; in NumPy, with 64 bits.

        Args:
            start: (4, 4) matrix from the world to the camera whose axes are those of the module,
                for column vectors: its last row is 0, 0, 0, 1.
            end: that of the other camera.
            intrinsics: those of the other camera.

        Returns:
            The move.

        Raises:
            ValueError: a matrix has another shape, cannot be inverted, or the two differ by more
                than a rotation and a translation.
        """
        matrices = {"start": np.asarray(start, float), "end": np.asarray(end, float)}
        for name, matrix in matrices.items():
            if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
                raise ValueError(f"`{name}` must be a finite 4 x 4 matrix, got {matrix.tolist()}.")
            if abs(np.linalg.det(matrix)) < _SINGULAR:
                raise ValueError(f"`{name}` must have an inverse, got {matrix.tolist()}.")
        change = matrices["end"] @ np.linalg.inv(matrices["start"])
        turn = change[:3, :3]
        if np.abs(turn @ turn.T - np.eye(3)).max() > _ORTHOGONAL or np.linalg.det(turn) < 0:
            raise ValueError(
                "`end` must differ from `start` by a rotation and a translation, got also a scale, "
                "a shear or a mirror."
            )
        center = -turn.T @ change[:3, 3]
        return cls(_rotation_vector(turn.T), center, intrinsics)


jax.export.register_namedtuple_serialization(CameraMove, serialized_name="jaxblur.CameraMove")

_SINGULAR, _ORTHOGONAL = 1e-12, 1e-3


def _rotation_vector(turn: np.ndarray) -> np.ndarray:
    """The logarithm of a rotation, through its unit quaternion of positive real part."""
    trace = float(np.trace(turn))
    index = int(np.argmax([trace, *np.diag(turn)]))
    quaternion = np.empty(4)
    if index == 0:
        quaternion[:] = 1 + trace, *_axis_part(turn)
    else:
        i, j, k = (index - 1 + np.arange(3)) % 3
        quaternion[0] = turn[k, j] - turn[j, k]
        quaternion[1 + i] = 1 - trace + 2 * turn[i, i]
        quaternion[1 + j] = turn[j, i] + turn[i, j]
        quaternion[1 + k] = turn[k, i] + turn[i, k]
    quaternion *= np.copysign(1, quaternion[0]) / np.linalg.norm(quaternion)
    sine = np.linalg.norm(quaternion[1:])
    half = np.arctan2(sine, quaternion[0])
    return quaternion[1:] * (2 * half / sine if sine > 0 else 2.0)


def _axis_part(turn: np.ndarray) -> np.ndarray:
    return np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])


def camera_velocity(
    depth: ArrayLike,
    twist: ArrayLike | Sequence[float],
    intrinsics: Intrinsics,
    shutter: ArrayLike = 1.0,
) -> Float[Array, "height width 2"]:
    """Half-spread of a static scene while the camera moves.

    Half of the way between the ends of `camera_path`: ``velocity`` of a `Frame`.

    Args:
        depth: as `camera_path`.
        twist: as `camera_path`.
        intrinsics: as `camera_path`.
        shutter: as `camera_path`.

    Returns:
        (H, W, 2) pixels, x right, y down; differentiable as `camera_path`.

    Raises:
        ValueError: as `camera_path`.
    """
    path = camera_path(depth, twist, intrinsics, shutter)
    return (path[..., 1, :] - path[..., 0, :]) / 2


def camera_path(
    depth: ArrayLike,
    twist: ArrayLike | Sequence[float],
    intrinsics: Intrinsics,
    shutter: ArrayLike = 1.0,
) -> Float[Array, "height width 2 2"]:
    """Displacement of a static scene at shutter opening and closing while the camera moves.

    The camera keeps its twist xi, that is, it moves on a screw. From the middle of the exposure, at
    which the frame is seen, to the time t it moves by ``exp(t xi)``, and a point X is seen at
    ``exp(-t xi) X``, with t = -shutter/2 at opening and shutter/2 at closing. Only the two ends are
    computed, exactly. Points at infinity (sky) move by the rotation alone. A point that would come
    nearer to the camera than a twentieth of its depth is treated as if it stayed there.

    Args:
        depth: (H, W) positive planar depth in the middle of the exposure, ``+inf`` for sky.
        twist: (6,) rotation vector in radians and translation in the units of depth, in camera axes
            (see the module), per frame or, with the default shutter, during the exposure.
        intrinsics: focal lengths and center in pixels.
        shutter: exposure time in frames.

    Returns:
        (H, W, 2, 2) pixels, x right, y down: ``path`` of a `Frame`. Differentiable in every
        argument, also at a twist of zero; the derivative in the depth of sky is 0, and that of a
        point held at a twentieth of its depth is that of a point that moves aside only.

    Raises:
        ValueError: depth is no image, the twist not six numbers, or `intrinsics` no `Intrinsics`.

    Source: the exponential map of SE(3), Murray, Li and Sastry 1994, 2.3.
    """
    depth, twist = jnp.asarray(depth), jnp.asarray(twist)
    shape, numbers = depth.shape, twist.shape
    if len(shape) != 2:
        raise ValueError(f"`depth` must have shape (height, width), got {shape}.")
    if numbers != (6,):
        raise ValueError(
            "`twist` must have shape (6,), a rotation vector and a translation, got "
            f"{numbers}; apply jax.vmap over a batch axis."
        )
    if not isinstance(intrinsics, Intrinsics):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ValueError(
            f"`intrinsics` must be jaxblur.Intrinsics, got {type(intrinsics).__name__}; pass "
            "jaxblur.Intrinsics.from_field_of_view(degrees, (height, width))."
        )
    dtype = jnp.result_type(jnp.float32, depth.dtype, twist.dtype)
    camera = Intrinsics(*(jnp.asarray(value, dtype) for value in intrinsics))
    return _camera_path(
        depth.astype(dtype), twist.astype(dtype), camera, jnp.asarray(shutter, dtype)
    )


@jax.jit
def _camera_path(
    depth: Float[Array, "height width"],
    twist: Float[Array, " 6"],
    intrinsics: Intrinsics,
    shutter: Float[Array, ""],
) -> Float[Array, "height width 2 2"]:
    ray = _rays(depth, intrinsics)
    # In units of the point's depth, so that infinity is a number like others.
    inverse = (1 / depth)[..., None]
    focal = jnp.stack([intrinsics.focal_x, intrinsics.focal_y])

    def displacement(time: Float[Array, ""]) -> Float[Array, "height width 2"]:
        turn, travel = _change(-time * twist)
        shift = ray @ turn.T + inverse * travel
        ahead = shift[..., 2:]
        # (x + dx)/(1 + dz) - x in differences: a camera at rest gives exactly zero.
        return focal * (shift[..., :2] - ray[..., :2] * ahead) / jnp.maximum(1 + ahead, NEAREST)

    return jnp.stack([displacement(side * shutter) for side in (-0.5, 0.5)], axis=-2)


def path_between_cameras(
    depth: ArrayLike,
    intrinsics: Intrinsics,
    *,
    before: CameraMove | None = None,
    after: CameraMove | None = None,
    shutter: ArrayLike = 0.5,
) -> Float[Array, "height width 2 2"]:
    """Displacement of a static scene at opening and closing, from cameras of three frames.

    With one move m the camera has gone ``t m`` at the time t after the frame, in frames: its center
    and its intrinsics on a straight line, its turn at a constant rate about one axis (slerp). With
    two, b to the frame before and a to the one after, it has gone ``t (a - b) / 2 + t^2 (a + b) /
    2``, which passes through both cameras without a jump of its velocity, and is the same where
    that is constant. Points at infinity move by the turn alone. A point that would come nearer to
    the camera than a twentieth of its depth is treated as if it stayed there.

    Args:
        depth: (H, W) positive planar depth, ``+inf`` for sky.
        intrinsics: those of the frame.
        before: the move from the frame's camera to that of the frame before. Without it the camera
            is taken to come as it goes on.
        after: the move to the camera of the frame after; likewise.
        shutter: exposure in frames. A share of the camera's motion is that share of the exposure.

    Returns:
        (H, W, 2, 2) pixels, x right, y down: ``path`` of a `Frame`. Differentiable in depth, moves,
        intrinsics and shutter.

    Raises:
        ValueError: depth is no image, or there is no move.

    Source: McGuire et al. 2012, section 4.1: "slerp for the rotation and lerp for the translation".
    """
    depth = jnp.asarray(depth)
    if depth.ndim != 2:
        raise ValueError(f"`depth` must have shape (height, width), got {depth.shape}.")
    if before is None and after is None:
        raise ValueError("`before` or `after` must be a CameraMove, got neither.")
    dtype = jnp.result_type(jnp.float32, depth.dtype)

    def plain(move: CameraMove) -> CameraMove:
        intrinsics = Intrinsics(*(jnp.asarray(value, dtype) for value in move.intrinsics))
        rotation, translation = (jnp.asarray(value, dtype) for value in move[:2])
        return CameraMove(rotation, translation, intrinsics)

    moves = [None if move is None else plain(move) for move in (before, after)]
    camera = Intrinsics(*(jnp.asarray(value, dtype) for value in intrinsics))
    return _path_between(depth.astype(dtype), camera, *moves, jnp.asarray(shutter, dtype))


@jax.jit
def _path_between(
    depth: Float[Array, "height width"],
    intrinsics: Intrinsics,
    before: CameraMove | None,
    after: CameraMove | None,
    shutter: Float[Array, ""],
) -> Float[Array, "height width 2 2"]:
    ray = _rays(depth, intrinsics)
    inverse = (1 / depth)[..., None]
    focal = jnp.stack([intrinsics.focal_x, intrinsics.focal_y])

    first, last = (None if move is None else _changes(intrinsics, move) for move in (before, after))
    if first is None or last is None:
        # A side without a camera of its own: the other one, backwards.
        known = last if first is None else jax.tree.map(jnp.negative, first)
        rate, growth = known, jax.tree.map(jnp.zeros_like, known)
    else:
        rate = jax.tree.map(lambda a, b: (b - a) / 2, first, last)
        growth = jax.tree.map(lambda a, b: (b + a) / 2, first, last)

    def displacement(time: Float[Array, ""]) -> Float[Array, "height width 2"]:
        move = jax.tree.map(lambda a, b: time * a + time * time * b, rate, growth)
        turn, _ = _change(jnp.concatenate([-move.rotation, jnp.zeros(3, depth.dtype)]))
        travel = move.translation
        shift = ray @ turn.T - inverse * (travel + turn @ travel)
        ahead = shift[..., 2:]
        place = (shift[..., :2] - ray[..., :2] * ahead) / jnp.maximum(1 + ahead, NEAREST)
        wider, aside = jnp.stack(move.intrinsics[:2]), jnp.stack(move.intrinsics[2:])
        return focal * place + wider * (ray[..., :2] + place) + aside

    return jnp.stack([displacement(side * shutter / 2) for side in (-1, 1)], axis=-2)


def _changes(intrinsics: Intrinsics, move: CameraMove) -> CameraMove:
    """The move with the changes of the intrinsics in their place."""
    changes = (b - a for a, b in zip(intrinsics, move.intrinsics, strict=True))
    return move._replace(intrinsics=Intrinsics(*changes))


def _rays(
    depth: Float[Array, "height width"], intrinsics: Intrinsics
) -> Float[Array, "height width 3"]:
    """The point of each pixel at depth 1."""
    height, width = depth.shape
    x = (jnp.arange(width, dtype=depth.dtype) + 0.5 - intrinsics.center_x) / intrinsics.focal_x
    y = (jnp.arange(height, dtype=depth.dtype) + 0.5 - intrinsics.center_y) / intrinsics.focal_y
    x, y = jnp.meshgrid(x, y)
    return jnp.stack([x, y, jnp.ones_like(x)], axis=-1)


def _change(twist: Float[Array, " 6"]) -> tuple[Float[Array, "3 3"], Float[Array, " 3"]]:
    """``exp(twist) - I``: rotation minus identity, and translation.

    With K the cross product with the rotation vector and q its squared length,
    ``R - I = a K + b K^2`` and ``p = (I + b K + c K^2) v``, where a = sin(|w|)/|w| and so on are
    power series in q: no norm, whose derivative at 0 would be singular.
    """
    x, y, z = twist[:3]
    squared = x * x + y * y + z * z
    zero = jnp.zeros_like(x)
    cross = jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    first, second, third = (_series(squared, n) for n in (1, 2, 3))
    twice = cross @ cross
    turn = first * cross + second * twice
    return turn, twist[3:] + (second * cross + third * twice) @ twist[3:]


def _series(squared: Float[Array, ""], first: int) -> Float[Array, ""]:
    """``sum_k (-q)^k / (2k + first)!``."""
    total = jnp.zeros_like(squared)
    for k in reversed(range(_TERMS)):
        total = (-1) ** k / math.factorial(2 * k + first) + squared * total
    return total
