"""Contrast sensitivity: one over the smallest contrast that is seen."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .model import parameters, sensitivity_table


def sensitivity(
    frequency: float, log10_luminance: Float[jax.Array, "rows columns"], channels: int
) -> Float[jax.Array, "channels rows columns"]:
    """Look up the contrast sensitivity of a band, linear in the logarithms.

    Args:
        frequency: of the band, cycles per degree.
        log10_luminance: (h, w) of the local light, cd/m2; beyond the table its end holds.
        channels: 3 for an image, 4 for a clip.

    Returns:
        (channels, h, w). The derivative is that of the straight piece of the table.
    """
    table = sensitivity_table()
    by_luminance = _at_frequency(frequency)[:channels]
    first, last = np.log10(table.luminance[[0, -1]])
    steps = table.luminance.size - 1
    place = jnp.clip((log10_luminance - first) / (last - first) * steps, 0, steps)
    low = jnp.floor(place).astype(int)
    high = jnp.minimum(low + 1, steps)
    share = place - low
    values = jnp.asarray(by_luminance, log10_luminance.dtype)
    logarithm = (1 - share) * values[:, low] + share * values[:, high]
    return 10 ** (logarithm + parameters().sensitivity_correction / 20)


def _at_frequency(frequency: float) -> np.ndarray:
    """(4, L) log10 of the sensitivity; beyond the table the last straight pieces go on."""
    table = sensitivity_table()
    known, at = np.log10(table.frequency), np.log10(frequency)
    low = np.clip(np.searchsorted(known, at) - 1, 0, known.size - 2)
    share = (at - known[low]) / (known[low + 1] - known[low])
    values = table.log10_sensitivity
    return (1 - share) * values[..., low] + share * values[..., low + 1]
