"""Pass L2 of `layered`: the path of every pixel over the exposure, ``x(t) = t v + t^2 a``.

Half the acceleration, a, comes from the frame's path where it has one. Elsewhere velocities are
taken to stay where they are in the image, so that the velocity of a point changes as it moves:
``a = bend (v . grad) v``. For a wheel that turns at a constant rate and a bend of 1/2 this is its
centripetal acceleration.
"""

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...frame import Frame
from ...kernels import At, Image, Outcome, each_pixel
from ...safe_math import safe_norm, shortening
from ...settings import Settings
from .._sampling import find_texel
from .._weights import SPEED_FLOOR
from ..parameters import LayeredParameters
from .silhouettes import Motion, cut, motion_of, taken_from

Vector = tuple[Array, Array]

TINY = 1e-6
"""Pixels by which a path may end beyond the radius: shorter bends have no finite derivative."""


class Path(NamedTuple):
    """The path of a pixel, the channels of one image.

    Attributes:
        x: of the velocity v, pixels to the right.
        y: pixels downward.
        log_depth: natural logarithm of the depth.
        bend_x: of half the acceleration a; ``||v|| + ||a||`` is within the radius.
        bend_y: likewise downward.
        disc: signed radius of the disc over which a lens spreads the pixel, pixels, negative before
            the focus; None without a lens.
    """

    x: Array
    y: Array
    log_depth: Array
    bend_x: Array
    bend_y: Array
    disc: Array | None = None

    def at(self, time: Array, point: Vector | None = None) -> Vector:
        """Displacement at a time in [-1, 1], seen from a point of the unit disc; pixels."""
        squared = time * time
        x, y = time * self.x + squared * self.bend_x, time * self.y + squared * self.bend_y
        if point is None or self.disc is None:
            return x, y
        return x + self.disc * point[0], y + self.disc * point[1]


class Images(NamedTuple):
    """Images that the program reads.

    Attributes:
        motion: (H, W, 4), see `.silhouettes.Motion`.
        path: (H, W, 4) displacement at opening and closing, or None.
    """

    motion: Image
    path: Image | None


def path_of_pixel(
    at: At, images: Images, parameters: LayeredParameters, settings: Settings
) -> Outcome:
    """Pass L2 of one pixel."""
    pixel = Motion(*images.motion.here())
    if images.path is None:
        x, y = _turn(at, images.motion, pixel, parameters.surface_sharpness, settings)
        x, y = parameters.bend * x, parameters.bend * y
    else:
        across, down = taken_from(pixel.taken_from)
        texel = find_texel(at, across, down, images.path)
        ends = cut(images.path.read_texel(texel.number))
        opening_x, opening_y, closing_x, closing_y = ends
        x, y = (opening_x + closing_x) / 2, (opening_y + closing_y) / 2
        # Shorter by as much as the velocity was made shorter.
        speed = safe_norm((closing_x - opening_x) / 2, (closing_y - opening_y) / 2)
        shorter = shortening(speed, settings.radius)
        x, y = x * shorter, y * shorter
    # A path ends within the radius.
    left = jnp.maximum(settings.radius - safe_norm(pixel.x, pixel.y), 0)
    length = safe_norm(x, y)
    too_long = (length > left) & (length > TINY)
    shorter = jnp.where(too_long, left / jnp.where(too_long, length, 1), 1)
    bent = (pixel.x, pixel.y, pixel.log_depth, x * shorter, y * shorter)
    if images.path is not None:
        return Outcome(bent)
    straight = (pixel.x, pixel.y, pixel.log_depth, jnp.zeros_like(x), jnp.zeros_like(x))
    return Outcome(bent, where=pixel.x**2 + pixel.y**2 > SPEED_FLOOR**2, otherwise=straight)


def _turn(
    at: At, motion: Image, pixel: Motion, sharpness: float | Array, settings: Settings
) -> Vector:
    """Change of velocity along the own way, ``(v . grad) v``; 0 beyond the ends of the surface."""
    x, y = pixel.x, pixel.y
    squared = jnp.square(x) + jnp.square(y)
    clamped = dataclasses.replace(settings, border="clamp")

    def change(side: float) -> tuple[Array, Array, Array]:
        index = find_texel(at, side * x, side * y, motion, clamped).number
        near_x, near_y, depth = motion.read_texel(index, 3)
        near_x, near_y = near_x - x, near_y - y
        depth_apart = jnp.abs(depth - pixel.log_depth) * sharpness
        alike = (jnp.square(near_x) + jnp.square(near_y) < squared / 4) & (depth_apart < 1)
        return jnp.where(alike, near_x, 0), jnp.where(alike, near_y, 0), alike

    ahead, back = change(0.5), change(-0.5)
    scale = jnp.where(ahead[2] & back[2], 1, 2).astype(x.dtype)
    return scale * (ahead[0] - back[0]), scale * (ahead[1] - back[1])


def paths_of(
    frame: Frame, parameters: LayeredParameters, settings: Settings
) -> Float[Array, "height width 5"]:
    """The path of every pixel (passes L1 and L2).

    Args:
        frame: see `.silhouettes.motion_of`.
        parameters: arrays.
        settings: radius and backend are used.

    Returns:
        (H, W, 5), see `Path`.
    """
    height, width = frame.depth.shape
    limits = (jnp.asarray(p) for p in (parameters.surface_sharpness, parameters.thin_coverage))
    motion = motion_of(frame, *limits, settings=settings)
    path = None if frame.path is None else Image(frame.path.reshape(height, width, 4))
    return each_pixel(
        path_of_pixel,
        (height, width),
        Images(Image(motion), path),
        parameters,
        settings,
        backend=settings.backend,
    )
