"""Which motions reach a tile: lines of fine tiles, instead of the ring of 3 x 3 large ones.

Every fine tile draws its fastest velocity along its own line, over all tiles that the line
crosses. A tile keeps two of those that cross it: the fastest, and the one most unlike that. Lines
are as long as the motion, so that blur may be longer than any tile, and what moves past without
reaching a tile leaves it alone. Which tiles a line crosses, and what it counts for there, hangs on
nothing that is farther away: a part of a frame gives what the frame does.
"""

import functools
import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..gathers import everywhere, gather_samples
from ..safe_math import safe_norm
from ..sampling import read_row
from ..settings import Backend
from ..weights import SPEED_FLOOR

USUAL_TILE = 8
"""Pixels. Six gain less than 0.1 dB on rendered scenes and double the work; twelve lose as much."""

_LARGEST = 7680, 4320
"""Up to this size frames share one scale of unlikeness; of larger ones it is coarser."""

_SPEED_BITS = 16
"""Speeds are ranked in this many bits: of those that differ by less than 0.003 px at a radius of
160 the first pixel counts as the fastest."""

IN_FRONT = 0.05
"""Log depth from which on a line counts as in front of what it crosses."""

ALIKE = 1.0
"""Pixels by which two velocities must differ to count as two."""

BEHIND = 20
"""What is in front goes first unless something else is this much more unlike the first choice."""

_INSET = 0.25
"""Pixels by which a line is narrower than a tile, so that mirrored frames round alike."""


def fine_tile(radius: int) -> int:
    """Side of the fine tiles: the divisor of the radius nearest to 8 pixels, else 8.

    A divisor, so that what holds for frames whose sides are multiples of the radius holds here.

    Args:
        radius: longest half-spread in pixels.

    Returns:
        Pixels.
    """
    if radius <= USUAL_TILE:
        return radius
    sizes = [size for size in range(5, 13) if radius % size == 0]
    return min(sizes, key=lambda size: abs(size - USUAL_TILE), default=USUAL_TILE)


def reaching_pixels(
    motion: Float[Array, "height width 4"], radius: int, backend: Backend
) -> Int[Array, "2 rows columns"]:
    """The two pixels whose motions matter most in each tile of a fine grid.

    Each tile's fastest pixel q, with velocity v, draws the line ``q - v .. q + v``. Of the lines
    that cross a tile the first is the fastest of those in front of the farthest point in the tile,
    or the fastest of all if none is in front. The second is that of the u with the largest
    ``min(||u||, ||u - v||)``, a twentieth of it counting where u is not in front.

    Args:
        motion: half-spread in pixels, to the right and downward; the natural logarithm of the
            depth; and what else belongs to a motion.
        radius: longest half-spread in pixels, which tells the side of a tile (`fine_tile`).
        backend: see `jaxblur.Settings`.

    Returns:
        Row-major indices into the image, -1 where there is no such line.
    """
    motion = lax.stop_gradient(motion)
    winner, farthest = _fastest_and_farthest(motion, radius, backend)
    rows, columns = winner.shape
    pixel = winner.reshape(-1)
    lines = _Lines(pixel, motion, (rows, columns), radius)
    in_front = functools.partial(lines.in_front, farthest)
    first = lines.highest(lambda tile: jnp.where(in_front(tile), 1, 0))
    unlikeness = lines.unlikeness_to(first)
    second = lines.highest(lambda tile: unlikeness(tile, jnp.where(in_front(tile), 1, 1 / BEHIND)))
    chosen = jnp.stack([first, second])
    return jnp.where(chosen >= 0, pixel[chosen], -1).reshape(2, rows, columns)


def _at_most(most: int, value: jax.Array) -> jax.Array:
    """The value, and `most` from a little below it on: so clamped vectors tie, rounded or not."""
    return jnp.where(value > most * (1 - 1e-5), jnp.asarray(most, value.dtype), value)


