"""A Fast and Stable Feature-Aware Motion Blur Filter [Guertin, McGuire, Nowrouzezahrai 2014].

The passes are numbered as in this folder's README; beside them lie chapter 3 and Annexe I.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..frame import Frame, register_record
from ..kernels import At, Image, Outcome, cond_of_values, each_pixel, sum_over, unchanged
from ..noise import Noise, resolve_noise
from ..safe_math import safe_norm, safe_normalize, shortening
from ..settings import GuertinSettings, Settings, checked_settings
from ._arguments import checked_inputs, takes
from ._masking import append_mask, divide_by_mask
from ._sampling import find_texel, path_samples, read_color, tap_position
from ._weights import (
    SPEED_FLOOR,
    anything_moves,
    cone,
    cylinder,
    finite_depth,
    floored_speed,
    relative_closeness,
)
from .parameters import GuertinParameters
from .tiles import (
    chances_of_tiles,
    chosen_tile,
    dominant_velocity,
    drawn_tile,
    own_tile,
    read_between_tiles,
    tile_variance,
)

register_record(GuertinParameters)

PERPENDICULAR = 1e-6
"""Cosines below this count as 0: the two directions are perpendicular up to rounding."""

Vector = tuple[Float[Array, "*a"], Float[Array, "*a"]]


class Motion(NamedTuple):
    """The motion of a pixel, the channels of one image.

    Attributes:
        x: of the velocity, clamped to the radius, pixels to the right.
        y: pixels downward.
        inverse_speed: ``1 / |v|_f``, 1 / pixels.
        depth: scene units, finite.
    """

    x: Float[Array, "*a"]
    y: Float[Array, "*a"]
    inverse_speed: Float[Array, "*a"]
    depth: Float[Array, "*a"]


class Buffers(NamedTuple):
    """Images of pass 1."""

    velocity: Image
    depth: Image


class Images(NamedTuple):
    """Images of passes 4 to 10.

    Attributes:
        color: (H, W, C).
        motion: (H, W, 4), see `Motion`.
        dominant: (tile rows, tile columns, 2) dominant velocity of each tile's neighborhood.
        tap_noise: (H, W, 1) in [-1, 1), or None.
        tile_noise: (H, W, 2) in [-1/2, 1/2), or None.
        variance: (tile rows, tile columns, 1) of pass 12, or None.
    """

    color: Image
    motion: Image
    dominant: Image
    tap_noise: Image | None
    tile_noise: Image | None
    variance: Image | None


class Scalars(NamedTuple):
    """Numbers of passes 4 to 11.

    Attributes:
        kappa: as in `GuertinParameters`.
        gamma: as in `GuertinParameters`.
        tau: as in `GuertinParameters`; without derivative where a tile is drawn.
        jitter: largest jitter of the samples, in spacings, ``eta phi / N``.
        depth_sharpness: as in `GuertinParameters`.
        choice: number of the tile that a pixel reads under ``tile_choice="expected"``: 0 its own,
            1 the neighbor along x, 2 the neighbor along y; else None.
    """

    kappa: Array
    gamma: Array
    tau: Array
    jitter: Array
    depth_sharpness: Array
    choice: Array | None

    @classmethod
    def of(
        cls, parameters: GuertinParameters, settings: GuertinSettings, choice: Array | None = None
    ) -> "Scalars":
        """The numbers that the passes use, of parameters that are arrays."""
        values = {name: jnp.asarray(value) for name, value in vars(parameters).items()}
        eta, phi = values.pop("eta"), values.pop("phi")
        if settings.tile_choice == "stochastic":
            values["tau"] = lax.stop_gradient(values["tau"])
        return cls(jitter=eta * phi / settings.samples, choice=choice, **values)


class Sums(NamedTuple):
    """Sums over the samples of a pixel."""

    color: tuple[Array, ...]
    weight: Array
    counted: Array


# Pass 1


def clamp_motion(at: At, images: Buffers, _: None, settings: GuertinSettings) -> Outcome:
    """Pass 1: ``v min(1, r / ||v||)``, with the other facts of a pixel's motion beside it."""
    x, y = images.velocity.here()
    (depth,) = images.depth.here()
    speed = safe_norm(x, y)
    shorter = shortening(speed, settings.radius)
    inverse_speed = 1 / floored_speed(jnp.minimum(speed, settings.radius))
    return Outcome(Motion(x * shorter, y * shorter, inverse_speed, finite_depth(depth)))


# Passes 4 to 10


