"""Opaque bodies along the rays of an image: their color, and how far away they are."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..exposure import fits, needed_capacity
from ..raster import Capacity, enough, rays, visible_triangles
from ..scene import Scene, World, pose_at
from ..shading import shade, surface_at


class Bodies(NamedTuple):
    """What rays hit, P pixels in row-major order.

    Attributes:
        color: (3, P) linear light; that of the sky where there is no body.
        depth: (P,) planar, scene units; infinite where there is no body.
    """

    color: jax.Array
    depth: jax.Array


def bodies(
    scene: Scene,
    time: float,
    offset: Float[np.ndarray, " 2"],
    footprint: float,
    size: tuple[int, int],
) -> Bodies:
    """Render the bodies of a scene with one ray per pixel.

    Args:
        scene: the bodies.
        time: frames.
        offset: (2,) x and y of the ray from the pixel center, pixels.
        footprint: width over which textures are averaged, pixels.
        size: (height, width).

    Returns:
        Color and depth.
    """
    moment, where = jnp.float32(time), jnp.asarray(offset, jnp.float32)
    capacity = needed_capacity(scene.world, np.full(3, time), size)
    while True:
        found, needed = _bodies(scene.world, moment, where, jnp.float32(footprint), size, capacity)
        if fits(needed, capacity):
            return found
        capacity = enough(*needed.tolist())


@functools.partial(jax.jit, static_argnames=("size", "capacity"))
def _bodies(
    world: World,
    time: Array,
    offset: Array,
    footprint: Array,
    size: tuple[int, int],
    capacity: Capacity,
) -> tuple[Bodies, Array]:
    pose, focal = pose_at(world, time), world.camera.focal * size[1]
    seen = visible_triangles(
        pose.points, world.triangles, world.closed, focal, offset, size, capacity
    )
    ray = rays(focal, offset, size)
    surface = surface_at(world, pose, seen.triangle.reshape(-1), ray, footprint / focal)
    return Bodies(shade(world, pose, surface, ray, footprint / focal), surface.depth), seen.needed
