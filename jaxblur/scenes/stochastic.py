"""Stochastic rasterization: every pixel samples the scene at its own random times."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .keyframes import (
    LightTable,
    camera_rotations,
    key_poses,
    light_table,
    needed_pieces,
    own_copies,
    position_at,
)
from .raster import enough
from .rendering import check_exposure
from .scene import NEAR, Pose, Scene, World
from .shading import shade, surface_at
from .shutter import ShutterFunction, exposure_center
from .swept import (
    Swept,
    SweptRows,
    candidates,
    corner_weights,
    depth_at,
    edge_polynomials,
    edge_values,
    row_counts,
    sweep,
    swept_rows,
)

PATH_TOLERANCE = 0.1
CANDIDATES = 16384
STRATA_PER_SWEEP = 16
"""Most strata that share a set of moving triangles: longer sweeps mean more candidates."""
REACH = 0.5
GROUP_BLOCK = 64
SAMPLE_BLOCK = 1024


class Strata(NamedTuple):
    """The division of the exposure among the samples.

    Arrays are padded, so that another number of samples compiles nothing new.

    Attributes:
        light: (G, Q + 1) share of the light at which the pieces of time of each group of strata
            begin and end; groups of several strata have one piece.
        groups: () number of groups.
        size: () number of strata in a group; the last one may have fewer.
        samples: () number of strata.
        offsets: (S, 2) x and y in the pixel in [0, 1), before they are shifted per pixel.
        center: () frames.
        shutter: () frames.
        table: light against time.
        seed: () int.
    """

    light: jax.Array
    groups: jax.Array
    size: jax.Array
    samples: jax.Array
    offsets: jax.Array
    center: jax.Array
    shutter: jax.Array
    table: LightTable
    seed: jax.Array


class _Sweeps(NamedTuple):
    """Data that the strata of a group share: keys, poses, moving triangles and their rows."""

    keys: jax.Array
    poses: Pose
    swept: Swept
    rows: SweptRows


class Seen(NamedTuple):
    """The nearest surface of every pixel so far, P of them.

    Attributes:
        nearest: (P + 1,) inverse depth, 0 where there is no surface; the last entry is not a pixel.
        owner: (P + 1,) swept triangle, -1 where there is no surface.
    """

    nearest: jax.Array
    owner: jax.Array


def stochastic(
    scene: Scene,
    time: float = 0.0,
    shutter: float = 0.5,
    samples: int = 8,
    size: tuple[int, int] = (180, 320),
    shutter_function: ShutterFunction = "box",
    *,
    seed: int = 0,
    placement: str = "centered",
) -> Float[Array, "height width 3"]:
    """Render a motion-blurred image from a few random samples per pixel.

    The light that the shutter lets through is divided into `samples` equal strata. In each of them
    every pixel has its own time, uniformly random within the stratum, and its own subpixel
    position: a point of the Halton sequence, shifted by a random vector per pixel. Coverage is
    analytic: the edge functions of the moving triangles are evaluated at the pixel's own time, and
    the nearest surface is shaded at that time. Errors appear as noise, not as ghosts, and the
    expected value over seeds is the true image.

    Corners move along straight lines in camera space through one or several strata. The exposure is
    cut into enough pieces (64 at most) to keep these lines within a tenth of a pixel of the true
    paths; for linear motion they are exact. Samples are accumulated one at a time, so memory does
    not depend on their number.

    Args:
        scene: scene to render.
        time: frames.
        shutter: exposure time in frames; 0 gives the sharp image.
        samples: number of samples per pixel.
        size: (height, width) in pixels.
        shutter_function: "box", "trapezoid", "triangle", "gaussian" or a sampled curve; see
            `shutter.shutter_curve`.
        seed: seed of the random numbers; the same seed gives the same image.
        placement: "centered", "leading" or "trailing"; see `accumulation.accumulate`.

    Returns:
        (H, W, 3) linear light, float32.

    Raises:
        ValueError: an argument is out of range.

    Source: Cook, Porter and Carpenter 1984; McGuire, Enderton, Shirley and Luebke 2010, after
    Hong and Oh 2017, section 3.1. Here the bound is the convex hull of the moving triangle per
    image row, and there is one time per pixel and stratum.
    """
    check_exposure(shutter, size)
    if samples < 1:
        raise ValueError(f"`samples` must be at least 1, got {samples}.")
    center = exposure_center(time, shutter, placement)
    ends = center - shutter / 2, center + shutter / 2
    pieces, _ = needed_pieces(scene.world, *ends, size, PATH_TOLERANCE)
    group = max(1, min(samples // pieces, STRATA_PER_SWEEP))
    starts = np.arange(0, samples, group)
    ends_of_groups = np.minimum(starts + group, samples)
    light = np.linspace(starts, ends_of_groups, -(-pieces // len(starts)) + 1, axis=1) / samples
    strata = Strata(
        _padded(light, GROUP_BLOCK),
        jnp.int32(len(starts)),
        jnp.int32(group),
        jnp.int32(samples),
        _padded(_halton(samples), SAMPLE_BLOCK),
        jnp.float32(center),
        jnp.float32(shutter),
        light_table(shutter_function),
        jnp.int32(seed),
    )
    capacity = enough(int(_most_rows(scene.world, strata, size)), 0).rows
    while True:
        image, needed = _mean(scene.world, strata, size, capacity)
        if int(needed) <= capacity:
            return image
        capacity = enough(int(needed), 0).rows


def _padded(values: np.ndarray, block: int) -> Array:
    """Pad the leading axis to whole blocks."""
    return jnp.asarray(np.pad(values, [(0, -len(values) % block), (0, 0)]), jnp.float32)


def _halton(count: int) -> np.ndarray:
    """Return points (count, 2) of the Halton sequence in bases 2 and 3.

    With the number of the stratum as third coordinate these are Hammersley points. A lattice such
    as R2 would also work, but it resonates at some speeds and numbers of samples.
    """
    number, axes = np.arange(count), []
    for base in (2, 3):
        place, rest, digit = np.zeros(count), number, 1 / base
        while rest.any():
            rest, remainder = np.divmod(rest, base)
            place, digit = place + digit * remainder, digit / base
        axes.append(place)
    return np.stack(axes, axis=1)


def _group(
    world: World, strata: Strata, index: Array, size: tuple[int, int]
) -> tuple[Array, Pose, Swept]:
    """Return the positions of a group's keys in the exposure, their poses, and moving triangles."""
    keys = position_at(strata.table, strata.light[index])
    poses = key_poses(world, strata.center + strata.shutter * keys)
    focal = world.camera.focal * size[1]
    return keys, poses, sweep(poses.points, world.triangles, world.closed, focal, size)