def blur_pixel(at: At, images: Images, scalars: Scalars, settings: GuertinSettings) -> Outcome:
    """Passes 4 to 10: the program of Annexe I."""
    pixel = Motion(*images.motion.here())

    # Pass 4: the dominant velocity of one tile. Pass 5: nothing to do where it is short.
    dominant = images.dominant.read_inside(*read_tile(at, images, scalars, settings))
    reach = safe_norm(*dominant)
    moves = reach > SPEED_FLOOR

    # Pass 6: w_m along the dominant velocity, w_c along the pixel's own.
    along, center = two_directions((pixel.x, pixel.y), pixel.inverse_speed, dominant, scalars.gamma)

    # Passes 7 and 8: samples, every other one along w_c.
    limit = path_samples(reach, settings)
    count = settings.samples if limit is None else limit
    jitter = jnp.zeros_like(reach)
    if images.tap_noise is not None:
        (noise,) = images.tap_noise.here()
        jitter = noise * scalars.jitter
    share = None
    if images.variance is not None:
        (share,) = read_between_tiles(at, images.variance, settings.radius)

    def sample(i: Int[Array, ""]) -> Sums:
        second = follows_center(i, settings, share)
        direction = [jnp.where(second, *pair) for pair in zip(center, along, strict=True)]
        position = tap_position(i, count, jitter) * reach
        texel = find_texel(
            at, position * direction[0], position * direction[1], images.color, settings
        )
        other = Motion(*images.motion.read_texel(texel.number))

        # wA and wB: how well the pixel and the sample move along the direction (departure 4).
        along_pixel: Array | int = 1
        along_other: Array | int = 1
        if settings.direction_weights == "on":
            along_pixel = jnp.where(second, 1, _cosine(center, along))
            along_other = _cosine((other.x, other.y), direction, other.inverse_speed)

        # f cone(T, |vs|) wB + b cone(T, |vc|) wA + 2 cylinder(T, min(|vs|, |vc|)) max(wA, wB)
        distance = jnp.abs(position)
        front, back = relative_closeness(other.depth, pixel.depth, scalars.depth_sharpness)
        slower = jnp.maximum(other.inverse_speed, pixel.inverse_speed)
        weight = (
            front * cone(distance, other.inverse_speed) * along_other
            + back * cone(distance, pixel.inverse_speed) * along_pixel
            + 2 * cylinder(distance, slower) * jnp.maximum(along_pixel, along_other)
        )
        counts = texel.counts if limit is None else texel.counts & (i < count)
        weight = jnp.where(counts, weight, 0)
        colors = read_color(images.color, texel, settings.fetch)
        one, zero = jnp.ones((), weight.dtype), jnp.zeros((), weight.dtype)
        return Sums(tuple(weight * color for color in colors), weight, jnp.where(counts, one, zero))

    sums = sum_over(settings.samples, sample, limit)

    # Pass 9: the pixel itself weighs N / (kappa |vc|), N the samples that counted (pass 10).
    center_weight = sums.counted * pixel.inverse_speed / scalars.kappa
    sharp = sums.counted == 0
    inverse = 1 / jnp.where(sharp, 1, sums.weight + center_weight)
    center_share = center_weight * inverse
    blurred = [
        jnp.where(sharp, own, color * inverse + center_share * own)
        for own, color in zip(images.color.here(), sums.color, strict=True)
    ]
    return Outcome(tuple(blurred), moves)


def read_tile(
    at: At, images: Images, scalars: Scalars, settings: GuertinSettings
) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """Row and column of the tile that a pixel reads (pass 4)."""
    if scalars.choice is not None:
        return chosen_tile(at, scalars.choice, settings.radius, images.dominant)
    if settings.tile_choice == "stochastic" and images.tile_noise is not None:
        noise = images.tile_noise.here()
        return drawn_tile(at, (noise[0], noise[1]), scalars.tau, settings.radius, images.dominant)
    return own_tile(at, settings.radius)


