"""Passes L2 and L3 of `layered`: the two motions that matter in each tile of a fine grid.

Every fine tile draws its fastest velocity as a line, over all tiles that the line crosses. A tile
keeps two of the lines that cross it: the fastest, and the one most unlike that. Lines are as long
as the motion, so that blur may be longer than any tile, and a motion that passes without reaching a
tile leaves it alone. The tiles that a line crosses, and its score there, depend on nothing farther
away: a part of a frame gives the result of the frame.
"""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ...kernels import At, Image, Outcome, largest_in_tiles, largest_marks, mark_over
from ...safe_math import safe_norm
from ...settings import Backend
from .._weights import SPEED_FLOOR

USUAL_TILE = 8
"""Pixels. Six gain less than 0.1 dB on rendered scenes and double the work; twelve lose as much."""

_LEVELS = 256
"""Steps of a score per pixel, if the radius leaves bits for so many: up to a radius of 400 it does;
at 1000 a step is a sixteenth of a pixel. Of lines within a step the first counts as the fastest."""

IN_FRONT = 0.05
"""Difference of log depth that puts a line in front of a tile that it crosses."""

ALIKE = 1.0
"""Pixels by which two velocities must differ to count as two."""

BEHIND = 20
"""A line in front goes first unless one behind is this many times more unlike the first choice."""

_INSET = 0.25
"""Pixels by which a line is narrower than a tile, so that mirrored frames round alike."""


class MotionImage(NamedTuple):
    """The motion of every pixel, (H, W, 4), see `.silhouettes.Motion`."""

    motion: Image


class Lines(NamedTuple):
    """The line of each tile, each field an image of one channel.

    Attributes:
        x: velocity, pixels to the right.
        y: pixels downward.
        depth: natural logarithm of the depth.
        speed: as a share of the radius.
        step_x: from one step of the line to the next, pixels.
        step_y: likewise downward.
        steps: number of steps, the first at the pixel; 0 for a line that is too short.
        row: middle of the pixel where the line begins, from the top of the frame.
        column: likewise from the left.
        farthest: greatest log depth of the tile.
        first_x: velocity of the line that came first in the tile; None in the first round.
        first_y: likewise downward.
    """

    x: Image
    y: Image
    depth: Image
    speed: Image
    step_x: Image
    step_y: Image
    steps: Image
    row: Image
    column: Image
    farthest: Image
    first_x: Image | None
    first_y: Image | None


def compare_pixels(at: At, images: MotionImage, _: None, radius: int) -> Outcome:
    """Pass L2, the keys of a tile's maxima: squared speed (clamped vectors tie), and depth."""
    x, y, depth, _taken = images.motion.here()
    return Outcome((_at_most(radius**2, jnp.square(x) + jnp.square(y)), depth))


def _at_most(most: int, value: jax.Array) -> jax.Array:
    """The value, and `most` from a little below it on: so clamped vectors tie, rounded or not."""
    return jnp.where(value > most * (1 - 1e-5), jnp.asarray(most, value.dtype), value)


def draw_lines(at: At, images: Lines, _: None, radius: int) -> Outcome:
    """Pass L3: a line leaves its score in the tiles under its four corners, both ways.

    A mark holds the score and how far up and to the left the line begins, so that of equal ones the
    first line leaves the largest; 0 means none. Corners are as wide apart as a tile.

    The first round scores the speed, and lines in front of everything in the tile first. The second
    scores the difference to the tile's first line, ``min(||u||, ||u - v||)``, and lines in front
    first.
    """
    size, reach = fine_tile(radius), _reach(radius)
    span, levels = 2 * reach + 1, _levels(radius)
    rows, columns = images.x.height, images.x.width
    (x,), (y,), (depth,), (speed,) = (
        image.here() for image in (images.x, images.y, images.depth, images.speed)
    )
    (step_x,), (step_y,), (steps,) = (
        image.here() for image in (images.step_x, images.step_y, images.steps)
    )
    (line_row,), (line_column,) = images.row.here(), images.column.here()
    half = size / 2 - _INSET

    def score(tile: Array) -> Array:
        in_front = images.farthest.read_texel(tile)[0] - depth > IN_FRONT
        if images.first_x is None or images.first_y is None:
            return speed + jnp.where(in_front, 1, 0)
        (first_x,), (first_y,) = images.first_x.read_texel(tile), images.first_y.read_texel(tile)
        apart = safe_norm(x - first_x, y - first_y)
        share = jnp.minimum(speed, apart / radius)
        share = jnp.where(in_front, share, share / BEHIND)
        return jnp.where(apart > ALIKE, share, -1)

    def mark(k: Int[Array, ""]) -> tuple[tuple[Array, Array], ...]:
        step = k.astype(x.dtype)
        from_own = (reach - at.row) * span + (reach - at.column) + 1

        # Traced once, for eight uses.
        @jax.jit
        def in_tile(row: Array, column: Array) -> tuple[Array, Array]:
            inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
            tile = jnp.where(inside, row * columns + column, 0).astype(jnp.int32)
            level = jnp.floor(score(tile) * levels).astype(jnp.int32)
            place = (row * span + column).astype(jnp.int32) + from_own
            counts = inside & (step < steps) & (level >= 0)
            return tile, jnp.where(counts, level * span**2 + place, 0)

        marks = []
        for way in (step, -step):
            across, down = way * step_x, way * step_y
            columns_there, rows_there = (
                [jnp.floor((place + side * half + moved) / size) for side in (-1, 1)]
                for place, moved in ((line_column, across), (line_row, down))
            )
            pairs = itertools.product(rows_there, columns_there)
            marks += [in_tile(row, column) for row, column in pairs]
        return tuple(marks)

    return Outcome(mark_over(steps, mark), where=steps > 0)


