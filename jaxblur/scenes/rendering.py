"""Sharp frames with exact buffers: color, depth, velocity, path, object numbers."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..frame import Frame
from . import motion
from .raster import Capacity, enough, rays, visible_triangles
from .scene import NEAR, Pose, Scene, World, pose_at
from .shading import shade, surface_at

SUBPIXELS = 16
PROBE_ROWS = 4096


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
    sky; velocity is half the way, in pixels, that the point goes in the image from
    ``time - shutter/2`` to ``time + shutter/2`` by its true motion. Sky moves as points at
    infinity do, with the rotation of the camera. Points behind the camera at an end of the
    exposure count as on the near plane.

    Args:
        scene: what to render.
        time: frames; the center of the exposure.
        shutter: frames that the shutter is open; 0 gives zero velocity.
        size: (height, width) in pixels.
        path: whether to give displacements at opening and closing too.
        subpixels: number of positions within a pixel for color.

    Returns:
        Color (H, W, 3) linear light, depth (H, W), velocity (H, W, 2) half-spread in pixels,
        path (H, W, 2, 2) in pixels or None; float32.

    Raises:
        ValueError: the size or the number of subpixels is not positive, or the shutter negative.
    """
    check_size(size)
    if subpixels < 1:
        raise ValueError(f"`subpixels` must be at least 1, got {subpixels}.")
    if not shutter >= 0:
        raise ValueError(f"`shutter` must not be negative, got {shutter}.")
    times = jnp.float32(time) + jnp.float32(shutter) * jnp.array([-0.5, 0.5], jnp.float32)
    capacity = needed_capacity(scene.world, [time], size)
    while True:
        color, depth, moves, need = _render(
            scene.world, jnp.float32(time), times, size, capacity, subpixels
        )
        if fits(need, capacity):
            break
        capacity = enough(*need.tolist())
    velocity = (moves[..., 1, :] - moves[..., 0, :]) / 2
    return Frame(color, depth, velocity, moves if path else None)


def displacement(
    scene: Scene, time: float = 0.0, step: float = 1.0, size: tuple[int, int] = (180, 320)
) -> Float[Array, "height width 2"]:
    """Find how far the points seen at one time go in the image until another.

    ``step`` 1 and -1 give the vectors to the next and to the previous frame, that is, the full
    displacement and not a half-spread.

    Args:
        scene: what to look at.
        time: frames, when the points are seen.
        step: frames until the other time, may be negative.
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
    """Number the object that is seen at every pixel center.

    Args:
        scene: what to look at.
        time: frames.
        size: (height, width) in pixels.

    Returns:
        (H, W) int32 indices of `Scene.object_names`, -1 for sky.

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
    capacity = needed_capacity(scene.world, [time], size)
    pose = _pose(scene.world, jnp.float32(time))
    return _visible(scene.world, pose, jnp.zeros(2), size, capacity)[0]


def check_size(size: tuple[int, int]) -> None:
    """Refuse sizes that are not two positive numbers.

    Raises:
        ValueError: they are not.
    """
    if len(size) != 2 or min(size) < 1:
        raise ValueError(f"`size` must be (height, width), both at least 1, got {size}.")


def subpixel_offsets(count: int) -> Float[Array, "samples 2"]:
    """Spread positions evenly over a pixel by the R2 sequence [Roberts 2018].

    Args:
        count: number of positions.

    Returns:
        (count, 2) offsets x, y from the pixel center in [-1/2, 1/2); their mean is zero.
    """
    golden = 1.32471795724474602596
    points = np.outer(np.arange(count), [1 / golden, 1 / golden**2]) % 1.0
    # Without its mean the sequence would shift the image by a part of a pixel.
    return jnp.asarray(points - points.mean(axis=0), jnp.float32)


def needed_capacity(world: World, times: list[float], size: tuple[int, int]) -> Capacity:
    """Count rows and fragments at some times and round them up.

    Args:
        world: the arrays of a scene.
        times: frames.
        size: (height, width).

    Returns:
        Capacity that suffices at these times for pixel centers; others may need more.
    """
    capacity = enough(PROBE_ROWS, size[0] * size[1])
    moments = jnp.asarray(times, jnp.float32)
    while not fits(need := _count(world, moments, size, capacity), capacity):
        capacity = enough(*need.tolist())
    return enough(*need.tolist())


def fits(need: jax.Array, capacity: Capacity) -> bool:
    """Tell whether (rows, fragments) needed are within the capacity."""
    rows, fragments = need.tolist()
    return rows <= capacity.rows and fragments <= capacity.fragments


