"""The gather along each pixel's own velocity, without dilation: the baseline."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from ..frame import Frame, check_frame
from ..kernels import At, Image, Outcome, each_pixel, sum_over
from ..noise import Noise, resolve_noise
from ..safe_math import clamp_speed, safe_norm
from ..settings import Settings, checked_settings
from ._arguments import takes
from ._masking import honoring_mask
from ._sampling import find_texel, path_samples, read_color, tap_position
from ._weights import SPEED_FLOOR


class Images(NamedTuple):
    """Images that the program reads.

    Attributes:
        color: (H, W, C).
        velocity: (H, W, 2), clamped to the radius.
        noise: (H, W, 1) in [-1, 1).
    """

    color: Image
    velocity: Image
    noise: Image


class Sums(NamedTuple):
    """Sums over the samples of a pixel."""

    color: tuple[Array, ...]
    counted: Array


def blur_pixel(at: At, images: Images, _: None, settings: Settings) -> Outcome:
    """The mean of the samples on ``p - v .. p + v``."""
    velocity_x, velocity_y = images.velocity.here()
    speed = safe_norm(velocity_x, velocity_y)
    limit = path_samples(speed, settings)
    count = settings.samples if limit is None else limit
    (noise,) = images.noise.here()
    jitter = noise / 2

    def sample(i: Int[Array, ""]) -> Sums:
        position = tap_position(i, count, jitter)
        texel = find_texel(at, position * velocity_x, position * velocity_y, images.color, settings)
        counts = (texel.counts & (i < count)).astype(position.dtype)
        colors = read_color(images.color, texel, settings.fetch)
        return Sums(tuple(counts * color for color in colors), counts)

    sums = sum_over(settings.samples, sample, limit)
    total = jnp.maximum(sums.counted, 1)
    blurred = [
        jnp.where(sums.counted > 0, color / total, own)
        for own, color in zip(images.color.here(), sums.color, strict=True)
    ]
    return Outcome(tuple(blurred), speed > SPEED_FLOOR)


@functools.partial(jax.jit, static_argnames=("settings",))
@honoring_mask
def _blur(frame: Frame, noise: Noise | None, settings: Settings) -> jax.Array:
    frame = check_frame(frame)
    height, width = frame.depth.shape
    noise = resolve_noise(noise, settings.noise, height, width)
    velocity, _ = clamp_speed(frame.velocity, settings.radius)
    tap_noise = Image(noise.tap.astype(frame.color.dtype))
    images = Images(Image(frame.color), Image(velocity), tap_noise)
    return each_pixel(
        blur_pixel,
        (height, width),
        images,
        None,
        settings,
        kept=frame.color,
        backend=settings.backend,
    )


@takes(None, Settings)
def pixel_velocity(
    frame: Frame,
    parameters: None = None,
    *,
    settings: Settings = Settings(),
    noise: Noise | None = None,
) -> jax.Array:
    """Blur along the velocity of the pixel itself: the mean of the samples on ``p - v .. p + v``.

    The simplest screen-space motion blur, kept as the baseline: silhouettes of moving objects
    stay sharp, and objects in front of them smear into them.

    Source: Rosado, Motion Blur as a Post-Processing Effect, GPU Gems 3, chapter 27, 2007; the
    samples are those of McGuire et al. 2012, jittered by half a spacing. McGuire et al. (section
    1.1) describe the method with a test that samples lie at or behind the pixel; here is none.

    Args:
        frame: color (H, W, C), depth (H, W) (not used) and velocity (H, W, 2) in pixels.
        parameters: None; there is nothing to set.
        settings: samples, radius (longest half-spread), spacing, border, fetch, noise and backend.
        noise: replaces the built-in noise; only ``tap`` is used.

    Returns:
        (H, W, C) blurred color, within the range of the input; pixels that move by half a pixel
        or less are returned bit for bit. Differentiable in color and
        velocity.

    Raises:
        ValueError: shapes disagree, or the settings are those of another filter.
    """
    return _blur(frame, noise, settings=checked_settings(settings, Settings, "pixel_velocity"))
