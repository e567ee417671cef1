"""Tiles: the dominant velocity of a neighborhood (passes 2, 3, 12), and the tile of a pixel (4).

Maxima find the place of the longest vector, and the vector is read there afterwards, so that a
maximum differentiates: its derivative is that of the vector that won. At a tie the first vector
wins and takes the whole derivative.
"""

import functools
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from ..kernels import At, Image, Outcome, each_pixel, largest_in_tiles, sum_over
from ..safe_math import safe_divide, safe_norm, safe_normalize, shortening

Diagonal = Literal["reaching", "all"]

RING = ((0, 0), (-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1))
"""Offsets (x, y) of the 3 x 3 ring: center first, then row-major, which is the order of ties."""


class Velocity(NamedTuple):
    """The velocities of pixels."""

    velocity: Image


class Found(NamedTuple):
    """The velocities of pixels, and where each tile's fastest pixel is."""

    velocity: Image
    fastest: Image


class Tiles(NamedTuple):
    """The velocities of tiles: x, y and the speed that counts."""

    tiles: Image


def clamped_speed(at: At, images: Velocity, _: None, radius: int) -> Outcome:
    """Pass 2, the key of the maximum: ``min(||v||, r)``, so that all clamped vectors tie."""
    return Outcome((jnp.minimum(safe_norm(*images.velocity.here()), radius),))


def tile_velocity(at: At, images: Found, _: None, radius: int) -> Outcome:
    """Pass 2: the velocity of a tile's fastest pixel, clamped to the radius, and its speed."""
    number = images.fastest.here()[0].astype(jnp.int32)
    row, column = at.row * radius + number // radius, at.column * radius + number % radius
    x, y = images.velocity.read_inside(row, column)
    speed = safe_norm(x, y)
    shorter = shortening(speed, radius)
    return Outcome((x * shorter, y * shorter, jnp.minimum(speed, radius)))


def ring_velocity(at: At, images: Tiles, _: None, diagonal: Diagonal) -> Outcome:
    """Pass 3: the fastest velocity of the ring; a diagonal tile counts if it reaches the center."""
    best_row, best_column, best = at.row, at.column, None
    for ox, oy in RING:
        row, column = at.row + oy, at.column + ox
        inside = (row >= 0) & (row < images.tiles.height)
        inside = inside & (column >= 0) & (column < images.tiles.width)
        row, column = jnp.where(inside, row, at.row), jnp.where(inside, column, at.column)
        x, y, speed = (lax.stop_gradient(part) for part in images.tiles.read_inside(row, column))
        if best is None:
            best = speed
            continue
        counts = inside
        if ox * oy and diagonal == "reaching":
            # The product of signs, since that of small components underflows.
            counts = inside & (jnp.sign(x) * jnp.sign(y) * (ox * oy) > 0)
        larger = counts & (speed > best)
        best = jnp.where(larger, speed, best)
        best_row = jnp.where(larger, row, best_row)
        best_column = jnp.where(larger, column, best_column)
    return Outcome(images.tiles.read_inside(best_row, best_column, 2))


class Soft(NamedTuple):
    """The static part of smooth maxima.

    Attributes:
        radius: tile size in pixels.
        temperature: T in pixels, > 0.
        diagonal: see `neighbor_max`.
    """

    radius: int
    temperature: float
    diagonal: Diagonal


class Winners(NamedTuple):
    """The velocities of pixels, and the velocity and speed of the fastest one of each tile."""

    velocity: Image
    fastest: Image


class SoftSums(NamedTuple):
    """Sums of a smooth maximum."""

    x: Array
    y: Array
    weight: Array


