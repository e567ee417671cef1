"""Structural similarity (SSIM)."""

import jax.numpy as jnp

from .images import Image, Mask, Scalar, masked_mean, of_one_shape

SSIM_WINDOW = 11
"""Rows and columns of the window of SSIM, and of the smallest image that has scores."""
SSIM_SIGMA = 1.5
"""Standard deviation of the window of SSIM, in pixels."""


def ssim(image: Image, truth: Image, mask: Mask | None = None) -> Scalar:
    """Structural similarity, mean over pixels and channels, for display values in [0, 1].

    Gaussian window of 11 x 11 with sigma 1.5, population covariance, constants 0.01 and 0.03,
    range 1. Only pixels whose window lies inside the image count. In scikit-image these settings
    are ``gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1``.

    Args:
        image: (H, W, C), after `display`.
        truth: (H, W, C), after `display`.
        mask: (H, W) pixels to count (their windows may reach outside the mask), or None for all.

    Returns:
        Scalar in [-1, 1]; 1 for equal images.

    Raises:
        ValueError: the image is smaller than the window, or shapes differ.

    Source: Wang, Bovik, Sheikh, Simoncelli 2004, "Image quality assessment: from error
    visibility to structural similarity", equation 13.
    """
    import dm_pix

    image, truth = of_one_shape(image, truth)
    if min(image.shape[:2]) < SSIM_WINDOW:
        raise ValueError(
            f"`image` must have at least {SSIM_WINDOW} rows and columns for SSIM, "
            f"got {image.shape[:2]}; use `psnr` for smaller images."
        )
    similarity = dm_pix.ssim(
        image, truth, filter_size=SSIM_WINDOW, filter_sigma=SSIM_SIGMA, return_map=True
    )
    rim = SSIM_WINDOW // 2
    inner = None if mask is None else jnp.asarray(mask)[rim:-rim, rim:-rim]
    return masked_mean(jnp.asarray(similarity), inner)
