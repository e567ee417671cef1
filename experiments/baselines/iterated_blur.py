"""Iterated blur: k passes of n taps along the velocity stand for n^k taps [Sousa 2008, 2011].

The velocity is dilated first, in four passes along one axis each (x, y, x, y): a still pixel takes
the mean velocity of the moving pixels within half a radius along the axis. Then

    C_0 = C,    C_k(p) = 1/n sum_i C_{k-1}(p + t_i W(p) / n^(k-1)),    t_i = (2 i + 1) / n - 1

where W is the dilated velocity: the taps of a pass fill the gaps of the pass before it.

Source: Sousa, Crysis Next Gen Effects, GDC 2008, and CryENGINE 3 Rendering Techniques, Gamefest
2011. Read was what others write of them: McGuire et al. 2012, section 1.1 (four 1-D diffusion
passes, 9 or 24 taps), and Guertin 2014, section 2.2.3 (dilation, and n^k taps by k passes).

Departures: how the diffusion weights its taps is not published, so it is the plain mean above;
camera and object motion are one velocity; near things are not kept sharp by a mask of depth.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

import jaxblur
from jaxblur.filters._sampling import find_texel, read_color
from jaxblur.kernels import At, Image, Outcome, each_pixel, sum_over
from jaxblur.safe_math import clamp_speed

PASSES = 2
STILL = 0.5
"""Pixels: slower ones count as still."""


class Velocity(NamedTuple):
    """The image of the dilation."""

    velocity: Image


class Images(NamedTuple):
    """Images of a pass of the blur."""

    color: Image
    velocity: Image


class Diffusion(NamedTuple):
    """A pass of the dilation: its axis, and pixels to either side."""

    along_x: bool
    reach: int


class Blur(NamedTuple):
    """A pass of the blur: the divisor of the velocity, and the settings."""

    shrinking: int
    settings: jaxblur.Settings


def dilate(at: At, images: Velocity, _: None, diffusion: Diffusion) -> Outcome:
    """The mean velocity of the moving pixels along one axis, for a pixel that is still."""
    x, y = images.velocity.here()

    def neighbor(i):
        offset = i - diffusion.reach
        row = at.row if diffusion.along_x else at.row + offset
        column = at.column + offset if diffusion.along_x else at.column
        row = jnp.clip(row, 0, images.velocity.height - 1)
        column = jnp.clip(column, 0, images.velocity.width - 1)
        other_x, other_y = images.velocity.read_inside(row, column)
        moves = (other_x**2 + other_y**2 > STILL**2).astype(other_x.dtype)
        return moves * other_x, moves * other_y, moves

    sum_x, sum_y, count = sum_over(2 * diffusion.reach + 1, neighbor)
    count = jnp.maximum(count, 1)
    return Outcome((sum_x / count, sum_y / count), where=x**2 + y**2 <= STILL**2)


def blur_pixel(at: At, images: Images, _: None, blur: Blur) -> Outcome:
    """One pass of n taps, along the velocity shrunk by n to the power of the passes before."""
    x, y = (part / blur.shrinking for part in images.velocity.here())
    count = blur.settings.samples

    def sample(i):
        position = (2 * i + 1) / count - 1
        texel = find_texel(at, position * x, position * y, images.color, blur.settings)
        counts = texel.counts.astype(position.dtype)
        color = read_color(images.color, texel, blur.settings.fetch)
        return [counts * value for value in color], counts

    colors, counted = sum_over(count, sample)
    return Outcome(
        tuple(
            jnp.where(counted > 0, color / jnp.maximum(counted, 1), own)
            for color, own in zip(colors, images.color.here(), strict=True)
        ),
        where=x**2 + y**2 > STILL**2,
    )


@functools.partial(jax.jit, static_argnames=("settings",))
@jaxblur.filters.honoring_mask
def iterated_blur(
    frame: jaxblur.Frame,
    parameters: None = None,
    *,
    settings: jaxblur.Settings = jaxblur.Settings(samples=5),
    noise: jaxblur.Noise | None = None,
) -> jax.Array:
    """Blur a frame; ``settings.samples`` are the taps of one pass. Takes no noise."""
    height, width = frame.depth.shape
    size, backend = (height, width), settings.backend
    velocity, _ = clamp_speed(frame.velocity, settings.radius)
    reach = max(settings.radius // 2, 1)
    for along_x in (True, False, True, False):
        images, diffusion = Velocity(Image(velocity)), Diffusion(along_x, reach)
        velocity = each_pixel(dilate, size, images, None, diffusion, kept=velocity, backend=backend)
    color = frame.color
    for number in range(PASSES):
        images = Images(Image(color), Image(velocity))
        blur = Blur(settings.samples**number, settings)
        color = each_pixel(blur_pixel, size, images, None, blur, kept=color, backend=backend)
    return color


jaxblur.register(
    jaxblur.FilterInfo(
        name="iterated_blur",
        summary="passes of few taps along a diffused velocity [Sousa 2008]",
        function=iterated_blur,
        settings=jaxblur.Settings(samples=5),
    )
)
