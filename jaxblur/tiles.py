"""Tiles: the dominant velocity of a neighborhood, and which tile a pixel reads.

The reductions run over (speed, index) pairs and the velocities are gathered by the winning
index, so that the maximum differentiates: its derivative is that of the vector that won. At a
tie the first vector wins and takes the whole derivative.
"""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from .safe_math import safe_divide, safe_norm, safe_normalize

# Center first, then row-major: with a strict comparison this is the order of ties.
RING = ((0, 0), (-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1))


def shortening(speed: Float[Array, "*shape"], radius: int) -> Float[Array, "*shape"]:
    """Factor that clamps a vector to the radius, ``min(1, r / ||v||)``.

    Args:
        speed: norms in pixels.
        radius: longest half-spread in pixels.

    Returns:
        Factors; the derivative at ``||v|| = r`` is 0, that of 1.
    """
    too_fast = speed > radius
    return jnp.where(too_fast, radius / jnp.where(too_fast, speed, 1), 1)


def clamp_speed(
    velocity: Float[Array, "*shape 2"],
    radius: int,
    speed: Float[Array, "*shape"] | None = None,
) -> tuple[Float[Array, "*shape 2"], Float[Array, "*shape"]]:
    """Clamp half-spreads radially to the radius: ``v min(1, r / ||v||)``.

    Source: Guertin et al. 2014, section 3.5. Never per component, which would turn vectors.
    The derivative at ``||v|| = r`` is that of the identity.

    Args:
        velocity: (..., 2) half-spread in pixels.
        radius: longest half-spread in pixels.
        speed: (...) norm of the velocity, where it is known.

    Returns:
        The clamped velocity (..., 2), and its speed (...) in [0, radius]. All clamped vectors
        have the same speed to the bit, so that they tie in a tile maximum.
    """
    speed = safe_norm(velocity[..., 0], velocity[..., 1]) if speed is None else speed
    return velocity * shortening(speed, radius)[..., None], jnp.minimum(speed, radius)


