"""Motion blur by slices of time: in each, the nearest surface that covers the pixel.

The exposure is cut into slices. In a slice at time t, in [-1, 1], the surface point that has moved
to a pixel p was, in the sharp frame, at an s with ``s + t v(s) = p``. Three guesses are made for
it: along the pixel's own velocity, and along the two velocities that matter in the neighborhood
(`.reaching`). A guess has landed if its own velocity carries it to p; of guesses that have landed
along different velocities, the nearest hides the others. Where none has landed, p's surface has
moved away and the surface behind it is not in the frame: the guess along the own velocity, if it
lies behind, stands for it. The result is the mean over the slices, so that an object covers a pixel
for as long as it is there.
"""

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from ...frame import Frame, check_frame, check_parameters, register_record
from ...kernels import At, Image, Outcome, cond_of_values, each_pixel, sum_over, unchanged
from ...noise import Noise, resolve_noise
from ...safe_math import safe_norm, shortening
from ...settings import Settings, checked_settings
from .._arguments import takes
from .._masking import honoring_mask
from .._sampling import Texel, find_texel, path_samples, read_color, read_color_along
from .._weights import SPEED_FLOOR, anything_moves
from ..builtin import LAYERED_GUESSES as GUESSES, needs_a_slice
from ..parameters import LayeredParameters
from ..tiles import own_tile
from .reaching import fine_tile, reaching_pixels
from .silhouettes import Motion, motion_of, taken_from

register_record(LayeredParameters)

SMALLEST_WEIGHT = 1e-3
"""Pixels whose slices together weigh less keep their color."""

Vector = tuple[Float[Array, "*a"], Float[Array, "*a"]]


class Images(NamedTuple):
    """Images of passes L4 to L9.

    Attributes:
        color: (H, W, C).
        motion: (H, W, 4), see `.silhouettes.Motion`.
        others: (tile rows, tile columns, 4) the two velocities that matter in each fine tile, x and
            y of each; 0 for none.
        noise: (H, W, 1) in [-1, 1).
        path: (H, W, 4) displacement at opening and closing, or None.
        hidden: (T H, W, C) T images below one another, colors of surfaces that the frame does not
            show, at times spread evenly over the exposure; NaN where unknown. Or None.
    """

    color: Image
    motion: Image
    others: Image
    noise: Image
    path: Image | None
    hidden: Image | None


class Way(NamedTuple):
    """A way to guess along.

    Attributes:
        velocity: pixels.
        turn: change of velocity along it, pixels.
        bend: how the way bends, pixels at t = 1.
        own: how surely it is the pixel's own way, 0 to 1.
    """

    velocity: Vector
    turn: Vector
    bend: Vector
    own: Float[Array, "*a"] | float


class Guess(NamedTuple):
    """A guess at the surface point that covers the pixel.

    Attributes:
        texel: where it is in the sharp frame.
        lands: how surely its own velocity carries it to the pixel, 0 to 1.
        depth: its log depth.
        color: its color.
    """

    texel: Texel
    lands: Float[Array, "*a"]
    depth: Float[Array, "*a"]
    color: tuple[Float[Array, "*a"], ...]


class Sums(NamedTuple):
    """Sums over the slices of a pixel."""

    color: tuple[Array, ...]
    weight: Array


