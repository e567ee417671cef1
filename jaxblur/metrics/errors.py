"""Errors of pixel values: PSNR, relative MSE, SMAPE, and how an error changes over time."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .images import Image, Mask, Scalar, absolute, masked_mean, of_one_shape

RELATIVE_FLOOR = 1e-2
"""Added to the squared truth that `relative_mse` divides by."""


def mse(image: Image, truth: Image, mask: Mask | None = None) -> Scalar:
    """Mean squared error over pixels and channels.

    Args:
        image: (H, W, C).
        truth: (H, W, C) in the same units.
        mask: (H, W) pixels to count, or None for all.

    Returns:
        Scalar, at least 0.

    Raises:
        ValueError: shapes differ; every metric here raises this.
    """
    image, truth = of_one_shape(image, truth)
    return masked_mean(jnp.square(image - truth), mask)


def psnr(image: Image, truth: Image, peak: float = 1.0, mask: Mask | None = None) -> Scalar:
    """Peak signal-to-noise ratio, 10 log10(peak^2 / MSE).

    Args:
        image: (H, W, C), after `display` for reported numbers.
        truth: (H, W, C) in the same units.
        peak: the value of full signal; 1 after `display`.
        mask: (H, W) pixels to count, or None for all.

    Returns:
        Scalar in dB; ``+inf`` with derivative 0 where the images are equal.

    Examples:
        >>> float(psnr(np.full((2, 2, 3), 0.6), np.full((2, 2, 3), 0.5)).round(3))
        20.0
    """
    error = mse(image, truth, mask) / peak**2
    equal = error == 0
    decibel = -10 * jnp.log10(jnp.where(equal, 1.0, error))
    return jnp.where(equal, jnp.inf, decibel)


def relative_mse(image: Image, truth: Image, mask: Mask | None = None) -> Scalar:
    """Relative mean squared error for linear HDR images: mean of (a - b)^2 / (b^2 + 0.01).

    Args:
        image: (H, W, C) linear light, a.
        truth: (H, W, C) linear light, b; differentiable too.
        mask: (H, W) pixels to count, or None for all.

    Returns:
        Scalar, at least 0.

    Source: Rousselle, Knaus, Zwicker 2011, "Adaptive sampling and reconstruction using greedy
    error minimization".
    """
    image, truth = of_one_shape(image, truth)
    return masked_mean(
        jnp.square(image - truth) / (jnp.square(truth) + RELATIVE_FLOOR),
        mask,
    )


def smape(image: Image, truth: Image, mask: Mask | None = None) -> Scalar:
    """Symmetric mean absolute percentage error: mean of |a - b| / (|a| + |b| + 0.01).

    Args:
        image: (H, W, C) linear light, a.
        truth: (H, W, C) linear light, b.
        mask: (H, W) pixels to count, or None for all.

    Returns:
        Scalar in [0, 1). At the kinks (a = b, a = 0, b = 0) the absolute value has derivative 0.

    Source: Vogels et al. 2018, "Denoising with kernel prediction and asymmetric loss functions".
    """
    image, truth = of_one_shape(image, truth)
    scale = absolute(image) + absolute(truth) + RELATIVE_FLOOR
    return masked_mean(absolute(image - truth) / scale, mask)


def temporal_difference_error(
    images: Float[jax.Array | np.ndarray, "frames height width channels"],
    truths: Float[jax.Array | np.ndarray, "frames height width channels"],
    mask: Mask | None = None,
) -> Float[jax.Array, " pairs"]:
    """Measure flicker against the truth: RMS of (a[t] - a[t-1]) - (b[t] - b[t-1]) per frame pair.

    A static error does not count, an error that changes over time does. The pooled value is
    ``sqrt(mean(error**2))``.

    Args:
        images: (T, H, W, C), a, after `display` for reported numbers.
        truths: (T, H, W, C), b, in the same units.
        mask: (H, W) pixels to count in every pair, or None for all.

    Returns:
        (T - 1,) in the units of the images, at least 0; derivative 0 where a pair has no error.

    Raises:
        ValueError: fewer than two frames.
    """
    error = jnp.asarray(images) - truths
    if error.shape[0] < 2:
        raise ValueError(f"`images` must hold at least 2 frames, got {error.shape[0]}.")
    squared = jax.vmap(masked_mean, (0, None))(jnp.square(jnp.diff(error, axis=0)), mask)
    still = squared == 0
    return jnp.where(still, 0.0, jnp.sqrt(jnp.where(still, 1.0, squared)))
