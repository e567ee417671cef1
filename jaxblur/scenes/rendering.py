"""Sharp frames with exact buffers: color, depth, velocity, path, object IDs."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..frame import Frame
from . import motion
from .exposure import fits, integrate, make_exposure, needed_capacity
from .raster import Capacity, enough, rays, visible_triangles
from .scene import NEAR, Scene, World, pose_at
from .shading import surface_at

SUBPIXELS = 16


def render(
    scene: Scene,
    time: float = 0.0,
    shutter: float = 0.5,
    size: tuple[int, int] = (180, 320),
    *,
    path: bool = False,
    subpixels: int = SUBPIXELS,
) -> Frame:
    """Render a sharp frame at one time.

    Color is the mean over a fixed set of positions within the pixel, all at `time`. Depth and
    velocity are those of the surface point at the pixel's center: depth is planar, +inf for
    sky; velocity is half the point's displacement in the image, in pixels, from ``time -
    shutter/2`` to ``time + shutter/2`` by its true motion. Sky moves like points at infinity, with
    the rotation of the camera. Points that are behind the camera at an end of the exposure are
    treated as if on the near plane.

    Args:
        scene: scene to render.
        time: frames; the center of the exposure.
        shutter: exposure time in frames; 0 gives zero velocity.
        size: (height, width) in pixels.
        path: whether to return the displacements at shutter opening and closing too.
        subpixels: number of positions within a pixel for color.

    Returns:
        Color (H, W, 3) linear light, depth (H, W), velocity (H, W, 2) half-spread in pixels,
        path (H, W, 2, 2) in pixels or None; float32.

    Raises:
        ValueError: the size or the number of subpixels is not positive, or the shutter negative.
    """
    check_exposure(shutter, size)
    if subpixels < 1:
        raise ValueError(f"`subpixels` must be at least 1, got {subpixels}.")
    color = integrate(scene, make_exposure(np.full(subpixels, time)), size)
    ends = jnp.float32(time) + jnp.float32(shutter) * jnp.array([-0.5, 0.5], jnp.float32)
    triangle = visible(scene, time, size)
    depth, moves = _moves(scene.world, triangle, jnp.float32(time), ends, size)
    velocity = (moves[..., 1, :] - moves[..., 0, :]) / 2
    return Frame(color, depth, velocity, moves if path else None)


def displacement(
    scene: Scene, time: float = 0.0, step: float = 1.0, size: tuple[int, int] = (180, 320)
) -> Float[Array, "height width 2"]:
    """Compute the image displacement of the points seen at one time until another time.

    ``step`` 1 and -1 give the vectors to the next and to the previous frame. These are full
    displacements, not half-spreads.

    Args:
        scene: scene to render.
        time: frames, the time at which the points are seen.
        step: frames from there to the other time, may be negative.
        size: (height, width) in pixels.

    Returns:
        (H, W, 2) pixels, x right, y down: position at ``time + step`` minus pixel center.

    Raises:
        ValueError: the size is not positive.
    """
    check_size(size)
    triangle = visible(scene, time, size)
    later = jnp.float32(time) + jnp.float32(step)
    return _moves(scene.world, triangle, jnp.float32(time), later[None], size)[1][..., 0, :]


def object_ids(
    scene: Scene, time: float = 0.0, size: tuple[int, int] = (180, 320)
) -> Int[Array, "height width"]:
    """Return the number of the object that is seen at every pixel center.

    Args:
        scene: scene to render.
        time: frames.
        size: (height, width) in pixels.

    Returns:
        (H, W) int32 indices into `Scene.object_names`, -1 for sky.

    Raises:
        ValueError: the size is not positive.
    """
    triangle = visible(scene, time, size)
    return jnp.where(triangle < 0, -1, scene.world.triangle_object[triangle])


def visible(
    scene: Scene, time: float = 0.0, size: tuple[int, int] = (180, 320)
) -> Int[Array, "height width"]:
    """Find the triangle that is seen at every pixel center: (H, W) int32, -1 for sky."""
    check_size(size)
    capacity = needed_capacity(scene.world, np.full(3, time), size)
    while True:
        triangle, needed = _visible(scene.world, jnp.float32(time), size, capacity)
        if fits(needed, capacity):
            return triangle
        capacity = enough(*needed.tolist())


def check_size(size: tuple[int, int]) -> None:
    """Check that `size` is two positive numbers.

    Raises:
        ValueError: it is not.
    """
    if len(size) != 2 or min(size) < 1:
        raise ValueError(f"`size` must be (height, width), both at least 1, got {size}.")


def check_exposure(shutter: float, size: tuple[int, int]) -> None:
    """Check `size` as `check_size` does, and that `shutter` is not negative.

    Raises:
        ValueError: one of them is out of range.
    """
    check_size(size)
    if not shutter >= 0:
        raise ValueError(f"`shutter` must not be negative, got {shutter}.")


@functools.partial(jax.jit, static_argnames=("size", "capacity"))
def _visible(
    world: World, time: Array, size: tuple[int, int], capacity: Capacity
) -> tuple[Array, Array]:
    points, focal = pose_at(world, time).points, world.camera.focal * size[1]
    return visible_triangles(
        points, world.triangles, world.closed, focal, jnp.zeros(2), size, capacity
    )


@functools.partial(jax.jit, static_argnames=("size",))
def _moves(
    world: World, triangle: Array, time: Array, times: Array, size: tuple[int, int]
) -> tuple[Array, Array]:
    """Return depth (H, W) at `time` and displacements (H, W, T, 2) to `times` in pixels."""
    focal = world.camera.focal * size[1]
    ray = rays(focal, jnp.zeros(2), size)
    flat = triangle.reshape(-1)
    pose = pose_at(world, time)
    surface = surface_at(world, pose, flat, ray, jnp.zeros(()))
    corners = world.triangles[jnp.maximum(flat, 0)].T
    is_sky = flat < 0

    def move(other: Array) -> Array:
        turn, _ = motion.transform(world.camera.motion, other)
        turned = ((turn - pose.camera_rotation).T @ pose.camera_rotation) @ ray
        shift = (pose_at(world, other).points - pose.points).T
        shift = sum(surface.weights[i] * shift[:, corners[i]] for i in range(3))
        shift = jnp.where(is_sky, turned, shift)
        depth = jnp.where(is_sky, 1.0, surface.depth) + shift[2]
        # (x + dx)/(z + dz) - x/z in differences: points at rest get exactly zero.
        seen = (shift[:2] - ray[:2] * shift[2]) / jnp.maximum(depth, NEAR)
        return (focal * seen).T.reshape(*size, 2)

    return surface.depth.reshape(size), jnp.moveaxis(jax.vmap(move)(times), 0, 2)
