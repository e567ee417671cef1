"""Pass L3 of `layered`: the nearest surface at every pixel, at some times of the exposure.

Every pixel that moves is drawn where its path has it at each of these times, and the nearest one
stays: a scatter-max. A mark holds how near the pixel is and where it comes from, so that it is a
pixel's *owner* that is found. Pixels at rest are not drawn: they own their place unless a mark is
nearer. (With a lens they are drawn like the others.) Nothing is drawn farther from its own place
than the radius. So a part of a frame gives the same result as the whole frame, if it has so many
pixels more at its border.
"""

import functools
import itertools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ...kernels import At, Image, Outcome, each_pixel, largest_marks, mark_over, still_place
from ...settings import Settings
from .._weights import SPEED_FLOOR
from .clock import Clock, Maps, Span, Times, time_when_drawn
from .paths import Path, Vector

MOST_INTERVALS = 15
"""Largest number of intervals between the times, so that many samples need no more memory; odd, see
`maps_of`."""

RESTS, MOVES, MISSES = 0, 1, 2
"""What `states_of` tells of a pixel."""

_NEAREST, _OCTAVES = -10, 32
"""Most levels are those of depths from 2^-10 scene units on, over so many doublings."""

_BEFORE, _BEYOND = 20, 38
"""Doublings of depth before and beyond those, as far as `.._weights.finite_depth` leaves depths."""

_TAIL = 0.05
"""Share of the levels that each of these two has, so that no unit of depth loses their order."""

_MOST_LEVELS = 1 << 23
"""Largest number of levels of depth: float32 holds each of them."""


class Drawn(NamedTuple):
    """What is drawn.

    Attributes:
        paths: (H, W, 5), or with a lens (H, W, 6), see `.paths.Path`.
        level: (H, W) of the depth, see `Coding.level`.
        times: of the shutter; None for the nominal one.
        points: (1, T, 2) of the unit disc, from which the maps are seen; None without a lens.
    """

    paths: Image
    level: Image
    times: Times | None
    points: Image | None


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


def maps_of(slices: int) -> Maps:
    """The maps of owners without a lens, at the ends of equal parts of the exposure.

    No slice has its middle at one of the times, so that a reversed motion has the same pairs of
    them. What is narrower along its motion than the way of an interval is missed in between.
    """
    intervals = min(slices, MOST_INTERVALS)
    return Maps(intervals + 1, intervals)


class Drawing(NamedTuple):
    """What is fixed when the program is traced."""

    maps: Maps
    coding: Coding


def draw_pixel(at: At, images: Drawn, span: Span | None, drawing: Drawing) -> Outcome:
    """Pass L3: a pixel leaves a mark at its place at each of the times."""
    path = Path(*images.paths.here())
    (level,) = images.level.here()
    height, width = images.paths.height, images.paths.width
    # With a lens, pixels at rest leave marks too: a place without a mark is then a hole.
    draws = moves(path) | drawing.maps.through_lens

    def mark(k: Int[Array, ""]) -> tuple[tuple[Array, Array]]:
        point = point_of(images.points, k)
        time = time_when_drawn(k, drawing.maps, path, at.row, images.times, span, point)
        place = path.at(time, point)
        # A vector that is NaN does not move, and leads to no place that an integer holds.
        x, y = (jnp.where(moves(path), part, 0) for part in place)
        right, down = (jnp.floor(part + 0.5).astype(jnp.int32) for part in (x, y))
        row, column = at.row + down, at.column + right
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        place = (k * height + jnp.where(inside, row, 0)) * width + jnp.where(inside, column, 0)
        return ((place, jnp.where(inside & draws, drawing.coding.mark(level, right, down), 0)),)

    count = jnp.where(draws, drawing.maps.total, 0).astype(path.x.dtype)
    return Outcome(mark_over(count, mark), where=draws)


def moves(path: Path) -> Array:
    """Whether a pixel is blurred: its velocity, its bend or its disc is above the floor."""
    squared = path.x**2 + path.y**2
    bent = path.bend_x**2 + path.bend_y**2
    moves = (squared > SPEED_FLOOR**2) | (bent > SPEED_FLOOR**2)
    return moves if path.disc is None else moves | (jnp.abs(path.disc) > SPEED_FLOOR)


def point_of(points: Image | None, index: Array) -> Vector | None:
    """The point of the unit disc from which a map is seen; None without a lens."""
    if points is None:
        return None
    x, y = points.read_texel(index)
    return x, y


def owners_of(
    paths: jax.Array,
    maps: Maps,
    settings: Settings,
    clock: Clock | None = None,
    points: Image | None = None,
) -> Int[Array, "times_height width"]:
    """The owner of every pixel, as a mark, in every map.

    Args:
        paths: (H, W, 5), or with a lens (H, W, 6), see `.paths.Path`.
        maps: how many, and when.
        settings: radius and backend are used.
        clock: of the shutter, whose times these are; None for the nominal one.
        points: see `Drawn`.

    Returns:
        Images of marks below one another, one a time; 0 where nothing that moves is. Without
        derivatives.

    Raises:
        ValueError: the frame is too large.
    """
    height, width = paths.shape[:2]
    length = maps.total * height * width
    if length >= 2**31:
        raise ValueError(
            f"layered needs {length} marks for a frame of {width}x{height}, more than 2^31; use "
            "fewer samples, or blur parts of the frame."
        )
    drawing = Drawing(maps, Coding.of(settings.radius))
    clock = lax.stop_gradient(clock)
    times, span = (None, None) if clock is None else (clock.times(), clock.span)
    paths = lax.stop_gradient(paths)
    level = Image(drawing.coding.level(paths[..., 2]))
    images = Drawn(Image(paths), level, times, points)
    marks = largest_marks(
        draw_pixel,
        (height, width),
        images,
        length,
        span,
        drawing,
        apart=maps.total,
        backend=settings.backend,
    )
    return marks.reshape(maps.total * height, width)


