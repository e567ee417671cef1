"""A Reconstruction Filter for Plausible Motion Blur [McGuire, Hennessy, Bukowski, Osman 2012]."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..frame import Frame, register_record
from ..kernels import At, Image, Outcome, each_pixel, sum_over
from ..noise import Noise, resolve_noise
from ..safe_math import safe_norm
from ..settings import McGuireSettings, Settings, checked_settings
from ._arguments import checked_inputs, takes
from ._masking import honoring_mask
from ._sampling import find_texel, path_samples, read_color, tap_position
from ._weights import (
    SPEED_FLOOR,
    absolute_closeness,
    cone,
    cylinder,
    finite_depth,
    floored_speed,
)
from .builtin import needs_odd_samples
from .parameters import McGuireParameters
from .tiles import dominant_velocity, own_tile

register_record(McGuireParameters)


class Motion(NamedTuple):
    """The motion of a pixel, the channels of one image.

    Attributes:
        inverse_speed: ``1 / |V|_f``, 1 / pixels.
        depth: scene units, finite.
    """

    inverse_speed: Float[Array, "*a"]
    depth: Float[Array, "*a"]


class Buffers(NamedTuple):
    """Images of pass 1."""

    velocity: Image
    depth: Image


class Images(NamedTuple):
    """Images of the gather.

    Attributes:
        color: (H, W, C).
        motion: (H, W, 2), see `Motion`.
        dominant: (tile rows, tile columns, 2) dominant velocity of each tile's neighborhood.
        noise: (H, W, 1) in [-1, 1).
    """

    color: Image
    motion: Image
    dominant: Image
    noise: Image


class Sums(NamedTuple):
    """Sums over the samples of a pixel."""

    color: tuple[Array, ...]
    weight: Array


def clamp_motion(at: At, images: Buffers, _: None, settings: Settings) -> Outcome:
    """Pass 1: the speed of a pixel, clamped to the radius, and its depth."""
    (depth,) = images.depth.here()
    speed = jnp.minimum(safe_norm(*images.velocity.here()), settings.radius)
    return Outcome(Motion(1 / floored_speed(speed), finite_depth(depth)))


def blur_pixel(
    at: At, images: Images, parameters: McGuireParameters, settings: Settings
) -> Outcome:
    """The gather of listing 1."""
    pixel = Motion(*images.motion.here())
    dominant = images.dominant.read_inside(*own_tile(at, settings.radius))
    reach = safe_norm(*dominant)

    limit = path_samples(reach, settings)
    count = settings.samples if limit is None else limit
    (noise,) = images.noise.here()
    jitter = noise / 2

    def sample(i: Int[Array, ""]) -> Sums:
        exists = i < count - 1
        # The sample at the pixel itself is left out; the center weight stands for it.
        i = jnp.where(2 * i >= count - 1, i + 1, i)
        position = tap_position(i, count, jitter)
        offset_x, offset_y = (position * step for step in dominant)
        texel = find_texel(at, offset_x, offset_y, images.color, settings)
        if settings.fetch != "bilinear":
            offset_x = (texel.column - at.column).astype(position.dtype)
            offset_y = (texel.row - at.row).astype(position.dtype)
        distance = safe_norm(offset_x, offset_y)
        other = Motion(*images.motion.read_texel(texel.number))

        # f cone(|V[Y]|) + b cone(|V[X]|) + 2 cylinder(|V[Y]|) cylinder(|V[X]|)
        front, back = absolute_closeness(other.depth, pixel.depth, parameters.soft_z_extent)
        both = cylinder(distance, other.inverse_speed) * cylinder(distance, pixel.inverse_speed)
        weight = (
            front * cone(distance, other.inverse_speed)
            + back * cone(distance, pixel.inverse_speed)
            + 2 * both
        )
        weight = jnp.where(texel.counts & exists, weight, 0)
        colors = read_color(images.color, texel, settings.fetch)
        return Sums(tuple(weight * color for color in colors), weight)

    sums = sum_over(settings.samples - 1, sample, limit)

    # The pixel itself weighs 1 / |V[X]|_f, less where fewer samples stand for the path.
    share = 1.0 if limit is None else limit / settings.samples
    center_weight = pixel.inverse_speed * share
    total = sums.weight + center_weight
    blurred = [
        (color + center_weight * own) / total
        for own, color in zip(images.color.here(), sums.color, strict=True)
    ]
    return Outcome(tuple(blurred), reach > SPEED_FLOOR)


@functools.partial(jax.jit, static_argnames=("settings",))
@honoring_mask
def _blur(
    frame: Frame, parameters: McGuireParameters, noise: Noise | None, settings: Settings
) -> jax.Array:
    frame, parameters = checked_inputs(frame, parameters, McGuireParameters)
    height, width = frame.depth.shape
    noise = resolve_noise(noise, settings.noise, height, width)
    run = functools.partial(each_pixel, size=(height, width), backend=settings.backend)
    buffers = Buffers(Image(frame.velocity), Image(frame.depth))
    images = Images(
        color=Image(frame.color),
        motion=Image(run(clamp_motion, images=buffers, settings=settings)),
        dominant=Image(dominant_velocity(frame.velocity, settings.radius, "all")),
        noise=Image(noise.tap.astype(frame.color.dtype)),
    )
    return run(
        blur_pixel, images=images, parameters=parameters, settings=settings, kept=frame.color
    )


@takes(McGuireParameters, McGuireSettings)
def mcguire2012(
    frame: Frame,
    parameters: McGuireParameters,
    *,
    settings: Settings = McGuireSettings(),
    noise: Noise | None = None,
) -> jax.Array:
    """Blur along the dominant velocity of the neighborhood.

    ``alpha_Y = f cone(|V[Y]|) + b cone(|V[X]|) + 2 cylinder(|V[Y]|) cylinder(|V[X]|)`` at samples
    ``Y = floor(X + t v_N + 1/2)``; the pixel itself weighs ``1 / |V[X]|_f``. Distances are those
    of the rounded samples; under bilinear fetch neither samples nor distances are rounded.

    Source: McGuire et al. 2012, listing 1 and figure 4; departure 6 (speeds are floored at half
    a pixel). The jitter is uniform in half a spacing to either side: ``noise.tap / 2``.

    Args:
        frame: color (H, W, C), depth (H, W), velocity (H, W, 2) half-spread in pixels.
        parameters: the extent of the soft depth comparison.
        settings: samples (odd), radius, spacing, border, fetch, noise and backend; a pixel reads
            its own tile.
        noise: replaces the built-in noise; only ``tap`` is used.

    Returns:
        (H, W, C) blurred color, within the range of the colors gathered; pixels whose
        neighborhood moves by half a pixel or less are returned bit for bit. Differentiable in
        color, depth, velocity and the extent.

    Raises:
        ValueError: shapes disagree, the number of samples is even, the extent is not a scalar, or
            the settings are those of another filter.
    """
    settings = checked_settings(settings, McGuireSettings, "mcguire2012")
    needs_odd_samples(settings)
    return _blur(frame, parameters, noise, settings=settings)
