"""Colors of visible time ranges: texture averaged along the path of a pixel over a surface."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, UInt32

from .intervals import (
    WORD,
    Clock,
    Intervals,
    bits_before,
    count_bits,
    first_and_last_bit,
    share_at,
)
from .keyframes import camera_rotations, own_copies
from .raster import dot
from .scene import Pose, World
from .shading import albedo, irradiance, sky_color, surface_at
from .swept import Swept, corner_weights, edge_polynomials, edge_values

POINTS = 4096


class View(NamedTuple):
    """Inputs that all shading of one pass shares.

    Attributes:
        poses: poses at the ends of the pieces.
        swept: moving triangles.
        clock: bits against time.
        ray: (3, P) through the sample of every pixel, camera space.
        spacing: () width of a sample's share of the pixel, as a difference of ray x or y.
    """

    poses: Pose
    swept: Swept
    clock: Clock
    ray: jax.Array
    spacing: jax.Array


class _Range(NamedTuple):
    """A range of bits, over which textures are read in parts.

    Attributes:
        mask: (W, N) bits of the range that count.
        piece: (N,) piece of time.
        start: (N,) first bit.
        length: (N,) number of bits from the first to the last, both included.
    """

    mask: jax.Array
    piece: jax.Array
    start: jax.Array
    length: jax.Array

    @property
    def bits(self) -> int:
        return WORD * self.mask.shape[0]

    def moment(self, part: Array | float) -> jax.Array:
        """Return the bit at a fraction of the range, from 0 to 1."""
        return self.start + part * self.length


def _range(mask: Array, piece: Array) -> _Range:
    first, last = first_and_last_bit(mask)
    empty = last < 0
    return _Range(mask, piece, jnp.where(empty, 0, first), jnp.where(empty, 0, last + 1 - first))


def shade_paths(
    world: World,
    view: View,
    intervals: Intervals,
    seen: UInt32[Array, "words n"],
    texture_samples: int,
) -> Float[Array, "3 pixels"]:
    """Add up the colors of all intervals and of the sky, weighted by their visible bits.

    Args:
        world: the arrays of a scene.
        view: inputs of the pass.
        intervals: sorted by cell.
        seen: (W, N) bits at which each interval is visible.
        texture_samples: static, largest number of parts of a path; fewer are read where the surface
            hardly moves under the pixel.

    Returns:
        (3, P) linear light.
    """
    pixels = view.ray.shape[1]
    pieces = view.clock.keys.shape[0] - 1
    cells = pixels * pieces
    covered = jnp.zeros((seen.shape[0], cells), jnp.uint32)
    covered = covered.at[:, jnp.minimum(intervals.cell, cells)].add(seen, mode="drop")
    total = jnp.zeros((3, pixels))

    def surface(index: Array, mask: Array) -> tuple[Array, Array]:
        cell = intervals.cell[index]
        span = _range(mask, jnp.minimum(cell // pixels, pieces - 1))
        owner = intervals.owner[index]
        return cell % pixels, _path_color(world, view, owner, cell % pixels, span, texture_samples)

    def sky(index: Array, mask: Array) -> tuple[Array, Array]:
        span = _range(mask, index // pixels)
        return index % pixels, _sky_color(world, view, index % pixels, span, texture_samples)

    total = _add_chunks(total, seen, surface)
    total = _add_chunks(total, ~covered, sky)
    return total / (WORD * seen.shape[0] * pieces)


def _add_chunks(
    total: Array, masks: Array, color: Callable[[Array, Array], tuple[Array, Array]]
) -> Array:
    """Shade the entries with a nonempty mask, `POINTS` at a time, and add them to their pixels."""
    count = masks.shape[1]
    there = jnp.any(masks != 0, axis=0)
    order = jnp.nonzero(there, size=count, fill_value=count - 1)[0].astype(jnp.int32)
    used = jnp.sum(there)

    def add(state: tuple[Array, Array]) -> tuple[Array, Array]:
        first, total = state
        number = first + jnp.arange(POINTS, dtype=jnp.int32)
        index = order[jnp.minimum(number, count - 1)]
        mask = jnp.where(number < used, masks[:, index], jnp.uint32(0))
        pixel, light = color(index, mask)
        return first + POINTS, total.at[:, pixel].add(jnp.where(number < used, light, 0.0))

    return jax.lax.while_loop(lambda s: s[0] < used, add, (jnp.int32(0), total))[1]


def _path_color(
    world: World, view: View, owner: Array, pixel: Array, span: _Range, texture_samples: int
) -> Array:
    """Sum the color (3, N) of surfaces over bits; lighting is that of the middle of the range."""
    triangle = owner % world.triangles.shape[0]
    ray = view.ray[:, pixel]
    polynomials = edge_polynomials(view.swept, owner, ray)
    forward = view.swept.forward[:, owner]
    corners = jnp.stack([world.texture[triangle, i].T for i in range(3)])
    middle = share_at(view.clock, span.piece, span.moment(0.5), span.bits)
    copies, pose = own_copies(world, view.poses, span.piece, triangle, middle)
    own = jnp.arange(owner.shape[0])
    surface = surface_at(copies, pose, own, ray, view.spacing)

    def texture(part: Array | float) -> Array:
        share = share_at(view.clock, span.piece, span.moment(part), span.bits)
        weights = corner_weights(edge_values(polynomials, share), forward)
        return jnp.einsum("in,ixn->xn", jnp.clip(weights, 0.0, 1.0), corners)

    def read(start: Array, end: Array) -> Array:
        # The box has the variance of the pixel's footprint swept along the path.
        width = jnp.hypot(surface.width, end - start)
        return albedo(copies, own, (start + end) / 2, width)

    steps = jnp.abs(texture(1.0) - texture(0.0)) / jnp.maximum(surface.width, 1e-6)
    color = _sum_parts(span, texture, read, steps, texture_samples)
    return color * irradiance(copies, pose, own, surface.weights, surface.faces_away)


def _sky_color(world: World, view: View, pixel: Array, span: _Range, texture_samples: int) -> Array:
    """Sum the color (3, N) of the sky over bits."""
    ray = view.ray[:, pixel]

    def direction(part: Array | float) -> Array:
        share = share_at(view.clock, span.piece, span.moment(part), span.bits)
        return jnp.einsum("nij,jn->in", camera_rotations(view.poses, span.piece, share), ray)

    def read(start: Array, end: Array) -> Array:
        change = end - start
        spacing = jnp.maximum(view.spacing, jnp.sqrt(jnp.max(dot(change, change))))
        return sky_color(world.light, world.noise, (start + end) / 2, spacing)

    steps = jnp.abs(direction(1.0) - direction(0.0)) / view.spacing
    return _sum_parts(span, direction, read, steps, texture_samples)


def _sum_parts(
    span: _Range,
    path: Callable[[Array | float], Array],
    read: Callable[[Array, Array], Array],
    steps: Array,
    most: int,
) -> Array:
    """Sum the values read in each part of a path, weighted by the number of bits in the part."""
    parts = jnp.clip(jnp.ceil(jnp.max(jnp.where(span.length > 0, steps, 0.0))), 1, most)

    def add(j: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        color, start, before = state
        end = path((j + 1) / parts)
        after = bits_before(span.moment((j + 1) / parts), span.bits)
        count = count_bits(span.mask & after & ~before)
        return color + count * read(start, end), end, after

    start = path(0.0)
    none = bits_before(span.moment(0.0), span.bits)
    color = jnp.zeros((3, span.start.shape[0]))
    return jax.lax.fori_loop(0, parts.astype(jnp.int32), add, (color, start, none))[0]
