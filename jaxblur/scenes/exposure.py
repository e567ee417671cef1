"""The streamed mean of sharp images, each with one ray per pixel."""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .lens import ThinLens
from .raster import Capacity, covered_rows, enough, rays, visible_triangles
from .scene import Scene, World, pose_at
from .shading import shade, surface_at

SAMPLE_BLOCK = 1024
PROBE_ROWS = 0


class Exposure(NamedTuple):
    """Time and subpixel position of every sample.

    Arrays are padded, so that another number of samples compiles nothing new.

    Attributes:
        times: (N,) frames.
        offsets: (N, 2) x and y from the pixel center, pixels.
        count: () number of samples without the padding.
        curve: (K,) transmission from opening to closing, used with a rolling shutter only.
        center: () frames, middle of the exposure of the middle of the image.
        shutter: () frames.
        readout: () frames between the exposures of the upper and the lower edge of the image.
        lens: (N, 2) point of the lens to the right of its center and below, scene units.
        focus: () depth of the plane in focus, scene units; infinite for a pinhole.
    """

    times: jax.Array
    offsets: jax.Array
    count: jax.Array
    curve: jax.Array
    center: jax.Array
    shutter: jax.Array
    readout: jax.Array
    lens: jax.Array
    focus: jax.Array


def make_exposure(
    times: np.ndarray,
    *,
    curve: np.ndarray | tuple[float, ...] = (1.0, 1.0),
    center: float = 0.0,
    shutter: float = 0.0,
    readout: float = 0.0,
    lens: ThinLens | None = None,
) -> Exposure:
    """Give every sample time a subpixel position, and pad the arrays.

    Args:
        times: (N,) frames.
        curve: (K,) transmission from opening to closing.
        center: frames, middle of the exposure.
        shutter: frames.
        readout: frames from the upper to the lower edge of the image.
        lens: a lens, or None for a pinhole.

    Returns:
        The exposure.
    """
    padding = -len(times) % SAMPLE_BLOCK
    points = np.zeros((len(times), 2)) if lens is None else lens.points(len(times))
    return Exposure(
        jnp.asarray(np.pad(times, (0, padding), mode="edge"), jnp.float32),
        jnp.asarray(np.pad(subpixel_offsets(len(times)), ((0, padding), (0, 0))), jnp.float32),
        jnp.int32(len(times)),
        jnp.asarray(curve, jnp.float32),
        jnp.float32(center),
        jnp.float32(shutter),
        jnp.float32(readout),
        jnp.asarray(np.pad(points, ((0, padding), (0, 0))), jnp.float32),
        jnp.float32(np.inf if lens is None else lens.focus),
    )


def subpixel_offsets(count: int) -> Float[np.ndarray, "samples 2"]:
    """Spread positions evenly over a pixel by the R2 sequence [Roberts 2018].

    Args:
        count: number of positions.

    Returns:
        (count, 2) offsets x, y from the pixel center, with mean zero. They lie in (-1, 1), and in
        [-1/2, 1/2) if there are many.
    """
    golden = 1.32471795724474602596
    points = np.outer(np.arange(count), [1 / golden, 1 / golden**2]) % 1.0
    # The mean is subtracted: it would shift the image by a fraction of a pixel.
    return points - points.mean(axis=0)


