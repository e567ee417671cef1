"""Differences as they are seen: contrast in units of its threshold, masked by other contrast."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..images import absolute
from .model import parameters
from .pooling import power
from .pyramid import separable

GAINS = (1.0, 1.45, 1.0, 1.0)
"""Of contrast in units of its threshold, by channel."""
BLUR_REACH = 6
"""Taps to each side of the blur of the masking contrast: 2 standard deviations."""

Channels = Float[jax.Array, "channels height width"]


def masked_difference(
    contrast: Float[jax.Array, "2 channels height width"], sensitivity: Channels
) -> Channels:
    """Difference of a band of contrast, in multiples of what is just seen.

    With contrasts T and R of test and reference, times sensitivity and gain::

        M_c = 10^mask_c sum_k w_kc blur(min(|T_k|, |R_k|))^q_k      what both pictures have masks
        d   = |T - R|^p / (1 + M)
        D   = d_max d / (d_max + d)                                 large differences saturate

    Args:
        contrast: (2, C, h, w) of test and reference.
        sensitivity: (C, h, w).

    Returns:
        (C, h, w), at least 0; derivative 0 where test and reference agree.

    Source: Mantiuk et al. 2024, section 3.5.
    """
    model = parameters()
    channels = sensitivity.shape[0]
    test, reference = contrast * (sensitivity * by_channel(GAINS, sensitivity))
    mutual = jnp.minimum(absolute(test), absolute(reference))
    masks = power(10**model.mask_c * _blurred(mutual), by_channel(model.mask_q, sensitivity))
    weights = jnp.asarray(2 ** model.xcm_weights[:channels, :channels], masks.dtype)
    mask = jnp.einsum("khw,kc->chw", masks, weights, precision="highest")
    difference = power(absolute(test - reference), model.mask_p) / (1 + mask)
    largest = 10**model.d_max
    return largest * difference / (largest + difference)


def by_channel(
    values: tuple[float, ...] | np.ndarray, like: Channels
) -> Float[jax.Array, "channels 1 1"]:
    """Values by channel as (C, 1, 1), for as many channels as another array has."""
    return jnp.asarray(values, like.dtype)[: like.shape[0], None, None]


def _blurred(planes: jax.Array) -> jax.Array:
    """Blur by a Gaussian with mirrored borders; planes too small for that stay as they are."""
    height, width = planes.shape[-2:]
    if min(height, width) <= BLUR_REACH:
        return planes
    return separable(_gaussian(height), _gaussian(width), planes)


@functools.lru_cache
def _gaussian(count: int) -> np.ndarray:
    """(N, N): a Gaussian around each of N pixels, mirrored about the first and the last."""
    taps = np.arange(-BLUR_REACH, BLUR_REACH + 1)
    weights = np.exp(-0.5 * (taps / parameters().pu_dilate) ** 2)
    matrix = np.zeros((count, count))
    for tap, weight in zip(taps, weights / weights.sum(), strict=True):
        place = np.abs(np.arange(count) + tap)
        mirrored = np.where(place < count, place, 2 * (count - 1) - place)
        matrix[np.arange(count), mirrored] += weight
    return matrix
