"""A Reconstruction Filter for Plausible Motion Blur [McGuire, Hennessy, Bukowski, Osman 2012]."""

import functools

import jax
import jax.numpy as jnp

from ..frame import Frame, check_frame, check_parameters
from ..gathers import gather_samples
from ..native import Stages
from ..noise import Noise, resolve_noise
from ..safe_math import safe_norm
from ..sampling import (
    channel,
    path_samples,
    read_color,
    read_position,
    read_row,
    sample_limit,
    tap_position,
)
from ..settings import Settings, checked_settings
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
from .parameters import McGuireParameters as McGuireParameters

jax.tree_util.register_dataclass(McGuireParameters)


def _sample(size, settings, index, local, tables):
    """Weighted color and weight of a tap [listing 1]."""
    count = local.get("count", settings.samples)
    exists = index < count - 1
    # The tap at the pixel itself is left out; the center weight stands for it.
    index = jnp.where(2 * index >= count - 1, index + 1, index)
    position = tap_position(index, count, local["jitter"])
    offset_x, offset_y = (position * step for step in local["dominant"])
    texels = read_position(offset_x, offset_y, size, settings.border)
    if settings.fetch == "nearest":
        offset_x, offset_y = jnp.floor(offset_x + 0.5), jnp.floor(offset_y + 0.5)
    distance = safe_norm(offset_x, offset_y)
    depth, inverse_speed = local["depth"], local["inverse_speed"]
    inverse_sample, depth_sample = read_row(tables["motion"], texels.index, 2)
    in_front, behind = absolute_closeness(depth_sample, depth, local["soft_z_extent"])
    both = cylinder(distance, inverse_sample) * cylinder(distance, inverse_speed)
    weight = (
        in_front * cone(distance, inverse_sample)
        + behind * cone(distance, inverse_speed)
        + 2 * both
    )
    weight = jnp.where(texels.counts & exists, weight, 0)
    colors = read_color(tables["color"], texels, size, settings.fetch)
    return (*(weight * color for color in colors), weight)


def _is_moving(settings, local, tables):
    """Whether anything moves in the neighborhood, and the dominant velocity there."""
    tile = own_tile(local["motion"].shape, settings.radius)
    dominant = read_row(tables["dominant"], tile, 2)
    reach = safe_norm(*dominant)
    return reach > SPEED_FLOOR, (dominant, reach)


def _prepare(settings, local, tables, found):
    """What the taps of a pixel need."""
    dominant, reach = found
    needed = {
        "dominant": dominant,
        "inverse_speed": channel(local["motion"], 0),
        "depth": channel(local["motion"], 1),
        "jitter": local["noise"] / 2,
        "soft_z_extent": local["soft_z_extent"],
    }
    return needed | path_samples(reach, settings)


def _finish(settings, sums, prepared, local):
    """The weighted mean; the pixel itself weighs more where fewer taps stand for a path."""
    *colors, weight = sums
    share = prepared.get("count", settings.samples) / settings.samples
    center_weight = prepared["inverse_speed"] * share
    total = weight + center_weight
    return tuple(
        (color + center_weight * channel(local["color"], k)) / total
        for k, color in enumerate(colors)
    )


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
        settings: samples (odd), radius, spacing, border, fetch and noise; tile choice and split
            do not apply, a pixel reads its own tile.
        noise: replaces the built-in noise; only ``tap`` is used.

    Returns:
        (H, W, C) blurred color, within the range of the colors gathered; pixels whose
        neighborhood moves by half a pixel or less are returned bit for bit. Differentiable in
        color, depth, velocity and the extent.

    Raises:
        ValueError: shapes disagree, or the number of samples is even.
    """
    settings = checked_settings(settings, Settings, "mcguire2012")
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
    dominant = dominant_velocity(velocity, speed, settings.radius, "all")
    motion = jnp.stack([1 / floored_speed(speed), finite_depth(frame.depth)], axis=-1)
    local = {
        "motion": motion,
        "noise": noise.tap.astype(frame.color.dtype)[..., None],
        "soft_z_extent": jnp.asarray(parameters.soft_z_extent, frame.color.dtype),
        "color": frame.color,
    }
    images = {"motion": motion, "dominant": dominant, "color": frame.color}
    tables = {name: image.reshape(-1) for name, image in images.items()}
    stages = Stages(
        moving=functools.partial(_is_moving, settings),
        prepare=functools.partial(_prepare, settings),
        sample=functools.partial(_sample, (height, width), settings),
        finish=functools.partial(_finish, settings),
        limit=sample_limit(settings),
    )
    taps = settings.samples - 1
    return gather_samples(stages, taps, frame.color, local, tables, settings.backend)
