"""Singular points, each defined once: value and derivative stay finite everywhere.

A ``where`` around a singular operation does not protect its gradient, because the derivative of
the branch that was not taken is computed all the same. The functions here replace the *input*
of the operation first (the double ``where``).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def safe_norm(vectors: Float[Array, "*shape axis"]) -> Float[Array, "*shape"]:
    """Euclidean norm over the last axis, ``sqrt(sum_i v_i^2)``.

    Scaled by the largest component, so that 1e-20 does not underflow and 1e30 does not
    overflow in float32. The derivative is ``v / ||v||``, and 0 where the norm is 0 or below the
    smallest normal number (XLA flushes those to 0).

    Args:
        vectors: vectors along the last axis, any unit.

    Returns:
        Norms in the same unit, >= 0.
    """
    largest = jax.lax.stop_gradient(jnp.max(jnp.abs(vectors), axis=-1))
    is_zero = largest < jnp.finfo(vectors.dtype).tiny
    scale = jnp.where(is_zero, 1, largest)
    unit = jnp.where(is_zero[..., None], 1, vectors / scale[..., None])
    return jnp.where(is_zero, 0, scale * jnp.sqrt(jnp.sum(unit * unit, axis=-1)))


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


def safe_normalize(vectors: Float[Array, "*shape axis"]) -> Float[Array, "*shape axis"]:
    """``v / ||v||`` along the last axis; 0 with derivative 0 at ``v = 0``.

    Args:
        vectors: vectors along the last axis, any unit.

    Returns:
        Unit vectors, or zeros.
    """
    norm = safe_norm(vectors)[..., None]
    return safe_divide(vectors, jnp.broadcast_to(norm, vectors.shape))
