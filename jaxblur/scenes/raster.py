"""Visibility: which triangle is seen through each pixel.

Homogeneous rasterization [Olano and Greer 1997]: with the camera-space corners ``v0 v1 v2`` of a
triangle as columns of M, a ray ``d = (x, y, 1)`` hits it where all ``M^-1 d`` are positive, and
the sum of ``M^-1 d`` is the inverse depth. Nothing is divided by depth, so that triangles through
the near plane need no clipping.

Triangles are expanded to rows and rows to fragments, in flat arrays of a capacity that is static
under jit; the counts needed are returned, so that too small a capacity never goes unseen. An
edge shared by two triangles gives both the same crossing to the last bit, and a pixel center on
it belongs to exactly one of them.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .scene import NEAR

BEHIND_ALL = 0.0
EDGE_ON = 1e-7
ROW_MARGIN = 1e-3


@dataclasses.dataclass(frozen=True)
class Capacity:
    """Static sizes of the flat arrays: rows of triangles, and fragments."""

    rows: int
    fragments: int


class Planes(NamedTuple):
    """Triangles in camera space as linear functions of the ray ``d = (x, y, 1)``.

    Attributes:
        edges: (F, 3, 3) an edge's function ``edges[:, i] . d``, opposite corner i, with a sign
            that depends on the order of its ends only, so that neighbors share its bits.
        inside: (F, 3) +1 or -1, the sign of the function inside the triangle.
        inverse_depth: (F, 3) ``1/z = inverse_depth . d``.
        drawn: (F,) bool: not degenerate, not behind the camera, not a hidden back face.
    """

    edges: jax.Array
    inside: jax.Array
    inverse_depth: jax.Array
    drawn: jax.Array


class Visibility(NamedTuple):
    """What is seen through each pixel, and the capacity that was needed.

    Attributes:
        triangle: (H, W) int, -1 where nothing is.
        rows: () int, rows needed.
        fragments: () int, fragments needed; right only if the rows sufficed.
    """

    triangle: jax.Array
    rows: jax.Array
    fragments: jax.Array


def planes(
    points: Float[Array, "points 3"],
    triangles: Int[Array, "triangles 3"],
    closed: Bool[Array, " triangles"],
) -> Planes:
    """Set up triangles for rasterization.

    Args:
        points: (V, 3) camera space.
        triangles: (F, 3) indices.
        closed: (F,) whether back faces are skipped.

    Returns:
        Edge functions and inverse depth of every triangle.
    """
    corners = points[triangles]
    normal = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = jnp.sum(corners[:, 0] * normal, axis=-1)
    ends = triangles[:, jnp.array([[1, 2], [2, 0], [0, 1]])]
    low, high = points[jnp.min(ends, -1)], points[jnp.max(ends, -1)]
    # low x high, written with the difference: two long, nearly equal vectors lose digits.
    edges = jnp.cross(low, high - low)
    order = jnp.where(ends[..., 0] < ends[..., 1], 1.0, -1.0)
    size = jnp.linalg.norm(corners[:, 0], axis=-1) * jnp.linalg.norm(normal, axis=-1)
    drawn = (jnp.abs(volume) > EDGE_ON * size) & jnp.any(corners[..., 2] > NEAR, axis=1)
    return Planes(
        edges,
        order * jnp.sign(volume)[:, None],
        normal / jnp.where(drawn, volume, 1.0)[:, None],
        drawn & ((volume < 0) | ~closed),
    )


def row_ranges(
    points: Float[Array, "points 3"],
    triangles: Int[Array, "triangles 3"],
    drawn: Bool[Array, " triangles"],
    focal: Float[Array, ""],
    offset: Float[Array, " 2"],
    size: tuple[int, int],
) -> tuple[Int[Array, " triangles"], Int[Array, " triangles"]]:
    """Find the image rows that a triangle may touch.

    Args:
        points: (V, 3) camera space.
        triangles: (F, 3) indices.
        drawn: (F,) bool.
        focal: () pixels.
        offset: (2,) x and y of the sample from the pixel center, pixels.
        size: (height, width) of the image.

    Returns:
        First row and number of rows, each (F,) int. All rows for triangles through the near
        plane.
    """
    height, width = size
    x, y, z = jnp.moveaxis(points[triangles], -1, 0)
    safe = jnp.maximum(z, NEAR)
    column, row = focal * x / safe + width / 2, focal * y / safe + height / 2
    # The edge functions decide; a row too many is harmless, and rounding may go either way.
    top = jnp.ceil(jnp.min(row, 1) - 0.5 - offset[1] - ROW_MARGIN)
    bottom = jnp.ceil(jnp.max(row, 1) - 0.5 - offset[1] + ROW_MARGIN)
    first, last = (jnp.clip(edge, 0, height).astype(jnp.int32) for edge in (top, bottom))
    beside = (jnp.max(column, 1) < -1) | (jnp.min(column, 1) > width + 1)
    crosses = jnp.any(z <= NEAR, axis=1)
    first = jnp.where(crosses, 0, first)
    last = jnp.where(crosses, height, jnp.where(beside, first, last))
    return first, jnp.where(drawn, last - first, 0)


def expand(
    counts: Int[Array, " owners"], capacity: int
) -> tuple[Int[Array, " items"], Int[Array, " items"], Bool[Array, " items"], Int[Array, ""]]:
    """List `counts[k]` items for every owner k, in order.

    Args:
        counts: (K,) not negative.
        capacity: static length of the list.

    Returns:
        Each item's owner, its number within the owner, whether it is there at all, and the
        length that was needed.
    """
    ends = jnp.cumsum(counts)
    starts = ends - counts
    marks = jnp.zeros(capacity, jnp.int32).at[starts].add(1, mode="drop")
    owner = jnp.cumsum(marks) - 1
    item = jnp.arange(capacity, dtype=jnp.int32)
    return owner, item - starts[owner], item < ends[-1], ends[-1]


def spans(
    planes: Planes,
    owner: Int[Array, " rows"],
    row: Int[Array, " rows"],
    focal: Float[Array, ""],
    offset: Float[Array, " 2"],
    size: tuple[int, int],
) -> tuple[Int[Array, " rows"], Int[Array, " rows"]]:
    """Intersect rows of pixel centers with triangles.

    Args:
        planes: of all triangles.
        owner: (R,) triangle of each row.
        row: (R,) image row.
        focal: () pixels.
        offset: (2,) x and y of the sample from the pixel center, pixels.
        size: (height, width) of the image.

    Returns:
        First column and end column (exclusive), each (R,) int; equal where nothing is covered.
    """
    height, width = size
    y = (row + 0.5 + offset[1] - height / 2) / focal
    near = jnp.array([0.0, 0.0, 1 / NEAR]) - planes.inverse_depth
    lines = jnp.concatenate([planes.edges, near[:, None]], axis=1)[owner]
    sign = jnp.concatenate([planes.inside, jnp.ones_like(planes.inside[:, :1])], axis=1)[owner]
    slope, level = lines[..., 0], lines[..., 1] * y[:, None] + lines[..., 2]
    upright = slope == 0
    crossing = -level / jnp.where(upright, 1.0, slope) * focal + width / 2 - offset[0]
    column = jnp.ceil(jnp.clip(crossing, -1.0, width + 1.0) - 0.5).astype(jnp.int32)
    # On an edge along the row the side is decided by its sign alone, zero counting as positive.
    outside = upright & (jnp.where(level >= 0, 1.0, -1.0) != sign)
    opens, closes = ~upright & (slope * sign > 0), ~upright & (slope * sign < 0)
    first = jnp.max(jnp.where(opens, column, 0), axis=1)
    end = jnp.min(jnp.where(closes, column, width), axis=1)
    end = jnp.where(jnp.any(outside, axis=1), first, end)
    return first, jnp.maximum(end, first)


def visible_triangles(
    points: Float[Array, "points 3"],
    triangles: Int[Array, "triangles 3"],
    closed: Bool[Array, " triangles"],
    focal: Float[Array, ""],
    offset: Float[Array, " 2"],
    size: tuple[int, int],
    capacity: Capacity,
) -> tuple[Visibility, Planes]:
    """Find the nearest triangle at every pixel.

    Equal depths go to the triangle with the larger number, so that the result is deterministic.

    Args:
        points: (V, 3) camera space.
        triangles: (F, 3) indices.
        closed: (F,) whether back faces are skipped.
        focal: () pixels.
        offset: (2,) x and y of the sample from the pixel center, pixels, within +-1/2.
        size: static (height, width).
        capacity: static sizes; the result is wrong if the counts returned exceed them.

    Returns:
        What is visible, and the triangles' planes.
    """
    height, width = size
    surface = planes(points, triangles, closed)
    first_row, row_count = row_ranges(points, triangles, surface.drawn, focal, offset, size)
    owner, number, real, rows = expand(row_count, capacity.rows)
    row = first_row[owner] + number
    first, end = spans(surface, owner, row, focal, offset, size)
    line, along, covered, fragments = expand(jnp.where(real, end - first, 0), capacity.fragments)
    pixel = jnp.where(covered, (row * width + first)[line] + along, height * width)
    plane = surface.inverse_depth[owner]
    ray_x = (first + 0.5 + offset[0] - width / 2) / focal
    ray_y = (row + 0.5 + offset[1] - height / 2) / focal
    start = plane[:, 0] * ray_x + plane[:, 1] * ray_y + plane[:, 2]
    # Materialized once: were it computed twice, rounding could make a pixel lose its winner.
    inverse_depth = jax.lax.optimization_barrier(start[line] + (plane[:, 0] / focal)[line] * along)
    nearest = jnp.full(height * width + 1, BEHIND_ALL).at[pixel].max(inverse_depth)
    wins = covered & (inverse_depth == nearest[pixel])
    seen = jnp.full(height * width + 1, -1, jnp.int32)
    seen = seen.at[jnp.where(wins, pixel, height * width)].max(owner[line])
    return Visibility(seen[:-1].reshape(size), rows, fragments), surface


def rays(
    focal: Float[Array, ""], offset: Float[Array, " 2"], size: tuple[int, int]
) -> Float[Array, "height width 3"]:
    """Make the rays ``(x, y, 1)`` in camera space through all pixels.

    Args:
        focal: () pixels.
        offset: (2,) x and y from the pixel center, pixels.
        size: (height, width).

    Returns:
        (H, W, 3).
    """
    height, width = size
    x = (jnp.arange(width) + 0.5 + offset[0] - width / 2) / focal
    y = (jnp.arange(height) + 0.5 + offset[1] - height / 2) / focal
    columns, rows = jnp.meshgrid(x, y)
    return jnp.stack([columns, rows, jnp.ones(size)], axis=-1)


def enough(rows: int, fragments: int) -> Capacity:
    """Round counts up, with a margin, to a capacity that similar scenes share."""
    return Capacity(_rounded(rows, 4096), _rounded(fragments, 16384))


def _rounded(count: int, smallest: int) -> int:
    steps = np.ceil(2 * np.log2(max(1.1 * count / smallest, 1.0)))
    return int(np.ceil(smallest * 2 ** (steps / 2)))
