"""The sRGB curve (IEC 61966-2-1), for integer images."""

import numpy as np
from jaxtyping import Float


def from_srgb(encoded: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Decode: values of any shape in 0..1 to linear light in 0..1.

    Args:
        encoded: sRGB values.

    Returns:
        Linear light of the same shape.
    """
    curved = ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, encoded / 12.92, curved)


def to_srgb(linear: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Encode: linear light of any shape to sRGB values, clipped to 0..1.

    Args:
        linear: linear light.

    Returns:
        sRGB values of the same shape, 0..1.
    """
    clipped = np.clip(linear, 0, 1)
    curved = 1.055 * np.maximum(clipped, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(clipped <= 0.0031308, clipped * 12.92, curved)