def integrate(
    scene: Scene, exposure: Exposure, size: tuple[int, int]
) -> Float[Array, "height width 3"]:
    """Average sharp images over an exposure; memory does not depend on their number.

    The capacity of the rasterizer is measured at the first, middle and last sample. If another
    sample needs more, the sum restarts with a larger capacity.

    Args:
        scene: scene to render.
        exposure: the samples.
        size: (height, width) in pixels.

    Returns:
        (H, W, 3) linear light.
    """
    last = int(exposure.count) - 1
    probes = np.asarray(exposure.times)[[0, last // 2, last]]
    capacity = needed_capacity(scene.world, probes, size)
    rolling, through_lens = bool(exposure.readout), bool(jnp.isfinite(exposure.focus))
    while True:
        mean, needed = _integrate(scene.world, exposure, size, capacity, rolling, through_lens)
        if fits(needed, capacity):
            return mean
        capacity = enough(*needed.tolist())


def needed_capacity(world: World, times: np.ndarray, size: tuple[int, int]) -> Capacity:
    """Measure the rows and fragments that some times need, rounded up.

    Args:
        world: the arrays of a scene.
        times: (T,) frames; every new T compiles once.
        size: (height, width).

    Returns:
        Capacity that suffices at these times for rays through pixel centers; other times and rays
        may need more.
    """
    moments = jnp.asarray(times, jnp.float32)
    capacity = enough(PROBE_ROWS, 0)
    while not fits(needed := _count(world, moments, size, capacity.rows), capacity):
        grown = enough(*needed.tolist())
        if grown.rows == capacity.rows:
            return grown
        capacity = grown
    return enough(*needed.tolist())


def fits(needed: jax.Array, capacity: Capacity) -> bool:
    """Return whether the needed (rows, fragments) are within the capacity."""
    rows, fragments = needed.tolist()
    return rows <= capacity.rows and fragments <= capacity.fragments


def sample_color(
    world: World,
    time: Float[Array, ""],
    offset: Float[Array, " 2"],
    footprint: Float[Array, ""],
    size: tuple[int, int],
    capacity: Capacity,
    lens_point: Float[Array, " 2"] | None = None,
    focus: Float[Array, ""] | None = None,
) -> tuple[Float[Array, "height width 3"], Array]:
    """Render one sharp image with one ray per pixel.

    Args:
        world: the arrays of a scene.
        time: () frames.
        offset: (2,) x and y of the ray from the pixel center, pixels.
        footprint: () width over which textures are averaged, pixels.
        size: static (height, width).
        capacity: static.
        lens_point: (2,) where the ray leaves the lens, right of its center and below, scene units;
            None for a pinhole.
        focus: () depth at which all rays of a pixel meet; with a point of the lens only.

    Returns:
        (H, W, 3) linear light, and (2,) the rows and fragments needed.
    """
    pose = pose_at(world, time)
    focal = world.camera.focal * size[1]
    if lens_point is not None and focus is not None:
        # The camera moves to the point, and its image is sheared so that the focus stays in place.
        aside = jnp.concatenate([lens_point, jnp.zeros(1)])
        pose = dataclasses.replace(
            pose,
            points=pose.points - aside,
            camera_position=pose.camera_position + pose.camera_rotation @ aside,
        )
        offset = offset - focal * lens_point / focus
    seen = visible_triangles(
        pose.points, world.triangles, world.closed, focal, offset, size, capacity
    )
    ray = rays(focal, offset, size)
    surface = surface_at(world, pose, seen.triangle.reshape(-1), ray, footprint / focal)
    color = shade(world, pose, surface, ray, footprint / focal)
    return color.T.reshape(*size, 3), seen.needed


@functools.partial(jax.jit, static_argnames=("size", "capacity"))
def _count(world: World, times: Array, size: tuple[int, int], capacity: int) -> Array:
    focal = world.camera.focal * size[1]

    def count(time: Array) -> Array:
        points = pose_at(world, time).points
        rows = covered_rows(
            points, world.triangles, world.closed, focal, jnp.zeros(2), size, capacity
        )
        return jnp.stack([rows.needed, jnp.sum(rows.count)])

    return jnp.max(jax.lax.map(count, times), axis=0)


def row_weights(exposure: Exposure, time: Float[Array, ""], height: int) -> Float[Array, " height"]:
    """Compute the light that a rolling shutter lets through to each row at one time.

    Args:
        exposure: exposure of the image.
        time: () frames.
        height: number of rows.

    Returns:
        (H,) the shutter curve at the position of `time` in the row's own exposure, 0 outside it.
    """
    rows = (jnp.arange(height) + 0.5) / height - 0.5
    position = (time - exposure.center - exposure.readout * rows) / exposure.shutter + 0.5
    grid = jnp.linspace(0.0, 1.0, exposure.curve.shape[0])
    return jnp.interp(position, grid, exposure.curve, left=0.0, right=0.0)


@functools.partial(jax.jit, static_argnames=("size", "capacity", "rolling", "through_lens"))
def _integrate(
    world: World,
    exposure: Exposure,
    size: tuple[int, int],
    capacity: Capacity,
    rolling: bool,
    through_lens: bool,
) -> tuple[Array, Array]:
    """Return the weighted mean and the capacity needed; stop once `capacity` is exceeded."""
    # Each sample averages textures over its share of the pixel.
    footprint = jax.lax.rsqrt(exposure.count.astype(jnp.float32))
    limit = jnp.array([capacity.rows, capacity.fragments])

    def unfinished(state: tuple[Array, ...]) -> Array:
        i, _, _, needed = state
        return (i < exposure.count) & jnp.all(needed <= limit)

    def add(state: tuple[Array, ...]) -> tuple[Array, ...]:
        i, total, weights, needed = state
        time = exposure.times[i]
        lens = (exposure.lens[i], exposure.focus) if through_lens else (None, None)
        color, count = sample_color(
            world, time, exposure.offsets[i], footprint, size, capacity, *lens
        )
        weight = row_weights(exposure, time, size[0]) if rolling else jnp.ones(size[0])
        total = total + weight[:, None, None] * color
        return i + 1, total, weights + weight, jnp.maximum(needed, count)

    start = (jnp.int32(0), jnp.zeros((*size, 3)), jnp.zeros(size[0]), jnp.zeros(2, jnp.int32))
    _, total, weights, needed = jax.lax.while_loop(unfinished, add, start)
    return total / jnp.maximum(weights, 1e-20)[:, None, None], needed