def soft_tile_velocity(at: At, images: Winners, _: None, soft: Soft) -> Outcome:
    """Pass 2, smooth: ``sum_p w_p v_p / sum_p w_p``, ``w_p = exp((||v_p|| - max) / T)``.

    Vectors that point against the fastest one are reversed first: v and -v are the same blur.
    """
    top_x, top_y, top = (lax.stop_gradient(part) for part in images.fastest.here())

    def pixel(i: Int[Array, ""]) -> SoftSums:
        row = at.row * soft.radius + lax.div(i, jnp.int32(soft.radius))
        column = at.column * soft.radius + lax.rem(i, jnp.int32(soft.radius))
        inside = (row < images.velocity.height) & (column < images.velocity.width)
        x, y = images.velocity.read_inside(jnp.where(inside, row, 0), jnp.where(inside, column, 0))
        speed = safe_norm(x, y)
        shorter = shortening(speed, soft.radius)
        weight = jnp.exp((jnp.minimum(speed, soft.radius) - top) / soft.temperature)
        weight = jnp.where(inside, weight, 0)
        signed = weight * shorter * jnp.where(x * top_x + y * top_y < 0, -1, 1)
        return SoftSums(signed * x, signed * y, weight)

    sums = sum_over(soft.radius * soft.radius, pixel)
    x, y = sums.x / sums.weight, sums.y / sums.weight
    return Outcome((x, y, safe_norm(x, y)))


def soft_ring_velocity(at: At, images: Tiles, _: None, soft: Soft) -> Outcome:
    """Pass 3, smooth: the same mean over the tiles of the ring that count in `ring_velocity`."""
    found = []
    for ox, oy in RING:
        row, column = at.row + oy, at.column + ox
        inside = (row >= 0) & (row < images.tiles.height)
        inside = inside & (column >= 0) & (column < images.tiles.width)
        place = jnp.where(inside, row, at.row), jnp.where(inside, column, at.column)
        x, y, speed = images.tiles.read_inside(*place)
        if ox * oy and soft.diagonal == "reaching":
            inside = inside & (jnp.sign(x) * jnp.sign(y) * (ox * oy) > 0)
        found.append((x, y, speed, inside))
    top_x, top_y, top, _inside = found[0]
    for x, y, speed, inside in found[1:]:
        larger = inside & (speed > top)
        top_x, top_y = jnp.where(larger, x, top_x), jnp.where(larger, y, top_y)
        top = jnp.where(larger, speed, top)
    top_x, top_y, top = (lax.stop_gradient(part) for part in (top_x, top_y, top))
    sum_x = sum_y = total = jnp.zeros_like(top)
    for x, y, speed, inside in found:
        weight = jnp.exp(jnp.where(inside, speed - top, 0) / soft.temperature)
        weight = jnp.where(inside, weight, 0)
        signed = weight * jnp.where(x * top_x + y * top_y < 0, -1, 1)
        sum_x, sum_y, total = sum_x + signed * x, sum_y + signed * y, total + weight
    return Outcome((sum_x / total, sum_y / total))


def ring_variance(at: At, images: Tiles, _: None, __: None) -> Outcome:
    """Pass 12: ``1 - mean |w(t) . w(u)|`` over the ring, eq. 3.2."""
    own_x, own_y = safe_normalize(*images.tiles.here())
    still = (own_x == 0) & (own_y == 0)
    aligned = count = jnp.zeros_like(own_x)
    for ox, oy in RING:
        row, column = at.row + oy, at.column + ox
        inside = (row >= 0) & (row < images.tiles.height)
        inside = inside & (column >= 0) & (column < images.tiles.width)
        row, column = jnp.where(inside, row, at.row), jnp.where(inside, column, at.column)
        x, y = safe_normalize(*images.tiles.read_inside(row, column))
        dot = jnp.abs(own_x * x + own_y * y)
        dot = jnp.where(still | ((x == 0) & (y == 0)), 1, dot)
        aligned = aligned + jnp.where(inside, dot, 0)
        count = count + inside.astype(dot.dtype)
    return Outcome((1 - aligned / count,))


def _vectors(name: str, vectors: ArrayLike) -> jax.Array:
    """The argument as an array of 2-D vectors on a grid, its shape checked."""
    vectors = jnp.asarray(vectors)
    if vectors.ndim != 3 or vectors.shape[-1] != 2:
        raise ValueError(f"`{name}` must have shape (rows, columns, 2), got {vectors.shape}.")
    return vectors