class MapsRead(NamedTuple):
    """Images of the program that looks through the maps.

    Attributes:
        owners: (T H, W, 1), see `owners_of`.
        paths: (H, W, 5), see `.paths.Path`.
    """

    owners: Image
    paths: Image


def state_of_pixel(at: At, images: MapsRead, _: None, drawing: Drawing) -> Outcome:
    """What there is to do at a pixel: whether it rests, moves, or also lacks an owner."""
    marks = [
        images.owners.read_inside(k * images.paths.height + at.row, at.column)[0]
        for k in range(drawing.maps.total)
    ]
    own = Path(*images.paths.here())
    largest = functools.reduce(jnp.maximum, marks)
    # The larger of two that follow each other: a slice takes the one that exists. None follows at
    # the ends of the exposure.
    pairs = [marks[0], marks[-1], *(jnp.maximum(*pair) for pair in itertools.pairwise(marks))]
    # Through a lens each map stands for itself.
    needed = marks if drawing.maps.through_lens else pairs
    misses = moves(own) & (functools.reduce(jnp.minimum, needed) == 0)
    crossed = largest > 0
    if drawing.maps.through_lens:
        zero = jnp.int32(0)
        own_mark = drawing.coding.mark(drawing.coding.level(own.log_depth), zero, zero)
        crossed = functools.reduce(jnp.logical_or, [mark != own_mark for mark in marks])
    state = jnp.where(misses, MISSES, jnp.where(moves(own) | crossed, MOVES, RESTS))
    return Outcome((state.astype(own.x.dtype),))


def states_of(
    owners: Image, paths: Image, maps: Maps, settings: Settings
) -> Float[Array, "height width 1"]:
    """What there is to do at every pixel.

    Args:
        owners: what `owners_of` gives.
        paths: as `owners_of`.
        maps: as `owners_of`.
        settings: radius and backend are used.

    Returns:
        `MISSES` where the pixel moves and has no owner at two times that follow each other, or at
        the first or the last; with a lens where it has none in one of the maps. Else `MOVES` where
        it moves or something moves across it, else `RESTS`. Without derivatives.
    """
    images = MapsRead(owners, Image(lax.stop_gradient(paths.values)))
    height, width = paths.values.shape[:2]
    return each_pixel(
        state_of_pixel,
        (height, width),
        images,
        None,
        Drawing(maps, Coding.of(settings.radius)),
        backend=settings.backend,
    )


class Owner(NamedTuple):
    """The owner of a pixel at a time.

    Attributes:
        exists: whether there is one.
        texel: its row-major number; that of the pixel itself where there is none.
        level: of its depth, see `Coding.level`; 0 where there is none.
    """

    exists: Array
    texel: Array
    level: Array


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
    (mark,) = owners.read_inside(time * height + at.row, at.column)
    level, own_level = coding.level_of(mark, own.x), coding.level(own.log_depth)
    rests = ~moves(own) & (level <= own_level)
    right, down = coding.offset_of(mark)
    drawn = (mark != 0) & ~rests
    right, down = (jnp.where(drawn, offset, 0) for offset in (right, down))
    texel = (at.row - down) * width + at.column - right
    return Owner(drawn | rests, texel, jnp.where(rests, own_level, level))


def moving_owner(
    at: At,
    owners: Image,
    paths: Image,
    index: Array,
    time: Array,
    coding: Coding,
    point: Vector | None = None,
) -> Owner:
    """`read_owner`, with the derivative that the motion of the owners gives.

    When a surface moves, its outline moves in the map of owners, and other pixels get another
    owner. Of two surfaces the one in front carries the outline between them. So along each axis
    the map is taken to move as the nearest of the surfaces at the pixel and at the two beside it:
    the derivative is that of a read at the offset ``-(x - floor(x + 1/2))``, x being the
    displacement of that surface. The value is that of `read_owner` to the bit.

    Args:
        at: the pixel.
        owners: what `owners_of` gives.
        paths: (H, W, 5), see `.paths.Path`.
        index: number of the time.
        time: at the pixel's row.
        coding: of the marks.
        point: of the unit disc, from which the map is seen; None without a lens.

    Returns:
        The owner.
    """
    size = jnp.asarray(paths.height), jnp.asarray(paths.width)

    def owner_beside(right: Array | int, down: Array | int) -> Owner:
        row = jnp.clip(at.row + down, 0, size[0] - 1)
        column = jnp.clip(at.column + right, 0, size[1] - 1)
        own = Path(*paths.read_inside(row, column))
        return read_owner(At(row, column), owners, index, own, coding, size)

    own = owner_beside(0, 0)

    def moved(axis: int) -> Array:
        front = own
        for side in (1, -1):
            other = owner_beside(*((side, 0) if axis == 0 else (0, side)))
            nearer = other.level > front.level
            front = Owner(*(jnp.where(nearer, *pair) for pair in zip(other, front, strict=True)))
        path = Path(*paths.read_texel(front.texel))
        part = path.at(time, point)[axis]
        return jnp.where(front.exists & moves(path), jnp.floor(part + 0.5) - part, 0)

    return owner_beside(*still_place(moved(0), moved(1)))
