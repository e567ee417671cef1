"""Scatter as you gather: each tap brings its share of the exposure, the pixel keeps the rest.

Taps come in pairs at ``+-(i + 1/2 + j)`` steps along the longest velocity of the neighborhood; a
step is ``u^-1 = |v_max| / (N / 2)`` pixels. Pixel C, tap S, both of a pair at an offset of o steps:

    depth:   d_b = clip(1/2 + k z, 0, 1),  d_f = clip(1/2 - k z, 0, 1),  z = relative z_S - z_C
    spread:  s_C = clip(u |V_C| - o + 1, 0, 1),  s_S = clip(u |V_S| - o + 1, 0, 1)
    weight:  w = d_b s_C + d_f s_S
    mirror:  where tap 1 of a pair is behind and slower than tap 2, w_1 becomes w_2, and so on
    result = 1/N sum w C(S) + (1 - 1/N sum w) C(C)

The weights are divided by N and not by their sum: what no tap covers stays the pixel's own color.
The mirror rebuilds the background behind a moving edge from the other side of the pixel.

Source: Jimenez, Next Generation Post Processing in Call of Duty: Advanced Warfare, Advances in
Real-Time Rendering, SIGGRAPH 2014. Read were his summary of the talk and public descriptions of
these equations, not the slides.

Departures: depth is compared relatively, as in Guertin et al. 2014; the tile is a pixel's own,
without jitter; tiles of one speed take the same path as all others.
"""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

import jaxblur
from jaxblur.filters._sampling import find_texel, read_color
from jaxblur.filters._weights import finite_depth
from jaxblur.filters.tiles import dominant_velocity, own_tile
from jaxblur.kernels import At, Image, Outcome, each_pixel, sum_over
from jaxblur.noise import resolve_noise
from jaxblur.safe_math import clamp_speed, safe_norm


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Parameters:
    """Parameters of the filter."""

    depth_sharpness: float | jax.Array = jaxblur.parameter(
        20.0, low=0.0, meaning="k, per relative difference of depth"
    )


class Images(NamedTuple):
    """Images of the gather; the dominant velocity is one a tile."""

    color: Image
    speed_and_depth: Image
    dominant: Image
    noise: Image


def blur_pixel(
    at: At, images: Images, parameters: Parameters, settings: jaxblur.Settings
) -> Outcome:
    """The sum over pairs of taps."""
    dominant = images.dominant.read_inside(*own_tile(at, settings.radius), 2)
    longest = safe_norm(*dominant)
    pairs = settings.samples // 2
    own_speed, own_depth = images.speed_and_depth.here()
    steps_per_pixel = pairs / jnp.maximum(longest, 0.5)
    (noise,) = images.noise.here()

    def tap(offset, side):
        along = side * offset / pairs
        texel = find_texel(at, along * dominant[0], along * dominant[1], images.color, settings)
        speed, depth = images.speed_and_depth.read_texel(texel.number)
        difference = parameters.depth_sharpness * (depth - own_depth)
        difference = jnp.clip(difference / jnp.minimum(depth, own_depth), -0.5, 0.5)
        covers_own = jnp.clip(steps_per_pixel * own_speed - offset + 1, 0, 1)
        covers = jnp.clip(steps_per_pixel * speed - offset + 1, 0, 1)
        weight = (0.5 + difference) * covers_own + (0.5 - difference) * covers
        return texel, speed, depth, jnp.where(texel.counts, weight, 0)

    def pair(i):
        offset = i + 0.5 + noise / 2
        first, first_speed, first_depth, first_weight = tap(offset, 1)
        second, second_speed, second_depth, second_weight = tap(offset, -1)
        behind, slower = first_depth > second_depth, second_speed > first_speed
        weights = (
            jnp.where(behind & slower, second_weight, first_weight),
            jnp.where(behind | slower, second_weight, first_weight),
        )
        weights = [
            jnp.where(texel.counts, weight, 0)
            for texel, weight in zip((first, second), weights, strict=True)
        ]
        colors = [read_color(images.color, texel, settings.fetch) for texel in (first, second)]
        mixed = [weights[0] * one + weights[1] * other for one, other in zip(*colors, strict=True)]
        return mixed, weights[0] + weights[1]

    colors, weight = sum_over(pairs, pair)
    values = (
        color / (2 * pairs) + (1 - weight / (2 * pairs)) * own
        for color, own in zip(colors, images.color.here(), strict=True)
    )
    return Outcome(tuple(values), where=longest > 0.5)


@functools.partial(jax.jit, static_argnames=("settings",))
@jaxblur.filters.honoring_mask
def scatter_as_you_gather(
    frame: jaxblur.Frame,
    parameters: Parameters,
    *,
    settings: jaxblur.Settings = jaxblur.Settings(),
    noise: jaxblur.Noise | None = None,
) -> jax.Array:
    """Blur a frame; of an odd number of samples one is not used."""
    height, width = frame.depth.shape
    _, speed = clamp_speed(frame.velocity, settings.radius)
    tap_noise = resolve_noise(noise, settings.noise, height, width).tap
    images = Images(
        Image(frame.color),
        Image(jnp.stack([speed, finite_depth(frame.depth)], axis=-1)),
        Image(dominant_velocity(frame.velocity, settings.radius, "all")),
        Image(tap_noise.astype(frame.color.dtype)),
    )
    return each_pixel(
        *(blur_pixel, (height, width), images, parameters, settings),
        kept=frame.color,
        backend=settings.backend,
    )


def _check(settings: jaxblur.Settings) -> None:
    if settings.samples < 2:
        raise ValueError(
            "`settings.samples` must be at least 2 for scatter_as_you_gather, whose taps come in "
            f"pairs, got {settings.samples}."
        )


jaxblur.register(
    jaxblur.FilterInfo(
        name="scatter_as_you_gather",
        summary="each tap brings its share, the pixel keeps the rest [Jimenez 2014]",
        function=scatter_as_you_gather,
        parameters=Parameters,
        check=_check,
    )
)
