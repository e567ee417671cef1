"""Gather along the pixel's own velocity that leaves out taps on another object.

    result(p) = sum_i [id(p + t_i V(p)) = id(p)] C(p + t_i V(p)) / sum_i [id(...) = id(p)]

Source: Rosado, GPU Gems 3, chapter 27, 2007, for the gather; the object-ID buffer that keeps colors
from leaking is that of Sousa, Crysis Next Gen Effects, GDC 2008, as Navarro 2012 describes it
(section 4.3.6).

Departures: no dilation, no mask of near things. The ids are the first channel of ``frame.guide``;
a frame without one is rejected.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

import jaxblur
from jaxblur.filters._sampling import find_texel, read_color, tap_position
from jaxblur.kernels import At, Image, Outcome, each_pixel, sum_over
from jaxblur.noise import resolve_noise
from jaxblur.safe_math import clamp_speed


class Images(NamedTuple):
    """Images of the gather, of the size of the frame."""

    color: Image
    velocity: Image
    ids: Image
    noise: Image


def blur_pixel(at: At, images: Images, _: None, settings: jaxblur.Settings) -> Outcome:
    """The mean of the taps on the pixel's own object."""
    x, y = images.velocity.here()
    (own,) = images.ids.here()
    (noise,) = images.noise.here()

    def sample(i):
        position = tap_position(i, settings.samples, noise / 2)
        texel = find_texel(at, position * x, position * y, images.color, settings)
        same = texel.counts & (images.ids.read_texel(texel.number)[0] == own)
        weight = same.astype(position.dtype)
        color = read_color(images.color, texel, settings.fetch)
        return [weight * value for value in color], weight

    colors, count = sum_over(settings.samples, sample)
    return Outcome(
        tuple(
            jnp.where(count > 0, color / jnp.maximum(count, 1), sharp)
            for color, sharp in zip(colors, images.color.here(), strict=True)
        ),
        where=x**2 + y**2 > 0.25,
    )


@functools.partial(jax.jit, static_argnames=("settings",))
@jaxblur.filters.honoring_mask
def object_id_gather(
    frame: jaxblur.Frame,
    parameters: None = None,
    *,
    settings: jaxblur.Settings = jaxblur.Settings(),
    noise: jaxblur.Noise | None = None,
) -> jax.Array:
    """Blur a frame whose ``guide`` has object ids in its first channel.

    Raises:
        ValueError: the frame has no ``guide``.
    """
    if frame.guide is None:
        raise ValueError(
            "`frame.guide` must hold object ids (H, W, 1) for object_id_gather, got None; pass "
            "frame.replace(guide=ids)."
        )
    height, width = frame.depth.shape
    velocity, _ = clamp_speed(frame.velocity, settings.radius)
    tap_noise = resolve_noise(noise, settings.noise, height, width).tap
    images = Images(
        *(Image(frame.color), Image(velocity)),
        *(Image(frame.guide[..., :1]), Image(tap_noise.astype(frame.color.dtype))),
    )
    return each_pixel(
        *(blur_pixel, (height, width), images, None, settings),
        kept=frame.color,
        backend=settings.backend,
    )


jaxblur.register(
    jaxblur.FilterInfo(
        name="object_id_gather",
        summary="along the pixel's velocity, on its own object alone; needs ids",
        function=object_id_gather,
    )
)
