"""The frames before and after, as `layered` reads them: where their points are in the exposure."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ...frame import Frame
from ...kernels import Image
from ...safe_math import safe_divide, safe_norm
from .._weights import finite_depth

_CURVED = 1e-3
"""Radians. Below, an arc equals the parabola in float32."""


class Neighbor(NamedTuple):
    """A neighbor frame.

    Attributes:
        color: (H, W, C).
        motion: (H, W, 5) displacement of each pixel to its places at opening and at closing of
            the blurred frame's exposure, x and y of each, pixels; and its log depth.
    """

    color: Image
    motion: Image


def neighbor_of(frame: Frame, frames: int, shutter: ArrayLike) -> Neighbor:
    """A neighbor, from the frame that it is.

    Args:
        frame: its motion is that of an exposure as long as the blurred frame's.
        frames: from it to the blurred frame, 1 or -1.
        shutter: exposure in frames.

    Returns:
        The neighbor. Differentiable.
    """
    half = jnp.asarray(shutter, frame.color.dtype) / 2
    ends = [displacement_at(frame, (frames + side * half) / half) for side in (-1, 1)]
    depth = jnp.log(finite_depth(frame.depth))[..., None]
    return Neighbor(Image(frame.color), Image(jnp.concatenate([*ends, depth], axis=-1)))


def displacement_at(frame: Frame, time: Array) -> Float[Array, "height width 2"]:
    """Displacement at a time in half exposures, on the arc through the ends of the path.

    With l half of the chord and the rest c split into c1 along l and c2 across it, the arc is

        x(t) = l sin(w t)/sin(w) + c2 (1 - cos(w t))/(1 - cos(w)) + c1 t^2,  tan(w/2) = |c2|/|l|,

    as `jaxblur.vectors.to_half_spread` defines it.
    """
    if frame.path is None:
        return time * frame.velocity
    opening, closing = frame.path[..., 0, :], frame.path[..., 1, :]
    line, rest = (closing - opening) / 2, (closing + opening) / 2
    squared = jnp.sum(line * line, axis=-1, keepdims=True)
    along = safe_divide(jnp.sum(line * rest, axis=-1, keepdims=True), squared) * line
    across = rest - along
    ratio = safe_divide(_norm(across), _norm(line))
    curved = ratio > _CURVED
    angle = 2 * jnp.arctan(jnp.where(curved, ratio, 1))
    tangent = jnp.where(curved, jnp.sin(time * angle) / jnp.sin(angle), time)
    sagitta = jnp.sin(time * angle / 2) / jnp.sin(angle / 2)
    bend = jnp.where(curved, sagitta, time) ** 2
    return tangent * line + bend * across + time**2 * along


def _norm(vectors: jax.Array) -> jax.Array:
    return safe_norm(vectors[..., 0], vectors[..., 1])[..., None]
