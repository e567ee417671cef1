"""Motion at silhouettes, freed of what the renderer mixed into it.

A renderer that averages vectors over a pixel, as Blender does, gives pixels on a silhouette a
velocity between that of the object and that of what is behind it, which nothing moves by.
"""

import functools

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..sample_sums import sum_samples
from ..sampling import read_nearest
from ..settings import Backend
from ..weights import SPEED_FLOOR

NEIGHBORS = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right)


def _neighbor(size: tuple[int, int], down: int, right: int) -> jax.Array:
    """Row-major index (H, W, 1) of the neighbor at an offset; beyond the edge, of the edge."""
    height, width = size
    row = lax.broadcasted_iota(jnp.int32, (height, width, 1), 0)
    column = lax.broadcasted_iota(jnp.int32, (height, width, 1), 1)
    row, column = jnp.clip(row + down, 0, height - 1), jnp.clip(column + right, 0, width - 1)
    return row * width + column


THIN = 6
"""Farther neighbors, of eight, that make a pixel part of something one pixel wide."""


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


def _purest(size, index, local, tables):
    """The motion that `purest_motion` finds, written for `sum_samples` with one sample."""
    del index
    separation, coverage = local
    motion, depth = tables
    width = motion.size // (size[0] * size[1])
    here = _neighbor(size, 0, 0)
    near = [_neighbor(size, *offset) for offset in NEIGHBORS]
    vectors = [[read_nearest(motion, n * width + axis) for axis in (0, 1)] for n in (here, *near)]
    own_depth = read_nearest(depth, here)
    behind = [(read_nearest(depth, n) - own_depth) * separation for n in near]
    other = [jnp.abs(step) > 1 for step in behind]
    count = _count(other, depth.dtype)
    mean = [
        _sum([jnp.where(a, v[axis], 0) for a, v in zip(other, vectors[1:], strict=True)])
        / jnp.maximum(count, 1)
        for axis in (0, 1)
    ]
    unlike = [jnp.square(v[0] - mean[0]) + jnp.square(v[1] - mean[1]) for v in vectors]
    best, choice = unlike[0], here
    for apart, n, distance in zip(other, near, unlike[1:], strict=True):
        take = (distance > best) & ~apart & (count > 0)
        best, choice = jnp.where(take, distance, best), jnp.where(take, n, choice)
    taken = [read_nearest(motion, choice * width + k) for k in range(width)]
    thin = _count([step > 1 for step in behind], depth.dtype) >= THIN
    return (*_unmixed(taken[:2], mean, thin, coverage), *taken[2:])


def purest_motion(
    motion: Float[Array, "height width components"],
    log_depth: Float[Array, "height width"],
    separation: Float[Array, ""],
    coverage: Float[Array, ""],
    backend: Backend,
) -> tuple[Float[Array, "height width"], ...]:
    """At a jump of depth, the motion of the own side that is least like the other side.

    Of the 3 x 3 neighbors those within ``1 / separation`` of the pixel in log depth are its own
    side, the others the other side. Where there is another side, the pixel takes the motion, its
    own or one of its own side, whose velocity is farthest from the mean of the other side.

    What is one pixel wide has no pure pixel. There the velocity is drawn on, away from the mean of
    the other side, as far as makes it slowest: a pole that moves with the camera before a
    background that does not is at rest.

    Args:
        motion: velocity in pixels, x and y, and what else belongs to a motion.
        log_depth: natural logarithm of the depth.
        separation: per unit of log depth, > 0; 20 tells depths apart that differ by 5 percent.
        coverage: least share of a pixel that something one pixel wide covers, in (0, 1].
        backend: see `jaxblur.Settings`.

    Returns:
        One plane for each component. The derivative is that of the motion taken.
    """
    size = log_depth.shape
    tables = motion.reshape(-1), log_depth.reshape(-1)
    everywhere = jnp.ones(size, bool)
    sample = functools.partial(_purest, size)
    return sum_samples(sample, 1, everywhere, (separation, coverage), tables, backend)