def tile_max(velocity: ArrayLike, radius: int) -> Float[Array, "tile_rows tile_columns 2"]:
    """The velocity of largest norm in each tile, "TileMax".

    ``TileMax[t] = vmax_{p in tile t} V[p]``

    Source: McGuire et al. 2012, eq. 1. Differentiable in velocity: the winner's derivative.

    Args:
        velocity: (H, W, 2) half-spread in pixels.
        radius: tile size in pixels.

    Returns:
        (ceil(H / r), ceil(W / r), 2) half-spread in pixels.

    Raises:
        ValueError: the velocity has another shape, or the radius is below 1.
    """
    velocity = _vectors("velocity", velocity)
    if radius < 1:
        raise ValueError(f"`radius` must be at least 1, got {radius}.")
    return _tile_max(velocity, radius=radius)


@functools.partial(jax.jit, static_argnames=("radius",))
def _tile_max(velocity: jax.Array, radius: int) -> jax.Array:
    fastest = fastest_pixels(velocity, radius)
    return velocity[fastest[..., 0], fastest[..., 1]]


def fastest_pixels(velocity: ArrayLike, radius: int) -> Int[Array, "tile_rows tile_columns 2"]:
    """Row and column of the fastest pixel of each tile, of equal ones the first.

    Args:
        velocity: (H, W, 2) half-spread in pixels.
        radius: tile size in pixels.

    Returns:
        (ceil(H / r), ceil(W / r), 2).
    """
    velocity = _vectors("velocity", velocity)
    size = velocity.shape[0], velocity.shape[1]
    found = largest_in_tiles(speed_of, size, radius, Velocity(Image(velocity)), backend="xla")
    number = found[..., 0].astype(jnp.int32)
    row, column = (lax.broadcasted_iota(jnp.int32, number.shape, axis) for axis in (0, 1))
    place = row * radius + number // radius, column * radius + number % radius
    return jnp.stack(place, axis=-1)


def speed_of(at: At, images: Velocity, _: None, __: None) -> Outcome:
    """The key of `tile_max`: ``||v||``."""
    return Outcome((safe_norm(*images.velocity.here()),))


def neighbor_max(tiles: ArrayLike, diagonal: str = "reaching") -> Float[Array, "rows columns 2"]:
    """The velocity of largest norm in the 3 x 3 ring of each tile, "NeighborMax".

    ``NeighborMax[t] = vmax_{u in ring of t} TileMax[u]``

    Source: McGuire et al. 2012, eq. 2; the rule for diagonal tiles is Guertin et al. 2014,
    section 3.4.4. Differentiable in the tiles: the winner's derivative.

    Args:
        tiles: (rows, columns, 2) tile maxima in pixels.
        diagonal: ``reaching`` [Guertin 2014] or ``all`` [McGuire 2012].

    Returns:
        (rows, columns, 2) half-spread in pixels.

    Raises:
        ValueError: the tiles have another shape, or ``diagonal`` is unknown.
    """
    tiles = _vectors("tiles", tiles)
    if diagonal not in ("reaching", "all"):
        raise ValueError(f"`diagonal` must be 'reaching' or 'all', got {diagonal!r}.")
    return _neighbor_max(tiles, diagonal=diagonal)


@functools.partial(jax.jit, static_argnames=("diagonal",))
def _neighbor_max(tiles: jax.Array, diagonal: Diagonal) -> jax.Array:
    speed = safe_norm(tiles[..., :1], tiles[..., 1:])
    return _ring(jnp.concatenate([tiles, speed], axis=-1), diagonal)


def _ring(tiles: Float[Array, "rows columns 3"], diagonal: Diagonal) -> Array:
    size = tiles.shape[0], tiles.shape[1]
    return each_pixel(ring_velocity, size, Tiles(Image(tiles)), None, diagonal, backend="xla")