def sample_color(
    world: World,
    time: Float[Array, ""],
    offset: Float[Array, " 2"],
    footprint: float,
    size: tuple[int, int],
    capacity: Capacity,
) -> tuple[Float[Array, "height width 3"], Int[Array, " 2"]]:
    """Render one sharp image with one ray per pixel.

    Args:
        world: the arrays of a scene.
        time: () frames.
        offset: (2,) x and y of the ray from the pixel center, pixels.
        footprint: width over which textures are averaged, pixels.
        size: static (height, width).
        capacity: static.

    Returns:
        (H, W, 3) linear light, and (rows, fragments) needed.
    """
    pose = pose_at(world, time)
    triangle, need = _visible(world, pose, offset, size, capacity)
    focal = world.camera.focal * size[1]
    ray = rays(focal, offset, size).reshape(-1, 3)
    surface = surface_at(world, pose, triangle.reshape(-1), ray, footprint / focal)
    return shade(world, pose, surface, ray, footprint / focal).reshape(*size, 3), need


_pose = jax.jit(pose_at)


@functools.partial(jax.jit, static_argnames=("size", "capacity"))
def _visible(
    world: World, pose: Pose, offset: jax.Array, size: tuple[int, int], capacity: Capacity
) -> tuple[jax.Array, jax.Array]:
    seen, _ = visible_triangles(
        pose.points,
        world.triangles,
        world.closed,
        world.camera.focal * size[1],
        offset,
        size,
        capacity,
    )
    return seen.triangle, jnp.stack([seen.rows, seen.fragments])


@functools.partial(jax.jit, static_argnames=("size", "capacity"))
def _count(world: World, times: jax.Array, size: tuple[int, int], capacity: Capacity) -> jax.Array:
    def count(time: jax.Array) -> jax.Array:
        return _visible(world, pose_at(world, time), jnp.zeros(2), size, capacity)[1]

    return jnp.max(jax.lax.map(count, times), axis=0)


@functools.partial(jax.jit, static_argnames=("size", "capacity", "subpixels"))
def _render(
    world: World,
    time: jax.Array,
    times: jax.Array,
    size: tuple[int, int],
    capacity: Capacity,
    subpixels: int,
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Give color, depth, displacements at `times`, and the capacity needed."""
    offsets = subpixel_offsets(subpixels)

    def add(i: jax.Array, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        total, need = state
        color, count = sample_color(world, time, offsets[i], subpixels**-0.5, size, capacity)
        return total + color, jnp.maximum(need, count)

    triangle, need = _visible(world, pose_at(world, time), jnp.zeros(2), size, capacity)
    color, need = jax.lax.fori_loop(0, subpixels, add, (jnp.zeros((*size, 3)), need))
    depth, moves = _moves(world, triangle, time, times, size)
    return color / subpixels, depth, moves, need


@functools.partial(jax.jit, static_argnames=("size",))
def _moves(
    world: World, triangle: jax.Array, time: jax.Array, times: jax.Array, size: tuple[int, int]
) -> tuple[jax.Array, jax.Array]:
    """Give depth (H, W) at `time` and displacements (H, W, T, 2) to `times` in pixels."""
    focal = world.camera.focal * size[1]
    ray = rays(focal, jnp.zeros(2), size).reshape(-1, 3)
    flat = triangle.reshape(-1)
    pose = pose_at(world, time)
    surface = surface_at(world, pose, flat, ray, jnp.zeros(()))
    corner = world.triangles[jnp.maximum(flat, 0)]

    def move(other: jax.Array) -> jax.Array:
        turn, _ = motion.transform(world.camera.motion, other)
        shift = (pose_at(world, other).points - pose.points)[corner]
        shift = jnp.einsum("nc,nci->ni", surface.weights, shift)
        turned = ray @ (pose.camera_rotation.T @ (turn - pose.camera_rotation))
        is_sky = flat[:, None] < 0
        shift = jnp.where(is_sky, turned, shift)
        depth = jnp.where(is_sky, 1.0, surface.depth[:, None]) + shift[:, 2:]
        # (x + dx)/(z + dz) - x/z in differences: what stays put is at rest to the last bit.
        seen = (shift[:, :2] - ray[:, :2] * shift[:, 2:]) / jnp.maximum(depth, NEAR)
        return (focal * seen).reshape(*size, 2)

    return surface.depth.reshape(size), jnp.moveaxis(jax.vmap(move)(times), 0, 2)
