"""The scores that this project reports of an image."""

from typing import NamedTuple

import numpy as np

from .errors import psnr
from .images import Image, Mask, display
from .structure import ssim
from .visibility import flip


class Scores(NamedTuple):
    """Result of `compare`: PSNR in dB, SSIM (1 is equal), mean FLIP (0 is equal)."""

    psnr: float
    ssim: float
    flip: float


def compare(image: Image, truth: Image, mask: Mask | None = None) -> Scores:
    """Compute PSNR, SSIM and FLIP of linear images, as this project reports them.

    Both images pass through `display` first: RGB only, sRGB curve, clipped to [0, 1].

    Args:
        image: (H, W, C) linear light.
        truth: (H, W, C) linear light.
        mask: (H, W) pixels to count, for instance `motion_footprint`; None for all.

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
