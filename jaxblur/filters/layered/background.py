"""Pass L4 of `layered`: what shows where the frame has nothing, for the pixels where that occurs.

At some (pixel, time) pairs no surface of the frame is in place: what is there was hidden behind
something that has moved away. (A slice takes the owners before and after it, so that it is filled
where one of them exists. Gaps of one time within the exposure, which open where a surface
stretches, need nothing.) In order of preference, the color is that

1. that which the caller gives (`hidden`, for experiments);
2. that of the nearest surface that a neighbor frame has there, as far as it is in the same light
   there, see `.neighbors.light_of`, and as far as the pixel's own surface could not be hidden in
   that frame by something else, see `_doubt`;
3. that of the frame itself: the mean of the surfaces behind the pixel's own that are nearest to the
   right, left, below, and above, each weighted by ``1 / distance^2`` and blurred along its own
   motion. It counts as far as the point from which the pixel's own motion would have come lies
   behind, for otherwise nothing was uncovered: a surface stretches, or comes in over the border of
   the frame.

One color is kept for each pixel, the mean over the times at which it is missing. It is
differentiable in the colors; where they are taken from is held.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ...kernels import At, Image, Outcome, each_pixel, sum_over
from ...settings import Settings
from .._sampling import find_texel
from ..parameters import LayeredParameters
from .arcs import Arc
from .clock import Maps, Span, Times, time_of_owners
from .neighbors import Neighbor
from .owners import MISSES, Coding, read_owner
from .paths import Path, Vector

DISTANCES = (1, 2, 3, 4, 6, 8, 11, 16)
"""Pixels to each side at which a surface behind is looked for."""

TIMES = (-2 / 3, 0, 2 / 3)
"""Times at which its color is read."""

STEPS = 2
"""Steps by which the point of a neighbor frame is found that is at a pixel at a time."""

MISS = 1.0
"""Pixels by which such a point may miss the pixel."""

_INSIDE = Settings(border="skip")
_SIDES = ((0, 1), (0, -1), (1, 0), (-1, 0))


class Images(NamedTuple):
    """Images that the program reads.

    Attributes:
        color: (H, W, C).
        paths: (H, W, 5), see `.paths.Path`.
        owners: (T H, W, 1), see `.owners.owners_of`.
        states: (H, W, 1), see `.owners.states_of`.
        neighbors: the frames before and after, as far as they are given.
        hidden: (T H, W, C) T images below one another at times spread evenly over the exposure;
            NaN where unknown. Or None.
        clock: tables of the shutter; None for the nominal one.
    """

    color: Image
    paths: Image
    owners: Image
    states: Image
    neighbors: tuple[Neighbor, ...]
    hidden: Image | None
    clock: Times | None


class Inputs(NamedTuple):
    """Scalars that the program uses.

    Attributes:
        parameters: of the filter.
        times: of the neighbors, in half exposures.
        span: of the shutter; None for the nominal one.
    """

    parameters: LayeredParameters
    times: tuple[Array, ...]
    span: Span | None


class Plan(NamedTuple):
    """What is fixed when the program is traced."""

    settings: Settings
    maps: Maps
    coding: Coding


class Sums(NamedTuple):
    """Sums over the times at which a pixel has no owner."""

    color: tuple[Array, ...]
    known: Array
    missing: Array


class Found(NamedTuple):
    """A color found for a time.

    Attributes:
        color: it.
        known: how surely, 0 to 1.
        depth: its log depth; infinite where there is none.
    """

    color: tuple[Array, ...]
    known: Array
    depth: Array


def mixed(found: Found, borrowed: Found) -> tuple[Sequence[Array], Array]:
    """A color of the frame and one of a neighbor, and how surely it is known."""
    there = borrowed.depth < jnp.inf
    share = jnp.where(found.known > 0, borrowed.known, 1)
    share = jnp.where(there, share, 0).astype(found.known.dtype)
    color = [a + share * (b - a) for a, b in zip(found.color, borrowed.color, strict=True)]
    return color, jnp.maximum(found.known, borrowed.known)


def background_of_pixel(at: At, images: Images, inputs: Inputs, plan: Plan) -> Outcome:
    """Pass L4 of one pixel: a color, times how much of it is known; and that."""
    own, parameters = Path(*images.paths.here()), inputs.parameters
    height, width = jnp.asarray(images.paths.height), jnp.asarray(images.paths.width)
    around = _around(at, images, own, parameters, (height, width))

    def at_time(k: Int[Array, ""]) -> Sums:
        time = time_of_owners(k, plan.maps, own.x, at.row, images.clock, inputs.span)
        owner = read_owner(at, images.owners, k, own, plan.coding, (height, width))
        found = _of_frame(at, images, own, time, around, parameters)
        zero = jnp.zeros_like(own.x)
        borrowed = Found(found.color, zero, jnp.full_like(own.x, jnp.inf))
        for neighbor, its_time in zip(images.neighbors, inputs.times, strict=True):
            own_place = place_at(own, its_time - time, its_time)
            around_x, around_y = around.velocity
            around_place = (its_time - time) * around_x, (its_time - time) * around_y
            starts = [(zero, zero), own_place, around_place]
            doubt = _doubt(at, neighbor, own, own_place, found.known, parameters)
            borrowed = of_neighbor(at, neighbor, time, starts, borrowed, doubt)
        color, known = mixed(found, borrowed)
        if images.hidden is not None:
            times = lax.div(images.hidden.height, height)
            image = jnp.minimum(lax.div(k * times, jnp.int32(plan.maps.parts)), times - 1)
            given = images.hidden.read_inside(image * height + at.row, at.column)
            is_given = given[0] == given[0]
            color = tuple(jnp.where(is_given, *pair) for pair in zip(given, color, strict=True))
            known = jnp.where(is_given, 1, known)
        share = jnp.where(owner.exists, 0, known)
        missing = jnp.where(owner.exists, 0, jnp.ones_like(own.x))
        return Sums(tuple(share * channel for channel in color), share, missing)

    def lacks(k: Int[Array, ""]) -> Array:
        return ~read_owner(at, images.owners, k, own, plan.coding, (height, width)).exists

    sums = sum_over(plan.maps.total, at_time, where=lacks)
    inverse = 1 / jnp.maximum(sums.missing, 1)
    values = (*(channel * inverse for channel in sums.color), sums.known * inverse)
    (state,) = images.states.here()
    return Outcome(values, where=state == MISSES)


class Around(NamedTuple):
    """The surfaces behind a pixel's own that are nearest to it in the frame.

    Attributes:
        color: their mean, each blurred along its motion.
        exists: whether there are any.
        velocity: their mean velocity.
    """

    color: tuple[Array, ...]
    exists: Array
    velocity: Vector


def _around(
    at: At,
    images: Images,
    own: Path,
    parameters: LayeredParameters,
    size: tuple[Array, Array],
) -> Around:
    """Search along a row and a column."""
    height, width = size
    behind = own.log_depth + 1 / parameters.surface_sharpness

    def first_behind(side: tuple[int, int]) -> Array:
        distance = jnp.zeros_like(own.x)
        for tried in DISTANCES:
            row, column = at.row + tried * side[0], at.column + tried * side[1]
            inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            row, column = jnp.where(inside, row, at.row), jnp.where(inside, column, at.column)
            depth = images.paths.read_inside(row, column, 3)[2]
            takes = (distance == 0) & inside & (depth > behind)
            distance = jnp.where(takes, jnp.asarray(tried, distance.dtype), distance)
        return distance

    def mean_color(offset: Vector, velocity: Sequence[Array]) -> tuple[Array, ...]:
        """Of a surface, blurred along its motion as far as that does not leave what is behind."""
        colors, count = [jnp.zeros_like(own.x)] * images.color.channels, jnp.zeros_like(own.x)
        for time in TIMES:
            x, y = (part + time * speed for part, speed in zip(offset, velocity, strict=True))
            texel = find_texel(at, x, y, images.color, _INSIDE, held=True)
            depth = images.paths.read_texel(texel.number, 3)[2]
            counts = texel.counts & (depth > behind)
            color = images.color.read_texel(texel.number)
            colors = [a + jnp.where(counts, b, 0) for a, b in zip(colors, color, strict=True)]
            count = count + jnp.where(counts, jnp.ones_like(count), 0)
        inverse = 1 / jnp.maximum(count, 1)
        return tuple(inverse * channel for channel in colors)

    shares, colors, velocities = [], [], []
    for side in _SIDES:
        distance = first_behind(side)
        exists = distance > 0
        shares.append(jnp.where(exists, 1 / jnp.where(exists, distance, 1) ** 2, 0))
        offset = side[1] * distance, side[0] * distance
        texel = find_texel(at, *offset, images.color, held=True)
        velocity = images.paths.read_texel(texel.number, 2)
        colors.append(mean_color(offset, velocity))
        velocities.append(velocity)
    total = _sum(shares)
    inverse = 1 / jnp.where(total > 0, total, 1)

    def mean(values: Sequence[Sequence[Array]]) -> tuple[Array, ...]:
        return tuple(
            inverse * _sum([share * value for share, value in zip(shares, channel, strict=True)])
            for channel in zip(*values, strict=True)
        )

    x, y = mean(velocities)
    return Around(mean(colors), total > 0, (x, y))


def _sum(terms: Sequence[Array]) -> Array:
    return functools.reduce(jnp.add, terms)


def _of_frame(
    at: At,
    images: Images,
    own: Path,
    time: Array,
    around: Around,
    parameters: LayeredParameters,
) -> Found:
    """What surrounds the pixel, as far as its own motion has uncovered something behind it."""
    squared = time * time
    x, y = squared * own.bend_x - time * own.x, squared * own.bend_y - time * own.y
    texel = find_texel(at, x, y, images.paths, _INSIDE, held=True)
    depth = images.paths.read_texel(texel.number, 3)[2]
    behind = jnp.clip(parameters.front_sharpness * (depth - own.log_depth), 0, 1)
    known = jnp.where(texel.counts & around.exists, behind, 0)
    return Found(around.color, known, jnp.full_like(own.x, jnp.inf))


def place_at(path: Path, away: Array, its_time: Array) -> Vector:
    """Where the point that is at the pixel at a time is in a neighbor: an offset from the pixel.

    Args:
        path: of the point.
        away: from that time to the time of the neighbor, half exposures.
        its_time: of the neighbor.
    """
    opening = path.bend_x - path.x, path.bend_y - path.y
    closing = path.bend_x + path.x, path.bend_y + path.y
    return Arc.through((*opening, *closing), 1 / jnp.abs(its_time)).at(away)


def _doubt(
    at: At,
    neighbor: Neighbor,
    own: Path,
    own_place: Vector,
    uncovered: Array,
    parameters: LayeredParameters,
) -> Callable[[Array], Array]:
    """How little a point of a neighbor counts, from 0 to 1, by its log depth.

    Where something nearer hides the place that the pixel's own surface has in the neighbor, what
    lies farther may be hidden by that surface at the pixel; unless the frame itself shows that the
    surface has moved away.
    """
    texel = find_texel(at, *own_place, neighbor.color, _INSIDE, held=True)
    depth = neighbor.motion.read_texel(texel.number)[4]
    hides = texel.counts & (depth < own.log_depth - 1 / parameters.surface_sharpness)
    covered = jnp.where(hides, 1 - uncovered, 0)

    def of_depth(depth: Array) -> Array:
        farther = parameters.front_sharpness * (depth - own.log_depth)
        return covered * jnp.clip(farther, 0, 1)

    return of_depth


def of_neighbor(
    at: At,
    neighbor: Neighbor,
    time: Array,
    starts: Sequence[Vector],
    found: Found,
    doubt: Callable[[Array], Array] | None = None,
    aside: Callable[[Array], Vector] | None = None,
) -> Found:
    """The nearest point of a neighbor frame that is at the pixel at a time, if it has one.

    A point s of the neighbor is there if ``s + d(s, t) = p``, d being its displacement. From
    each start, an offset from the pixel at which the point may be, ``s <- p - d(s, t)`` is taken a
    few times. ``doubt`` tells how little a log depth counts, from 0 to 1. ``aside`` is the further
    displacement of a log depth that a lens causes.
    """

    def displacement(x: Array, y: Array) -> tuple[Array, ...]:
        texel = find_texel(at, x, y, neighbor.color, held=True)
        ends = neighbor.motion.read_texel(texel.number)
        opening_x, opening_y, closing_x, closing_y, depth = ends
        share = (1 + time) / 2
        across = opening_x + share * (closing_x - opening_x)
        down = opening_y + share * (closing_y - opening_y)
        if aside is not None:
            aside_x, aside_y = aside(depth)
            across, down = across + aside_x, down + aside_y
        return texel.number, across, down, depth

    for x, y in starts:
        for _ in range(STEPS):
            _, across, down, _ = displacement(x, y)
            x, y = -across, -down
        number, across, down, depth = displacement(x, y)
        texel = find_texel(at, x, y, neighbor.color, _INSIDE, held=True)
        miss = jnp.square(x - texel.across + across) + jnp.square(y - texel.down + down)
        takes = texel.counts & (miss <= MISS**2) & (depth < found.depth)
        color, light = neighbor.color.read_texel(number), neighbor.light_at(texel.row, texel.column)
        light = light if doubt is None else light * (1 - doubt(depth))
        found = Found(
            tuple(jnp.where(takes, *pair) for pair in zip(color, found.color, strict=True)),
            jnp.where(takes, light, found.known),
            jnp.where(takes, depth, found.depth),
        )
    return found


def known_colors(
    program: Callable[..., Outcome], images: Any, inputs: Any, plan: Plan
) -> Float[Array, "height width channels_and_known"]:
    """Run pass L4 for all pixels.

    Args:
        program: `background_of_pixel`, or `.holes.hole_of_pixel` through a lens.
        images: of the program, among them ``color`` and ``paths``.
        inputs: scalars of the program.
        plan: what is fixed.

    Returns:
        (H, W, C + 1): a color times how much of it is known, 0 to 1, and that; 0 where something is
        there all the time, or in every map.
    """
    height, width = images.paths.values.shape[:2]
    kept = jnp.zeros((height, width, 1), images.color.values.dtype)
    return each_pixel(
        program,
        (height, width),
        images,
        inputs,
        plan,
        kept=kept,
        backend=plan.settings.backend,
    )
