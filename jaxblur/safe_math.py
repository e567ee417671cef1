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