def dominant_velocity(
    velocity: Float[Array, "height width 2"],
    radius: int,
    diagonal: Diagonal,
    temperature: float | None = None,
) -> Float[Array, "tile_rows tile_columns 2"]:
    """Passes 2 and 3: TileMax, then NeighborMax, of velocities clamped to the radius.

    XLA runs these passes on every back end: there are few tiles, and a reduction over windows is
    one of its strengths.

    Args:
        velocity: (H, W, 2) half-spread in pixels.
        radius: tile size in pixels.
        diagonal: see `neighbor_max`.
        temperature: of smooth maxima, pixels; the maxima as published if None.

    Returns:
        (ceil(H / r), ceil(W / r), 2) half-spread in pixels.
    """
    size = velocity.shape[0], velocity.shape[1]
    image = Velocity(Image(velocity))
    fastest = largest_in_tiles(clamped_speed, size, radius, image, None, radius, backend="xla")
    found = Found(image.velocity, Image(fastest))
    grid = fastest.shape[0], fastest.shape[1]
    tiles = each_pixel(tile_velocity, grid, found, None, radius, backend="xla")
    if temperature is None:
        return _ring(tiles, diagonal)
    soft, winners = Soft(radius, temperature, diagonal), Winners(image.velocity, Image(tiles))
    tiles = each_pixel(soft_tile_velocity, grid, winners, None, soft)
    return each_pixel(soft_ring_velocity, grid, Tiles(Image(tiles)), None, soft, backend="xla")


def tile_variance(tiles: ArrayLike) -> Float[Array, "rows columns"]:
    """Angular variance of each tile's velocity within its 3 x 3 ring.

    ``v(t) = 1 - 1/|N| sum_{u in N} |w(t) . w(u)|``, ``w = v / ||v||``, N the ring inside the grid.

    Tiles without motion count as aligned. Differentiable in the tiles.
    Source: Guertin et al. 2014, eq. 3.2.

    Args:
        tiles: (rows, columns, 2) dominant velocities in pixels.

    Returns:
        (rows, columns) in [0, 1]; 0 where all directions agree.

    Raises:
        ValueError: the tiles have another shape.
    """
    return _tile_variance(_vectors("tiles", tiles))


@jax.jit
def _tile_variance(tiles: jax.Array) -> jax.Array:
    size = tiles.shape[0], tiles.shape[1]
    return each_pixel(ring_variance, size, Tiles(Image(tiles)), None, None, backend="xla")[..., 0]


def own_tile(at: At, radius: int) -> tuple[Int[Array, "*shape"], Int[Array, "*shape"]]:
    """Row and column of the tile that a pixel lies in.

    Args:
        at: the pixel.
        radius: tile size in pixels.

    Returns:
        Row and column in the grid of tiles.
    """
    row, column = (jnp.asarray(place, jnp.int32) for place in at)
    return lax.div(row, jnp.full_like(row, radius)), lax.div(column, jnp.full_like(column, radius))


def _local_position(place: Array, radius: int) -> Array:
    """Position inside the tile along one axis, ``u = (x mod r + 0.5) / r``, in (0, 1)."""
    place = jnp.asarray(place, jnp.int32)
    return (lax.rem(place, jnp.full_like(place, radius)) + 0.5) / radius


def _step_out(position: Array) -> Array:
    """-1, 0 or 1: the tile of a position relative to a tile, along one axis."""
    return jnp.where(position < 0, -1, jnp.where(position >= 1, 1, 0))


def drawn_tile(
    at: At,
    noise: tuple[Array, Array],
    tau: float | Array,
    radius: int,
    tiles: Image,
) -> tuple[Int[Array, "*shape"], Int[Array, "*shape"]]:
    """The tile that a pixel reads, drawn with the given noise (pass 4).

    The lookup moves to ``u + tau xi``. If exactly one axis leaves the tile, that neighbor is
    read; if both do, or the neighbor is outside the grid, the own tile is (departure 5).

    Args:
        at: the pixel.
        noise: xi in [-0.5, 0.5), x and y.
        tau: reach of the jitter in tiles, 0 <= tau <= 1; has no derivative here.
        radius: tile size in pixels.
        tiles: an image of tiles; its size counts.

    Returns:
        Row and column in the grid of tiles.
    """
    own_row, own_column = own_tile(at, radius)
    step_x = _step_out(_local_position(at.column, radius) + tau * noise[0])
    step_y = _step_out(_local_position(at.row, radius) + tau * noise[1])
    row, column = own_row + step_y, own_column + step_x
    inside = (row >= 0) & (row < tiles.height) & (column >= 0) & (column < tiles.width)
    leaves = ((step_x == 0) != (step_y == 0)) & inside
    return jnp.where(leaves, row, own_row), jnp.where(leaves, column, own_column)


