"""Pass L1 of `layered`: the motion and depth of every pixel, cleaned of mixtures at silhouettes.

A renderer that averages vectors over a pixel, as Blender does, gives pixels on a silhouette a
velocity between that of the object and that of the background, although nothing moves that way.
And a pixel that an object covers in part, but not in the middle, has the depth of the background
while its color is partly that of the object: it would stay behind as an outline when the object
moves.
"""

import functools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ...frame import Frame
from ...kernels import At, Image, Outcome, each_pixel
from ...safe_math import safe_norm, shortening
from ...settings import Settings
from .._weights import SPEED_FLOOR, finite_depth

NEIGHBORS = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right)

LONGEST = 1e18
"""Pixels to which velocities are cut, so that no square overflows and infinity is a length."""

MIXED = 0.02
"""Least share of a nearer surface in a pixel's color that makes the pixel part of that surface."""

THIN = 6
"""Farther neighbors, of eight, that make a pixel part of something one pixel wide."""

Vector = Sequence[Array]


class Buffers(NamedTuple):
    """Images that the program reads.

    Attributes:
        motion: (H, W, 2) velocity, or (H, W, 4) path.
        depth: (H, W, 1) scene units.
        color: (H, W, C), the frame's guide where it has one.
        valid: (H, W, 1) 0 where the color is masked, or None.
    """

    motion: Image
    depth: Image
    color: Image
    valid: Image | None


class Limits(NamedTuple):
    """Numbers that the program uses.

    Attributes:
        separation: per unit of log depth, > 0; 20 separates depths that differ by 5 percent.
        coverage: least share of a pixel that a thing one pixel wide covers, in (0, 1].
    """

    separation: Array
    coverage: Array


class Motion(NamedTuple):
    """The motion of a pixel, the channels of one image.

    Attributes:
        x: of the velocity, within the radius, pixels to the right.
        y: pixels downward.
        log_depth: natural logarithm of the depth of the surface whose motion it is.
        taken_from: the pixel that the motion is from, see `taken_from`.
    """

    x: Float[Array, "*a"]
    y: Float[Array, "*a"]
    log_depth: Float[Array, "*a"]
    taken_from: Float[Array, "*a"]


def purest_motion(at: At, images: Buffers, limits: Limits, settings: Settings) -> Outcome:
    """A pixel's motion; at a jump of depth, that of its own side least like the other side.

    Of the 3 x 3 neighbors those within ``1 / separation`` of the pixel in log depth are its own
    side, the others the other side. Where there is another side, the pixel takes the motion, its
    own or one of its own side, whose velocity is farthest from the mean of the other side.

    A pixel is of its own depth's side, unless its color is partly that of a nearer neighbor: with F
    the color beyond that neighbor and B that on the pixel's other side, the share a of the nearer
    surface is that of ``C = a F + (1 - a) B``. Then the pixel is of the neighbor's side.

    A thing one pixel wide has no pure pixel. There the velocity is extrapolated, away from the mean
    of the other side, until it is slowest: a pole that moves with the camera before a background
    that does not is at rest.
    """
    (depth,) = images.depth.here()
    own_velocity = _velocity(images.motion.here())
    near = [
        (
            jnp.clip(at.row + down, 0, images.depth.height - 1),
            jnp.clip(at.column + right, 0, images.depth.width - 1),
        )
        for down, right in NEIGHBORS
    ]
    step = jnp.exp(1 / limits.separation)
    depths = [finite_depth(images.depth.read_inside(*place)[0]) for place in near]
    own_depth = finite_depth(depth)
    jumps = [(d > own_depth * step) | (d < own_depth / step) for d in depths]

    # The pixel's side: its own, or that of the nearest neighbor if its color is partly of that.
    nearest, covering = own_depth / step, jnp.zeros_like(own_depth)
    for d, (row, column), (down, right) in zip(depths, near, NEIGHBORS, strict=True):
        inside = (row == at.row + down) & (column == at.column + right)
        covers = inside & (d < nearest)
        covering = jnp.where(covers, 4.0 * down + right, covering)
        nearest = jnp.where(covers, d, nearest)
    mixed = _share_of_nearer(at, images, own_depth / step, covering) > MIXED
    side_depth = jnp.where(mixed, nearest, own_depth)
    start = jnp.where(mixed, covering, 0)

    # Which neighbors lie apart in depth, and which behind.
    behind = [d > side_depth * step for d in depths]
    apart = [far | (d < side_depth / step) for far, d in zip(behind, depths, strict=True)]

    def motion(velocity: Vector, depth: Array, number: Array) -> Motion:
        x, y = velocity
        shorter = shortening(safe_norm(x, y), settings.radius)
        return Motion(x * shorter, y * shorter, jnp.log(depth), number)

    # The mean velocity of the other side.
    across, down = taken_from(start)
    row, column = at.row + down.astype(jnp.int32), at.column + across.astype(jnp.int32)
    own = _velocity(images.motion.read_inside(row, column))
    vectors = [_velocity(images.motion.read_inside(*place)) for place in near]
    count = jnp.maximum(_count(apart, own[0]), 1)
    mean = [
        _sum(jnp.where(a, vector[axis], 0) for a, vector in zip(apart, vectors, strict=True))
        / count
        for axis in (0, 1)
    ]

    # Of the own side, the velocity farthest from it.
    def distance(vector: Vector) -> Array:
        return jnp.square(vector[0] - mean[0]) + jnp.square(vector[1] - mean[1])

    best, taken, number = distance(own), own, start
    for a, vector, (down, right) in zip(apart, vectors, NEIGHBORS, strict=True):
        take = (distance(vector) > best) & ~a
        best = jnp.where(take, distance(vector), best)
        taken = [jnp.where(take, new, old) for new, old in zip(vector, taken, strict=True)]
        number = jnp.where(take, 4.0 * down + right, number)
    thin = _count(behind, own[0]) >= THIN
    pure = motion(_extrapolated(taken, mean, thin, limits.coverage), side_depth, number)
    return Outcome(
        pure,
        where=functools.reduce(jnp.logical_or, jumps),
        otherwise=motion(own_velocity, own_depth, jnp.zeros_like(own_depth)),
    )


