"""Which motions reach a tile: lines of fine tiles, instead of the ring of 3 x 3 large ones.

Every fine tile draws its fastest velocity along its own line, over all tiles that the line
crosses. A tile keeps two of those that cross it: the fastest, and the one most unlike that. Lines
are as long as the motion, so that blur may be longer than any tile, and what moves past without
reaching a tile leaves it alone. Which tiles a line crosses, and what it counts for there, hangs on
nothing that is farther away: a part of a frame gives what the frame does.
"""

import functools
import itertools

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..gathers import everywhere, gather_samples
from ..marks import largest_marks
from ..safe_math import safe_norm
from ..sampling import read_nearest, read_row
from ..settings import Backend
from ..weights import SPEED_FLOOR

USUAL_TILE = 8
"""Pixels. Six gain less than 0.1 dB on rendered scenes and double the work; twelve lose as much."""

_LEVELS = 256
"""Steps of a score to the pixel, if the radius leaves bits for so many: up to 400 it does, and at
1000 steps are a sixteenth of a pixel. Of lines within a step the first counts as the fastest."""

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
    pixel, farthest = _fastest_and_farthest(motion, radius, backend)
    lines = _lines(pixel, motion, radius)

    def highest(score, tables):
        marks = functools.partial(_marks, score, pixel.shape, radius)
        best = largest_marks(marks, _steps, lines, tables, pixel.size, backend)
        return _line_of(best, pixel.shape, radius)

    tables = {"farthest": farthest}
    first = highest(_score_first, tables)
    for axis in ("x", "y"):
        tables[f"first_{axis}"] = lines[axis].reshape(-1)[jnp.maximum(first, 0)]
    chosen = jnp.stack([first, highest(functools.partial(_score_second, radius), tables)])
    return jnp.where(chosen >= 0, pixel.reshape(-1)[chosen], -1).reshape(2, *pixel.shape)


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
    (height, width), size, nothing = image, fine_tile(radius), local["nothing"]
    top, left = (lax.broadcasted_iota(jnp.int32, nothing.shape, axis) * size for axis in (0, 1))

    # Beyond the edge the last pixels come again, which changes nothing.
    def compare_row(k, best):
        start = jnp.minimum(top + k, height - 1) * width

        def compare(j, best):
            fastest, number, farthest = best
            index = start + jnp.minimum(left + j, width - 1)
            x, y, depth = read_row(tables["motion"], index, 4, 3)
            speed = _at_most(radius**2, jnp.square(x) + jnp.square(y))
            number = jnp.where(speed > fastest, jnp.asarray(k * size + j, number.dtype), number)
            fastest = jnp.where(speed > fastest, speed, fastest)
            return fastest, number, jnp.where(depth > farthest, depth, farthest)

        return lax.fori_loop(0, size, compare, best)

    best = lax.fori_loop(0, size, compare_row, (nothing - 1, nothing, nothing - jnp.inf))
    return list(best[1:])


def _reach(radius: int) -> int:
    """Tiles between a line's own and the farthest that it crosses, up, down, or aside, at most."""
    return -(-radius // fine_tile(radius)) + 1


def _levels(radius: int) -> int:
    """Steps of a score from 0 to 1: 31 bits hold a step from 0 to 2 and where the line is from."""
    places = (2 * _reach(radius) + 1) ** 2
    return min(_LEVELS * radius, (2**31 - 1) // places // 2 - 1)


def _lines(pixel, motion, radius):
    """What belongs to the lines of the tiles' fastest pixels: (rows, columns, 1) planes."""
    x, y, depth = jnp.moveaxis(motion.reshape(-1, motion.shape[-1])[pixel, :3], -1, 0)
    speed = _at_most(radius, safe_norm(x, y))
    # No farther apart than a tile; rounding of a speed clamped to a whole number of tiles may not
    # add a step, which would move all of them.
    steps = jnp.maximum(jnp.ceil(speed / fine_tile(radius) - 1e-3), 1)
    row, column = (place.astype(x.dtype) for place in jnp.divmod(pixel, motion.shape[1]))
    planes = {
        "x": x,
        "y": y,
        "depth": depth,
        "speed": speed / radius,
        "step_x": x / steps,
        "step_y": y / steps,
        "steps": jnp.where(speed > SPEED_FLOOR, steps + 1, 0),
        "row": row + 0.5,
        "column": column + 0.5,
    }
    return {name: plane[..., None] for name, plane in planes.items()}


def _steps(lines):
    """How many steps each line takes, the first at its pixel."""
    return lines["steps"]


def _is_in_front(line, tables, tile):
    """Whether a line is in front of all that is in a tile."""
    return read_nearest(tables["farthest"], tile) - line["depth"] > IN_FRONT


def _score_first(line, tables, tile):
    """The speed as a share of the radius; what is in front goes first."""
    return line["speed"] + jnp.where(_is_in_front(line, tables, tile), 1, 0)


def _score_second(radius, line, tables, tile):
    """What a line shows that the tile's first does not, as a share of the radius."""
    apart = safe_norm(
        line["x"] - read_nearest(tables["first_x"], tile),
        line["y"] - read_nearest(tables["first_y"], tile),
    )
    share = jnp.minimum(line["speed"], apart / radius)
    share = jnp.where(_is_in_front(line, tables, tile), share, share / BEHIND)
    return jnp.where(apart > ALIKE, share, -1)


def _marks(score, grid, radius, step, line, tables):
    """The tiles under a line's four corners, both ways, and the marks that it leaves there.

    A mark tells the score and how far up and to the left the line is from, so that of equal ones
    the first line leaves the largest; 0 stands for none. Corners are as wide apart as a tile.
    """
    (rows, columns), size, reach = grid, fine_tile(radius), _reach(radius)
    span, levels = 2 * reach + 1, _levels(radius)
    step = step.astype(line["x"].dtype)
    own_row, own_column = (lax.broadcasted_iota(jnp.int32, (*grid, 1), axis) for axis in (0, 1))
    from_own = (reach - own_row) * span + (reach - own_column) + 1
    half = size / 2 - _INSET

    # Traced once, for eight uses.
    @jax.jit
    def mark(row, column, line, tables):
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        tile = jnp.where(inside, row * columns + column, 0).astype(jnp.int32)
        level = jnp.floor(score(line, tables, tile) * levels).astype(jnp.int32)
        place = (row * span + column).astype(jnp.int32) + from_own
        counts = inside & (step < line["steps"]) & (level >= 0)
        return tile, jnp.where(counts, level * span**2 + place, 0)

    marks = []
    for way in (step, -step):
        across, down = way * line["step_x"], way * line["step_y"]
        columns_there, rows_there = (
            [jnp.floor((line[name] + side * half + moved) / size) for side in (-1, 1)]
            for name, moved in (("column", across), ("row", down))
        )
        pairs = itertools.product(rows_there, columns_there)
        marks += [mark(row, column, line, tables) for row, column in pairs]
    return tuple(marks)


def _line_of(marks: Int[Array, " tiles"], grid: tuple[int, ...], radius: int) -> Array:
    """Number of the line that left each mark of `_marks`; -1 where there is none."""
    reach = _reach(radius)
    up, left = jnp.divmod((marks - 1) % (2 * reach + 1) ** 2, 2 * reach + 1)
    row, column = jnp.divmod(jnp.arange(marks.size), grid[1])
    line = (row + reach - up) * grid[1] + column + reach - left
    return jnp.where(marks > 0, line, -1)
