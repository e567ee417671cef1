"""The built-in noise as programs of one pixel: interleaved gradient noise, in whole numbers.

The same bits as `jaxblur.noise.make_noise("ign", ...)`, by arithmetic that fits 32 bits with a
sign, which every target has.
"""

from typing import Any

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from ..kernels import At, Outcome

_UNIT = 10**8
_ALONG_X, _ALONG_Y = 6711056, 583715
_OUTER = round(529829189 * 2**52 / 10**15)
_DIGITS = 5
"""Digits in base 16 of a row or a column: frames of up to 2^20 pixels along a side."""
_LIMB = 4095


def _times(factor: int, place: Array) -> Array:
    """``factor * place mod 10^8``, digit by digit."""
    product = jnp.zeros_like(place)
    for digit in reversed(range(_DIGITS)):
        part = lax.shift_right_arithmetic(place, jnp.int32(4 * digit)) & 15
        product = lax.rem(product * 16 + part * factor, jnp.int32(_UNIT))
    return product


def _gradient(along_x: Array, along_y: Array) -> Array:
    """Interleaved gradient noise in [0, 1), from both products."""
    total = along_x + along_y
    inner = jnp.where(total >= _UNIT, total - _UNIT, total) * 16
    # The upper word of the product with an unsigned constant, in limbs of twelve bits.
    low, middle, high = inner & _LIMB, (inner >> 12) & _LIMB, inner >> 24
    outer_low, outer_middle, outer_high = _OUTER & _LIMB, (_OUTER >> 12) & _LIMB, _OUTER >> 24
    first = low * outer_middle + middle * outer_low + ((low * outer_low) >> 12)
    second = low * outer_high + middle * outer_middle + high * outer_low + (first >> 12)
    third = middle * outer_high + high * outer_middle + (second >> 12)
    upper = ((second & _LIMB) >> 8) + third * 16 + ((high * outer_high) & 255) * 65536
    return (upper & (2**24 - 1)).astype(jnp.float32) * jnp.float32(2**-24)


def tap_noise(at: At, images: Any, _: None, __: None) -> Outcome:
    """Interleaved gradient noise in [-1, 1), which shifts the samples of a pixel [Jimenez 2014]."""
    value = _gradient(_times(_ALONG_X, at.column), _times(_ALONG_Y, at.row))
    return Outcome((2 * value - 1,))


def tile_noise(at: At, images: Any, _: None, __: None) -> Outcome:
    """The same noise along rotated axes, in [-1/2, 1/2), which jitters the tile of a pixel."""
    along_row, along_column = _times(_ALONG_X, at.row), _times(_ALONG_Y, at.column)
    first = _gradient(along_row, along_column)
    backward = jnp.where(along_column == 0, 0, _UNIT - along_column)
    second = _gradient(along_row, backward)
    return Outcome((first - 0.5, second - 0.5))
