"""Per-pixel noise that turns banding into grain: it shifts taps and the tile that a pixel reads.

Noise is an input of every filter (departure 7 of the filter specification): pass a `Noise`, or
let the filter build one of the kinds below. Tap noise and tile noise are independent.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from .frame import register_record
from .settings import NoiseKind

_HALTON_BLOCK = 64

_INNER_UNIT, _INNER_X, _INNER_Y = 10**8, np.int64(6711056), np.int64(583715)
"""0.06711056 and 0.00583715 in units of 10^-8."""

_OUTER = round(529829189 * 2**52 / 10**15)
"""52.9829189 / 10^8 in units of 2^-52; with four more bits in the other factor, of 2^-56."""


_STEP_X, _STEP_Y = 97, 303
"""Columns and rows by which the pattern moves from seed to seed. Interleaved gradient noise then
changes at every pixel by nearly the golden ratio (0.613, 0.380 and 0.382 in its three planes), so
that the values that a pixel takes in a few frames are spread evenly."""


@register_record
@dataclasses.dataclass(frozen=True)
class Noise:
    """Noise for one frame.

    Attributes:
        tap: (H, W) in [-1, 1), shifts all taps of a pixel along their lines.
        tile: (H, W, 2) in [-0.5, 0.5) as ``(x, y)``, jitters the lookup of the tile.
    """

    tap: jax.Array
    tile: jax.Array


def interleaved_gradient(x: Int[np.ndarray, "*a"], y: Int[np.ndarray, "*b"]) -> Float[Array, "*c"]:
    """Interleaved gradient noise, ``frac(52.9829189 frac(0.06711056 x + 0.00583715 y))``.

    Computed in integers, so that every program gives the same bits: in floating point the result
    depends on how products are fused with sums, and for large coordinates only three digits are
    correct.

    Source: Jimenez, Next Generation Post Processing in Call of Duty, SIGGRAPH course 2014.

    Args:
        x: columns of the pixels, at most 2^31 in magnitude.
        y: rows of the pixels; broadcast against the columns.

    Returns:
        Values in [0, 1), multiples of 2^-24; within 1e-7 of the formula.
    """
    along_x, along_y = (_INNER_X * x) % _INNER_UNIT, (_INNER_Y * y) % _INNER_UNIT
    total = jnp.asarray(along_x, jnp.uint32) + jnp.asarray(along_y, jnp.uint32)
    inner = jnp.where(total >= _INNER_UNIT, total - _INNER_UNIT, total)
    # The upper word of the product with 52.9829189 / 10^8 in units of 2^-56, without its integer
    # part.
    outer = _upper_word(inner << 4, _OUTER) & (2**24 - 1)
    return outer.astype(jnp.float32) * jnp.float32(2**-24)


def _upper_word(first: jax.Array, second: int) -> jax.Array:
    """The upper 32 bits of a product of 32-bit numbers, by halves of 16 bits.

    `lax.mulhi` has no form for arrays that are spread over devices (jax 0.10.2).
    """
    low, high = first & 0xFFFF, first >> 16
    second_low, second_high = jnp.uint32(second & 0xFFFF), jnp.uint32(second >> 16)
    middle = high * second_low + (low * second_low >> 16)
    carried = low * second_high + (middle & 0xFFFF)
    return high * second_high + (middle >> 16) + (carried >> 16)


def _halton_block() -> np.ndarray:
    """Return the first 64 x 64 Halton points in bases 2, 3, 5, laid out row by row."""
    from scipy.stats import qmc

    points = qmc.Halton(d=3, scramble=False).random(_HALTON_BLOCK**2)
    return points.reshape(_HALTON_BLOCK, _HALTON_BLOCK, 3).astype(np.float32)


def _uniform(
    kind: NoiseKind, height: int, width: int, right: int, down: int
) -> Float[Array, "{height} {width} 3"]:
    """Make three independent values in [0, 1) for every pixel, moved by some pixels."""
    if kind == "none":
        return jnp.full((height, width, 3), 0.5, jnp.float32)
    if kind == "halton":
        rows = (np.arange(height) + down % _HALTON_BLOCK) % _HALTON_BLOCK
        columns = (np.arange(width) + right % _HALTON_BLOCK) % _HALTON_BLOCK
        return jnp.asarray(_halton_block()[np.ix_(rows, columns)])
    # The noise repeats after so many pixels.
    y, x = np.ogrid[:height, :width]
    y, x = y + down % _INNER_UNIT, x + right % _INNER_UNIT
    # Shifted copies of one pattern correlate (up to 0.7); rotated copies do not.
    planes = [interleaved_gradient(x, y), interleaved_gradient(y, x), interleaved_gradient(y, -x)]
    return jnp.stack(planes, axis=-1)


def make_noise(
    kind: NoiseKind, height: int, width: int, seed: int = 0, *, origin: tuple[int, int] = (0, 0)
) -> Noise:
    """Make built-in noise of one kind.

    Args:
        kind: ``ign`` (interleaved gradient noise), ``halton`` (bases 2, 3, 5 in a repeated
            64 x 64 block) or ``none`` (all zero).
        height: rows.
        width: columns.
        seed: moves the pattern, such as the number of a frame, so that it does not stand still over
            a shot; 0 is the noise that filters make themselves.
        origin: (x, y) where the first pixel lies in a larger picture, whose noise it gets; pixels.

    Returns:
        The noise, float32.
    """
    right, down = origin[0] + seed * _STEP_X, origin[1] + seed * _STEP_Y
    uniform = _uniform(kind, height, width, right, down)
    return Noise(tap=2 * uniform[..., 0] - 1, tile=uniform[..., 1:] - 0.5)


def shared_noise(noise: Noise, disparity: ArrayLike) -> Noise:
    """The noise of a right eye that sticks to the surfaces: where it sees them, that of the left.

    Grain that differs between the eyes disturbs their fusion; so does grain that is at rest on the
    screen and therefore floats in front of the scene.

    Args:
        noise: of the left eye.
        disparity: (H, W) pixels: what the right view shows at column x, the left view shows at
            ``x + d``; ``focal separation / depth`` with the focal length in pixels, 0 for sky.

    Returns:
        The noise of the right eye. Where the left view ends, its outermost column is used.

    Raises:
        ValueError: the disparity has another shape than the noise.
    """
    height, width = noise.tap.shape
    if jnp.shape(disparity) != (height, width):
        raise ValueError(
            f"`disparity` must have the shape of the noise, {(height, width)}, got "
            f"{jnp.shape(disparity)}."
        )
    column = jnp.arange(width) + jnp.rint(disparity).astype(jnp.int32)
    rows, column = jnp.arange(height)[:, None], jnp.clip(column, 0, width - 1)
    return Noise(noise.tap[rows, column], noise.tile[rows, column])


def resolve_noise(noise: Noise | None, kind: NoiseKind, height: int, width: int) -> Noise:
    """Return the noise that was passed, after a check of its shapes, or the built-in kind.

    Args:
        noise: explicit noise, or None.
        kind: the built-in kind used for None.
        height: rows of the frame.
        width: columns of the frame.

    Returns:
        Noise for a frame of this size.

    Raises:
        TypeError: ``noise`` is neither a `Noise` nor None.
        ValueError: an array of ``noise`` has the wrong shape.
    """
    if noise is None:
        return make_noise(kind, height, width)
    if not isinstance(noise, Noise):
        raise TypeError(
            f"`noise` must be a jaxblur.Noise of `tap` and `tile`, got {type(noise).__name__}."
        )
    for name, shape in (("tap", (height, width)), ("tile", (height, width, 2))):
        actual = jnp.shape(getattr(noise, name))
        if actual != shape:
            raise ValueError(f"`noise.{name}` must have shape {shape}, got {actual}.")
    return noise
