"""Velocities in two 8-bit integers, as game engines store them.

The length of the half-spread is clamped to the radius, which keeps its direction; clamping x and y
separately would turn every fast velocity to one of four diagonals.
"""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, UInt8

from ..safe_math import clamp_speed

LEVELS, REST = 127, 128
"""Number of steps on either side of rest, and the integer for rest. Zero is decoded
exactly, which ``v / 2r + 0.5`` in [0, 1] does not allow."""


def encode_velocity(velocity: ArrayLike, radius: int) -> UInt8[Array, "height width 2"]:
    """Encode half-spreads radially, ``round(127 min(|v|, r) / r * v / |v|) + 128``.

    Source: Guertin et al. 2014, section 3.5, with two departures: rest is an integer, and the floor
    of half a pixel is left to the filters, so that points at rest stay at rest. The rounding has no
    derivative.

    Args:
        velocity: (H, W, 2) half-spread in pixels, x right, y down.
        radius: longest half-spread in pixels that is kept, at least 1.

    Returns:
        (H, W, 2) unsigned 8-bit integers from 1 to 255 in steps of radius/127 pixels.

    Raises:
        ValueError: shape or radius is wrong.

    Examples:
        >>> import jax.numpy as jnp
        >>> encode_velocity(jnp.asarray([[[0.0, 0.0], [40.0, 0.0], [300.0, -400.0]]]), 40).tolist()
        [[[128, 128], [255, 128], [204, 26]]]
    """
    velocity = jnp.asarray(velocity)
    _check(velocity, radius)
    clamped, _ = clamp_speed(velocity.astype(jnp.result_type(velocity, jnp.float32)), radius)
    return (jnp.round(clamped * (LEVELS / radius)) + REST).astype(jnp.uint8)


def decode_velocity(encoded: ArrayLike, radius: int) -> Float[Array, "height width 2"]:
    """Decode the integers from `encode_velocity`, ``r (i - 128) / 127``.

    Args:
        encoded: (H, W, 2) unsigned 8-bit integers.
        radius: the radius used for encoding, pixels.

    Returns:
        (H, W, 2) half-spread in pixels; each component within radius/254 of the clamped one.

    Raises:
        ValueError: shape, type or radius is wrong.
    """
    encoded = jnp.asarray(encoded)
    _check(encoded, radius)
    if encoded.dtype != jnp.uint8:
        raise ValueError(f"`encoded` must hold unsigned 8-bit integers, got {encoded.dtype}.")
    return (encoded.astype(jnp.float32) - REST) * (radius / LEVELS)


def _check(values: jax.Array, radius: int) -> None:
    if values.ndim != 3 or values.shape[-1] != 2:
        raise ValueError(f"velocities must have shape (height, width, 2), got {values.shape}.")
    if radius < 1:
        raise ValueError(f"`radius` must be at least 1, got {radius}.")
