"""Velocity dilation: every pixel takes the longest velocity near it, then averages along that.

    W(p) = the longest of V(q) over all q with |q - p| <= r in x and in y
    result(p) = 1/N sum_i C(p + t_i W(p))

Source: the dilation methods of McGuire et al. 2012, section 1.1, in their plainest form: the
maximum of eq. 1 and 2 over every pixel's own neighborhood, and a gather without weights.

Departures: Epic Games 2010 convolve the velocity with a Gaussian instead of taking the maximum,
and so does Sousa 2008 in one axis at a time (`iterated_blur`); a mean of opposed vectors cancels
them, a maximum does not.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

import jaxblur
from jaxblur.kernels import At, Image, Outcome, each_pixel
from jaxblur.safe_math import clamp_speed


class Velocity(NamedTuple):
    """The velocity of a pixel and its speed, by which all clamped ones tie."""

    velocity: Image


class Line(NamedTuple):
    """The axis of a pass, and pixels to either side."""

    along_x: bool
    reach: int


def longest_on_line(at: At, images: Velocity, _: None, line: Line) -> Outcome:
    """The longest velocity along one axis; of equal ones the pixel's own, then the first."""

    def compare(i, best):
        row, column = at
        if line.along_x:
            column = jnp.clip(column + i - line.reach, 0, images.velocity.width - 1)
        else:
            row = jnp.clip(row + i - line.reach, 0, images.velocity.height - 1)
        other = images.velocity.read_inside(row, column)
        longer = other[2] > best[2]
        return tuple(jnp.where(longer, a, b) for a, b in zip(other, best, strict=True))

    return Outcome(lax.fori_loop(0, 2 * line.reach + 1, compare, images.velocity.here()))


@functools.partial(jax.jit, static_argnames=("settings",))
@jaxblur.filters.honoring_mask
def velocity_dilation(
    frame: jaxblur.Frame,
    parameters: None = None,
    *,
    settings: jaxblur.Settings = jaxblur.Settings(),
    noise: jaxblur.Noise | None = None,
) -> jax.Array:
    """Blur a frame along the longest velocity within the radius."""
    height, width = frame.depth.shape
    velocity, speed = clamp_speed(frame.velocity, settings.radius)
    velocity = jnp.concatenate([velocity, speed[..., None]], axis=-1)
    for along_x in (True, False):
        velocity = each_pixel(
            *(longest_on_line, (height, width), Velocity(Image(velocity))),
            settings=Line(along_x, settings.radius),
            backend=settings.backend,
        )
    dilated = frame.replace(velocity=velocity[..., :2], path=None)
    return jaxblur.pixel_velocity(dilated, settings=settings, noise=noise)


jaxblur.register(
    jaxblur.FilterInfo(
        name="velocity_dilation",
        summary="along the longest velocity within the radius",
        function=velocity_dilation,
    )
)
