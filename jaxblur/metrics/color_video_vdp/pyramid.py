"""Bands of spatial frequency: a Laplacian pyramid whose bands are contrasts to the local light."""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

KERNEL = (0.05, 0.25, 0.4, 0.25, 0.05)
"""Burt and Adelson 1983 with a = 0.4."""
LOWEST_FREQUENCY = 0.2
"""Cycles per degree; coarser bands are left to the base band."""
BASE_FREQUENCY = 0.1
"""Cycles per degree at which the base band is looked up."""
PEAK = 0.3228
"""Frequency at which the second band has its peak, in units of half the sampling frequency."""
DARKEST = 0.01
"""cd/m2, of the light that a contrast refers to."""
LARGEST = 1000.0
"""Largest contrast."""
SMALLEST_SIDE = 4

Planes = Float[jax.Array, "*planes height width"]
Resized = Float[jax.Array, "*planes rows columns"]


class Band(NamedTuple):
    """One band of the pair of test and reference.

    Attributes:
        contrast: (2, C, h, w) Weber contrast of test and reference.
        log10_luminance: (h, w) of the reference's local light in cd/m2; (1, 1) for the base band,
            whose light is the mean of the picture.
    """

    contrast: Float[jax.Array, "2 channels height width"]
    log10_luminance: Float[jax.Array, "rows columns"]


def band_frequencies(size: tuple[int, int], pixels_per_degree: float) -> np.ndarray:
    """Frequencies of the bands in cycles per degree, from fine to coarse; the last is the base.

    Args:
        size: (height, width) of the picture, at least 4.
        pixels_per_degree: of the display.

    Returns:
        Two or more frequencies; as many as fit the picture, down to 0.2 cycles per degree.
    """
    half = pixels_per_degree / 2
    fitting = int(math.log2(min(size))) - 1
    frequencies = half * np.array([1.0, *(PEAK * 2.0**-level for level in range(fitting))])
    above = np.count_nonzero(frequencies[:fitting] > LOWEST_FREQUENCY)
    return np.array([*frequencies[: min(above + 1, fitting)], BASE_FREQUENCY])


def contrast_bands(
    pair: Float[jax.Array, "2 channels height width"], count: int
) -> tuple[Band, ...]:
    """Decompose test and reference into bands of contrast.

    ``(g_i - expand(g_i+1)) / L`` with the Gaussian pyramid g and the local light L, the luminance
    of ``expand(g_i+1)``, of test and reference each; the base band is the coarsest g by its mean.

    Args:
        pair: (2, C, H, W) test and reference, luminance first, cd/m2.
        count: number of bands.

    Returns:
        The bands, fine to coarse, each half as high and wide as the one before, rounded up.

    Source: Mantiuk et al. 2024, section 3.4.
    """
    levels = [pair]
    for _ in range(count - 1):
        levels.append(reduced(levels[-1]))
    bands = []
    for index, level in enumerate(levels[:-1]):
        blurred = expanded(levels[index + 1], level.shape[-2:])
        light = jnp.maximum(blurred[:, :1], DARKEST)
        # The bands between are half as high as those of an undecimated pyramid.
        gain = 1.0 if index == 0 else 2.0
        bands.append(_band(gain, level - blurred, light))
    light = jnp.maximum(levels[-1][:, :1], DARKEST).mean((-2, -1), keepdims=True)
    return (*bands, _band(1.0, levels[-1], light))


def _band(gain: float, layer: jax.Array, light: jax.Array) -> Band:
    return Band(gain * jnp.minimum(layer / light, LARGEST), jnp.log10(light[1, 0]))


def reduced(planes: Planes) -> Resized:
    """Blur and take every second pixel, starting with the first; sizes are rounded up.

    Borders are mirrored, with one exception. The package cvvdp, on which the model was calibrated,
    decides by the number of *rows* how the last column is mirrored. Where just one of height and
    width is odd, the weights of the last column so add up to 1.25 or 0.75. It is done here too.

    Args:
        planes: (..., H, W).

    Returns:
        (..., ceil(H / 2), ceil(W / 2)).
    """
    height, width = planes.shape[-2:]
    odd = height % 2 == 1
    return separable(_reduction(height, odd), _reduction(width, odd), planes)


def expanded(planes: Planes, size: tuple[int, ...]) -> Resized:
    """Interpolate to twice the size; the border is repeated.

    Args:
        planes: (..., h, w).
        size: (H, W), of which h and w are the halves, rounded up.

    Returns:
        (..., H, W).
    """
    return separable(_expansion(size[0]), _expansion(size[1]), planes)


def separable(rows: np.ndarray, columns: np.ndarray, planes: Planes) -> Resized:
    """Apply one matrix along the rows and one along the columns.

    Products compile in less than half of the time that sums of shifted planes take, gradients in
    a third.

    Args:
        rows: (H', H).
        columns: (W', W).
        planes: (..., H, W).

    Returns:
        (..., H', W').
    """
    left, right = jnp.asarray(rows, planes.dtype), jnp.asarray(columns.T, planes.dtype)
    return jnp.matmul(left, jnp.matmul(planes, right, precision="highest"), precision="highest")


@functools.lru_cache
def _reduction(count: int, mirror_as_odd: bool) -> np.ndarray:
    """(ceil(N / 2), N): the kernel around every second of N pixels, its ends mirrored."""
    matrix = np.zeros(((count + 1) // 2, count))
    for row in range(matrix.shape[0]):
        for tap, weight in enumerate(KERNEL):
            if 0 <= (column := 2 * row + tap - 2) < count:
                matrix[row, column] += weight
    matrix[0, :2] += KERNEL[1], KERNEL[0]
    matrix[-1, -2:] += (KERNEL[4], KERNEL[3]) if mirror_as_odd else (0.0, KERNEL[4])
    return matrix


@functools.lru_cache
def _expansion(count: int) -> np.ndarray:
    """(N, ceil(N / 2)): twice the kernel around N pixels, of which every second is known."""
    matrix = np.zeros((count, (count + 1) // 2))
    for row in range(count):
        for tap, weight in enumerate(KERNEL):
            if (row + tap) % 2 == 0:
                column = np.clip((row + tap - 2) // 2, 0, matrix.shape[1] - 1)
                matrix[row, column] += 2 * weight
    return matrix
