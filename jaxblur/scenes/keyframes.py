"""Motion in pieces of time: poses at the ends of each piece, straight lines between them.

`stochastic` and `motion_paths` move every corner of a triangle along a straight line in camera
space within a piece. `needed_pieces` measures the error of this approximation.
"""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .scene import NEAR, Pose, World, points_at, pose_at
from .shutter import ShutterFunction, shutter_curve

CHECKS = 4
MOST_PIECES = 64
TABLE_POINTS = 1025


class LightTable(NamedTuple):
    """Share of the light that has passed, as a function of the position in the exposure.

    Attributes:
        position: (T,) increasing from -1/2 (opening) to 1/2 (closing).
        light: (T,) increasing from 0 to 1.
    """

    position: jax.Array
    light: jax.Array


def light_table(shutter_function: ShutterFunction) -> LightTable:
    """Integrate a shutter function.

    Args:
        shutter_function: a name or a curve; see `shutter.shutter_curve`.

    Returns:
        The table: 2 points for the box, for which it is exact, else 1025.

    Raises:
        ValueError: the name is unknown, or the values are not a curve.
    """
    curve = shutter_curve(shutter_function)
    count = 2 if np.all(curve == curve[0]) else TABLE_POINTS
    position = np.linspace(0, 1, count)
    height = np.interp(position, np.linspace(0, 1, len(curve)), curve)
    light = np.concatenate([[0.0], np.cumsum(height[1:] + height[:-1])])
    return LightTable(jnp.float32(position - 0.5), jnp.float32(light / light[-1]))


def position_at(table: LightTable, light: Float[Array, "..."]) -> Float[Array, "..."]:
    """Find the position in the exposure, -1/2 to 1/2, by which a share of the light has passed."""
    return jnp.interp(light, table.light, table.position)


def light_at(table: LightTable, position: Float[Array, "..."]) -> Float[Array, "..."]:
    """Find the share of the light that has passed by a position in the exposure."""
    return jnp.interp(position, table.position, table.light)


def needed_pieces(
    world: World, opening: float, closing: float, size: tuple[int, int], tolerance: float
) -> tuple[int, float]:
    """Find the number of pieces of time that keeps straight paths close to the true ones.

    Args:
        world: the arrays of a scene.
        opening: frames.
        closing: frames.
        size: (height, width) of the image.
        tolerance: largest distance allowed between the true and the straight path in the image,
            pixels.

    Returns:
        Number of pieces, a power of two and at most 64, and the largest distance that remains, in
        pixels, measured at the quarter points of each piece.
    """
    pieces = 1
    while True:
        error = float(_path_error(world, opening, closing, jnp.array(size), pieces))
        if error <= tolerance or pieces == MOST_PIECES:
            return pieces, error
        pieces *= 2


@jax.jit
def _path_error(
    world: World, opening: Array, closing: Array, size: Int[Array, " 2"], pieces: Array
) -> Array:
    limit = jnp.flip(size).astype(jnp.float32)
    scale = world.camera.focal * limit[0]

    def project(points: Array) -> Array:
        return scale * points[:, :2] / jnp.maximum(points[:, 2:], NEAR)

    def error(piece: Array) -> Array:
        share = jnp.linspace(0.0, 1.0, CHECKS + 1)
        times = opening + (closing - opening) * (piece + share) / pieces
        points = jax.lax.map(functools.partial(points_at, world), times)

        def distance(k: Array) -> Array:
            true = project(points[k])
            chord = project(points[0] + share[k] * (points[-1] - points[0]))
            seen = jnp.all(jnp.abs(true) < limit, axis=1) & (points[k, :, 2] > NEAR)
            return jnp.max(jnp.where(seen, jnp.linalg.norm(chord - true, axis=1), 0.0))

        return jnp.max(jax.lax.map(distance, jnp.arange(1, CHECKS)))

    return jax.lax.fori_loop(0, pieces, lambda k, worst: jnp.maximum(worst, error(k)), 0.0)


def key_poses(world: World, times: Float[Array, " keys"]) -> Pose:
    """Evaluate a world at several times: a pose with a leading axis."""
    return jax.vmap(functools.partial(pose_at, world))(times)


def _between(values: Array, piece: Array, share: Array, *index: Array) -> Array:
    """Interpolate the values at an index between the two ends of a piece."""
    start, end = values[(piece, *index)], values[(piece + 1, *index)]
    return start + share.reshape(share.shape + (1,) * (start.ndim - 1)) * (end - start)


def camera_rotations(
    poses: Pose, piece: Int[Array, " points"], share: Float[Array, " points"]
) -> Float[Array, "points 3 3"]:
    """Return the rotation from camera to world axes at each point's own time.

    Interpolated between the ends of a piece as the points are, so that the sky moves with them.
    """
    return _between(poses.camera_rotation, piece, share)


def own_copies(
    world: World,
    poses: Pose,
    piece: Int[Array, " points"],
    triangle: Int[Array, " points"],
    share: Float[Array, " points"],
) -> tuple[World, Pose]:
    """Copy, for every point, the triangle that it sees, posed at the point's own time.

    Triangle n of the result belongs to point n. Functions that expect a world at one time can then
    process points that are seen at different times.

    Args:
        world: the arrays of a scene.
        poses: poses at the ends of the pieces, leading axis K + 1.
        piece: (N,) in [0, K).
        triangle: (N,) not negative.
        share: (N,) time as a share of the piece, in [0, 1].

    Returns:
        World and pose with N triangles and 3 N points. The pose's camera is not rotated: pass rays
        in world axes where their direction matters.
    """
    count = triangle.shape[0]
    corners = [_between(poses.points, piece, share, world.triangles[triangle, i]) for i in range(3)]
    pose = Pose(
        jnp.concatenate(corners),
        _between(poses.normals, piece, share, triangle),
        jnp.eye(3),
        jnp.zeros(3),
    )
    numbers = jnp.arange(3 * count, dtype=jnp.int32).reshape(3, count).T
    copies = dataclasses.replace(
        world,
        triangles=numbers,
        triangle_material=world.triangle_material[triangle],
        closed=world.closed[triangle],
        texture=world.texture[triangle],
    )
    return jax.lax.optimization_barrier((copies, pose))
