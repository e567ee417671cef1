"""Pass L3 of `layered`: the nearest surface at every pixel, at some times of the exposure.

Every pixel that moves is drawn where its path has it at each of these times, and the nearest one
stays: a scatter-max. A mark holds how near the pixel is and where it comes from, so that it is a
pixel's *owner* that is found. Pixels at rest are not drawn: they own their place unless a mark is
nearer. What is drawn at a pixel depends on nothing farther away than the radius, so that a part of
a frame gives the result of the frame.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from ...kernels import At, Image, Outcome, largest_marks, mark_over
from ...settings import Settings
from .._weights import SPEED_FLOOR
from .paths import Path

MOST_INTERVALS = 15
"""Largest number of intervals between the times, so that many samples need no more memory; odd, see
`intervals_of`."""

_NEAREST, _OCTAVES = -10, 32
"""Most levels are those of depths from 2^-10 scene units on, over so many doublings."""

_BEFORE, _BEYOND = 20, 38
"""Doublings of depth before and beyond those, as far as `.._weights.finite_depth` leaves depths."""

_TAIL = 0.05
"""Share of the levels that each of these two has, so that no unit of depth loses their order."""

_MOST_LEVELS = 1 << 23
"""Largest number of levels of depth: float32 holds each of them."""


class Drawn(NamedTuple):
    """What is drawn, planes (H, W); each pixel is read for each of the times.

    Attributes:
        x: as `.paths.Path`.
        y: as `.paths.Path`.
        bend_x: as `.paths.Path`.
        bend_y: as `.paths.Path`.
        level: of the depth, see `Coding.level`.
    """

    x: Image
    y: Image
    bend_x: Image
    bend_y: Image
    level: Image


class Coding(NamedTuple):
    """How a mark holds a depth and a place, in 31 bits.

    Attributes:
        bits: of an offset along one axis, from its owner to a pixel.
        levels: of depth. At a radius of 160 a level is 0.3 percent of the depth, at 1000 five, and
            at the largest radius (`..builtin.LAYERED_RADIUS`) it is a doubling.
    """

    bits: int
    levels: int

    @classmethod
    def of(cls, radius: int) -> "Coding":
        """The coding for offsets up to the radius."""
        bits = (2 * radius).bit_length()
        return cls(bits, min(1 << (31 - 2 * bits), _MOST_LEVELS))

    def level(self, log_depth: Array) -> Array:
        """From 1 for the farthest to ``levels - 1`` for the nearest; a whole number."""
        doublings = log_depth * (1 / math.log(2)) - _NEAREST
        before = jnp.clip(doublings * (1 / _BEFORE), -1, 0)
        within = jnp.clip(doublings * (1 / _OCTAVES), 0, 1)
        beyond = jnp.clip((doublings - _OCTAVES) * (1 / _BEYOND), 0, 1)
        share = (1 - _TAIL) - _TAIL * (before + beyond) - (1 - 2 * _TAIL) * within
        level = jnp.floor(share * self.levels)
        return jnp.clip(level, 1, self.levels - 1)

    def mark(self, level: Array, right: Array, down: Array) -> Int[Array, "*shape"]:
        """A mark, from whole offsets of the pixel from its owner."""
        half = 1 << (self.bits - 1)
        place = (down + half) * (1 << self.bits) + right + half
        return level.astype(jnp.int32) * (1 << 2 * self.bits) + place

    def level_of(self, mark: Array, like: Array) -> Array:
        """The level of a mark; 0 where there is none."""
        return lax.shift_right_arithmetic(mark, jnp.int32(2 * self.bits)).astype(like.dtype)

    def offset_of(self, mark: Array) -> tuple[Array, Array]:
        """Whole offsets of the pixel from its owner, to the right and downward."""
        half, mask = 1 << (self.bits - 1), jnp.int32((1 << self.bits) - 1)
        down = lax.shift_right_arithmetic(mark, jnp.int32(self.bits))
        return (mark & mask) - half, (down & mask) - half


def intervals_of(slices: int) -> int:
    """The number of intervals into which the times of `owners_of` cut the exposure.

    No slice has its middle at one of the times, so that a reversed motion has the same pairs of
    them. What is narrower along its motion than the way of an interval is missed in between.
    """
    return min(slices, MOST_INTERVALS)


def time_of(index: Array, intervals: int, like: Array) -> Array:
    """The time of a map of owners, ``-1 + 2 k / intervals``; symmetric about 0 to the bit."""
    return (2 * index - intervals).astype(like.dtype) * (1 / intervals)


class Drawing(NamedTuple):
    """What is fixed when the program is traced."""

    intervals: int
    coding: Coding


def draw_pixel(at: At, images: Drawn, _: None, drawing: Drawing) -> Outcome:
    """Pass L3: a pixel leaves a mark at its place at each of the times."""
    x, y, bend_x, bend_y, level = (image.here()[0] for image in images)
    path = Path(x, y, level, bend_x, bend_y)
    height, width = images.x.height, images.x.width

    def mark(k: Int[Array, ""]) -> tuple[tuple[Array, Array]]:
        # A vector that is NaN does not move, and leads to no place that an integer holds.
        ends = (
            jnp.where(moves(path), part, 0) for part in path.at(time_of(k, drawing.intervals, x))
        )
        right, down = (jnp.floor(part + 0.5).astype(jnp.int32) for part in ends)
        row, column = at.row + down, at.column + right
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        place = (k * height + jnp.where(inside, row, 0)) * width + jnp.where(inside, column, 0)
        return (
            (place, jnp.where(inside & moves(path), drawing.coding.mark(level, right, down), 0)),
        )

    count = jnp.where(moves(path), drawing.intervals + 1, 0).astype(path.x.dtype)
    return Outcome(mark_over(count, mark), where=moves(path))


def moves(path: Path) -> Array:
    """Whether a pixel is blurred: its velocity or its bend is above the floor."""
    squared = path.x**2 + path.y**2
    bent = path.bend_x**2 + path.bend_y**2
    return (squared > SPEED_FLOOR**2) | (bent > SPEED_FLOOR**2)


def owners_of(
    paths: jax.Array, intervals: int, settings: Settings
) -> Int[Array, "times_height width"]:
    """The owner of every pixel, as a mark, at ``intervals + 1`` times from -1 to 1.

    Args:
        paths: (H, W, 5), see `.paths.Path`.
        intervals: between the times.
        settings: radius and backend are used.

    Returns:
        Images of marks below one another, one a time; 0 where nothing that moves is. Without
        derivatives.

    Raises:
        ValueError: the frame is too large.
    """
    height, width = paths.shape[:2]
    length = (intervals + 1) * height * width
    if length >= 2**31:
        raise ValueError(
            f"layered needs {length} marks for a frame of {width}x{height}, more than 2^31; use "
            "fewer samples, or blur parts of the frame."
        )
    drawing = Drawing(intervals, Coding.of(settings.radius))
    path = Path(*jnp.moveaxis(lax.stop_gradient(paths), -1, 0))
    level = drawing.coding.level(path.log_depth)
    images = Drawn(*map(Image, (path.x, path.y, path.bend_x, path.bend_y, level)))
    marks = largest_marks(
        *(draw_pixel, (height, width), images, length, None, drawing),
        apart=intervals + 1,
        backend=settings.backend,
    )
    return marks.reshape((intervals + 1) * height, width)


class Owner(NamedTuple):
    """The owner of a pixel at a time.

    Attributes:
        exists: whether there is one.
        texel: its row-major number; that of the pixel itself where there is none.
    """

    exists: Array
    texel: Array


def read_owner(
    at: At, owners: Image, time: Array, own: Path, coding: Coding, size: tuple[Array, Array]
) -> Owner:
    """The owner of the pixel at a time, that itself where it rests and nothing is nearer.

    Args:
        at: the pixel.
        owners: what `owners_of` gives.
        time: number of the time.
        own: path of the pixel.
        coding: of the marks.
        size: rows and columns of the frame.

    Returns:
        The owner.
    """
    height, width = size
    (mark,) = owners.read(time * height + at.row, at.column)
    rests = ~moves(own) & (coding.level_of(mark, own.x) <= coding.level(own.log_depth))
    right, down = coding.offset_of(mark)
    drawn = (mark != 0) & ~rests
    right, down = (jnp.where(drawn, offset, 0) for offset in (right, down))
    return Owner(drawn | rests, (at.row - down) * width + at.column - right)