def two_directions(
    velocity: Vector,
    inverse_speed: Float[Array, "*a"],
    dominant: tuple[Array, ...],
    gamma: float | Array,
) -> tuple[Vector, Vector]:
    """The two unit directions (pass 6): along the dominant velocity, and the center direction.

    ``w_c = normalize((1 - a) w_p + a v / ||v||)``, ``a = clip((||v|| - 0.5) / gamma, 0, 1)``,
    w_p the perpendicular of the dominant direction on the side of v.

    Source: Guertin et al. 2014, eq. 3.1, with departure 2.

    Args:
        velocity: x and y of the pixel's own velocity, pixels.
        inverse_speed: reciprocal of its floored norm, 1 / pixels.
        dominant: x and y of the dominant velocity of the neighborhood, pixels.
        gamma: speed in pixels over which the center direction turns, > 0.

    Returns:
        x and y of both; 0 where nothing moves.
    """
    along_x, along_y = safe_normalize(*dominant)
    # Compared before normalizing: where v is the dominant velocity the two products are equal to
    # the bit, and the side does not depend on rounding.
    side = jnp.where(dominant[0] * velocity[1] < dominant[1] * velocity[0], -1, 1)
    # Below the floor the share is 0, so that a vector that is too short there does no harm.
    own_share = jnp.clip((1 / inverse_speed - SPEED_FLOOR) / gamma, 0, 1)
    own_x, own_y = (part * inverse_speed for part in velocity)
    center_x = own_share * own_x - (1 - own_share) * side * along_y
    center_y = own_share * own_y + (1 - own_share) * side * along_x
    # Two unit vectors on one side: their mix is no shorter than 0.7, or 0 where nothing moves.
    squared = jnp.square(center_x) + jnp.square(center_y)
    inverse = 1 / jnp.sqrt(jnp.where(squared == 0, 1, squared))
    return (along_x, along_y), (center_x * inverse, center_y * inverse)


def follows_center(
    index: Int[Array, "*a"], settings: GuertinSettings, share: Float[Array, "*b"] | None
) -> Bool[Array, "*c"]:
    """Whether a sample follows w_c: every odd one, or the share of N, evenly interleaved.

    Args:
        index: of the sample, from 0.
        settings: its directions and samples are used.
        share: of the samples, 0 to 1 (pass 12); every odd one if None.

    Returns:
        True for those that do.
    """
    if settings.directions == "one":
        return jnp.zeros_like(index, bool)
    if share is None:
        return lax.rem(index, jnp.asarray(2, index.dtype)) == 1
    taps = jnp.round(share * settings.samples)
    return jnp.floor((index + 1) * taps / settings.samples) > jnp.floor(
        index * taps / settings.samples
    )


def _cosine(
    first: tuple[Array, ...], second: tuple[Array, ...] | list[Array], scale: float | Array = 1.0
) -> Array:
    """Cosine of the angle between two directions, without sign; 0 if they are perpendicular.

    They are so but for rounding where a still pixel's second direction meets all that moves with
    the dominant velocity; there the derivative is 0 too.
    """
    cosine = jnp.abs(first[0] * second[0] + first[1] * second[1]) * scale
    return jnp.where(cosine > PERPENDICULAR, cosine, 0)


# The filter


def prepare_images(frame: Frame, settings: GuertinSettings, noise: Noise | None) -> Images:
    """Passes 1 to 3 and 12: the images that passes 4 to 11 read.

    Args:
        frame: checked buffers without a mask.
        settings: as `guertin2014`.
        noise: as `guertin2014`.

    Returns:
        The images.
    """
    size, dtype = frame.depth.shape, frame.color.dtype
    buffers = Buffers(Image(frame.velocity), Image(frame.depth))
    motion = each_pixel(
        clamp_motion, (size[0], size[1]), buffers, None, settings, backend=settings.backend
    )
    tiles = dominant_velocity(
        frame.velocity, settings.radius, settings.diagonal_tiles, settings.soft_temperature
    )
    images = Images(Image(frame.color), Image(motion), Image(tiles), None, None, None)
    if noise is not None or settings.noise != "none":
        noise = resolve_noise(noise, settings.noise, size[0], size[1])
        images = images._replace(
            tap_noise=Image(noise.tap.astype(dtype)), tile_noise=Image(noise.tile)
        )
    if settings.split == "variance":
        images = images._replace(variance=Image(tile_variance(tiles)))
    return images


def _blur(
    settings: GuertinSettings,
    frame: Frame,
    noise: Noise | None,
    parameters: GuertinParameters,
    _: Array,
) -> Float[Array, "choices height width channels"]:
    """The image for each choice of tile."""
    images = prepare_images(frame, settings, noise)
    height, width = frame.depth.shape

    def of_choice(choice: Array | None) -> jax.Array:
        scalars = Scalars.of(parameters, settings, choice)
        return each_pixel(
            blur_pixel,
            (height, width),
            images,
            scalars,
            settings,
            kept=frame.color,
            backend=settings.backend,
        )

    if settings.tile_choice != "expected":
        return of_choice(None)[None]
    # Not by `lax.map`: where a loop is differentiated twice, JAX drops the derivative rules of the
    # functions in it. Under `jit` the three calls share one trace.
    of_choice = jax.jit(of_choice)
    return jnp.stack([of_choice(jnp.asarray(k, frame.color.dtype)) for k in range(3)])


def _keep(count: int, frame: Frame, *others: Any) -> jax.Array:
    """The same where nothing moves."""
    color = unchanged(frame.color, others[-1])
    return jnp.broadcast_to(color, (count, *color.shape))


