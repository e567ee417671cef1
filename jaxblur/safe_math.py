"""Singular points, each defined once: value and derivative stay finite everywhere.

A ``where`` around a singular operation does not protect its gradient, because the derivative of
the branch that was not taken is computed all the same. The functions here replace the *input*
of the operation first (the double ``where``).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def _scaled(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Components divided by the larger one, that scale, and where both are zero."""
    largest = jax.lax.stop_gradient(jnp.maximum(jnp.abs(x), jnp.abs(y)))
    is_zero = largest < jnp.finfo(x.dtype).tiny
    scale = jnp.where(is_zero, 1, largest)
    return jnp.where(is_zero, 1, x / scale), jnp.where(is_zero, 1, y / scale), scale, is_zero


def safe_norm(x: Float[Array, "*shape"], y: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Euclidean norm of the vectors ``(x, y)``, ``sqrt(x^2 + y^2)``.

    Components come as separate planes: a reduction over an axis of two would keep XLA from
    fusing the kernels. Scaled by the larger component, so that 1e-20 does not underflow and 1e30
    does not overflow in float32. The derivative is ``v / ||v||``, and 0 where the norm is 0 or
    below the smallest normal number (XLA flushes those to 0).

    Args:
        x: horizontal components, any unit.
        y: vertical components, same unit.

    Returns:
        Norms in the same unit, >= 0.
    """
    unit_x, unit_y, scale, is_zero = _scaled(x, y)
    return jnp.where(is_zero, 0, scale * jnp.sqrt(unit_x * unit_x + unit_y * unit_y))


def safe_divide(
    numerator: Float[Array, "*shape"], denominator: Float[Array, "*shape"], otherwise: float = 0.0
) -> Float[Array, "*shape"]:
    """``numerator / denominator``, and ``otherwise`` with derivative 0 where the latter is 0.

    Args:
        numerator: any values.
        denominator: any values.
        otherwise: the value at a zero denominator.

    Returns:
        The quotient.
    """
    is_zero = denominator == 0
    return jnp.where(is_zero, otherwise, numerator / jnp.where(is_zero, 1, denominator))


def safe_normalize(
    x: Float[Array, "*shape"], y: Float[Array, "*shape"]
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """``v / ||v||`` of the vectors ``(x, y)``; 0 with derivative 0 at ``v = 0``.

    Args:
        x: horizontal components, any unit.
        y: vertical components, same unit.

    Returns:
        Components of unit vectors, or zeros.
    """
    unit_x, unit_y, _, is_zero = _scaled(x, y)
    inverse = 1 / jnp.sqrt(unit_x * unit_x + unit_y * unit_y)
    return jnp.where(is_zero, 0, unit_x * inverse), jnp.where(is_zero, 0, unit_y * inverse)


def shortening(speed: Float[Array, "*shape"], radius: int) -> Float[Array, "*shape"]:
    """Factor that clamps a vector to the radius, ``min(1, r / ||v||)``.

    Args:
        speed: norms in pixels.
        radius: longest half-spread in pixels.

    Returns:
        Factors; the derivative at ``||v|| = r`` is 0, that of 1.
    """
    too_fast = speed > radius
    return jnp.where(too_fast, radius / jnp.where(too_fast, speed, 1), 1)


def clamp_speed(
    velocity: Float[Array, "*shape 2"],
    radius: int,
    speed: Float[Array, "*shape"] | None = None,
) -> tuple[Float[Array, "*shape 2"], Float[Array, "*shape"]]:
    """Clamp half-spreads radially to the radius: ``v min(1, r / ||v||)``.

    Source: Guertin et al. 2014, section 3.5. Never per component, which would turn vectors.
    The derivative at ``||v|| = r`` is that of the identity.

    Args:
        velocity: (..., 2) half-spread in pixels.
        radius: longest half-spread in pixels.
        speed: (...) norm of the velocity, where it is known.

    Returns:
        The clamped velocity (..., 2), and its speed (...) in [0, radius]. All clamped vectors
        have the same speed to the bit, so that they tie in a tile maximum.
    """
    speed = safe_norm(velocity[..., 0], velocity[..., 1]) if speed is None else speed
    return velocity * shortening(speed, radius)[..., None], jnp.minimum(speed, radius)
