"""Image metrics with explicit conventions: PSNR, SSIM, FLIP, relative MSE, temporal error.

All numbers that this project reports use one display transform, :func:`display`: keep RGB, apply
the exact sRGB curve, clip to [0, 1]; the peak is 1. :func:`compare` applies it to linear images.
The other functions take images as they are, so that they can also be used as losses. All except
:func:`flip` are differentiable JAX functions whose derivatives stay finite where two images agree.

``mask`` is an (H, W) array of booleans that limits a mean to some pixels. An empty mask gives NaN,
except in :func:`compare`, which raises an error.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from . import srgb
from .frame import Frame

Image = Float[jax.Array | np.ndarray, "height width channels"]
Mask = Bool[jax.Array | np.ndarray, "height width"]
Scalar = Float[jax.Array, ""]

SSIM_WINDOW = 11
"""Rows and columns of the window of SSIM, and of the smallest image that has scores."""
SSIM_SIGMA = 1.5
RELATIVE_FLOOR = 1e-2


def rgb(image: Image) -> Float[jax.Array, "height width 3"]:
    """Keep only the color channels.

    Args:
        image: (H, W, C). If there are more than three channels, the first three are taken, which
            for premultiplied RGBA is the image over black; a single channel becomes gray.

    Returns:
        (H, W, 3), values unchanged.

    Raises:
        ValueError: the image does not have 1 or at least 3 channels.
    """
    image = jnp.asarray(image)
    channels = image.shape[-1]
    if channels in (0, 2):
        raise ValueError(
            f"`image` must have 1 or at least 3 channels, got shape {image.shape}; "
            "pass the color channels alone."
        )
    return image[..., :3] if channels >= 3 else jnp.repeat(image, 3, axis=-1)


def display(image: Image) -> Float[jax.Array, "height width 3"]:
    """Apply the project's display transform: RGB only, exact sRGB curve, clipped to [0, 1].

    Args:
        image: (H, W, C) linear light, channels as :func:`rgb` takes them.

    Returns:
        (H, W, 3) display values in [0, 1]. The derivative is 0 beyond the clip.

    Raises:
        ValueError: the image does not have 1 or at least 3 channels.
    """
    return jnp.clip(srgb.encode(rgb(image)), 0.0, 1.0)


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
    image, truth = _of_one_shape(image, truth)
    return _masked_mean(jnp.square(image - truth), mask)


def psnr(image: Image, truth: Image, peak: float = 1.0, mask: Mask | None = None) -> Scalar:
    """Peak signal-to-noise ratio, 10 log10(peak^2 / MSE).

    Args:
        image: (H, W, C), after :func:`display` for reported numbers.
        truth: (H, W, C) in the same units.
        peak: the value of full signal; 1 after :func:`display`.
        mask: (H, W) pixels to count, or None for all.

    Returns:
        Scalar in dB; ``+inf`` with derivative 0 where the images are equal.

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
    image, truth = _of_one_shape(image, truth)
    return _masked_mean(
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
    image, truth = _of_one_shape(image, truth)
    scale = _absolute(image) + _absolute(truth) + RELATIVE_FLOOR
    return _masked_mean(_absolute(image - truth) / scale, mask)


def ssim(image: Image, truth: Image, mask: Mask | None = None) -> Scalar:
    """Structural similarity, mean over pixels and channels, for display values in [0, 1].

    Gaussian window of 11 x 11 with sigma 1.5, population covariance, constants 0.01 and 0.03,
    range 1. Only pixels whose window lies inside the image count. In scikit-image these settings
    are ``gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1``.

    Args:
        image: (H, W, C), after :func:`display`.
        truth: (H, W, C), after :func:`display`.
        mask: (H, W) pixels to count (their windows may reach outside the mask), or None for all.

    Returns:
        Scalar in [-1, 1]; 1 for equal images.

    Raises:
        ValueError: the image is smaller than the window, or shapes differ.

    Source: Wang, Bovik, Sheikh, Simoncelli 2004, "Image quality assessment: from error
    visibility to structural similarity", equation 13.
    """
    import dm_pix

    image, truth = _of_one_shape(image, truth)
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
    return _masked_mean(jnp.asarray(similarity), inner)


def flip_map(
    image: Image, truth: Image, hdr: bool = False, pixels_per_degree: float = 67.0
) -> Float[np.ndarray, "height width"]:
    """Compute FLIP per pixel: how visible the difference is when the two images alternate.

    Runs in NumPy through NVIDIA's ``flip_evaluator``; not differentiable.

    Args:
        image: (H, W, 3): display values in [0, 1] after :func:`display`, or with ``hdr`` linear
            Rec.709 light, not negative.
        truth: (H, W, 3) in the same units.
        hdr: take the largest error over a range of exposures derived from the truth (HDR-FLIP).
        pixels_per_degree: pixels per degree of visual angle; 67 is a 0.7 m wide 4K monitor seen
            from 0.7 m.

    Returns:
        (H, W) in [0, 1]; 0 means no visible difference.

    Raises:
        ValueError: shapes differ, or values are outside the range above or not finite.

    Source: Andersson et al. 2020, "FLIP: a difference evaluator for alternating images"; HDR:
    Andersson et al. 2021, "Visualizing errors in rendered high dynamic range images".
    """
    import flip_evaluator

    # flip_evaluator accepts only writable C-ordered arrays, and JAX arrays are read-only.
    image, truth = (np.array(array, np.float32, order="C") for array in (image, truth))
    _check_flip_input(image, truth, hdr)
    error, _, _ = flip_evaluator.evaluate(
        truth,
        image,
        "HDR" if hdr else "LDR",
        applyMagma=False,
        parameters={"ppd": float(pixels_per_degree)},
    )
    return error[..., 0]


def flip(
    image: Image,
    truth: Image,
    mask: Mask | None = None,
    hdr: bool = False,
    pixels_per_degree: float = 67.0,
) -> float:
    """Mean FLIP error over pixels; see :func:`flip_map` for the arguments.

    Args:
        image: (H, W, 3) display values, or linear light with ``hdr``.
        truth: (H, W, 3) in the same units.
        mask: (H, W) pixels to count, or None for all.
        hdr: evaluate HDR-FLIP on linear light.
        pixels_per_degree: pixels per degree of visual angle.

    Returns:
        A float in [0, 1]; 0 means no visible difference.

    Raises:
        ValueError: as for :func:`flip_map`.
    """
    error = flip_map(image, truth, hdr, pixels_per_degree)
    return float(error.mean() if mask is None else error[np.asarray(mask)].mean())


def temporal_difference_error(
    images: Float[jax.Array | np.ndarray, "frames height width channels"],
    truths: Float[jax.Array | np.ndarray, "frames height width channels"],
    mask: Mask | None = None,
) -> Float[jax.Array, " pairs"]:
    """Measure flicker against the truth: RMS of (a[t] - a[t-1]) - (b[t] - b[t-1]) per frame pair.

    A static error does not count, an error that changes over time does. The pooled value is
    ``sqrt(mean(error**2))``.

    Args:
        images: (T, H, W, C), a, after :func:`display` for reported numbers.
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
    squared = jax.vmap(_masked_mean, (0, None))(jnp.square(jnp.diff(error, axis=0)), mask)
    still = squared == 0
    return jnp.where(still, 0.0, jnp.sqrt(jnp.where(still, 1.0, squared)))


class Scores(NamedTuple):
    """Result of :func:`compare`: PSNR in dB, SSIM (1 is equal), mean FLIP (0 is equal)."""

    psnr: float
    ssim: float
    flip: float


def compare(image: Image, truth: Image, mask: Mask | None = None) -> Scores:
    """Compute PSNR, SSIM and FLIP of linear images, as this project reports them.

    Both images pass through :func:`display` first: RGB only, sRGB curve, clipped to [0, 1].

    Args:
        image: (H, W, C) linear light.
        truth: (H, W, C) linear light.
        mask: (H, W) pixels to count, for instance :func:`motion_footprint`; None for all.

    Returns:
        The three metrics as floats.

    Raises:
        ValueError: shapes differ, values are not finite, the mask is empty, or the image is
            smaller than the SSIM window of 11 pixels.
    """
    if mask is not None and not np.asarray(mask).any():
        raise ValueError("`mask` must hold at least one pixel; pass None to count every pixel.")
    shown, expected = display(image), display(truth)
    visible = flip(shown, expected, mask)
    return Scores(
        psnr=float(psnr(shown, expected, mask=mask)),
        ssim=float(ssim(shown, expected, mask)),
        flip=visible,
    )


def motion_footprint(
    frame: Frame, threshold: float = 0.5, margin: int = 2
) -> Bool[np.ndarray, "height width"]:
    """Find the pixels that motion reaches: those where blur can differ from the sharp frame.

    Every pixel whose path leads more than ``threshold`` away from it marks the pixels under its
    path (``frame.path`` if present, else p - velocity .. p + velocity); the result is grown by
    ``margin``. Runs in NumPy; not differentiable.

    Args:
        frame: one frame; only velocity and path are read.
        threshold: pixels; slower points mark nothing.
        margin: number of times that the footprint grows by the four neighbors of its pixels.

    Returns:
        (H, W) True where motion reaches.
    """
    velocity = np.asarray(frame.velocity)
    path = np.stack([-velocity, velocity], axis=2) if frame.path is None else np.asarray(frame.path)
    reach = np.linalg.norm(path, axis=-1).max(axis=-1)
    footprint = _sweep(path, reach > threshold, float(reach.max()))
    for _ in range(margin):
        padded = np.pad(footprint, 1)
        footprint = (
            footprint | padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:]
        )
    return footprint


def _sweep(path: np.ndarray, moving: np.ndarray, reach: float) -> np.ndarray:
    """Mark the pixels under the paths of the moving pixels, in steps of at most half a pixel."""
    height, width = moving.shape
    start = np.argwhere(moving)
    ends = path[moving]
    swept = np.zeros_like(moving)
    for share in np.linspace(0.0, 1.0, int(np.ceil(2 * reach)) + 1):
        for end in (0, 1):
            row, column = np.floor(start + share * ends[:, end, ::-1] + 0.5).astype(int).T
            inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            swept[row[inside], column[inside]] = True
    return swept


def _of_one_shape(image: Any, truth: Any) -> tuple[jax.Array, jax.Array]:
    """Convert both to JAX arrays of equal shape; broadcasting is not allowed."""
    image, truth = jnp.asarray(image), jnp.asarray(truth)
    if image.shape != truth.shape:
        raise ValueError(
            f"`image` and `truth` must have one shape, got {image.shape} and {truth.shape}."
        )
    return image, truth


def _masked_mean(values: jax.Array, mask: Mask | None) -> jax.Array:
    if mask is None:
        return jnp.mean(values)
    return jnp.mean(values, where=jnp.broadcast_to(jnp.asarray(mask)[..., None], values.shape))


def _absolute(values: jax.Array) -> jax.Array:
    # The derivative of jnp.abs at 0 is 1, which would push equal images apart.
    return values * jnp.sign(values)


def _check_flip_input(image: np.ndarray, truth: np.ndarray, hdr: bool) -> None:
    if image.shape != truth.shape or image.ndim != 3 or image.shape[-1] != 3:
        raise ValueError(
            "`image` and `truth` must both have shape (height, width, 3), "
            f"got {image.shape} and {truth.shape}."
        )
    for name, array in (("image", image), ("truth", truth)):
        if not np.isfinite(array).all():
            bad = np.argwhere(~np.isfinite(array))
            raise ValueError(
                f"`{name}` must be finite, got {len(bad)} NaN or infinite values, the first at "
                f"row {bad[0, 0]}, column {bad[0, 1]}; repair the image first."
            )
        limit = np.inf if hdr else 1.0
        if array.min() < 0 or array.max() > limit:
            raise ValueError(
                f"`{name}` must lie in [0, {limit:g}], got {array.min():g} .. {array.max():g}; "
                + ("clamp it at 0." if hdr else "apply `metrics.display` first.")
            )