def _share_of_nearer(at: At, images: Buffers, nearer: Array, covering: Array) -> Array:
    """Share of a nearer surface in the pixel's color; 0 where it cannot be told.

    Args:
        at: the pixel.
        images: see `Buffers`.
        nearer: depth above which nothing counts as nearer.
        covering: the neighbor that may cover the pixel in part, see `taken_from`; 0 for none.
    """
    across, down = (part.astype(jnp.int32) for part in taken_from(covering))

    def place(steps: int) -> tuple[Array, Array, Array]:
        row, column = at.row + steps * down, at.column + steps * across
        inside = (row >= 0) & (row < images.depth.height)
        inside = inside & (column >= 0) & (column < images.depth.width)
        row, column = jnp.where(inside, row, at.row), jnp.where(inside, column, at.column)
        is_nearer = finite_depth(images.depth.read_inside(row, column)[0]) < nearer
        return row, column, inside & is_nearer

    def is_valid(row: Array, column: Array) -> Array:
        return (
            jnp.asarray(True)
            if images.valid is None
            else images.valid.read_inside(row, column)[0] != 0
        )

    row, column, beyond = place(2)
    beside_row, beside_column, _ = place(1)
    row, column = jnp.where(beyond, row, beside_row), jnp.where(beyond, column, beside_column)
    inner, known = images.color.read_inside(row, column), is_valid(row, column)
    row, column, is_nearer = place(-1)
    outer, known = images.color.read_inside(row, column), known & is_valid(row, column)
    known = known & is_valid(at.row, at.column)
    gaps = [a - b for a, b in zip(inner, outer, strict=True)]
    apart = [a - b for a, b in zip(images.color.here(), outer, strict=True)]
    squared = _sum(jnp.square(gap) for gap in gaps)
    known = known & (covering != 0) & ~is_nearer & (squared > 0)
    share = _sum(a * b for a, b in zip(apart, gaps, strict=True)) / jnp.where(known, squared, 1)
    return jnp.where(known, share, 0)


def _velocity(channels: Sequence[Array]) -> Vector:
    """Velocity x, y of a pixel: that itself, or half of its path from opening to closing."""
    if len(channels) == 2:
        return cut(channels)
    opening_x, opening_y, closing_x, closing_y = cut(channels)
    return (closing_x - opening_x) / 2, (closing_y - opening_y) / 2


def cut(vector: Vector) -> Vector:
    """Components of vectors, no longer than squares of differences allow."""
    return [jnp.clip(part, -LONGEST, LONGEST) for part in vector]


def _sum(terms: Iterable[Array]) -> Array:
    return functools.reduce(jnp.add, terms)


def _count(conditions: Sequence[Array], like: Array) -> Array:
    return _sum(condition.astype(like.dtype) for condition in conditions)


def _extrapolated(vector: Vector, other: Vector, thin: Array, coverage: Array) -> Vector:
    """The slowest velocity of which at least the coverage, mixed with the other, is the vector.

    ``vector = a v + (1 - a) other``, so that ``v = vector + s (vector - other)`` with
    ``s = 1/a - 1``, 0 <= s <= 1/coverage - 1. The vector itself where nothing is thin.
    """
    gap = [a - b for a, b in zip(vector, other, strict=True)]
    squared = jnp.square(gap[0]) + jnp.square(gap[1])
    differ = squared > SPEED_FLOOR**2
    slowest = -(vector[0] * gap[0] + vector[1] * gap[1]) / jnp.where(differ, squared, 1)
    share = jnp.where(thin & differ, jnp.clip(slowest, 0, 1 / coverage - 1), 0)
    return [a + share * g for a, g in zip(vector, gap, strict=True)]


def motion_of(
    frame: Frame, separation: Array, coverage: Array, settings: Settings
) -> Float[Array, "height width 4"]:
    """The motion of every pixel, see `purest_motion`.

    Args:
        frame: with a mask, the last channel of its color is that mask, and is not a color.
        separation: see `Limits`.
        coverage: see `Limits`.
        settings: radius and backend are used.

    Returns:
        (H, W, 4), see `Motion`. The derivative is that of the motion taken.
    """
    height, width = frame.depth.shape
    motion = frame.velocity if frame.path is None else frame.path.reshape(height, width, 4)
    color, valid = lax.stop_gradient(frame.color), None
    if frame.valid is not None:
        color, valid = color[..., :-1], Image(color[..., -1:])
    if frame.guide is not None:
        color = lax.stop_gradient(frame.guide)
    images = Buffers(Image(motion), Image(frame.depth), Image(color), valid)
    return each_pixel(
        purest_motion,
        (height, width),
        images,
        Limits(separation, coverage),
        settings,
        backend=settings.backend,
    )


def taken_from(number: Float[Array, "*shape"]) -> tuple[Float[Array, "*shape"], ...]:
    """Offset of the pixel that a motion was taken from.

    Args:
        number: of a `Motion`, four times the rows and the columns to it.

    Returns:
        Whole pixels to the right and downward, -1 to 1 each.
    """
    down = jnp.floor(number / 4 + 0.5)
    return number - 4 * down, down
