"""Losses of a fit: pixel errors, and their mean over the random outcomes of a filter.

======== ==================================================================================
pixel    error of a pixel, a = image, b = truth
======== ==================================================================================
mse      ``(a - b)^2`` in linear light
relative ``(a - b)^2 / (b^2 + 0.01)`` in linear light, for HDR
display  ``(D(a) - D(b))^2``, D = `jaxblur.metrics.display`: sRGB curve, clipped to [0, 1]
ssim     ``1 - SSIM(D(a), D(b))`` of the window around the pixel, see `jaxblur.metrics.ssim`
======== ==================================================================================

Only color channels are compared, those that `jaxblur.metrics.rgb` selects.

``loss`` says how the random outcomes, such as the choice of tile, are averaged, exactly in both
cases:

- ``expected``: ``sum_k P_k error(c_k, truth)``, the mean error of one stochastic image.
- ``mean``: ``error(sum_k P_k c_k, truth)``, the error of the mean image; smaller by the variance.
"""

import typing
from typing import Literal, NamedTuple

import dm_pix
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .. import metrics

Pixel = Literal["mse", "relative", "display", "ssim"]
Over = Literal["expected", "mean"]

PIXEL_LOSSES: tuple[str, ...] = typing.get_args(Pixel)


class Outcomes(NamedTuple):
    """All images that a random choice can give, as `jaxblur.FilterInfo.outcomes` returns them.

    Attributes:
        colors: (K, H, W, C) linear light.
        chances: (K, H, W) probabilities, sum 1 over K.
    """

    colors: Float[Array, "k height width channels"]
    chances: Float[Array, "k height width"]


def pixel_error(
    pixel: Pixel, image: metrics.Image, truth: metrics.Image
) -> Float[Array, "height width"]:
    """Error of every pixel, the mean over its color channels.

    Args:
        pixel: one of `PIXEL_LOSSES`.
        image: (H, W, C) linear light.
        truth: (H, W, C) linear light.

    Returns:
        (H, W), at least 0; differentiable in image and truth. For ``ssim`` the pixels whose
        window leaves the image are 0, see `inner_pixels`.
    """
    if pixel == "ssim":
        return _dissimilarity(metrics.display(image), metrics.display(truth))
    curve = metrics.display if pixel == "display" else metrics.rgb
    image, truth = curve(image), curve(truth)
    squared = jnp.square(image - truth)
    if pixel == "relative":
        squared = squared / (jnp.square(truth) + metrics.RELATIVE_FLOOR)
    return jnp.mean(squared, axis=-1)


def error_map(
    pixel: Pixel, over: Over, outcomes: Outcomes, truth: metrics.Image
) -> Float[Array, "height width"]:
    """Error of every pixel, averaged over the random outcomes.

    Args:
        pixel: one of `PIXEL_LOSSES`; ``ssim`` only with ``mean``, see `check_loss`.
        over: ``expected`` or ``mean``.
        outcomes: the images and their probabilities.
        truth: (H, W, C) linear light.

    Returns:
        (H, W), at least 0; differentiable in colors and probabilities.
    """
    if over == "mean":
        mean = jnp.sum(outcomes.chances[..., None] * outcomes.colors, axis=0)
        return pixel_error(pixel, mean, truth)
    errors = jax.vmap(lambda color: pixel_error(pixel, color, truth))(outcomes.colors)
    return jnp.sum(outcomes.chances * errors, axis=0)


def inner_pixels(pixel: Pixel, size: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    """The pixels at which a pixel loss is defined.

    Args:
        pixel: one of `PIXEL_LOSSES`.
        size: (H, W) of the image.

    Returns:
        (H, W) all True, except for ``ssim``: False where the window leaves the image.

    Raises:
        ValueError: the image is smaller than the window.
    """
    inner = np.ones(size, bool)
    if pixel == "ssim":
        if min(size) < metrics.SSIM_WINDOW:
            raise ValueError(
                f"`pixel='ssim'` needs at least {metrics.SSIM_WINDOW} rows and columns, got "
                f"{size}; use larger frames, or another `pixel`."
            )
        rim = metrics.SSIM_WINDOW // 2
        inner[:rim] = inner[-rim:] = inner[:, :rim] = inner[:, -rim:] = False
    return inner


def check_loss(pixel: str, loss: str) -> None:
    """Reject a combination that is not defined.

    Args:
        pixel: name of a pixel loss.
        loss: ``auto``, ``expected`` or ``mean``.

    Raises:
        ValueError: a name is unknown, or the expected SSIM is asked for.
    """
    if pixel not in PIXEL_LOSSES:
        known = ", ".join(PIXEL_LOSSES)
        raise ValueError(f"`pixel` must be one of {known}, got {pixel!r}.")
    if loss not in ("auto", *typing.get_args(Over)):
        raise ValueError(f"`loss` must be auto, expected or mean, got {loss!r}.")
    if pixel == "ssim" and loss == "expected":
        raise ValueError(
            "`pixel` ssim compares windows, whose outcomes are drawn jointly: their expectation "
            "is no sum over single pixels; pass `loss` mean, or another `pixel`."
        )


def _dissimilarity(image: jax.Array, truth: jax.Array) -> jax.Array:
    similarity = dm_pix.ssim(
        image,
        truth,
        filter_size=metrics.SSIM_WINDOW,
        filter_sigma=metrics.SSIM_SIGMA,
        return_map=True,
    )
    return jnp.pad(1 - jnp.mean(jnp.asarray(similarity), axis=-1), metrics.SSIM_WINDOW // 2)
