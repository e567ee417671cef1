"""ColorVideoVDP: how much worse than the reference a clip or an image looks, in JOD."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..images import absolute
from .display import Display, find_display, opponent_channels
from .masking import masked_difference
from .pooling import just_objectionable_differences, over_pixels
from .pyramid import SMALLEST_SIDE, band_frequencies, contrast_bands
from .sensitivity import sensitivity
from .temporal import temporal_filters

Clip = Float[jax.Array | np.ndarray, "*frames height width 3"]


def cvvdp(
    test: Clip,
    reference: Clip,
    *,
    frames_per_second: float | None = None,
    display: str | Display = "standard_4k",
    pixels_per_degree: float | None = None,
) -> Float[jax.Array, ""]:
    """Quality of a clip or an image beside its reference, by ColorVideoVDP.

    Models what a person sees on a display: sensitivity by spatial and temporal frequency, luminance
    and color, and masking. Flicker counts in clips.

    Args:
        test: (F, H, W, 3) frames of a clip, or (H, W, 3) an image: display-linear light, with
            the primaries of sRGB. Displays of standard dynamic range have white at 1. On
            ``standard_hdr_linear`` values are cd/m2, and on ``standard_hdr_pq`` they are cd/m2
            with the primaries of Rec. 2020. Values are clipped to what the display shows.
        reference: the same shape and unit; differentiable too.
        frames_per_second: frame rate of a clip; not needed for an image, or a clip of one frame.
        display: name in `DISPLAYS`, or a `Display`.
        pixels_per_degree: pixels per degree of visual angle, in place of the display's. Smaller
            means closer to the screen.

    Returns:
        Scalar in JOD (just-objectionable differences): 10 for equal clips, where the derivative is
        0; of two that differ by 1 JOD, 75 of 100 people prefer the better one. Compiles once for
        each shape, frame rate and display. Frames are judged one after the other, so that
        the memory is that of the clips and of one frame; so for gradients.

    Raises:
        ValueError: shapes differ or are no clips, sides are below 4 pixels, a clip has no frame
            rate, or the display is unknown.

    Source: Mantiuk, Hanji, Ashraf, Asano, Chapiro 2024, "ColorVideoVDP: a visual difference
    predictor for image, video and display distortions"; calibration 0.5.7.

    Examples:
        >>> picture = np.full((16, 16, 3), 0.5, np.float32)
        >>> float(cvvdp(picture, picture))
        10.0
    """
    test, reference = jnp.asarray(test), jnp.asarray(reference)
    check_shapes(test.shape, reference.shape)
    if test.ndim == 3:
        test, reference = test[None], reference[None]
    is_clip = test.shape[0] > 1
    if is_clip and (frames_per_second is None or not frames_per_second > 0):
        raise ValueError(
            f"`frames_per_second` must be positive for a clip, got {frames_per_second}; "
            "pass its frame rate, such as 24."
        )
    screen = find_display(display)
    density = screen.pixels_per_degree if pixels_per_degree is None else pixels_per_degree
    if not density > 0:
        raise ValueError(f"`pixels_per_degree` must be positive, got {density}.")
    rate = float(frames_per_second) if is_clip and frames_per_second else 0.0
    dtype = jnp.promote_types(jnp.result_type(test, reference), jnp.float32)
    return _compiled(test.astype(dtype), reference.astype(dtype), rate, screen, float(density))


def check_shapes(test: tuple[int, ...], reference: tuple[int, ...]) -> None:
    """Reject shapes that differ or are no clips."""
    if test != reference:
        raise ValueError(f"`test` and `reference` must have one shape, got {test} and {reference}.")
    if len(test) not in (3, 4) or test[-1] != 3 or min(test[-3:-1]) < SMALLEST_SIDE or not test[0]:
        raise ValueError(
            "`test` must have shape (frames, height, width, 3) or (height, width, 3) with sides "
            f"of at least {SMALLEST_SIDE}, got {test}; pass the three color channels alone."
        )


@functools.partial(jax.jit, static_argnums=(2, 3, 4))
def _compiled(
    test: jax.Array,
    reference: jax.Array,
    frames_per_second: float,
    display: Display,
    pixels_per_degree: float,
) -> jax.Array:
    height, width = test.shape[1:3]
    frequencies = band_frequencies((height, width), pixels_per_degree)
    if test.shape[0] == 1:
        pair = opponent_channels(jnp.concatenate([test, reference]), display)
        return just_objectionable_differences(_differences(pair, frequencies)[None])
    filters = jnp.asarray(temporal_filters(frames_per_second), test.dtype)

    # What a frame keeps for its derivative would fill the memory: it is computed again.
    @jax.checkpoint
    def of_frame(number: jax.Array) -> jax.Array:
        # Before the first frame it stands still.
        window = jnp.maximum(number - jnp.arange(filters.shape[1]), 0)
        frames = opponent_channels(jnp.stack([test[window], reference[window]]), display)
        seen = [
            jnp.einsum("n,pnhw->phw", filters[channel], frames[:, :, color], precision="highest")
            for channel, color in enumerate((0, 1, 2, 0))
        ]
        return _differences(jnp.stack(seen, axis=1), frequencies)

    return just_objectionable_differences(jax.lax.map(of_frame, jnp.arange(test.shape[0])))


def _differences(
    pair: Float[jax.Array, "2 channels height width"], frequencies: np.ndarray
) -> Float[jax.Array, "channels bands"]:
    """Differences of one frame by channel and band."""
    bands = contrast_bands(pair, len(frequencies))
    pooled = []
    for band, frequency in zip(bands, frequencies, strict=True):
        visible = sensitivity(float(frequency), band.log10_luminance, pair.shape[1])
        if band is bands[-1]:
            # The base band is neither masked nor clamped.
            difference = absolute(band.contrast[0] - band.contrast[1]) * visible
        else:
            difference = masked_difference(band.contrast, visible)
        pooled.append(over_pixels(difference))
    return jnp.stack(pooled, axis=-1)
