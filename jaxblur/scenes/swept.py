"""Moving triangles: time-dependent edge functions, and the pixels that a triangle may sweep.

While the corners of a triangle move linearly in camera space, the edge function
``(low(s) x high(s)) . d`` of a fixed ray d is **quadratic** in the time s of the piece [Gribel,
Doggett and Akenine-Moller 2010]. Nothing is divided by depth, so perspective is exact, and
triangles that cross the near plane need no clipping.
"""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .raster import cross, dot, expand
from .scene import NEAR

MARGIN = 1e-3
"""Pixels by which a swept area is enlarged: coverage is tested later, so extras are harmless."""

PAIRS = np.array(list(itertools.combinations(range(6), 2))).T
"""All pairs of the six corners at both ends; they include every side of the convex hull."""


class Swept(NamedTuple):
    """Triangles over pieces of time, N = pieces x triangles, piece by piece.

    Attributes:
        edges: (3, 3, 3, N) coefficients of 1, s, s^2 of the edge opposite corner i, by component of
            the ray. The sign depends only on the order of the edge's point numbers, so that
            triangles that share the edge compute identical bits.
        forward: (3, N) bool, whether the triangle runs along the edge in that order.
        depth: (2, 3, N) of the corners at start and end.
        outline: (2, 6, N) x and y in pixels of the corners at start and end.
        bounds: (2, 2, N) smallest and largest x and y in pixels of the part beyond the near plane.
        crosses: (N,) bool, whether a corner is behind the near plane at start or end.
        drawn: (N,) bool: not degenerate, not always behind, not always a hidden back face.
        closed: (N,) bool, whether the back is never seen.
    """

    edges: jax.Array
    forward: jax.Array
    depth: jax.Array
    outline: jax.Array
    bounds: jax.Array
    crosses: jax.Array
    drawn: jax.Array
    closed: jax.Array


class SweptRows(NamedTuple):
    """Spans of image rows that swept triangles may touch.

    Attributes:
        owner: (R,) swept triangle.
        row: (R,) image row.
        first: (R,) first column.
        ends: (R,) number of candidate pixels up to and including this row.
        needed: () rows needed; rows beyond the capacity are missing.
    """

    owner: jax.Array
    row: jax.Array
    first: jax.Array
    ends: jax.Array
    needed: jax.Array


def sweep(
    points: Float[Array, "keys points 3"],
    triangles: Int[Array, "triangles 3"],
    closed: Bool[Array, " triangles"],
    focal: Float[Array, ""],
    size: tuple[int, int],
) -> Swept:
    """Set up triangles for all pieces between keys.

    Args:
        points: (K + 1, V, 3) camera space at the keys.
        triangles: (F, 3) indices.
        closed: (F,) whether back faces are skipped.
        focal: () pixels.
        size: (height, width).

    Returns:
        K F moving triangles.
    """
    pieces = points.shape[0] - 1
    corner = [jnp.moveaxis(points[:, triangles[:, i]], -1, 0) for i in range(3)]
    start = [c[:, :-1].reshape(3, -1) for c in corner]
    shift = [(c[:, 1:] - c[:, :-1]).reshape(3, -1) for c in corner]
    edges, forward = [], []
    for a, b in ((1, 2), (2, 0), (0, 1)):
        along = jnp.tile(triangles[:, a] < triangles[:, b], pieces)
        low, high, low_shift, high_shift = (
            jnp.where(along, pair[0], pair[1])
            for pair in (
                (start[a], start[b]),
                (start[b], start[a]),
                (shift[a], shift[b]),
                (shift[b], shift[a]),
            )
        )
        edges.append(_edge(low, high - low, low_shift, high_shift - low_shift))
        forward.append(along)
    edges, forward = jnp.stack(edges, axis=1), jnp.stack(forward)
    depth = jnp.stack([jnp.stack([p[2] for p in start])] * 2)
    depth = depth.at[1].add(jnp.stack([m[2] for m in shift]))
    ends = jnp.stack([*start, *(p + m for p, m in zip(start, shift, strict=True))], axis=1)
    outline = _image_points(ends, focal, size)
    shut = jnp.tile(closed, pieces)
    hidden = shut & _always_faces_away(edges[:, 0], forward[0], start[0], shift[0])
    distinct = [triangles[:, i] != triangles[:, (i + 1) % 3] for i in range(3)]
    drawn = jnp.tile(distinct[0] & distinct[1] & distinct[2], pieces) & ~hidden
    drawn &= jnp.any(depth > NEAR, axis=(0, 1))
    bounds = _clipped_bounds(ends, focal, size)
    crosses = jnp.any(depth <= NEAR, axis=(0, 1))
    # The barrier prevents fusion into the many consumers, each of which would compile and compute
    # it again.
    return jax.lax.optimization_barrier(
        Swept(edges, forward, depth, outline, bounds, crosses, drawn, shut)
    )