def blur_pixel(
    at: At, images: Images, parameters: LayeredParameters, settings: Settings
) -> Outcome:
    """Passes L4 to L9: the mean over the slices of time."""
    # L4: nothing to do where the pixel does not move and no velocity reaches its tile.
    pixel = Motion(*images.motion.here())
    x, y = pixel.x, pixel.y
    squared = jnp.square(x) + jnp.square(y)
    tile = own_tile(at, fine_tile(settings.radius))
    velocities = images.others.read(*tile)
    reached = functools.reduce(jnp.logical_or, [part != 0 for part in velocities])

    # L5: the pixel's own way, and the two of the tile as far as they differ from it.
    half = half_acceleration(at, images.path, pixel.taken_from, settings.radius)
    turn = turn_along(at, images.motion, pixel, parameters.surface_sharpness, settings)
    others = [
        other_way((x, y), other, parameters.distinct) for other in (velocities[:2], velocities[2:])
    ]
    moving = squared > SPEED_FLOOR**2
    for _, own in others:
        moving = moving | (own < 1)

    # L6: slices, in each of which every way is guessed along once.
    longest = squared
    for (other_x, other_y), _ in others:
        longest = jnp.maximum(longest, jnp.square(other_x) + jnp.square(other_y))
    slices = dataclasses.replace(settings, samples=settings.samples // GUESSES)
    limit = path_samples(jnp.sqrt(longest), slices)
    count = slices.samples if limit is None else limit

    (noise,) = images.noise.here()
    jitter = noise * parameters.jitter / 2
    inverse_own = 1 / (jnp.square(parameters.own_tolerance) * (squared + SPEED_FLOOR**2))
    inverse_tolerance = 1 / jnp.square(parameters.landing_tolerance)
    front, surface = parameters.front_sharpness, parameters.surface_sharpness
    # Interpolating the other guesses too gains 0.1 dB and takes a fifth more time.
    interpolates = (settings.fetch == "bilinear", False, False)

    def make_guess(time: Array, way: Way, mixes: bool) -> Guess:
        (way_x, way_y), (turn_x, turn_y), (bend_x, bend_y), own = way
        time_squared = time * time
        offset_x = time_squared * bend_x - time * way_x
        offset_y = time_squared * bend_y - time * way_y
        texel = find_texel(at, offset_x, offset_y, images.color, settings)
        read_x, read_y, depth = images.motion.read_texel(texel.number, 3)
        apart_x, apart_y = read_x - way_x + time * turn_x, read_y - way_y + time * turn_y
        apart = jnp.square(apart_x) + jnp.square(apart_y)
        # L7: it lands if it hardly misses the pixel, or is of the pixel's surface: if neither its
        # velocity nor its depth differs. Where two of these are equal the derivative is that of
        # one.
        hits = 1.5 - time_squared * apart * inverse_tolerance
        moves_alike = 1.5 * own - apart * inverse_own
        as_deep = 1.5 * own - jnp.abs(depth - pixel.log_depth) * surface
        same = jnp.where(moves_alike < as_deep, moves_alike, as_deep)
        lands = jnp.clip(jnp.where(hits > same, hits, same), 0, 1)
        lands = jnp.where(texel.counts, lands, 0)
        if mixes:
            along_x = jnp.abs(way_x) >= jnp.abs(way_y)
            color = read_color_along(images.color, texel, along_x)
        else:
            color = read_color(images.color, texel, "nearest")
        return Guess(texel, lands, depth, color)

    def slice_of_time(i: Int[Array, ""]) -> Sums:
        ways = ways_of((x, y), turn, half, parameters.bend, others)
        times = times_of(i, count, jitter)
        guesses = [
            make_guess(time, way, mixes)
            for time, way, mixes in zip(times, ways, interpolates, strict=True)
        ]
        # L8: the nearest of the guesses that have landed hides the others.
        shares, empty = visible_shares(guesses, [way.own for way in ways], front)
        landed = list(shares)
        # Where nothing has landed: the guess along the own velocity, if it lies behind.
        own = guesses[0]
        behind = jnp.clip(front * (own.depth - pixel.log_depth), 0, 1)
        shares[0] = shares[0] + empty * jnp.where(own.texel.counts, behind, 0)
        if limit is not None:
            shares = [jnp.where(i < count, share, 0) for share in shares]
        mixed, weight = mix(shares, guesses), _sum(shares)
        if images.hidden is None:
            return Sums(tuple(mixed), weight)
        times_known = lax.div(images.hidden.height, images.color.height)
        first_row = lax.div(i * times_known, jnp.int32(slices.samples)) * images.color.height
        hidden = images.hidden.read(first_row + at.row, at.column)
        given = [
            color + empty * other for color, other in zip(mix(landed, guesses), hidden, strict=True)
        ]
        known = hidden[0] == hidden[0]
        chosen = [jnp.where(known, *pair) for pair in zip(given, mixed, strict=True)]
        return Sums(tuple(chosen), jnp.where(known, 1, weight))

    sums = sum_over(slices.samples, slice_of_time, limit)
    # L9: the mean, or the pixel's own color where nothing is known.
    blurs = moving & (sums.weight > SMALLEST_WEIGHT)
    inverse = 1 / jnp.where(blurs, sums.weight, 1)
    blurred = [
        jnp.where(blurs, color * inverse, own)
        for own, color in zip(images.color.here(), sums.color, strict=True)
    ]
    return Outcome(tuple(blurred), where=reached | (squared > SPEED_FLOOR**2))


def times_of(index: Int[Array, ""], count: Array | int, jitter: Array) -> list[Array]:
    """Times of the three guesses in slice i: thirds of the slice, the own guess in the middle.

    The other two change sides in the middle of the exposure, so that a reversed motion reads the
    same texels; in the middle slice of an odd number they join the own guess.
    """
    index = index.astype(jitter.dtype)
    center = 2 * (index + 0.5) - count
    side = jnp.sign(center)
    third, slice_length = 2 / GUESSES, 1 / count
    jitter = jitter * third * slice_length
    return [(center + side * k * third) * slice_length + jitter for k in (0, -1, 1)]


def ways_of(
    velocity: Vector,
    turn: Vector,
    half: Vector | None,
    bend: float | Array,
    others: Sequence[tuple[Vector, Array]],
) -> list[Way]:
    """The three ways to guess along.

    A point s gets to p at time t if ``s + t v(s) + t^2 a(s) = p``, a being half its acceleration;
    to second order ``s = p - t v + t^2 ((v . grad) v - a)``. Where no path gives a, velocities are
    taken to stay where they are in the image, and a is half the turn.
    """
    if half is None:
        bent = bend * turn[0], bend * turn[1]
    else:
        bent = turn[0] - half[0], turn[1] - half[1]
    ways = [Way(velocity, turn, bent, 1.0)]
    for other, own in others:
        ways.append(Way(other, (own * turn[0], own * turn[1]), (own * bent[0], own * bent[1]), own))
    return ways


def other_way(own: Vector, other: Sequence[Array], distinct: float | Array) -> tuple[Vector, Array]:
    """A velocity of the tile, and how surely it is the pixel's own one; that itself for none."""
    (x, y), (other_x, other_y) = own, other
    apart = jnp.square(other_x - x) + jnp.square(other_y - y)
    differs = jnp.clip(apart * (2 / jnp.square(distinct)) - 1, 0, 1)
    exists = (other_x != 0) | (other_y != 0)
    differs = jnp.where(exists, differs, 0)
    return (x + differs * (other_x - x), y + differs * (other_y - y)), 1 - differs


def visible_shares(
    guesses: Sequence[Guess], own: Sequence[Array | float], sharpness: float | Array
) -> tuple[list[Array], Array]:
    """Share of each landed guess in the visible color, and the share that none of them fills.

    Guesses along one velocity are of other times and do not hide each other, in so far as the
    velocity is one.
    """
    lands, depths = [guess.lands for guess in guesses], [guess.depth for guess in guesses]
    shares = list(lands)
    for j, k in itertools.combinations(range(len(lands)), 2):
        # How surely j is in front of k, or k of j. Equal depths differ by 0, whatever is rounded.
        order = jnp.clip(sharpness * (depths[k] - depths[j]), -1, 1)
        order = (1 - own[j] * own[k]) * order
        behind = jnp.maximum(order, 0)
        shares[k] = shares[k] * (1 - lands[j] * behind)
        shares[j] = shares[j] * (1 - lands[k] * (behind - order))
    empty = functools.reduce(jnp.multiply, [1 - landed for landed in lands])
    filled = (1 - empty) / jnp.maximum(_sum(shares), 1e-6)
    return [share * filled for share in shares], empty


def mix(shares: Sequence[Array], guesses: Sequence[Guess]) -> list[Array]:
    """The colors of the guesses, mixed by their shares."""
    return [
        _sum([share * color for share, color in zip(shares, channel, strict=True)])
        for channel in zip(*(guess.color for guess in guesses), strict=True)
    ]


def _sum(terms: Sequence[Array]) -> Array:
    return functools.reduce(jnp.add, terms)


def half_acceleration(at: At, path: Image | None, taken: Array, radius: int) -> Vector | None:
    """Half the acceleration of the path that a pixel's motion is from, pixels; None without one."""
    if path is None:
        return None
    across, down = taken_from(taken)
    index = find_texel(at, across, down, path).number
    opening_x, opening_y, closing_x, closing_y = path.read_texel(index)
    x, y = (opening_x + closing_x) / 2, (opening_y + closing_y) / 2
    # No longer than the radius, so that samples have a farthest place, and shorter by as much as
    # the velocity is.
    speed = safe_norm((closing_x - opening_x) / 2, (closing_y - opening_y) / 2)
    shorter = shortening(speed, radius) * shortening(safe_norm(x, y), radius)
    return x * shorter, y * shorter


def turn_along(
    at: At, motion: Image, pixel: Motion, sharpness: float | Array, settings: Settings
) -> Vector:
    """Change of velocity along the own way, ``(v . grad) v``; 0 beyond the ends of the surface."""
    x, y = pixel.x, pixel.y
    squared = jnp.square(x) + jnp.square(y)
    clamped = dataclasses.replace(settings, border="clamp")

    def change(side: float) -> tuple[Array, Array, Array]:
        index = find_texel(at, side * x, side * y, motion, clamped).number
        near_x, near_y, depth = motion.read_texel(index, 3)
        near_x, near_y = near_x - x, near_y - y
        depth_apart = jnp.abs(depth - pixel.log_depth) * sharpness
        alike = (jnp.square(near_x) + jnp.square(near_y) < squared / 4) & (depth_apart < 1)
        return jnp.where(alike, near_x, 0), jnp.where(alike, near_y, 0), alike

    ahead, back = change(0.5), change(-0.5)
    scale = jnp.where(ahead[2] & back[2], 1, 2).astype(x.dtype)
    return scale * (ahead[0] - back[0]), scale * (ahead[1] - back[1])


def _reaching_velocities(
    motion: Float[Array, "height width 4"], settings: Settings
) -> Float[Array, "rows columns 4"]:
    """The two velocities that matter in each fine tile (passes L2 and L3); 0 for none."""
    pixels = reaching_pixels(motion, settings.radius, settings.backend)
    vectors = motion.reshape(-1, motion.shape[-1])[pixels, :2]
    vectors = jnp.where((pixels >= 0)[..., None], vectors, 0)
    return jnp.concatenate(list(vectors), axis=-1)


def _blur(
    settings: Settings,
    frame: Frame,
    parameters: LayeredParameters,
    noise: Noise | None,
    hidden: jax.Array | None,
    _: Array,
) -> jax.Array:
    """The image."""
    height, width = frame.depth.shape
    noise = resolve_noise(noise, settings.noise, height, width)
    motion = motion_of(
        frame,
        jnp.asarray(parameters.surface_sharpness),
        jnp.asarray(parameters.thin_coverage),
        settings,
    )
    images = Images(
        color=Image(frame.color),
        motion=Image(motion),
        others=Image(_reaching_velocities(motion, settings)),
        noise=Image(noise.tap.astype(frame.color.dtype)),
        path=None if frame.path is None else Image(frame.path.reshape(height, width, 4)),
        hidden=None if hidden is None else Image(hidden.reshape(-1, *hidden.shape[2:])),
    )
    return each_pixel(
        *(blur_pixel, (height, width), images, parameters, settings),
        kept=frame.color,
        backend=settings.backend,
    )


def _keep(frame: Frame, *others: Any) -> jax.Array:
    """The same where nothing moves."""
    return unchanged(frame.color, others[-1])


@functools.partial(jax.jit, static_argnames=("settings",))
@honoring_mask
def _layered(
    frame: Frame,
    parameters: LayeredParameters,
    noise: Noise | None,
    hidden: jax.Array | None,
    settings: Settings,
) -> jax.Array:
    check_parameters(parameters, LayeredParameters)
    frame = check_frame(frame)
    parameters = jax.tree.map(lambda p: jnp.asarray(p, frame.color.dtype), parameters)
    vectors = frame.velocity if frame.path is None else frame.path
    anything = anything_moves(vectors)
    return cond_of_values(
        *(anything, functools.partial(_blur, settings), _keep),
        (frame, parameters, noise, hidden, anything),
    )


@takes(LayeredParameters, Settings)
def layered(
    frame: Frame,
    parameters: LayeredParameters,
    *,
    settings: Settings = Settings(radius=160, fetch="bilinear"),
    noise: Noise | None = None,
) -> jax.Array:
    """Blur by slices of time.

    Source: this project; iterative image warping (Bowles et al. 2012) per time slice, with the
    neighborhood velocities of McGuire et al. 2012 drawn as lines.

    Args:
        frame: color (H, W, C), depth (H, W), velocity (H, W, 2) half-spread in pixels; a path, if
            there is one, is followed instead of the velocity, whose derivative is 0 then.
        parameters: see `LayeredParameters`.
        settings: samples (three to a slice, the rest left over), radius, spacing, border, fetch,
            noise and backend. ``bilinear`` mixes the two texels next to the guess along the own
            velocity, along the axis that it follows more; the other guesses read the nearest texel.
            ``blend`` mixes what a slice adds for the four texels next to a guess, one guess at a
            time, the others at their nearest texel.
        noise: replaces the built-in noise; only ``tap`` is used.

    Returns:
        (H, W, C) blurred color, within the range of the colors read; pixels that nothing reaches
        are returned bit for bit. Differentiable in every input, but for the number of slices
        and the velocities that are found to reach a tile.

    Raises:
        ValueError: shapes disagree, there are fewer than three samples, a parameter is not a
            scalar, or the settings are those of another filter.
    """
    return layered_with_hidden(frame, parameters, None, settings=settings, noise=noise)


def layered_with_hidden(
    frame: Frame,
    parameters: LayeredParameters,
    hidden: ArrayLike | None,
    *,
    settings: Settings = Settings(radius=160, fetch="bilinear"),
    noise: Noise | None = None,
) -> jax.Array:
    """`layered`, given the colors of surfaces that the frame does not show.

    A hook for experiments: how much of the error is due to hidden background.

    Args:
        frame: as `layered`, without a mask.
        parameters: as `layered`.
        hidden: (T, H, W, C) color of the visible surface at T times spread evenly over the
            exposure, used where no guess lands; NaN where unknown. None for `layered` itself.
        settings: as `layered`; no spacing.
        noise: as `layered`.

    Returns:
        As `layered`.

    Raises:
        ValueError: as `layered`, or the hidden colors have another shape, or there is a spacing or
            a mask beside them.
    """
    settings = checked_settings(settings, Settings, "layered")
    needs_a_slice(settings)
    if hidden is not None:
        hidden, expected = jnp.asarray(hidden), jnp.shape(frame.color)
        if hidden.ndim != 4 or hidden.shape[1:] != expected:
            raise ValueError(f"`hidden` must have shape (T, *{expected}), got {hidden.shape}.")
        if settings.spacing or frame.valid is not None:
            raise ValueError("`hidden` works without `settings.spacing` and `frame.valid` only.")
    return _layered(frame, parameters, noise, hidden, settings=settings)