def fine_tile(radius: int) -> int:
    """Side of the fine tiles: the divisor of the radius nearest to 8 pixels, else 8.

    A divisor, so that statements about frames whose sides are multiples of the radius hold here.

    Args:
        radius: longest half-spread in pixels.

    Returns:
        Pixels.
    """
    if radius <= USUAL_TILE:
        return radius
    sizes = [size for size in range(5, 13) if radius % size == 0]
    return min(sizes, key=lambda size: abs(size - USUAL_TILE), default=USUAL_TILE)


def _reach(radius: int) -> int:
    """Tiles between a line's own and the farthest that it crosses, up, down, or aside, at most."""
    return -(-radius // fine_tile(radius)) + 1


def _levels(radius: int) -> int:
    """Steps of a score from 0 to 1: 31 bits hold a score from 0 to 2 and the line's place."""
    places = (2 * _reach(radius) + 1) ** 2
    return min(_LEVELS * radius, (2**31 - 1) // places // 2 - 1)


def reaching_pixels(
    motion: Float[Array, "height width 4"], radius: int, backend: Backend
) -> Int[Array, "2 rows columns"]:
    """The two pixels whose motions matter most in each tile of a fine grid.

    Each tile's fastest pixel q, with velocity v, draws the line ``q - v .. q + v``. Of the lines
    that cross a tile the first is the fastest of those in front of the farthest point in the tile,
    or the fastest of all if none is in front. The second is that of the u with the largest
    ``min(||u||, ||u - v||)``, a twentieth of it counting where u is not in front.

    Args:
        motion: (H, W, 4), see `.silhouettes.Motion`.
        radius: longest half-spread in pixels, on which the side of a tile depends (`fine_tile`).
        backend: see `jaxblur.Settings`.

    Returns:
        Row-major indices into the image, -1 where there is no such line.
    """
    motion = lax.stop_gradient(motion)
    size = motion.shape[0], motion.shape[1]
    found = largest_in_tiles(
        *(compare_pixels, size, fine_tile(radius), MotionImage(Image(motion)), None, radius),
        backend=backend,
    )
    pixel = _pixel_of(found[..., 0], motion.shape[1], radius)
    lines = _lines(pixel, motion, found[..., 3], radius)
    grid = pixel.shape[0], pixel.shape[1]

    def highest(lines: Lines) -> Int[Array, " tiles"]:
        best = largest_marks(draw_lines, grid, lines, pixel.size, settings=radius, backend=backend)
        return _line_of(best, grid, radius)

    first = highest(lines)
    first_x, first_y = (
        Image(image.values.reshape(-1)[jnp.maximum(first, 0)].reshape(grid))
        for image in (lines.x, lines.y)
    )
    second = highest(lines._replace(first_x=first_x, first_y=first_y))
    chosen = jnp.stack([first, second])
    return jnp.where(chosen >= 0, pixel.reshape(-1)[chosen], -1).reshape(2, *grid)


def _pixel_of(
    number: Float[Array, "rows columns"], width: int, radius: int
) -> Int[Array, "rows columns"]:
    """Row-major index of a pixel in the image from its number in its tile."""
    number, size = number.astype(jnp.int32), fine_tile(radius)
    row, column = (lax.broadcasted_iota(jnp.int32, number.shape, axis) * size for axis in (0, 1))
    return (row + number // size) * width + column + number % size


def _lines(
    pixel: Int[Array, "rows columns"],
    motion: Float[Array, "height width 4"],
    farthest: Float[Array, "rows columns"],
    radius: int,
) -> Lines:
    """The lines of the tiles' fastest pixels, for the first round."""
    x, y, depth = jnp.moveaxis(motion.reshape(-1, motion.shape[-1])[pixel, :3], -1, 0)
    speed = _at_most(radius, safe_norm(x, y))
    # Steps are no longer than a tile; rounding of a speed clamped to a whole number of tiles may
    # not add a step, which would move all of them.
    steps = jnp.maximum(jnp.ceil(speed / fine_tile(radius) - 1e-3), 1)
    row, column = (place.astype(x.dtype) for place in jnp.divmod(pixel, motion.shape[1]))
    return Lines(
        x=Image(x),
        y=Image(y),
        depth=Image(depth),
        speed=Image(speed / radius),
        step_x=Image(x / steps),
        step_y=Image(y / steps),
        steps=Image(jnp.where(speed > SPEED_FLOOR, steps + 1, 0)),
        row=Image(row + 0.5),
        column=Image(column + 0.5),
        farthest=Image(farthest),
        first_x=None,
        first_y=None,
    )


def _line_of(marks: Int[Array, " tiles"], grid: tuple[int, int], radius: int) -> Array:
    """Number of the line that left each mark of `draw_lines`; -1 where there is none."""
    reach = _reach(radius)
    up, left = jnp.divmod((marks - 1) % (2 * reach + 1) ** 2, 2 * reach + 1)
    row, column = jnp.divmod(jnp.arange(marks.size), grid[1])
    line = (row + reach - up) * grid[1] + column + reach - left
    return jnp.where(marks > 0, line, -1)