def _step_to_neighbor(place: Array, count: int | Array, radius: int) -> Array:
    """Step to the nearer neighbor tile along one axis, 0 where the grid ends."""
    step = jnp.where(_local_position(place, radius) < 0.5, -1, 1)
    tile = lax.div(jnp.asarray(place, jnp.int32), jnp.int32(radius)) + step
    return jnp.where((tile >= 0) & (tile < count), step, 0)


def _leaving_chance(place: Array, radius: int, tau: float | Array) -> Array:
    """Chance to read the nearer neighbor along one axis.

    ``w = max(0, 1/2 - d / tau)`` at a distance d (in tiles) from the border; 0 for tau = 0.
    """
    local = _local_position(place, radius)
    distance = jnp.minimum(local, 1 - local)
    return jnp.maximum(0, 0.5 - safe_divide(distance, jnp.broadcast_to(tau, distance.shape), 1.0))


def chosen_tile(
    at: At, choice: Array, radius: int, tiles: Image
) -> tuple[Int[Array, "*shape"], Int[Array, "*shape"]]:
    """One of the tiles that the jitter of `drawn_tile` can reach.

    Args:
        at: the pixel.
        choice: 0 for the own tile, 1 for the neighbor along x, 2 for that along y.
        radius: tile size in pixels.
        tiles: an image of tiles; its size counts.

    Returns:
        Row and column in the grid of tiles; the own ones where there is no such neighbor.
    """
    row, column = own_tile(at, radius)
    step_x = _step_to_neighbor(at.column, tiles.width, radius)
    step_y = _step_to_neighbor(at.row, tiles.height, radius)
    return row + jnp.where(choice == 2, step_y, 0), column + jnp.where(choice == 1, step_x, 0)


def chances_of_tiles(
    at: At, tau: float | Array, radius: int, tiles: Image | tuple[int, int]
) -> tuple[Array, Array, Array]:
    """The probabilities of the choices of `chosen_tile`.

    ``P_x = w_x (1 - w_y)``, ``P_y = w_y (1 - w_x)``, ``P_own = 1 - P_x - P_y`` (departure 5).
    Differentiable in tau; the derivative at ``w = 0`` is half the one-sided one.

    Args:
        at: the pixel.
        tau: reach of the jitter in tiles, 0 <= tau <= 1.
        radius: tile size in pixels.
        tiles: an image of tiles whose size counts, or rows and columns of the grid.

    Returns:
        Probabilities of the own tile, the neighbor along x, and that along y.
    """
    rows, columns = (tiles.height, tiles.width) if isinstance(tiles, Image) else tiles
    chance_x = _leaving_chance(at.column, radius, tau)
    chance_y = _leaving_chance(at.row, radius, tau)
    # "Both leave" reads the own tile even where one of the two neighbors does not exist.
    exists_x = _step_to_neighbor(at.column, columns, radius) != 0
    exists_y = _step_to_neighbor(at.row, rows, radius) != 0
    to_x = jnp.where(exists_x, chance_x * (1 - chance_y), 0)
    to_y = jnp.where(exists_y, chance_y * (1 - chance_x), 0)
    return 1 - to_x - to_y, to_x, to_y


def read_between_tiles(at: At, image: Image, radius: int) -> tuple[Array, ...]:
    """Bilinear lookup of values of tiles at a pixel; tile centers carry the values.

    Args:
        at: the pixel.
        image: (rows, columns, C), values of tiles.
        radius: tile size in pixels.

    Returns:
        One value a channel, constant beyond the outermost tile centers.
    """
    sides = []
    for place, count in ((at.row, image.height), (at.column, image.width)):
        along = (place + 0.5) / radius - 0.5
        first = jnp.floor(along)
        number = first.astype(jnp.int32)
        ends = [jnp.clip(number + k, 0, count - 1) for k in (0, 1)]
        sides.append((ends, along - first))
    (rows, down), (columns, across) = sides
    upper, lower = (
        [
            a + across * (b - a)
            for a, b in zip(*(image.read_inside(row, c) for c in columns), strict=True)
        ]
        for row in rows
    )
    return tuple(a + down * (b - a) for a, b in zip(upper, lower, strict=True))
