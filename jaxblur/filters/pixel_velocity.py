"""The gather along each pixel's own velocity, without dilation: the baseline."""

import functools

import jax
import jax.numpy as jnp

from ..frame import Frame, check_frame
from ..gathers import gather_samples
from ..native import Stages
from ..noise import Noise, resolve_noise
from ..safe_math import safe_norm
from ..sampling import channel, path_samples, read_color, read_position, sample_limit, tap_position
from ..settings import Settings, checked_settings
from ..tiles import clamp_speed
from ..weights import SPEED_FLOOR
from .masking import honoring_mask


def _is_moving(local, tables):
    """Whether the pixel itself moves."""
    velocity = [channel(local["velocity"], axis) for axis in (0, 1)]
    speed = safe_norm(*velocity)
    return speed > SPEED_FLOOR, (velocity, speed)


def _prepare(settings, local, tables, found):
    """What the taps of a pixel need."""
    velocity, speed = found
    needed = {"velocity": velocity, "jitter": local["noise"] / 2}
    return needed | path_samples(speed, settings)


def _sample(size, settings, index, local, tables):
    """Color of a tap on the pixel's own path, and 1 where it counts."""
    count = local.get("count", settings.samples)
    position = tap_position(index, count, local["jitter"])
    velocity_x, velocity_y = local["velocity"]
    texels = read_position(position * velocity_x, position * velocity_y, size, settings.border)
    colors = read_color(tables["color"], texels, size, settings.fetch)
    counts = (texels.counts & (index < count)).astype(position.dtype)
    return (*(counts * color for color in colors), counts)


def _finish(sums, prepared, local):
    """The mean of the taps that count."""
    *colors, count = sums
    total = jnp.maximum(count, 1)
    return tuple(
        jnp.where(count > 0, color / total, channel(local["color"], k))
        for k, color in enumerate(colors)
    )


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
    settings = checked_settings(settings, Settings, "pixel_velocity")
    frame = check_frame(frame)
    height, width = frame.depth.shape
    noise = resolve_noise(noise, settings.noise, height, width)
    velocity, _ = clamp_speed(frame.velocity, settings.radius)
    local = {
        "velocity": velocity,
        "noise": noise.tap.astype(frame.color.dtype)[..., None],
        "color": frame.color,
    }
    stages = Stages(
        moving=_is_moving,
        prepare=functools.partial(_prepare, settings),
        sample=functools.partial(_sample, (height, width), settings),
        finish=_finish,
        limit=sample_limit(settings),
    )
    tables = {"color": frame.color.reshape(-1)}
    return gather_samples(stages, settings.samples, frame.color, local, tables, settings.backend)
