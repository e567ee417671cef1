"""Pass L4 of `layered` through a lens: what is seen where a map of owners has a hole.

From a point of the lens, parts are visible that a nearer surface hides in the frame. In a map of
owners they are holes beside that surface. The background goes on across a hole, so each hole takes
the color of the deepest owners around it in the same map, and is blurred as they are. Colors of
neighbor frames are preferred, as in `.background`.

One color is kept for each pixel, the mean over the maps in which it has no owner. It is
differentiable in the colors; where they are taken from is held.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Int

from ...kernels import At, Image, Outcome, sum_over
from ..parameters import LayeredParameters
from .aperture import Aperture
from .background import DISTANCES, Found, Plan, Sums, mixed, of_neighbor, place_at
from .clock import Span, Times, time_of_owners
from .neighbors import Neighbor
from .owners import MISSES, point_of
from .paths import Path

_SIDES = ((0, 1), (0, -1), (1, 0), (-1, 0))


class Images(NamedTuple):
    """Images that the program reads.

    Attributes:
        color: (H, W, C).
        paths: (H, W, 6), see `.paths.Path`.
        owners: (T H, W, 1), see `.owners.owners_of`.
        states: (H, W, 1), see `.owners.states_of`.
        points: (1, T, 2) of the unit disc, from which the maps are seen.
        neighbors: the frames before and after, as far as they are given.
        clock: tables of the shutter; None for the nominal one.
    """

    color: Image
    paths: Image
    owners: Image
    states: Image
    points: Image
    neighbors: tuple[Neighbor, ...]
    clock: Times | None


class Inputs(NamedTuple):
    """Scalars that the program uses.

    Attributes:
        parameters: of the filter.
        aperture: the lens.
        times: of the neighbors, in half exposures.
        span: of the shutter; None for the nominal one.
    """

    parameters: LayeredParameters
    aperture: Aperture
    times: tuple[Array, ...]
    span: Span | None


class Side(NamedTuple):
    """The first owner on one side of a pixel.

    Attributes:
        mark: that it left, see `.owners.Coding`; 0 where there is none.
        distance: to it, pixels.
    """

    mark: Array
    distance: Array


def hole_of_pixel(at: At, images: Images, inputs: Inputs, plan: Plan) -> Outcome:
    """Pass L4 of one pixel: a color, times how much of it is known; and that."""
    own = Path(*images.paths.here())
    size = jnp.asarray(images.paths.height), jnp.asarray(images.paths.width)

    def in_map(k: Int[Array, ""]) -> Sums:
        (mark,) = images.owners.read_inside(k * size[0] + at.row, at.column)
        found, texel = _beside(at, images, inputs, plan, k, size)
        color, known = found.color, found.known
        if images.neighbors:
            time = time_of_owners(k, plan.maps, own.x, at.row, images.clock, inputs.span)
            beside = Path(*images.paths.read_texel(texel))
            borrowed = _borrowed(at, images, inputs, k, time, (own, beside), found)
            color, known = mixed(found, borrowed)
        missing = (mark == 0).astype(own.x.dtype)
        share = missing * known
        return Sums(tuple(share * channel for channel in color), share, missing)

    def is_hole(k: Int[Array, ""]) -> Array:
        return images.owners.read_inside(k * size[0] + at.row, at.column)[0] == 0

    sums = sum_over(plan.maps.total, in_map, where=is_hole)
    inverse = 1 / jnp.maximum(sums.missing, 1)
    values = (*(channel * inverse for channel in sums.color), sums.known * inverse)
    (state,) = images.states.here()
    return Outcome(values, where=state == MISSES)


def _beside(
    at: At, images: Images, inputs: Inputs, plan: Plan, k: Array, size: tuple[Array, Array]
) -> tuple[Found, Array]:
    """The mean color of the deepest owners beside a pixel in a map, and the texel of one."""
    width = size[1]
    sides = [_first_owner(at, images.owners, k, size, side) for side in _SIDES]
    texels, depths = [], []
    for (down, right), side in zip(_SIDES, sides, strict=True):
        moved_right, moved_down = plan.coding.offset_of(side.mark)
        exists, distance = side.mark != 0, side.distance
        row, column = at.row + down * distance - moved_down, at.column + right * distance
        texel = jnp.where(exists, row * width + column - moved_right, at.row * width + at.column)
        texels.append(texel)
        depth = images.paths.read_texel(texel, 3)[2]
        depths.append(jnp.where(exists, depth, -jnp.inf))
    deepest = functools.reduce(jnp.maximum, depths)
    weights = []
    for side, depth in zip(sides, depths, strict=True):
        nearer = jnp.where(side.mark != 0, deepest - depth, 0)
        alike = jnp.clip(2 - nearer * inputs.parameters.surface_sharpness, 0, 1)
        weights.append(
            jnp.where(side.mark != 0, alike / jnp.square(side.distance.astype(alike.dtype)), 0)
        )
    total = functools.reduce(jnp.add, weights)
    inverse = 1 / jnp.where(total > 0, total, 1)
    colors = [images.color.read_texel(texel) for texel in texels]
    color = tuple(
        inverse * sum(weight * value for weight, value in zip(weights, channel, strict=True))
        for channel in zip(*colors, strict=True)
    )
    texel = texels[0]
    for other, depth in zip(texels, depths, strict=True):
        texel = jnp.where(depth == deepest, other, texel)
    known = (total > 0).astype(total.dtype)
    return Found(color, known, jnp.full_like(total, jnp.inf)), texel


def _first_owner(
    at: At, owners: Image, k: Array, size: tuple[Array, Array], side: tuple[int, int]
) -> Side:
    """The nearest owner in a map on one side of a pixel."""
    height, width = size
    found = Side(jnp.zeros_like(at.row), jnp.ones_like(at.row))
    for distance in DISTANCES:
        row, column = at.row + distance * side[0], at.column + distance * side[1]
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        row, column = jnp.where(inside, row, at.row), jnp.where(inside, column, at.column)
        (mark,) = owners.read_inside(k * height + row, column)
        takes = inside & (mark != 0) & (found.mark == 0)
        found = Side(jnp.where(takes, mark, found.mark), jnp.where(takes, distance, found.distance))
    return found


def _borrowed(
    at: At,
    images: Images,
    inputs: Inputs,
    k: Array,
    time: Array,
    paths: Sequence[Path],
    found: Found,
) -> Found:
    """What the neighbor frames have there."""
    point = point_of(images.points, k)
    assert point is not None
    zero = jnp.zeros_like(time)
    borrowed = Found(found.color, zero, jnp.full_like(time, jnp.inf))

    def aside(log_depth: Array) -> tuple[Array, Array]:
        disc = inputs.aperture.disc(log_depth)
        return disc * point[0], disc * point[1]

    for neighbor, its_time in zip(images.neighbors, inputs.times, strict=True):
        places = [place_at(path, its_time - time, its_time) for path in paths]
        starts = [(zero, zero), *places]
        borrowed = of_neighbor(at, neighbor, time, starts, borrowed, aside=aside)
    return borrowed
