"""FLIP: how visible a difference is when two images alternate."""

import numpy as np
from jaxtyping import Float

from .images import Image, Mask


def flip_map(
    image: Image, truth: Image, hdr: bool = False, pixels_per_degree: float = 67.0
) -> Float[np.ndarray, "height width"]:
    """Compute FLIP per pixel: how visible the difference is when the two images alternate.

    Runs in NumPy through NVIDIA's ``flip_evaluator``; not differentiable.

    Args:
        image: (H, W, 3): display values in [0, 1] after `display`, or with ``hdr`` linear
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
    """Mean FLIP error over pixels; see `flip_map` for the arguments.

    Args:
        image: (H, W, 3) display values, or linear light with ``hdr``.
        truth: (H, W, 3) in the same units.
        mask: (H, W) pixels to count, or None for all.
        hdr: evaluate HDR-FLIP on linear light.
        pixels_per_degree: pixels per degree of visual angle.

    Returns:
        A float in [0, 1]; 0 means no visible difference.

    Raises:
        ValueError: as for `flip_map`.
    """
    error = flip_map(image, truth, hdr, pixels_per_degree)
    return float(error.mean() if mask is None else error[np.asarray(mask)].mean())


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
