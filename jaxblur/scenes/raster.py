"""Visibility: the triangle that is seen through each pixel.

Homogeneous rasterization [Olano and Greer 1997]: with the camera-space corners ``v0 v1 v2`` of a
triangle as columns of M, a ray ``d = (x, y, 1)`` hits it where all ``M^-1 d`` are positive, and
the sum of ``M^-1 d`` is the inverse depth. Nothing is divided by depth, so triangles that cross the
near plane need no clipping.

Triangles are expanded to rows, and rows to fragments, in flat arrays whose capacity is static under
jit. The counts needed are returned, so that the caller notices a capacity that is too small. Two
triangles that share an edge compute bit-identical crossings for it, and a pixel center on the edge
belongs to exactly one of them.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .scene import NEAR

EDGE_ON = 1e-7
ROW_MARGIN = 1e-3


@dataclasses.dataclass(frozen=True)
class Capacity:
    """Static sizes of the flat arrays: rows of triangles, and fragments."""

    rows: int
    fragments: int


class Visibility(NamedTuple):
    """The triangle seen through each pixel, and the capacity needed.

    Attributes:
        triangle: (H, W) int, -1 where there is none.
        needed: (2,) int, rows and fragments; the fragment count is valid only if the rows sufficed.
    """

    triangle: jax.Array
    needed: jax.Array


class Planes(NamedTuple):
    """Triangles in camera space as linear functions of the ray ``d = (x, y, 1)``.

    The component axis comes first: arrays with a last axis of length 3 vectorize badly.

    Attributes:
        edges: 3 arrays (3, F): ``edges[i] . d`` is the function of the edge opposite corner i. Its
            sign depends only on the order of the edge's point numbers, so that triangles that share
            the edge compute identical bits.
        inside: 3 arrays (F,) of +1 or -1, the sign of the function inside the triangle.
        inverse_depth: (3, F) ``1/z = inverse_depth . d``.
        drawn: (F,) bool: not degenerate, not behind the camera, not a hidden back face.
    """

    edges: list[jax.Array]
    inside: list[jax.Array]
    inverse_depth: jax.Array
    drawn: jax.Array


class Rows(NamedTuple):
    """The covered part of every image row that a triangle touches, R entries.

    Attributes:
        owner: (R,) int, triangle.
        row: (R,) int, image row.
        first: (R,) int, first column covered.
        count: (R,) int, number of columns covered.
        plane: (3, R) inverse depth as a function of the ray.
        needed: () int, number of entries needed.
    """

    owner: jax.Array
    row: jax.Array
    first: jax.Array
    count: jax.Array
    plane: jax.Array
    needed: jax.Array


def cross(a: jax.Array, b: jax.Array) -> jax.Array:
    """Cross product along the leading axis."""
    return jnp.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def dot(a: jax.Array, b: jax.Array) -> jax.Array:
    """Inner product along the leading axis."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


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
    index = [triangles[:, i] for i in range(3)]
    corner = [points.T[:, i] for i in index]
    normal = cross(corner[1] - corner[0], corner[2] - corner[0])
    volume = dot(corner[0], normal)
    side = jnp.sign(volume)
    edges, inside = [], []
    for i, j in ((1, 2), (2, 0), (0, 1)):
        ordered = index[i] < index[j]
        low = jnp.where(ordered, corner[i], corner[j])
        high = jnp.where(ordered, corner[j], corner[i])
        # low x high, written with the difference: the product of two long, nearly equal vectors
        # loses precision.
        edges.append(cross(low, high - low))
        inside.append(jnp.where(ordered, side, -side))
    size = dot(corner[0], corner[0]) * dot(normal, normal)
    ahead = jnp.maximum(jnp.maximum(corner[0][2], corner[1][2]), corner[2][2]) > NEAR
    drawn = (volume**2 > EDGE_ON**2 * size) & ahead
    plane = normal / jnp.where(drawn, volume, 1.0)
    return Planes(edges, inside, plane, drawn & ((volume < 0) | ~closed))