def _fastest_and_farthest(
    motion: Float[Array, "height width 4"], radius: int, backend: Backend
) -> tuple[Int[Array, "rows columns"], Float[Array, " tiles"]]:
    """Of each tile the fastest pixel, the first of equal ones, and the greatest log depth."""
    (height, width, _), size = motion.shape, fine_tile(radius)
    grid = -(-height // size), -(-width // size)
    stages = everywhere(functools.partial(_compare_pixels, (height, width), radius))
    nothing = jnp.zeros((*grid, 1), motion.dtype)
    tables = {"motion": motion.reshape(-1)}
    found = gather_samples(stages, 0, nothing, {"nothing": nothing}, tables, backend)
    number, farthest = found[..., 0].astype(jnp.int32), found[..., 1]
    row, column = (lax.broadcasted_iota(jnp.int32, grid, axis) * size for axis in (0, 1))
    pixel = (row + number // size) * width + column + number % size
    return pixel, farthest.reshape(-1)


def _compare_pixels(image, radius, local, tables, _):
    """Number of the fastest pixel of a tile, row by row, and the greatest log depth."""
    (height, width), size, grid = image, fine_tile(radius), local["nothing"].shape
    rows, columns = (
        [jnp.minimum(first * size + k, length - 1) for k in range(size)]
        for first, length in (
            (lax.broadcasted_iota(jnp.int32, grid, 0), height),
            (lax.broadcasted_iota(jnp.int32, grid, 1), width),
        )
    )
    fastest = jnp.full_like(local["nothing"], -1)
    number, farthest = jnp.zeros_like(fastest), jnp.full_like(fastest, -jnp.inf)
    # Beyond the edge the last pixels come again, which changes nothing.
    for k, (row, column) in enumerate(itertools.product(rows, columns)):
        x, y, depth = read_row(tables["motion"], row * width + column, 4, 3)
        speed = _at_most(radius**2, jnp.square(x) + jnp.square(y))
        number = jnp.where(speed > fastest, float(k), number)
        fastest = jnp.where(speed > fastest, speed, fastest)
        farthest = jnp.where(depth > farthest, depth, farthest)
    return [number, farthest]


def _levels(size: int, count: int) -> int:
    """Steps to which unlikeness up to the radius is rounded: with the ranks, 31 bits hold them."""
    width, height = _LARGEST
    usual = -(-width // size) * -(-height // size)
    return (2**31 - 1) // max(usual, count) - 1


def _slowest_first(speed: jax.Array, radius: int) -> Int[Array, " lines"]:
    """Numbers of the lines in the order of their speeds; of equal ones the last line is first.

    By sorts of whole numbers, a digit of the speed and the place in each: XLA sorts one array of
    whole numbers four times as fast as it finds the order of another.
    """
    count = speed.size
    place_bits = max(count - 1, 1).bit_length()
    digit_bits = 31 - place_bits
    levels = jnp.round(speed / radius * (2**_SPEED_BITS - 1)).astype(jnp.int32)
    places = jnp.arange(count, dtype=jnp.int32)
    order = places[::-1]
    for lowest in range(0, _SPEED_BITS, digit_bits):
        digit = (levels[order] >> lowest) & (2**digit_bits - 1)
        keys = lax.sort((digit << place_bits) | places, is_stable=False)
        order = order[keys & (2**place_bits - 1)]
    return order


class _Lines:
    """The lines that the tiles' fastest pixels draw over the grid.

    What belongs to a line is there four times over, (4 T,), for the corners of its width: one
    array for all is quicker than four.
    """

    def __init__(
        self,
        pixel: Int[Array, " tiles"],
        motion: Float[Array, "height width 4"],
        grid: tuple[int, int],
        radius: int,
    ) -> None:
        self._rows, self._columns = grid
        self._size, self._radius, self._count = fine_tile(radius), radius, len(pixel)
        width = motion.shape[1]
        x, y, depth = motion.reshape(-1, motion.shape[-1])[pixel, :3].T
        clamped = _at_most(radius, safe_norm(x, y))
        self._levels = _levels(self._size, self._count)
        self._by_rank = _slowest_first(clamped, radius)
        ranks = jnp.arange(self._count, dtype=jnp.int32)
        ranks = jnp.zeros_like(ranks).at[self._by_rank].set(ranks)
        # No farther apart than a tile; rounding of a speed clamped to a whole number of tiles may
        # not add a step, which would move all of them.
        steps = jnp.maximum(jnp.ceil(clamped / self._size - 1e-3), 1)
        half = self._size / 2 - _INSET
        right, down = (jnp.asarray(side, x.dtype) for side in ((-1, 1, -1, 1), (-1, -1, 1, 1)))

        def at_corners(start, side):
            return (side[:, None] * half + (start + 0.5)).reshape(-1)

        self._start_x, self._start_y = (
            at_corners(pixel % width, right),
            at_corners(pixel // width, down),
        )
        planes = (x, y, depth, clamped, steps, ranks)
        self._x, self._y, self._depth, self._speed, self._steps, self._rank = (
            jnp.tile(plane, 4) for plane in planes
        )

    def in_front(self, depth, tile):
        """Whether each line is in front of the depth at the tiles of its corners."""
        return depth[tile] - self._depth > IN_FRONT

    def unlikeness_to(self, first):
        """What each line shows that the tiles' first do not: levels times a factor, -1 if alike."""
        first_x, first_y = self._x[jnp.maximum(first, 0)], self._y[jnp.maximum(first, 0)]
        scale = self._levels / self._radius

        def level(tile, factor):
            apart = safe_norm(self._x - first_x[tile], self._y - first_y[tile])
            share = jnp.minimum(jnp.minimum(self._speed, apart), self._radius)
            share = jnp.floor(share * factor * scale).astype(jnp.int32)
            return jnp.where(apart > ALIKE, share, -1)

        return level

    def highest(self, level: Callable[[Array], Array]) -> Int[Array, " tiles"]:
        """Number of the line of the highest level of those that cross each tile, -1 for none.

        Args:
            level: maps tiles (K, 4 T), K for each corner, to the levels of the lines there, whole
                numbers; lines below 0 do not count, and of one level the fastest does.

        Returns:
            (T,).
        """
        counts = self._speed > SPEED_FLOOR
        most = jnp.max(self._steps).astype(jnp.int32)

        def add_steps(step, best):
            # Both ways from the pixel at once: half as many rounds, each of which has its price.
            tile, inside = self._crossed(jnp.stack([step, -step])[:, None])
            key = level(tile) * self._count + self._rank
            on_line = inside & counts & (step <= self._steps)
            return best.at[tile].max(jnp.where(on_line, key, -1))

        none = jnp.full(self._count, -1, jnp.int32)
        best = lax.fori_loop(0, most + 1, add_steps, none)
        return jnp.where(best >= 0, self._by_rank[best % self._count], -1)

    def _crossed(self, step):
        """The tiles under each line's corners at steps of its own, and whether in the grid."""
        row = jnp.floor((self._start_y + step * (self._y / self._steps)) / self._size)
        column = jnp.floor((self._start_x + step * (self._x / self._steps)) / self._size)
        inside = (row >= 0) & (row < self._rows) & (column >= 0) & (column < self._columns)
        tile = jnp.where(inside, row * self._columns + column, 0)
        return tile.astype(jnp.int32), inside
