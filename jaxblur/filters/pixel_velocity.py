"""The gather along each pixel's own velocity, without dilation: the baseline."""

import functools

import jax
import jax.numpy as jnp

from ..frame import Frame, check_frame
from ..noise import Noise, resolve_noise
from ..sample_sums import sum_samples
from ..sampling import color_table, read_color, read_position, tap_position
from ..settings import Settings
from ..tiles import clamp_speed
from ..weights import SPEED_FLOOR
from .masking import honoring_mask


def _sample(size, settings, index, local, color):
    """Color of a tap on the pixel's own path, and 1 where it counts."""
    position = tap_position(index, settings.samples, local["jitter"])
    velocity_x, velocity_y = local["velocity"]
    texels = read_position(position * velocity_x, position * velocity_y, size, settings.border)
    colors = read_color(color, texels, size, settings.fetch)
    counts = texels.counts.astype(position.dtype)
    return (*(counts * color for color in colors), counts)


@functools.partial(jax.jit, static_argnames=("settings",))
@honoring_mask
def pixel_velocity(
    frame: Frame,
    parameters: None = None,
    *,
    settings: Settings = Settings(),
    noise: Noise | None = None,
) -> jax.Array:
    """Blur along the velocity of the pixel itself: the mean of the taps on ``p - v .. p + v``.

    The simplest screen-space motion blur, kept as the baseline: silhouettes of moving objects
    stay sharp, and what lies in front of them smears into them.

    Source: Rosado, Motion Blur as a Post-Processing Effect, GPU Gems 3, chapter 27, 2007; the
    taps are those of McGuire et al. 2012, jittered by half a spacing.

    Args:
        frame: color (H, W, C), depth (H, W) (not used) and velocity (H, W, 2) in pixels.
        parameters: None; there is nothing to set.
        settings: samples, radius (longest half-spread), border, fetch and noise.
        noise: replaces the built-in noise.

    Returns:
        (H, W, C) blurred color, within the range of the input; pixels that move by half a pixel
        or less are returned bit for bit. Differentiable in color, and under bilinear fetch in
        velocity.

    Raises:
        ValueError: shapes disagree.
    """
    frame = check_frame(frame)
    height, width = frame.depth.shape
    noise = resolve_noise(noise, settings.noise, height, width)
    velocity, speed = clamp_speed(frame.velocity, settings.radius)
    local = {
        "velocity": (velocity[..., :1], velocity[..., 1:]),
        "jitter": noise.tap.astype(frame.color.dtype)[..., None] / 2,
    }
    moving = speed > SPEED_FLOOR
    sample = functools.partial(_sample, (height, width), settings)
    *colors, count = sum_samples(
        sample, settings.samples, moving, local, color_table(frame.color), settings.backend
    )
    mean = jnp.stack(colors, axis=-1) / jnp.maximum(count, 1)[..., None]
    blurred = moving & (count > 0)
    return jnp.where(blurred[..., None], mean, frame.color)