def row_ranges(
    points: Float[Array, "points 3"],
    triangles: Int[Array, "triangles 3"],
    drawn: Bool[Array, " triangles"],
    focal: Float[Array, ""],
    offset: Float[Array, " 2"],
    size: tuple[int, int],
) -> tuple[Int[Array, " triangles"], Int[Array, " triangles"]]:
    """Find the image rows that each triangle may touch.

    Args:
        points: (V, 3) camera space.
        triangles: (F, 3) indices.
        drawn: (F,) bool.
        focal: () pixels.
        offset: (2,) x and y of the sample from the pixel center, pixels.
        size: (height, width) of the image.

    Returns:
        First row and number of rows, each (F,) int; all rows for triangles that cross the near
        plane.
    """
    height, width = size
    x, y, z = points.T[:, triangles.T]
    safe = jnp.maximum(z, NEAR)
    column, row = focal * x / safe + width / 2, focal * y / safe + height / 2
    # The edge functions decide coverage, so an extra row is harmless; rounding may go either way.
    top = jnp.ceil(jnp.min(row, 0) - 0.5 - offset[1] - ROW_MARGIN)
    bottom = jnp.ceil(jnp.max(row, 0) - 0.5 - offset[1] + ROW_MARGIN)
    first, last = (jnp.clip(edge, 0, height).astype(jnp.int32) for edge in (top, bottom))
    column = column - offset[0]
    beside = (jnp.max(column, 0) < -1) | (jnp.min(column, 0) > width + 1)
    crosses = jnp.min(z, axis=0) <= NEAR
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
        Each item's owner, its number within the owner, whether the item exists, and the length
        needed.
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
        planes: planes of all triangles.
        owner: (R,) triangle of each row.
        row: (R,) image row.
        focal: () pixels.
        offset: (2,) x and y of the sample from the pixel center, pixels.
        size: (height, width) of the image.

    Returns:
        First column and number of columns, each (R,) int; no columns where nothing is covered.
    """
    height, width = size
    y = (row + 0.5 + offset[1] - height / 2) / focal
    first, end = jnp.zeros_like(row), jnp.full_like(row, width)
    in_front = jnp.array([0.0, 0.0, 1 / NEAR])[:, None] - planes.inverse_depth
    lines = [*planes.edges, in_front]
    signs = [*planes.inside, jnp.ones_like(in_front[0])]
    for line, sign in zip(lines, signs, strict=True):
        slope, rise, level = line[:, owner]
        inside, value = sign[owner], rise * y + level
        upright = slope == 0
        crossing = -value / jnp.where(upright, 1.0, slope) * focal + width / 2 - offset[0]
        column = jnp.ceil(jnp.clip(crossing, -1.0, width + 1.0) - 0.5).astype(jnp.int32)
        # An edge along the row: the sign of its function decides, and zero counts as positive.
        outside = upright & ((value >= 0) != (inside > 0))
        end = jnp.where(outside, 0, end)
        first = jnp.where(~upright & (slope * inside > 0), jnp.maximum(first, column), first)
        end = jnp.where(~upright & (slope * inside < 0), jnp.minimum(end, column), end)
    return first, jnp.maximum(end - first, 0)


def covered_rows(
    points: Float[Array, "points 3"],
    triangles: Int[Array, "triangles 3"],
    closed: Bool[Array, " triangles"],
    focal: Float[Array, ""],
    offset: Float[Array, " 2"],
    size: tuple[int, int],
    capacity: int,
) -> Rows:
    """Cut all triangles into rows of pixels.

    Args:
        points: (V, 3) camera space.
        triangles: (F, 3) indices.
        closed: (F,) whether back faces are skipped.
        focal: () pixels.
        offset: (2,) x and y of the sample from the pixel center, pixels.
        size: static (height, width).
        capacity: static number of entries; entries beyond it are missing, see `Rows.needed`.

    Returns:
        The rows; the number of fragments is the sum of their counts.
    """
    surface = planes(points, triangles, closed)
    first_row, row_count = row_ranges(points, triangles, surface.drawn, focal, offset, size)
    owner, number, real, needed = expand(row_count, capacity)
    row = first_row[owner] + number
    first, count = spans(surface, owner, row, focal, offset, size)
    plane = surface.inverse_depth[:, owner]
    return Rows(owner, row, first, jnp.where(real, count, 0), plane, needed)


def visible_triangles(
    points: Float[Array, "points 3"],
    triangles: Int[Array, "triangles 3"],
    closed: Bool[Array, " triangles"],
    focal: Float[Array, ""],
    offset: Float[Array, " 2"],
    size: tuple[int, int],
    capacity: Capacity,
) -> Visibility:
    """Find the nearest triangle at every pixel.

    At equal depths the triangle with the larger number wins, so that the result is deterministic.

    Args:
        points: (V, 3) camera space.
        triangles: (F, 3) indices.
        closed: (F,) whether back faces are skipped.
        focal: () pixels.
        offset: (2,) x and y of the sample from the pixel center, pixels.
        size: static (height, width).
        capacity: static sizes; the result is wrong if the counts returned exceed them.

    Returns:
        The visible triangles, and the counts needed.
    """
    height, width = size
    rows = covered_rows(points, triangles, closed, focal, offset, size, capacity.rows)
    line, along, covered, fragments = expand(rows.count, capacity.fragments)
    nowhere = height * width
    pixel = jnp.where(covered, (rows.row * width + rows.first)[line] + along, nowhere)
    ray_x = (rows.first + 0.5 + offset[0] - width / 2) / focal
    ray_y = (rows.row + 0.5 + offset[1] - height / 2) / focal
    start = rows.plane[0] * ray_x + rows.plane[1] * ray_y + rows.plane[2]
    # Materialized once: computed twice, it might round differently and leave a pixel no winner.
    inverse_depth = jax.lax.optimization_barrier(
        start[line] + (rows.plane[0] / focal)[line] * along
    )
    nearest = jnp.zeros(nowhere + 1).at[pixel].max(inverse_depth)
    wins = covered & (inverse_depth == nearest[pixel])
    seen = jnp.full(nowhere + 1, -1, jnp.int32)
    seen = seen.at[jnp.where(wins, pixel, nowhere)].max(rows.owner[line])
    return Visibility(seen[:-1].reshape(size), jnp.stack([rows.needed, fragments]))


def rays(
    focal: Float[Array, ""], offset: Float[Array, " 2"], size: tuple[int, int]
) -> Float[Array, "3 pixels"]:
    """Make the rays ``(x, y, 1)`` in camera space through all pixels in row-major order.

    Args:
        focal: () pixels.
        offset: (2,) x and y from the pixel center, pixels.
        size: (height, width).

    Returns:
        (3, H W).
    """
    height, width = size
    x = (jnp.arange(width) + 0.5 + offset[0] - width / 2) / focal
    y = (jnp.arange(height) + 0.5 + offset[1] - height / 2) / focal
    columns, rows = jnp.meshgrid(x, y)
    return jnp.stack([columns.ravel(), rows.ravel(), jnp.ones(height * width)])


def enough(rows: int, fragments: int) -> Capacity:
    """Round counts up, with a margin, to a capacity that similar scenes share."""
    return Capacity(_rounded(rows, 16384), _rounded(fragments, 32768))


def _rounded(count: int, smallest: int) -> int:
    half_octaves = int(np.ceil(2 * np.log2(max(1.05 * count / smallest, 1.0))))
    return int(np.ceil(smallest * 2 ** (half_octaves / 2)))
