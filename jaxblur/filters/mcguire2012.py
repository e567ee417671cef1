"""A Reconstruction Filter for Plausible Motion Blur [McGuire, Hennessy, Bukowski, Osman 2012]."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp

from ..frame import Frame, check_frame, check_parameters
from ..noise import Noise, resolve_noise
from ..safe_math import safe_norm
from ..sample_sums import sum_samples
from ..sampling import (
    color_table,
    read_color,
    read_nearest,
    read_position,
    tap_position,
)
from ..settings import Settings
from ..tiles import clamp_speed, dominant_velocity, own_tile
from ..weights import (
    SPEED_FLOOR,
    absolute_closeness,
    cone,
    cylinder,
    finite_depth,
    floored_speed,
)
from .masking import honoring_mask


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class McGuireParameters:
    """Parameters of McGuire 2012; floats, arrays or tracers.

    Attributes:
        soft_z_extent: depth over which foreground fades into background, in scene units, > 0.
    """

    soft_z_extent: float | jax.Array = 0.1


def _sample(size, settings, index, local, tables):
    """Weighted color and weight of a tap [listing 1]."""
    # The tap at the pixel itself is left out; the center weight stands for it.
    index = jnp.where(index >= settings.samples // 2, index + 1, index)
    position = tap_position(index, settings.samples, local["jitter"])
    offset_x, offset_y = (position * step for step in local["dominant"])
    texels = read_position(offset_x, offset_y, size, settings.border)
    if settings.fetch == "nearest":
        offset_x, offset_y = jnp.floor(offset_x + 0.5), jnp.floor(offset_y + 0.5)
    distance = safe_norm(offset_x, offset_y)
    depth, inverse_speed = local["depth"], local["inverse_speed"]
    inverse_sample = read_nearest(tables["inverse_speed"], texels.index)
    depth_sample = read_nearest(tables["depth"], texels.index)
    in_front, behind = absolute_closeness(depth_sample, depth, local["soft_z_extent"])
    both = cylinder(distance, inverse_sample) * cylinder(distance, inverse_speed)
    weight = (
        in_front * cone(distance, inverse_sample)
        + behind * cone(distance, inverse_speed)
        + 2 * both
    )
    weight = jnp.where(texels.counts, weight, 0)
    colors = read_color(tables["color"], texels, size, settings.fetch)
    return (*(weight * color for color in colors), weight)


@functools.partial(jax.jit, static_argnames=("settings",))
@honoring_mask
def mcguire2012(
    frame: Frame,
    parameters: McGuireParameters,
    *,
    settings: Settings = Settings(samples=15, radius=20),
    noise: Noise | None = None,
) -> jax.Array:
    """Blur along the dominant velocity of the neighborhood.

    ``alpha_Y = f cone(|V[Y]|) + b cone(|V[X]|) + 2 cylinder(|V[Y]|) cylinder(|V[X]|)`` at taps
    ``Y = floor(X + t v_N + 1/2)``; the pixel itself weighs ``1 / |V[X]|_f``. Distances are those
    of the rounded taps; under bilinear fetch taps are not rounded and neither are distances.

    Source: McGuire et al. 2012, listing 1 and figure 4; departure 6 (speeds are floored at half
    a pixel). The jitter is uniform in half a spacing to either side: ``noise.tap / 2``.

    Args:
        frame: color (H, W, C), depth (H, W), velocity (H, W, 2) half-spread in pixels.
        parameters: the extent of the soft depth comparison.
        settings: samples (odd), radius, border, fetch and noise; tile choice and split do not
            apply, a pixel reads its own tile.
        noise: replaces the built-in noise; only ``tap`` is used.

    Returns:
        (H, W, C) blurred color, within the range of the colors gathered; pixels whose
        neighborhood moves by half a pixel or less are returned bit for bit. Differentiable in
        color, depth, velocity and the extent.

    Raises:
        ValueError: shapes disagree, or the number of samples is even.
    """
    if settings.samples % 2 == 0:
        raise ValueError(
            f"`settings.samples` must be odd for mcguire2012, got {settings.samples}; "
            f"use {settings.samples + 1}."
        )
    check_parameters(parameters, McGuireParameters)
    frame = check_frame(frame)
    height, width = frame.depth.shape
    noise = resolve_noise(noise, settings.noise, height, width)
    velocity, speed = clamp_speed(frame.velocity, settings.radius)
    tiles = dominant_velocity(velocity, speed, settings.radius, "all").reshape(-1, 2)
    dominant = tiles[own_tile(height, width, settings.radius)[..., 0]]
    inverse_speed = 1 / floored_speed(speed)
    buffers = {"depth": finite_depth(frame.depth), "inverse_speed": inverse_speed}
    tables: dict[str, Any] = {name: buffer.reshape(-1) for name, buffer in buffers.items()}
    local = {name: buffer[..., None] for name, buffer in buffers.items()} | {
        "dominant": (dominant[..., :1], dominant[..., 1:]),
        "jitter": noise.tap.astype(frame.color.dtype)[..., None] / 2,
        "soft_z_extent": jnp.asarray(parameters.soft_z_extent, frame.color.dtype),
    }
    tables["color"] = color_table(frame.color)
    moving = safe_norm(dominant[..., 0], dominant[..., 1]) > SPEED_FLOOR
    sample = functools.partial(_sample, (height, width), settings)
    *colors, weight = sum_samples(
        sample, settings.samples - 1, moving, local, tables, settings.backend
    )
    total = jnp.stack(colors, axis=-1) + frame.color * inverse_speed[..., None]
    blurred = total / (weight + inverse_speed)[..., None]
    return jnp.where(moving[..., None], blurred, frame.color)