@functools.partial(jax.jit, static_argnames=("size",))
def _most_rows(world: World, strata: Strata, size: tuple[int, int]) -> Array:
    def count(index: Array, most: Array) -> Array:
        swept = _group(world, strata, index, size)[2]
        return jnp.maximum(most, jnp.sum(row_counts(swept, jnp.zeros(2), REACH, size)[1]))

    return jax.lax.fori_loop(0, strata.groups, count, jnp.int32(0))


@functools.partial(jax.jit, static_argnames=("size", "capacity"))
def _mean(
    world: World, strata: Strata, size: tuple[int, int], capacity: int
) -> tuple[Array, Array]:
    """Return the mean over the strata, and the largest number of rows that a group needed."""
    key = jax.random.key(strata.seed)
    shift = jax.random.uniform(key, (2, size[0] * size[1]))

    def add_group(number: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        total, needed = state
        keys, poses, swept = _group(world, strata, number, size)
        rows = swept_rows(swept, jnp.zeros(2), REACH, size, capacity)
        sweeps = _Sweeps(keys, poses, swept, rows)
        first = number * strata.size
        last = jnp.minimum(first + strata.size, strata.samples)
        total = jax.lax.fori_loop(
            first,
            last,
            lambda i, total: total + _sample(world, strata, sweeps, i, shift, key, size),
            total,
        )
        return total, jnp.maximum(needed, rows.needed)

    start = jnp.zeros((3, size[0] * size[1])), jnp.int32(0)
    total, needed = jax.lax.fori_loop(0, strata.groups, add_group, start)
    return (total / strata.samples).T.reshape(*size, 3), needed


def _sample(
    world: World,
    strata: Strata,
    sweeps: _Sweeps,
    index: Array,
    shift: Array,
    key: Array,
    size: tuple[int, int],
) -> Array:
    """Compute the color (3, P) of one sample per pixel."""
    keys, poses, swept, rows = sweeps
    jitter = jax.random.uniform(jax.random.fold_in(key, index), shift.shape[1:])
    position = position_at(strata.table, (index + jitter) / strata.samples)
    piece = jnp.searchsorted(keys[1:-1], position, side="right").astype(jnp.int32)
    share = (position - keys[piece]) / (keys[piece + 1] - keys[piece])
    focal = world.camera.focal * size[1]
    ray = _rays(focal, (strata.offsets[index][:, None] + shift) % 1.0 - 0.5, size)
    owner = _nearest(swept, rows, ray, piece, share, keys.shape[0] - 1, size)
    triangle = jnp.maximum(owner, 0) % world.triangles.shape[0]
    copies, pose = own_copies(world, poses, piece, triangle, share)
    own = jnp.where(owner < 0, -1, jnp.arange(owner.shape[0]))
    # Each sample averages textures over its share of the pixel.
    spacing = jax.lax.rsqrt(strata.samples.astype(jnp.float32)) / focal
    surface = surface_at(copies, pose, own, ray, spacing)
    rotation = camera_rotations(poses, piece, share)
    direction = jnp.einsum("pij,jp->ip", rotation, ray)
    return shade(copies, pose, surface, direction, spacing)


def _rays(focal: Array, offset: Array, size: tuple[int, int]) -> Array:
    """Make rays (3, P) through each pixel's own subpixel position."""
    height, width = size
    row, column = jnp.divmod(jnp.arange(height * width), width)
    x = (column + 0.5 + offset[0] - width / 2) / focal
    y = (row + 0.5 + offset[1] - height / 2) / focal
    return jnp.stack([x, y, jnp.ones_like(x)])


def _nearest(
    swept: Swept,
    rows: SweptRows,
    ray: Array,
    piece: Array,
    share: Array,
    pieces: int,
    size: tuple[int, int],
) -> Array:
    """Find the swept triangle (P,) that each pixel sees at its own time, -1 for none."""
    pixels = ray.shape[1]
    triangles = swept.drawn.shape[0] // pieces

    def unfinished(state: tuple[Array, Seen]) -> Array:
        return state[0] < rows.ends[-1]

    def add(state: tuple[Array, Seen]) -> tuple[Array, Seen]:
        first, seen = state
        owner, row, column, real = candidates(rows, first, CANDIDATES)
        pixel = row * size[1] + column
        real &= piece[pixel] == owner // triangles
        covered, depth = _hit(swept, owner, ray[:, pixel], share[pixel])
        pixel = jnp.where(real & covered, pixel, pixels)
        # Materialized once: computed twice, it might round differently and leave a pixel no winner.
        inverse = jax.lax.optimization_barrier(1.0 / jnp.where(covered, depth, 1.0))
        nearest = seen.nearest.at[pixel].max(inverse)
        wins = jnp.where(inverse == nearest[pixel], pixel, pixels)
        kept = jnp.where(nearest > seen.nearest, -1, seen.owner)
        return first + CANDIDATES, Seen(nearest, kept.at[wins].max(owner))

    start = Seen(jnp.zeros(pixels + 1), jnp.full(pixels + 1, -1, jnp.int32))
    return jax.lax.while_loop(unfinished, add, (jnp.int32(0), start))[1].owner[:-1]


def _hit(swept: Swept, owner: Array, ray: Array, share: Array) -> tuple[Array, Array]:
    """Test whether rays hit moving triangles at a time in the piece; return the depths too."""
    values = edge_values(edge_polynomials(swept, owner, ray), share)
    forward = swept.forward[:, owner]
    agrees = (values < 0) == forward
    front, back = jnp.all(agrees, axis=0), jnp.all(~agrees, axis=0)
    depth = depth_at(swept, owner, corner_weights(values, forward), share)
    return (front | (back & ~swept.closed[owner])) & (depth > NEAR), depth
