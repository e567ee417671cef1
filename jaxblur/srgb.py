"""The exact piecewise sRGB curve, for NumPy and JAX arrays alike (IEC 61966-2-1:1999).

Values are not clipped; negative ones lie on the linear segment. The branch that is not taken gets a
harmless input, so that derivatives are finite everywhere; at the joint the derivative is that of
the linear segment.
"""

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import jax
    import numpy as np

Array = TypeVar("Array", "jax.Array", "np.ndarray")

LINEAR_JOINT = 0.0031308
ENCODED_JOINT = 0.04045


def encode(linear: Array) -> Array:
    """Convert linear light to sRGB: 12.92 x up to x = 0.0031308, then 1.055 x^(1/2.4) - 0.055.

    Args:
        linear: NumPy or JAX array of any shape, linear light.

    Returns:
        sRGB values: an array of the same kind, shape and dtype.

    Examples:
        >>> import numpy as np
        >>> encode(np.array([0.0, 0.18, 1.0])).round(4).tolist()
        [0.0, 0.4614, 1.0]
    """
    namespace = linear.__array_namespace__()
    straight = linear <= LINEAR_JOINT
    base = namespace.where(straight, 1.0, linear)
    return namespace.where(straight, 12.92 * linear, 1.055 * base ** (1 / 2.4) - 0.055)


def decode(encoded: Array) -> Array:
    """Convert sRGB values to linear light, the inverse of `encode`.

    Args:
        encoded: NumPy or JAX array of any shape, sRGB values.

    Returns:
        Linear light: an array of the same kind, shape and dtype.

    Examples:
        >>> import numpy as np
        >>> decode(np.array([0.0, 0.5, 1.0])).round(4).tolist()
        [0.0, 0.214, 1.0]
    """
    namespace = encoded.__array_namespace__()
    straight = encoded <= ENCODED_JOINT
    base = namespace.where(straight, 1.0, (encoded + 0.055) / 1.055)
    return namespace.where(straight, encoded / 12.92, base**2.4)
