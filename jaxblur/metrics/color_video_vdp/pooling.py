"""Sums of differences over pixels, bands, channels and frames, and the step to JOD."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .model import parameters

NEAR_ZERO = 1e-5
"""Keeps the derivative of a power finite at 0."""
LINEAR_UP_TO = 0.1
"""Differences up to here go to JOD by a straight line, whose derivative at 0 is finite."""
BEST = 10.0
"""JOD of equal pictures."""


def power(base: jax.Array, exponent: float | jax.Array) -> jax.Array:
    """``(x + e)^p - e^p`` with e = 1e-5, a power whose derivative at 0 is finite."""
    return (base + NEAR_ZERO) ** exponent - NEAR_ZERO**exponent


def norm(values: jax.Array, exponent: float, axis: int | tuple[int, ...], mean: bool) -> jax.Array:
    """``(sum x^p)^(1/p)`` over some axes, or with the mean in place of the sum.

    Args:
        values: at least 0.
        exponent: p.
        axis: axes to reduce.
        mean: whether to divide the sum by the number of values.

    Returns:
        The values without the axes.
    """
    reduce = jnp.mean if mean else jnp.sum
    return power(reduce(power(values, exponent), axis=axis), 1 / exponent)


def over_pixels(difference: Float[jax.Array, "channels height width"]) -> Float[jax.Array, " c"]:
    """Mean over the pixels of a band, by channel."""
    return norm(difference, parameters().beta, axis=(-2, -1), mean=True)


def just_objectionable_differences(
    differences: Float[jax.Array, "frames channels bands"],
) -> Float[jax.Array, ""]:
    """Sum over bands, channels and frames, in JOD.

    Args:
        differences: (F, 4, B) of a clip, or (1, 3, B) of an image, whose sum is weighted anew.

    Returns:
        10 where there are none, less where there are; 1 less is noticed as worse by 75 of 100.

    Source: Mantiuk et al. 2024, section 3.6.
    """
    model = parameters()
    frames, channels, _ = differences.shape
    weights = np.array([1.0, model.ch_chrom_w, model.ch_chrom_w, model.ch_trans_w])[:channels]
    weighted = differences * jnp.asarray(weights[:, None], differences.dtype)
    base = jnp.asarray(model.baseband_weight[:channels], differences.dtype)
    weighted = weighted.at[..., -1].multiply(base)
    by_channel = norm(weighted, model.beta_sch, axis=-1, mean=False)
    by_frame = norm(by_channel, model.beta_tch, axis=-1, mean=False)
    if frames == 1:
        return _jod(model.image_int * by_frame[0])
    return _jod(norm(by_frame, model.beta_t, axis=0, mean=True))


def _jod(difference: jax.Array) -> jax.Array:
    model = parameters()
    small = difference <= LINEAR_UP_TO
    straight = LINEAR_UP_TO ** (model.jod_exp - 1) * difference
    curved = jnp.where(small, 1.0, difference) ** model.jod_exp
    return BEST - model.jod_a * jnp.where(small, straight, curved)
