"""Motion blur by slices of time: in each, the nearest surface that covers the pixel.

The exposure is cut into slices. Who is in front at a pixel is known at some times of the exposure:
every pixel has been drawn there along its path (`.owners`). A slice takes the owners at the times
before and after it. Along the path of each it guesses which point has moved to the pixel at a time
inside the slice. A guess has landed if that point's own path carries it to the pixel; of landed
guesses along different paths the nearest hides the other. Where none has landed, the surface is
not in the frame, and `.background` stands for it. The result is the mean over the slices, so that
an object covers a pixel for as long as it is there. A slice of which nothing is known shows
something that was hidden: it takes the mean of what the pixel shows at other times and that is not
in front of the pixel's own surface.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from ...kernels import At, Image, Outcome, sum_over
from ...settings import Settings
from .._sampling import find_texel, path_samples, read_color, read_color_along
from .._weights import SPEED_FLOOR
from ..parameters import LayeredParameters
from .clock import Maps, Span, Times, time_of_light, time_of_owners
from .owners import RESTS, Coding, moving_owner, read_owner
from .paths import Path

SMALLEST_WEIGHT = 1e-3
"""Pixels whose slices together weigh less keep their color."""

SMALLEST_REAR = 0.5
"""For how many slices a pixel must show its rear before the rear stands for all that is missing.
Below, a guess that hardly lands would stand for many slices, and its derivative would be noise."""


class Images(NamedTuple):
    """Images of pass L5.

    Attributes:
        color: (H, W, C).
        paths: (H, W, 5), see `.paths.Path`.
        owners: (T H, W, 1), see `.owners.owners_of`.
        states: (H, W, 1), see `.owners.states_of`.
        background: (H, W, C + 1), see `.background.known_colors`.
        noise: (H, W, 1) in [-1, 1).
        clock: tables of the shutter; None for the nominal one.
    """

    color: Image
    paths: Image
    owners: Image
    states: Image
    background: Image
    noise: Image
    clock: Times | None


class Inputs(NamedTuple):
    """Scalars of pass L5.

    Attributes:
        parameters: of the filter.
        span: of the shutter; None for the nominal one.
    """

    parameters: LayeredParameters
    span: Span | None


class Guess(NamedTuple):
    """A guess at the surface point that covers the pixel.

    Attributes:
        way: the path that it was guessed along.
        lands: how surely its own path carries it to the pixel, 0 to 1.
        depth: its log depth.
        color: its color.
        weight: what it counts, 1 but for its derivative in the shutter's curve; None for the
            nominal shutter.
    """

    way: Path
    lands: Array
    depth: Array
    color: tuple[Array, ...]
    weight: Array | None


class Sums(NamedTuple):
    """Sums over the slices of a pixel."""

    color: tuple[Array, ...]
    weight: Array


class SliceSums(NamedTuple):
    """What is summed over the slices.

    Attributes:
        seen: what is known.
        rear: the part of it that is not in front of the pixel's own surface.
        light: what the slices count.
    """

    seen: Sums
    rear: Sums
    light: Array


class Plan(NamedTuple):
    """What is fixed when the program is traced.

    Attributes:
        settings: of the filter.
        slices: number of slices.
        maps: of owners.
        coding: of the owners.
    """

    settings: Settings
    slices: int
    maps: Maps
    coding: Coding


class Slice(NamedTuple):
    """What a pixel shows in a slice.

    Attributes:
        color: times how surely it is known.
        known: how surely, 0 to 1.
        rear: the part of `color` and `known` that is not in front of the pixel's own surface.
        light: what the slice counts, 1 but for its derivative in the shutter's curve (color and
            `known` have it as a factor); None for the nominal shutter.
    """

    color: tuple[Array, ...]
    known: Array
    rear: Sums
    light: Array | None


def blur_pixel(at: At, images: Images, inputs: Inputs, plan: Plan) -> Outcome:
    """Pass L5: the mean over the slices of time."""
    limit = None
    if plan.settings.spacing:
        limit = slices_along(longest_motion(at, images.paths, images.owners, plan), plan)
    slice_at = slices_at(at, images, inputs, plan, limit)

    def slice_of_time(i: Int[Array, ""]) -> SliceSums:
        color, known, rear, light = slice_at(i)
        light = jnp.ones_like(known) if light is None else light
        sums = SliceSums(Sums(color, known), rear, light)
        if limit is not None:
            taken = i < limit
            sums = jax.tree.map(lambda value: jnp.where(taken, value, 0), sums)
        return sums

    sums = sum_over(plan.slices, slice_of_time, limit)
    (state,) = images.states.here()
    return Outcome(mean_of(filled(*sums), images.color.here()), where=state != RESTS)


def filled(seen: Sums, rear: Sums, light: Array) -> Sums:
    """Sums in which the mean of what is in the rear stands for what is not known.

    What is in front at some time is in the frame, so that what is missing was hidden behind
    something. Without this a thing that passes in front of it would be seen for too long.

    Args:
        seen: what is known.
        rear: the part of it that is not in front of the pixel's own surface.
        light: what all slices count.
    """
    missing = jnp.maximum(light - seen.weight, 0)
    share = missing / jnp.maximum(rear.weight, SMALLEST_REAR)
    return Sums(
        tuple(a + share * b for a, b in zip(seen.color, rear.color, strict=True)),
        seen.weight + share * rear.weight,
    )


def mean_of(sums: Sums, sharp: Sequence[Array]) -> tuple[Array, ...]:
    """The mean color of the slices, or the sharp one where nothing is known."""
    blurs = sums.weight > SMALLEST_WEIGHT
    inverse = 1 / jnp.where(blurs, sums.weight, 1)
    return tuple(
        jnp.where(blurs, color * inverse, kept)
        for kept, color in zip(sharp, sums.color, strict=True)
    )


def longest_motion(at: At, paths: Image, owners: Image, plan: Plan) -> Array:
    """The squared speed of the fastest of what a pixel shows and the pixel itself."""
    own = Path(*paths.here())
    size = jnp.asarray(paths.height), jnp.asarray(paths.width)
    longest = squared_reach(own)
    for k in range(plan.maps.total):
        owner = read_owner(at, owners, jnp.int32(k), own, plan.coding, size)
        path = Path(*paths.read_texel(owner.texel))
        longest = jnp.maximum(longest, squared_reach(path))
    return longest


def squared_reach(path: Path) -> Array:
    """The squared speed of a path, longer by its disc."""
    squared = path.x**2 + path.y**2
    if path.disc is None:
        return squared
    return jnp.square(jnp.sqrt(squared) + jnp.abs(path.disc))


def slices_along(longest: Array, plan: Plan) -> Array | None:
    """The number of slices for a squared speed; None where every pixel has all."""
    slices = dataclasses.replace(plan.settings, samples=plan.slices)
    return path_samples(jnp.sqrt(longest), slices)


def slices_at(
    at: At, images: Images, inputs: Inputs, plan: Plan, limit: Array | None
) -> Callable[[Array], Slice]:
    """What a pixel shows in each slice.

    Args:
        at: the pixel.
        images: see `Images`.
        inputs: scalars.
        plan: what is fixed.
        limit: number of slices; None for all of the plan.

    Returns:
        Maps the number of a slice to it.
    """
    settings, maps, parameters = plan.settings, plan.maps, inputs.parameters
    own = Path(*images.paths.here())
    count = plan.slices if limit is None else limit
    (noise,) = images.noise.here()
    jitter = noise * parameters.jitter / 2
    inverse_tolerance = 1 / jnp.square(parameters.landing_tolerance)
    sharpness = parameters.surface_sharpness
    *behind, known = images.background.here()

    def make_guess(light: Array, index: Array) -> Guess:
        time, weight = time_of_light(light, at.row, images.clock, inputs.span)
        own_time = time_of_owners(index, maps, own.x, at.row, images.clock, inputs.span)
        owner = moving_owner(at, images.owners, images.paths, index, own_time, plan.coding)
        way = Path(*images.paths.read_texel(owner.texel))
        # The owner is at the pixel at its own time. From there the point that is at the pixel at
        # another time is found along its velocity, which is exact where the surface turns or moves.
        squared = own_time * own_time
        offset_x = -time * way.x - squared * way.bend_x
        offset_y = -time * way.y - squared * way.bend_y
        texel = find_texel(at, offset_x, offset_y, images.color, settings)
        x, y, depth = images.paths.read_texel(texel.number, 3)
        point = Path(x, y, depth, way.bend_x, way.bend_y)
        there_x, there_y = point.at(time)
        miss = jnp.square(offset_x + there_x) + jnp.square(offset_y + there_y)
        lands = landing(miss * inverse_tolerance, point, way, parameters)
        lands = jnp.where(texel.counts & owner.exists, lands, 0)
        if settings.fetch == "bilinear":
            along_x = jnp.abs(way.x) >= jnp.abs(way.y)
            color = read_color_along(images.color, texel, along_x)
        else:
            color = read_color(images.color, texel, "nearest")
        return Guess(way, lands, point.log_depth, color, weight)

    def slice_at(i: Array) -> Slice:
        # The owners before and after the slice, each for a time in its own half of it.
        first = ((2 * i + 1).astype(own.x.dtype) * (maps.parts / 2) / count).astype(jnp.int32)
        # Beyond its own number of slices a pixel is evaluated too, beside others with more.
        first = jnp.minimum(first, maps.parts - 1)
        center = (2 * i + 1).astype(own.x.dtype) - count
        before, after = (
            make_guess((center + side / 2 + jitter) / count, first + k)
            for side, k in ((-1, 0), (1, 1))
        )
        # The nearer one hides the other, as far as they move apart.
        shares, empty = visible_shares(before, after, parameters)
        light = None
        if before.weight is not None and after.weight is not None:
            light = (before.weight + after.weight) / 2
            shares = [shares[0] * before.weight, shares[1] * after.weight]
            empty = empty * light
        color = [
            shares[0] * a + shares[1] * b + empty * c
            for a, b, c in zip(before.color, after.color, behind, strict=True)
        ]
        # A background is behind. A guess is in the rear unless its surface is another, and nearer.
        rears = [
            share * jnp.clip(1.5 - sharpness * (own.log_depth - guess.depth), 0, 1)
            for share, guess in zip(shares, (before, after), strict=True)
        ]
        rear_color = [
            rears[0] * a + rears[1] * b + empty * c
            for a, b, c in zip(before.color, after.color, behind, strict=True)
        ]
        rear = Sums(tuple(rear_color), rears[0] + rears[1] + empty * known)
        return Slice(tuple(color), shares[0] + shares[1] + empty * known, rear, light)

    return slice_at


def landing(miss: Array, point: Path, way: Path, parameters: LayeredParameters) -> Array:
    """How surely a guess has landed, 0 to 1.

    It has if it hardly misses the pixel, or is of the owner's surface: if neither its velocity nor
    its depth differs. Where two of these are equal the derivative is that of one. What bends its
    path is nearly what bends the owner's.

    Args:
        miss: squared distance by which the point misses the pixel, in squared tolerances.
        point: path of the point that was read.
        way: path of the owner.
        parameters: of the filter.
    """
    apart = jnp.square(point.x - way.x) + jnp.square(point.y - way.y)
    speed = jnp.square(way.x) + jnp.square(way.y)
    alike = jnp.square(parameters.own_tolerance) * (speed + SPEED_FLOOR**2)
    hits = 1.5 - miss
    moves_alike = 1.5 - apart / alike
    as_deep = 1.5 - jnp.abs(point.log_depth - way.log_depth) * parameters.surface_sharpness
    same = jnp.where(moves_alike < as_deep, moves_alike, as_deep)
    return jnp.clip(jnp.where(hits > same, hits, same), 0, 1)


def visible_shares(
    first: Guess, second: Guess, parameters: LayeredParameters
) -> tuple[list[Array], Array]:
    """Share of each landed guess in the visible color, and the share that neither fills.

    Guesses along one path are of other times and do not hide each other, in so far as the
    velocity is one.
    """
    apart = jnp.square(first.way.x - second.way.x) + jnp.square(first.way.y - second.way.y)
    differ = jnp.clip(apart * (2 / jnp.square(parameters.distinct)) - 1, 0, 1)
    # How surely the first is in front, or the second. Equal depths differ by 0.
    order = differ * jnp.clip(parameters.front_sharpness * (second.depth - first.depth), -1, 1)
    behind = jnp.maximum(order, 0)
    shares = [
        first.lands * (1 - second.lands * (behind - order)),
        second.lands * (1 - first.lands * behind),
    ]
    empty = (1 - first.lands) * (1 - second.lands)
    filled = (1 - empty) / jnp.maximum(shares[0] + shares[1], 1e-6)
    return [share * filled for share in shares], empty
