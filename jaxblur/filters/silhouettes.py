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

NEIGHBORS = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right)


def _neighbor(size: tuple[int, int], down: int, right: int) -> jax.Array:
    """Row-major index (H, W, 1) of the neighbor at an offset; beyond the edge, of the edge."""
    height, width = size
    row = lax.broadcasted_iota(jnp.int32, (height, width, 1), 0)
    column = lax.broadcasted_iota(jnp.int32, (height, width, 1), 1)
    row, column = jnp.clip(row + down, 0, height - 1), jnp.clip(column + right, 0, width - 1)
    return row * width + column


def _sum(terms):
    return functools.reduce(jnp.add, terms)


def _purest(size, index, separation, tables):
    """The motion that `purest_motion` chooses, written for `sum_samples` with one sample."""
    del index
    motion, depth = tables
    width = motion.size // (size[0] * size[1])
    here = _neighbor(size, 0, 0)
    near = [_neighbor(size, *offset) for offset in NEIGHBORS]
    vectors = [[read_nearest(motion, n * width + axis) for axis in (0, 1)] for n in (here, *near)]
    depths = [read_nearest(depth, n) for n in (here, *near)]
    other = [jnp.abs(d - depths[0]) * separation > 1 for d in depths[1:]]
    count = _sum([jnp.where(apart, 1, 0).astype(depth.dtype) for apart in other])
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
    return tuple(read_nearest(motion, choice * width + k) for k in range(width))


def purest_motion(
    motion: Float[Array, "height width components"],
    log_depth: Float[Array, "height width"],
    separation: Float[Array, ""],
    backend: Backend,
) -> tuple[Float[Array, "height width"], ...]:
    """At a jump of depth, the motion of the own side that is least like the other side.

    Of the 3 x 3 neighbors those within ``1 / separation`` of the pixel in log depth are its own
    side, the others the other side. Where there is another side, the pixel takes the motion, its
    own or one of its own side, whose velocity is farthest from the mean of the other side.

    Args:
        motion: velocity in pixels, x and y, and what else belongs to a motion.
        log_depth: natural logarithm of the depth.
        separation: per unit of log depth, > 0; 20 tells depths apart that differ by 5 percent.
        backend: see `jaxblur.Settings`.

    Returns:
        One plane for each component. The derivative is that of the motion taken.
    """
    size = log_depth.shape
    tables = motion.reshape(-1), log_depth.reshape(-1)
    everywhere = jnp.ones(size, bool)
    sample = functools.partial(_purest, size)
    return sum_samples(sample, 1, everywhere, separation, tables, backend)