def _image_points(points: Array, focal: Array, size: tuple[int, int]) -> Array:
    """Project camera-space points (3, ...) to x and y in pixels (2, ...)."""
    seen = focal * points[:2] / jnp.maximum(points[2], NEAR)
    return seen + jnp.array([size[1] / 2, size[0] / 2]).reshape(2, *[1] * (points.ndim - 1))


def _clipped_bounds(ends: Array, focal: Array, size: tuple[int, int]) -> Array:
    """Bound the image of the hull of six points, clipped at the near plane: boxes (2, 2, N)."""
    first, second = ends[:, PAIRS[0]], ends[:, PAIRS[1]]

    def cut(point: Array, other: Array) -> Array:
        fall = other[2] - point[2]
        share = (NEAR - point[2]) / jnp.where(fall == 0, 1.0, fall)
        return jnp.where(point[2] < NEAR, point + share * (other - point), point)

    image = [_image_points(cut(*pair), focal, size) for pair in ((first, second), (second, first))]
    image = jnp.stack(image, axis=1)
    there = jnp.maximum(first[2], second[2]) > NEAR
    low = jnp.min(jnp.where(there, image, jnp.inf), axis=(1, 2))
    return jnp.stack([low, jnp.max(jnp.where(there, image, -jnp.inf), axis=(1, 2))])


def _edge(low: Array, along: Array, low_shift: Array, along_shift: Array) -> Array:
    """Expand ``low(s) x along(s)``; differences, as products of long vectors lose precision."""
    return jnp.stack(
        [
            cross(low, along),
            cross(low, along_shift) + cross(low_shift, along),
            cross(low_shift, along_shift),
        ]
    )


def _always_faces_away(edge: Array, forward: Array, corner: Array, shift: Array) -> Array:
    """Test whether the volume, a cubic in s, stays positive, by its Bernstein coefficients."""
    sign = jnp.where(forward, 1.0, -1.0)
    v0, v1 = dot(corner, edge[0]), dot(corner, edge[1]) + dot(shift, edge[0])
    v2, v3 = dot(corner, edge[2]) + dot(shift, edge[1]), dot(shift, edge[2])
    control = jnp.stack([v0, v0 + v1 / 3, v0 + (2 * v1 + v2) / 3, v0 + v1 + v2 + v3])
    return jnp.all(sign * control > 0, axis=0)


def swept_rows(
    swept: Swept,
    offset: Float[Array, " 2"],
    reach: float,
    size: tuple[int, int],
    capacity: int,
) -> SweptRows:
    """List the rows of pixels whose samples the convex hull of a moving triangle may cover.

    Args:
        swept: moving triangles.
        offset: (2,) x and y of the samples from the pixel center, pixels.
        reach: largest distance of samples from there in x and in y, pixels.
        size: (height, width).
        capacity: static length of the list.

    Returns:
        The rows.
    """
    width = size[1]
    start, count = row_counts(swept, offset, reach, size)
    owner, number, real, needed = expand(count, capacity)
    row = start[owner] + number
    middle = row + 0.5 + offset[1]
    left, right = _hull_span(
        swept.outline[:, :, owner], middle - reach - MARGIN, middle + reach + MARGIN
    )
    crosses = swept.crosses[owner]
    low, high = swept.bounds[:, 0, owner]
    left, right = jnp.where(crosses, low, left), jnp.where(crosses, high, right)
    first = jnp.clip(jnp.ceil(left - 0.5 - offset[0] - reach - MARGIN), 0, width)
    end = jnp.clip(jnp.floor(right + 0.5 - offset[0] + reach + MARGIN), 0, width)
    first, end = first.astype(jnp.int32), end.astype(jnp.int32)
    ends = jnp.cumsum(jnp.where(real, jnp.maximum(end - first, 0), 0))
    return SweptRows(owner, row, first, ends, needed)


