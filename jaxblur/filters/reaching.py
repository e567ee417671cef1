"""Which motions reach a tile: lines of fine tiles, instead of the ring of 3 x 3 large ones.

Every fine tile draws its fastest velocity along its own line, over all tiles that the line
crosses. A tile keeps two of those that cross it: the fastest, and the one most unlike that. Lines
are as long as the motion, so that blur may be longer than any tile, and what moves past without
reaching a tile leaves it alone.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..safe_math import safe_norm
from ..tiles import tile_argmax

USUAL_TILE = 8
"""Pixels. Six gain less than 0.1 dB on rendered scenes and double the work; twelve lose as much."""

SLOWEST = 0.5
"""Pixels of half-spread; slower points are as sharp as a pixel can show."""

_LEVELS = 1023
"""Steps to which unlikeness is rounded: with 8K frames it still leaves room for the ranks."""

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


def reaching_velocities(
    x: Float[Array, "height width"],
    y: Float[Array, "height width"],
    speed: Float[Array, "height width"],
    size: int,
) -> Float[Array, "2 rows columns 2"]:
    """The two velocities that matter most in each tile of a fine grid.

    First the fastest v of those whose line ``q - v .. q + v`` crosses the tile, q being the
    fastest pixel of its own tile; then, of the others, the u with the largest
    ``min(||u||, ||u - v||)``.

    Args:
        x: half-spread in pixels to the right.
        y: half-spread in pixels downward.
        speed: its norm.
        size: side of a tile in pixels.

    Returns:
        Velocities in pixels, 0 where there is none. Differentiable: the derivative is that of the
        pixels chosen.
    """
    winner = tile_argmax(speed, size)
    flat = winner.reshape(-1)
    vectors = jnp.stack([x.reshape(-1)[flat], y.reshape(-1)[flat]], axis=-1)
    rows, columns = winner.shape
    lines = _Lines(flat, lax.stop_gradient(vectors), (rows, columns), speed.shape[1], size)
    first = lines.highest(lambda _: lines.rank)
    second = lines.highest(lambda tile: lines.unlikeness(first[tile]))
    # Row 0 stands for "none".
    vectors = jnp.concatenate([jnp.zeros((1, 2), vectors.dtype), vectors])
    return vectors[jnp.stack([first, second]) + 1].reshape(2, rows, columns, 2)


class _Lines:
    """The lines that the tiles' fastest pixels draw over the grid.

    Attributes:
        rank: of each line by speed, from 1; unique, so that a rank names its line.
    """

    def __init__(
        self,
        pixel: Int[Array, " tiles"],
        velocity: Float[Array, "tiles 2"],
        grid: tuple[int, int],
        width: int,
        size: int,
    ) -> None:
        self._rows, self._columns = grid
        self._size = size
        self._x, self._y = velocity[:, 0], velocity[:, 1]
        self._start_x, self._start_y = pixel % width + 0.5, pixel // width + 0.5
        self._speed = safe_norm(self._x, self._y)
        # Only as many steps as the longest line needs, whatever the radius.
        self._steps = jnp.ceil(jnp.max(self._speed) / size).astype(jnp.int32)
        self._by_rank = jnp.argsort(self._speed, stable=True, descending=True)[::-1]
        count = len(pixel)
        self.rank = jnp.zeros(count, jnp.int32).at[self._by_rank].set(jnp.arange(1, count + 1))

    def unlikeness(self, first: Int[Array, " tiles"]) -> Int[Array, " tiles"]:
        """Key of each line where another one is known: what the other does not show, then speed."""
        other = jnp.maximum(first, 0)
        apart = safe_norm(self._x - self._x[other], self._y - self._y[other])
        share = jnp.minimum(self._speed, apart) / jnp.maximum(jnp.max(self._speed), SLOWEST)
        level = jnp.floor(jnp.clip(share, 0, 1) * _LEVELS).astype(jnp.int32)
        return jnp.where(apart > SLOWEST, level * (len(other) + 1) + self.rank, 0)

    def highest(self, key: Callable[[Array], Array]) -> Int[Array, " tiles"]:
        """Number of the line with the highest key of those that cross each tile, -1 for none.

        Args:
            key: maps tiles (T,), one for each line, to keys (T,), 0 for lines that do not count;
                the rank is their remainder modulo T + 1.

        Returns:
            (T,).
        """
        count = len(self.rank)
        counts = self._speed > SLOWEST

        def add_step(step, best):
            for tile, inside in self._crossed(step - self._steps):
                best = best.at[tile].max(jnp.where(inside & counts, key(tile), 0))
            return best

        best = lax.fori_loop(0, 2 * self._steps + 1, add_step, jnp.zeros(count, jnp.int32))
        rank = best % (count + 1)
        return jnp.where(best > 0, self._by_rank[jnp.maximum(rank - 1, 0)], -1)

    def _crossed(self, step):
        """The four tiles under each line's width at one step of it, and whether in the grid."""
        position = step / jnp.maximum(self._steps, 1)
        half = self._size / 2 - _INSET
        for down in (-half, half):
            row = jnp.floor((self._start_y + position * self._y + down) / self._size)
            for right in (-half, half):
                column = jnp.floor((self._start_x + position * self._x + right) / self._size)
                inside = (row >= 0) & (row < self._rows) & (column >= 0) & (column < self._columns)
                tile = jnp.where(inside, row * self._columns + column, 0)
                yield tile.astype(jnp.int32), inside