@functools.partial(jax.jit, static_argnames=("settings",))
def _outcomes(
    frame: Frame,
    parameters: GuertinParameters,
    noise: Noise | None,
    settings: GuertinSettings,
) -> tuple[jax.Array, jax.Array]:
    masked = frame.valid is not None
    frame = append_mask(frame) if masked else frame
    frame, parameters = checked_inputs(frame, parameters, GuertinParameters)
    (height, width), radius = frame.depth.shape, settings.radius
    moves = anything_moves(frame.velocity)
    if settings.tile_choice == "expected":
        at = At(jnp.arange(height)[:, None], jnp.arange(width)[None])
        tiles = -(-height // radius), -(-width // radius)
        chances = chances_of_tiles(at, parameters.tau, radius, tiles)
        chances = jnp.stack([jnp.broadcast_to(chance, (height, width)) for chance in chances])
    else:
        chances = jnp.ones((1, height, width), frame.color.dtype)
    colors = cond_of_values(
        moves,
        functools.partial(_blur, settings),
        functools.partial(_keep, len(chances)),
        (frame, noise, parameters, moves),
    )
    return (divide_by_mask(colors) if masked else colors), chances


@functools.partial(jax.jit, static_argnames=("settings",))
def _mean(
    frame: Frame,
    parameters: GuertinParameters,
    noise: Noise | None,
    settings: GuertinSettings,
) -> jax.Array:
    colors, chances = _outcomes(frame, parameters, noise, settings)
    # As differences from the own tile, so that pixels that nothing reaches keep their bits.
    own = colors[0]
    if len(colors) == 1:
        return own
    return own + jnp.sum(chances[1:, ..., None] * (colors[1:] - own), axis=0)


@takes(GuertinParameters, GuertinSettings)
def guertin2014(
    frame: Frame,
    parameters: GuertinParameters,
    *,
    settings: Settings = GuertinSettings(),
    noise: Noise | None = None,
) -> jax.Array:
    """Blur along two directions with feature-aware weights.

    Half of the samples follow the dominant velocity of the neighborhood, half the pixel's own
    velocity (or the perpendicular of the dominant one where the pixel is still), all with reach
    ``||vmax||``. The weight of a sample is

    ``f cone(T, |vs|) wB + b cone(T, |vc|) wA + 2 cylinder(T, min(|vs|, |vc|)) max(wA, wB)``

    and the pixel itself weighs ``N / (kappa |vc|)``.

    Source: Guertin et al. 2014, chapter 3 and Annexe I, with departures 1 to 5.

    Args:
        frame: color (H, W, C), depth (H, W), velocity (H, W, 2) half-spread in pixels.
        parameters: kappa, gamma, tau, eta, phi, depth_sharpness.
        settings: `jaxblur.GuertinSettings`, or `jaxblur.Settings` for its own choices as published.
        noise: replaces the built-in noise.

    Returns:
        (H, W, C) blurred color, within the range of the colors gathered; pixels whose
        neighborhood moves by half a pixel or less are returned bit for bit. Differentiable in
        every input; tau needs ``tile_choice="expected"``. Where gamma, phi and velocity move the
        samples, the derivative is that of `jaxblur.kernels.places`.

    Raises:
        ValueError: shapes disagree, a parameter is not a scalar, or the settings are those of
            another filter.
    """
    return _mean(
        frame,
        parameters,
        noise,
        settings=checked_settings(settings, GuertinSettings, "guertin2014"),
    )


@takes(GuertinParameters, GuertinSettings)
def tile_outcomes(
    frame: Frame,
    parameters: GuertinParameters,
    *,
    settings: Settings = GuertinSettings(),
    noise: Noise | None = None,
) -> tuple[jax.Array, jax.Array]:
    """The result of `guertin2014` for each choice of tile, and the probability of each choice.

    With ``tile_choice="expected"`` these are all outcomes of ``stochastic``, so that any
    expectation over the tile jitter can be computed exactly: the mean image is ``sum_k P_k c_k``,
    the expected squared error ``sum_k P_k |c_k - truth|^2``. Otherwise there is one outcome.

    Args:
        frame: as `guertin2014`.
        parameters: as `guertin2014`.
        settings: as `guertin2014`.
        noise: as `guertin2014`.

    Returns:
        Colors (K, H, W, C) and probabilities (K, H, W) that sum to 1 over K; K is 3 for
        ``expected`` (own tile, neighbor along x, neighbor along y), else 1.

    Raises:
        ValueError: as `guertin2014`.
    """
    return _outcomes(
        frame,
        parameters,
        noise,
        settings=checked_settings(settings, GuertinSettings, "guertin2014"),
    )