def row_counts(
    swept: Swept, offset: Float[Array, " 2"], reach: float, size: tuple[int, int]
) -> tuple[Int[Array, " swept"], Int[Array, " swept"]]:
    """Find the first image row and the number of rows of every moving triangle."""
    height, width = size
    (left, top), (right, bottom) = swept.bounds
    top = jnp.ceil(top - 0.5 - offset[1] - reach - MARGIN)
    bottom = jnp.floor(bottom + 0.5 - offset[1] + reach + MARGIN)
    first, last = (jnp.clip(edge, 0, height).astype(jnp.int32) for edge in (top, bottom))
    apart = (right < -1) | (left > width + 1) | ~swept.drawn
    return first, jnp.where(apart, 0, jnp.maximum(last - first, 0))


def _hull_span(outline: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Find the leftmost and rightmost x of the hull of six points in a band of y."""
    (x0, x1), (y0, y1) = outline[0][PAIRS], outline[1][PAIRS]
    rise = y1 - y0
    level = rise == 0
    slope = 1 / jnp.where(level, 1.0, rise)
    ends = [
        jnp.where(level, at_level, jnp.clip((edge - y0) * slope, 0.0, 1.0))
        for edge, at_level in ((low, 0.0), (high, 1.0))
    ]
    ends = jnp.stack([x0 + (x1 - x0) * end for end in ends])
    touches = (jnp.maximum(y0, y1) >= low) & (jnp.minimum(y0, y1) <= high)
    left = jnp.min(jnp.where(touches, ends, jnp.inf), axis=(0, 1))
    right = jnp.max(jnp.where(touches, ends, -jnp.inf), axis=(0, 1))
    return left, right


def candidates(
    rows: SweptRows, first: Int[Array, ""], count: int
) -> tuple[Int[Array, " candidates"], Int[Array, " candidates"], Int[Array, " candidates"], Array]:
    """List a run of candidates: pairs of a swept triangle and a pixel.

    Args:
        rows: rows of all swept triangles.
        first: () number of the first candidate.
        count: static length of the run.

    Returns:
        Swept triangle, row, column and whether the candidate exists, each (count,).
    """
    number = first + jnp.arange(count, dtype=jnp.int32)
    line = jnp.searchsorted(rows.ends, number, side="right")
    line = jnp.minimum(line, rows.ends.shape[0] - 1)
    before = jnp.where(line > 0, rows.ends[line - 1], 0)
    return (
        rows.owner[line],
        rows.row[line],
        rows.first[line] + number - before,
        number < rows.ends[-1],
    )


def edge_polynomials(
    swept: Swept, owner: Int[Array, " points"], ray: Float[Array, "3 points"]
) -> Float[Array, "3 3 points"]:
    """Compute the edge functions of given rays as polynomials in time.

    Args:
        swept: moving triangles.
        owner: (N,) the triangle of each ray.
        ray: (3, N) camera space.

    Returns:
        (3, 3, N) coefficients of 1, s, s^2 of the edge opposite corner i.
    """
    lines = swept.edges.reshape(27, -1)[:, owner].reshape(3, 3, 3, -1)
    return lines[:, :, 0] * ray[0] + lines[:, :, 1] * ray[1] + lines[:, :, 2] * ray[2]


def edge_values(
    polynomials: Float[Array, "3 3 points"], share: Float[Array, " points"]
) -> Float[Array, "3 points"]:
    """Evaluate edge functions at a time in the piece."""
    return polynomials[0] + share * (polynomials[1] + share * polynomials[2])


def corner_weights(
    values: Float[Array, "3 points"], forward: Bool[Array, "3 points"]
) -> Float[Array, "3 points"]:
    """Turn edge functions into perspective-correct weights of the corners, with sum 1."""
    signed = jnp.where(forward, values, -values)
    total = jnp.sum(signed, axis=0)
    return signed / jnp.where(total == 0, 1.0, total)


def depth_at(
    swept: Swept,
    owner: Int[Array, " points"],
    weights: Float[Array, "3 points"],
    share: Float[Array, " points"],
) -> Float[Array, " points"]:
    """Compute the planar depth of the point with given corner weights at a time in the piece."""
    start, end = swept.depth[:, :, owner]
    return jnp.sum(weights * (start + share * (end - start)), axis=0)
