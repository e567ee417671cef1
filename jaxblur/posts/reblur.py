"""Reblur: the mean of three pixels along the motion, against the noise that a blur leaves."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..frame import Frame, check_frame, check_parameters, register_record
from ..kernels import At, Image, Outcome, each_pixel
from ..safe_math import safe_norm
from ..settings import Backend
from ._inputs import beside, checked_image


@register_record
@dataclasses.dataclass(frozen=True)
class ReblurParameters:
    """Parameters of `reblur`.

    Attributes:
        shortest: half-spread in pixels from which pixels are mixed: a shorter blur has details of
            the size of a pixel.
        alike: largest difference of two velocities of one motion, as a share of the pixel's.
        surface: largest difference of two depths of one surface, as a share of the larger one.
        noise: difference of square roots of light at which a neighbor counts ``1/e``; larger
            differences are picture and not noise. Infinite: all count alike.
    """

    shortest: float | jax.Array = 4.0
    alike: float | jax.Array = 0.5
    surface: float | jax.Array = 0.05
    noise: float | jax.Array = 0.1


class Images(NamedTuple):
    """Images of the program: (H, W, C) blurred color, (H, W, 2) half-spread, (H, W, 1) depth."""

    color: Image
    velocity: Image
    depth: Image


def mean_along(at: At, images: Images, parameters: ReblurParameters, _: None) -> Outcome:
    """The mean of a pixel and of what is one pixel before and after it along its motion.

        C'[p] = sum_k w_k C[p + k u] / sum_k w_k,   u = v / ||v||,   k = -1, 0, 1
        w_k = exp(-(max over channels |sqrt C[p + k u] - sqrt C[p]| / noise)^2)

    where the pixel nearest to ``p + k u`` is of the same motion and surface, else 0; ``w_0`` is 1.
    """
    x, y = images.velocity.here()
    (depth,) = images.depth.here()
    own = images.color.here()
    speed = safe_norm(x, y)
    moves = speed > parameters.shortest
    inverse = 1 / jnp.where(moves, speed, 1)
    color, total = list(own), jnp.ones_like(x)
    for side in (-1, 1):
        across, down = side * x * inverse, side * y * inverse
        near_row, near_column = (jnp.floor(part + 0.5).astype(jnp.int32) for part in (down, across))
        other_x, other_y = beside(images.velocity, at, near_row, near_column)
        (other_depth,) = beside(images.depth, at, near_row, near_column)
        row, column = at.row + near_row, at.column + near_column
        inside = (row >= 0) & (row < images.color.height)
        inside = inside & (column >= 0) & (column < images.color.width)
        # As products, since both may be infinite: sky is one surface.
        share = 1 - parameters.surface
        one_surface = (other_depth >= share * depth) & (depth >= share * other_depth)
        one_motion = safe_norm(other_x - x, other_y - y) <= parameters.alike * speed
        light = _between(at, images.color, down, across)
        roots = [
            jnp.abs(jnp.sqrt(jnp.maximum(a, 0)) - jnp.sqrt(jnp.maximum(b, 0)))
            for a, b in zip(light, own, strict=True)
        ]
        apart = functools.reduce(jnp.maximum, roots) / parameters.noise
        weight = jnp.where(inside & one_surface & one_motion, jnp.exp(-jnp.square(apart)), 0)
        color = [a + weight * b for a, b in zip(color, light, strict=True)]
        total = total + weight
    return Outcome(tuple(channel / total for channel in color), where=moves)


def _between(at: At, image: Image, down: Array, across: Array) -> Sequence[Array]:
    """The color at an offset, bilinear of the four pixels around it."""
    top, left = jnp.floor(down), jnp.floor(across)
    low, right = down - top, across - left
    row, column = top.astype(jnp.int32), left.astype(jnp.int32)
    corners = [[beside(image, at, row + i, column + j) for j in (0, 1)] for i in (0, 1)]
    return [
        (1 - low) * ((1 - right) * a + right * b) + low * ((1 - right) * c + right * d)
        for a, b, c, d in zip(*corners[0], *corners[1], strict=True)
    ]


def reblur(
    image: ArrayLike,
    frame: Frame,
    parameters: ReblurParameters = ReblurParameters(),
    *,
    backend: Backend = "auto",
) -> Float[Array, "height width channels"]:
    """Remove noise from a blurred image by the mean of three pixels along the motion.

    A blurred image varies little along the motion, and its noise is another in every pixel.

    Args:
        image: (H, W, C) blurred, linear light.
        frame: depth (H, W) and velocity (H, W, 2), half-spread in pixels, of the sharp frame; its
            color is not looked at.
        parameters: see `ReblurParameters`.
        backend: see `jaxblur.Settings`.

    Returns:
        (H, W, C). Pixels that move less than `shortest` keep their bits. Differentiable in image,
        velocity and noise; which pixels are of one motion and surface is held.

    Raises:
        ValueError: sizes disagree, or a parameter is not a scalar.

    Source: Guertin et al. 2014, section 3.6.1, which suggests to blur again where the variance is
        high; the mean of three, and its weight by the difference, are this project's.
    """
    color, frame = checked_image(image), check_frame(frame)
    if color.shape[:2] != frame.depth.shape:
        raise ValueError(
            f"`frame` must be as large as `image`, {color.shape[:2]}, got {frame.depth.shape}."
        )
    check_parameters(parameters, ReblurParameters)
    return _reblur(color, frame.velocity, frame.depth, parameters, backend)


@functools.partial(jax.jit, static_argnames=("backend",))
def _reblur(
    color: jax.Array,
    velocity: jax.Array,
    depth: jax.Array,
    parameters: ReblurParameters,
    backend: Backend,
) -> jax.Array:
    parameters = jax.tree.map(lambda p: jnp.asarray(p, color.dtype), parameters)
    size = color.shape[0], color.shape[1]
    images = Images(
        Image(color), *(Image(a.astype(color.dtype)) for a in (velocity, depth[..., None]))
    )
    return each_pixel(mean_along, size, images, parameters, kept=color, backend=backend)
