"""Motion at silhouettes, freed of what the renderer mixed into it.

A renderer that averages vectors over a pixel, as Blender does, gives pixels on a silhouette a
velocity between that of the object and that of what is behind it, which nothing moves by.
"""

import functools

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..frame import Frame
from ..gathers import gather_samples
from ..native import Stages
from ..safe_math import safe_norm
from ..sampling import channel, read_nearest, read_row
from ..settings import Backend
from ..tiles import shortening
from ..weights import SPEED_FLOOR, finite_depth

NEIGHBORS = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right)

_LONGEST = 1e18
"""Pixels to which neighbors' velocities are cut, so that no square overflows."""

THIN = 6
"""Farther neighbors, of eight, that make a pixel part of something one pixel wide."""


def _neighbor(size: tuple[int, int], down: int, right: int) -> jax.Array:
    """Row-major index (H, W, 1) of the neighbor at an offset; beyond the edge, of the edge."""
    height, width = size
    row = lax.broadcasted_iota(jnp.int32, (height, width, 1), 0)
    column = lax.broadcasted_iota(jnp.int32, (height, width, 1), 1)
    row, column = jnp.clip(row + down, 0, height - 1), jnp.clip(column + right, 0, width - 1)
    return row * width + column


def _sum(terms):
    return functools.reduce(jnp.add, terms)


def _count(conditions, dtype):
    return _sum([condition.astype(dtype) for condition in conditions])


def _unmixed(vector, other, thin, coverage):
    """The slowest velocity of which at least the coverage, mixed with the other, is the vector.

    ``vector = a v + (1 - a) other``, so that ``v = vector + s (vector - other)`` with
    ``s = 1/a - 1``, 0 <= s <= 1/coverage - 1.
    """
    gap = [a - b for a, b in zip(vector, other, strict=True)]
    squared = jnp.square(gap[0]) + jnp.square(gap[1])
    apart = squared > SPEED_FLOOR**2
    slowest = -(vector[0] * gap[0] + vector[1] * gap[1]) / jnp.where(apart, squared, 1)
    share = jnp.where(thin & apart, jnp.clip(slowest, 0, 1 / coverage - 1), 0)
    return [a + share * g for a, g in zip(vector, gap, strict=True)]


def _velocity(row):
    """Velocity x, y from the row of a pixel: that itself, or its path to and fro."""
    if len(row) == 2:
        return list(row)
    opening_x, opening_y, closing_x, closing_y = row
    return [(closing_x - opening_x) / 2, (closing_y - opening_y) / 2]


def _own_velocity(local):
    width = local["motion"].shape[-1]
    return _velocity([channel(local["motion"], k) for k in range(width)])


def _neighboring_velocity(local, tables, index):
    """That of a neighbor, no longer than squares of differences allow."""
    row = read_row(tables["motion"], index, local["motion"].shape[-1])
    return [jnp.clip(part, -_LONGEST, _LONGEST) for part in _velocity(row)]


def _jumps(size, local, tables):
    """Whether there is a jump of depth beside the pixel; which neighbors are apart, or behind."""
    near = [_neighbor(size, *offset) for offset in NEIGHBORS]
    step = jnp.exp(1 / local["separation"])
    own = finite_depth(local["depth"])
    farther, nearer = own * step, own / step
    depths = [finite_depth(read_nearest(tables["depth"], index)) for index in near]
    behind = [depth > farther for depth in depths]
    apart = [far | (depth < nearer) for far, depth in zip(behind, depths, strict=True)]
    return functools.reduce(jnp.logical_or, apart), (near, apart, behind)


def _motion(radius, velocity, number, local):
    """What `purest_motion` returns of a pixel."""
    x, y = velocity
    shorter = shortening(safe_norm(x, y), radius)
    return [x * shorter, y * shorter, jnp.log(finite_depth(local["depth"])), number]


def _own_motion(radius, local, _tables, _found):
    velocity = _own_velocity(local)
    return _motion(radius, velocity, jnp.zeros_like(velocity[0]), local)


def _purest_motion(radius, local, tables, found):
    """The motion beside a jump."""
    near, other, behind = found
    own = [jnp.clip(part, -_LONGEST, _LONGEST) for part in _own_velocity(local)]
    vectors = [_neighboring_velocity(local, tables, index) for index in near]
    count = jnp.maximum(_count(other, own[0].dtype), 1)
    mean = [
        _sum([jnp.where(a, vector[axis], 0) for a, vector in zip(other, vectors, strict=True)])
        / count
        for axis in (0, 1)
    ]

    def unlikeness(vector):
        return jnp.square(vector[0] - mean[0]) + jnp.square(vector[1] - mean[1])

    best, taken, number = unlikeness(own), own, jnp.zeros_like(own[0])
    for apart, vector, (down, right) in zip(other, vectors, NEIGHBORS, strict=True):
        distance = unlikeness(vector)
        take = (distance > best) & ~apart
        best = jnp.where(take, distance, best)
        taken = [jnp.where(take, new, old) for new, old in zip(vector, taken, strict=True)]
        number = jnp.where(take, 4.0 * down + right, number)
    thin = _count(behind, own[0].dtype) >= THIN
    return _motion(radius, _unmixed(taken, mean, thin, local["coverage"]), number, local)


def purest_motion(
    frame: Frame,
    radius: int,
    separation: float | Float[Array, ""],
    coverage: float | Float[Array, ""],
    backend: Backend,
) -> Float[Array, "height width 4"]:
    """Every pixel's motion; at a jump of depth that of the own side least like the other side.

    Of the 3 x 3 neighbors those within ``1 / separation`` of the pixel in log depth are its own
    side, the others the other side. Where there is another side, the pixel takes the motion, its
    own or one of its own side, whose velocity is farthest from the mean of the other side.

    What is one pixel wide has no pure pixel. There the velocity is drawn on, away from the mean of
    the other side, as far as makes it slowest: a pole that moves with the camera before a
    background that does not is at rest.

    Args:
        frame: its depth and path are used, or its velocity where there is no path.
        radius: longest half-spread in pixels.
        separation: per unit of log depth, > 0; 20 tells depths apart that differ by 5 percent.
        coverage: least share of a pixel that something one pixel wide covers, in (0, 1].
        backend: see `jaxblur.Settings`.

    Returns:
        Velocity in pixels, x and y, within the radius; the natural logarithm of the pixel's own
        depth; and the number of the pixel that the motion was taken from, see `taken_from`. The
        derivative is that of the motion taken.
    """
    height, width = frame.depth.shape
    motion = frame.velocity if frame.path is None else frame.path.reshape(height, width, 4)
    local = {"motion": motion, "depth": frame.depth[..., None]}
    local |= {"separation": separation, "coverage": coverage}
    tables = {"motion": motion.reshape(-1), "depth": frame.depth.reshape(-1)}
    stages = Stages(
        moving=functools.partial(_jumps, (height, width)),
        prepare=functools.partial(_purest_motion, radius),
        rest=functools.partial(_own_motion, radius),
    )
    return gather_samples(stages, 0, motion, local, tables, backend)


def taken_from(number: Float[Array, "*shape"]) -> tuple[Float[Array, "*shape"], ...]:
    """Offset of the pixel that a motion was taken from.

    Args:
        number: as `purest_motion` returns it, four times the rows and the columns to it.

    Returns:
        Whole pixels to the right and downward, -1 to 1 each.
    """
    down = jnp.floor(number / 4 + 0.5)
    return number - 4 * down, down