def _faster(
    longest: float, first: tuple[jax.Array, jax.Array], second: tuple[jax.Array, jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """The pair with the larger clamped speed; at a tie the one with the smaller index."""
    first, second = ((jnp.minimum(speed, longest), index) for speed, index in (first, second))
    take_first = (first[0] > second[0]) | ((first[0] == second[0]) & (first[1] <= second[1]))
    speed = jnp.where(take_first, first[0], second[0])
    return speed, jnp.where(take_first, first[1], second[1])


def tile_argmax(
    speed: Float[Array, "height width"], radius: int, longest: float = np.inf
) -> Int[Array, "tile_rows tile_columns"]:
    """Row-major index of the fastest pixel of each ``radius x radius`` tile.

    Ragged tiles are padded with "no velocity"; ties go to the first pixel in row-major order.

    Args:
        speed: (H, W) in pixels, >= 0.
        radius: tile size in pixels.
        longest: speeds beyond it tie.

    Returns:
        (ceil(H / r), ceil(W / r)) indices into the flattened image.
    """
    height, width = speed.shape
    index = jnp.arange(height * width, dtype=jnp.int32).reshape(height, width)
    none = (jnp.asarray(-1, speed.dtype), jnp.asarray(0, jnp.int32))
    _, winner = lax.reduce_window(
        (lax.stop_gradient(speed), index),
        none,
        functools.partial(_faster, longest),
        window_dimensions=(radius, radius),
        window_strides=(radius, radius),
        padding=((0, -height % radius), (0, -width % radius)),
    )
    return winner


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
    speed = safe_norm(velocity[..., 0], velocity[..., 1])
    return velocity.reshape(-1, 2)[tile_argmax(speed, radius)]


def _shifted(tiles: jax.Array, offset: tuple[int, int], fill: float | bool) -> jax.Array:
    """``tiles[row + oy, column + ox]`` for an offset (ox, oy), ``fill`` outside the grid."""
    ox, oy = offset
    padding = ((1, 1), (1, 1), *((0, 0),) * (tiles.ndim - 2))
    padded = jnp.pad(tiles, padding, constant_values=fill)
    rows, columns = tiles.shape[:2]
    return padded[1 + oy : 1 + oy + rows, 1 + ox : 1 + ox + columns]


def neighbor_argmax(
    tiles: Float[Array, "rows columns 2"],
    speed: Float[Array, "rows columns"],
    diagonal: str,
) -> Int[Array, "rows columns"]:
    """Row-major index of the tile of the 3 x 3 ring whose velocity dominates.

    Args:
        tiles: (rows, columns, 2) tile maxima in pixels.
        speed: (rows, columns) their norms, >= 0.
        diagonal: ``reaching``: a diagonal tile at offset (ox, oy) counts only if its velocity can
            reach the center along its own line, ``vx vy ox oy > 0`` [Guertin 2014, 3.4.4];
            ``all``: every tile counts [McGuire 2012].

    Returns:
        (rows, columns) indices into the flattened tiles. Ties: center first, then row-major.

    Raises:
        ValueError: ``diagonal`` is neither of the two.
    """
    if diagonal not in ("reaching", "all"):
        raise ValueError(f"`diagonal` must be 'reaching' or 'all', got {diagonal!r}.")
    # The product of signs, since that of small components underflows.
    slope = jnp.sign(tiles[..., 0]) * jnp.sign(tiles[..., 1])
    keys = []
    for ox, oy in RING:
        counts = (slope * (ox * oy) > 0) | (ox * oy == 0) | (diagonal == "all")
        # The rule looks at the neighbor, so it is applied before the shift.
        keys.append(_shifted(jnp.where(counts, speed, -1), (ox, oy), -1.0))
    winner = jnp.argmax(lax.stop_gradient(jnp.stack(keys)), axis=0)
    rows, columns = speed.shape
    offset = jnp.asarray([oy * columns + ox for ox, oy in RING], jnp.int32)
    return jnp.arange(rows * columns, dtype=jnp.int32).reshape(rows, columns) + offset[winner]


def neighbor_max(tiles: ArrayLike, diagonal: str = "reaching") -> Float[Array, "rows columns 2"]:
    """The velocity of largest norm in the 3 x 3 ring of each tile, "NeighborMax".

    ``NeighborMax[t] = vmax_{u in ring of t} TileMax[u]``

    Source: McGuire et al. 2012, eq. 2; the rule for diagonal tiles is Guertin et al. 2014,
    section 3.4.4. Differentiable in the tiles: the winner's derivative.

    Args:
        tiles: (rows, columns, 2) tile maxima in pixels.
        diagonal: ``reaching`` [Guertin 2014] or ``all`` [McGuire 2012], see `neighbor_argmax`.

    Returns:
        (rows, columns, 2) half-spread in pixels.

    Raises:
        ValueError: the tiles have another shape, or ``diagonal`` is unknown.
    """
    tiles = _vectors("tiles", tiles)
    speed = safe_norm(tiles[..., 0], tiles[..., 1])
    return tiles.reshape(-1, 2)[neighbor_argmax(tiles, speed, diagonal)]


def dominant_velocity(
    velocity: Float[Array, "height width 2"],
    speed: Float[Array, "height width"],
    radius: int,
    diagonal: str,
) -> Float[Array, "tile_rows tile_columns 2"]:
    """TileMax, then NeighborMax, of velocities clamped as `clamp_speed` does.

    Args:
        velocity: (H, W, 2) half-spread in pixels; clamped or not.
        speed: (H, W) its norm.
        radius: tile size in pixels.
        diagonal: see `neighbor_argmax`.

    Returns:
        (ceil(H / r), ceil(W / r), 2) half-spread in pixels.
    """
    fastest = tile_argmax(speed, radius, float(radius))
    tiles, speed = clamp_speed(velocity.reshape(-1, 2)[fastest], radius, speed.reshape(-1)[fastest])
    winner = neighbor_argmax(tiles, speed, diagonal)
    return tiles.reshape(-1, 2)[winner]


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
    tiles = _vectors("tiles", tiles)
    x, y = safe_normalize(tiles[..., 0], tiles[..., 1])
    still = (x == 0) & (y == 0)
    aligned, count = jnp.zeros_like(x), jnp.zeros_like(x)
    for offset in RING:
        dot = jnp.abs(x * _shifted(x, offset, 0.0) + y * _shifted(y, offset, 0.0))
        dot = jnp.where(still | _shifted(still, offset, False), 1, dot)
        inside = _shifted(jnp.ones_like(dot), offset, 0.0)
        aligned, count = aligned + inside * dot, count + inside
    return 1 - aligned / count


def sample_tiles(
    values: Float[Array, "rows columns"], radius: int, height: int, width: int
) -> Float[Array, "{height} {width}"]:
    """Bilinear lookup of a per-tile value at every pixel; tile centers carry the values.

    Args:
        values: (rows, columns), one value a tile.
        radius: tile size in pixels.
        height: rows of the image.
        width: columns of the image.

    Returns:
        (height, width) interpolated values, constant beyond the outermost tile centers.
    """
    row = (jnp.arange(height) + 0.5) / radius - 0.5
    column = (jnp.arange(width) + 0.5) / radius - 0.5
    coordinates = jnp.meshgrid(row, column, indexing="ij")
    return jax.scipy.ndimage.map_coordinates(values, coordinates, order=1, mode="nearest")


def _local_position(axis: int, shape: Sequence[int], radius: int) -> Float[Array, "height width 1"]:
    """Position inside the tile along one axis, ``u = (x mod r + 0.5) / r``, in (0, 1)."""
    index = lax.broadcasted_iota(jnp.int32, (*shape[:2], 1), axis)
    return (lax.rem(index, jnp.full_like(index, radius)) + 0.5) / radius


def _step_out(position: Float[Array, "*shape"]) -> Int[Array, "*shape"]:
    """-1, 0 or 1: the tile that a position relative to a tile lies in, along one axis."""
    return jnp.where(position < 0, -1, jnp.where(position >= 1, 1, 0))


def stochastic_tile(
    tile_noise: Float[Array, "height width 2"],
    tau: Float[Array, ""],
    radius: int,
) -> Int[Array, "height width 1"]:
    """Row-major index of the tile that each pixel reads, drawn with the given noise.

    The lookup moves to ``u + tau xi``. If exactly one axis leaves the tile, that neighbor is
    read; if both do, or the neighbor is outside the grid, the own tile is (departure 5).

    Args:
        tile_noise: (H, W, 2) xi in [-0.5, 0.5) as (x, y).
        tau: reach of the jitter in tiles, 0 <= tau <= 1; has no derivative here.
        radius: tile size in pixels.

    Returns:
        (H, W, 1) indices into the flattened tile grid.
    """
    noise_x, noise_y = (lax.slice_in_dim(tile_noise, k, k + 1, axis=2) for k in (0, 1))
    height, width = noise_x.shape[:2]
    rows, columns = -(-height // radius), -(-width // radius)
    own_row, own_column = _own_row_and_column(noise_x.shape, radius)
    step_x = _step_out(_local_position(1, noise_x.shape, radius) + tau * noise_x)
    step_y = _step_out(_local_position(0, noise_x.shape, radius) + tau * noise_y)
    row, column = own_row + step_y, own_column + step_x
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    leaves = ((step_x == 0) != (step_y == 0)) & inside
    return jnp.where(leaves, row * columns + column, own_row * columns + own_column)


def own_tile(shape: Sequence[int], radius: int) -> Int[Array, "height width 1"]:
    """Row-major index of the tile that each pixel lies in.

    Args:
        shape: of the image, rows and columns first.
        radius: tile size in pixels.

    Returns:
        (H, W, 1) indices into the flattened tile grid.
    """
    row, column = _own_row_and_column(shape, radius)
    return row * (-(-shape[1] // radius)) + column


def _own_row_and_column(
    shape: Sequence[int], radius: int
) -> tuple[Int[Array, "height width 1"], Int[Array, "height width 1"]]:
    """Row and column, in the grid, of the tile that each pixel lies in."""
    y, x = (lax.broadcasted_iota(jnp.int32, (*shape[:2], 1), axis) for axis in (0, 1))
    return lax.div(y, jnp.full_like(y, radius)), lax.div(x, jnp.full_like(x, radius))


def _leaving_probability(
    size: int, radius: int, tau: Float[Array, ""]
) -> tuple[np.ndarray, Float[Array, " size"]]:
    """Step toward the nearer neighbor tile along one axis, and the chance to read it.

    ``w = max(0, 1/2 - d / tau)`` at a distance d (in tiles) from the border; 0 for tau = 0 and
    where there is no tile to step to.
    """
    local = (np.arange(size) % radius + 0.5) / radius
    step = np.where(local < 0.5, -1, 1)
    distance = np.minimum(local, 1 - local)
    tile = np.arange(size) // radius + step
    exists = (tile >= 0) & (tile < -(-size // radius))
    tau = jnp.broadcast_to(tau, (size,))
    chance = jnp.maximum(0, 0.5 - safe_divide(jnp.asarray(distance, tau.dtype), tau, 1.0))
    return np.where(exists, step, 0), chance


def reachable_tiles(
    shape: Sequence[int], radius: int, tau: Float[Array, ""]
) -> tuple[Int[Array, "3 height width"], Float[Array, "3 height width"]]:
    """The tiles that the stochastic lookup can reach, and the probability of each.

    ``P_x = w_x (1 - w_y)``, ``P_y = w_y (1 - w_x)``, ``P_own = 1 - P_x - P_y`` (departure 5).
    Differentiable in tau; the derivative at ``w = 0`` is half the one-sided one.

    Args:
        shape: of the image, rows and columns first.
        radius: tile size in pixels.
        tau: reach of the jitter in tiles, 0 <= tau <= 1.

    Returns:
        Indices into the flattened tile grid and probabilities, both (3, H, W) in the order own,
        neighbor along x, neighbor along y.
    """
    height, width = shape[:2]
    own = own_tile(shape, radius)[..., 0]
    columns = -(-width // radius)
    step_x, chance_x = _leaving_probability(width, radius, tau)
    step_y, chance_y = _leaving_probability(height, radius, tau)
    chance_y = chance_y[:, None]
    # "Both leave" reads the own tile even where one of the two neighbors does not exist.
    to_x = jnp.where(step_x != 0, chance_x * (1 - chance_y), 0)
    to_y = jnp.where((step_y != 0)[:, None], chance_y * (1 - chance_x), 0)
    index = jnp.stack([own, own + step_x, own + columns * step_y[:, None]])
    return index, jnp.stack([1 - to_x - to_y, to_x, to_y])
