"""Leave masked samples out of a filter.

The result of a filter is ``sum_i w_i c_i / sum_i w_i``, with the same weights for all channels of a
call.
Filtering ``m c`` and the mask m alike, and dividing, gives ``sum_i w_i m_i c_i / sum_i w_i m_i``:
a masked sample contributes neither color nor weight, in any filter, for the cost of one more
channel.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Concatenate, ParamSpec

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..frame import Frame, check_frame

P = ParamSpec("P")

SMALLEST_SHARE = 1e-3
"""Least filtered mask of a pixel that is reached by valid samples."""


def honoring_mask(
    function: Callable[Concatenate[Frame, P], jax.Array],
) -> Callable[Concatenate[Frame, P], jax.Array]:
    """Make a filter leave out what ``frame.valid`` masks.

    Args:
        function: a filter; its frames never have a mask.

    Returns:
        The same filter for frames with a mask too; without one nothing changes.
    """

    @functools.wraps(function)
    def with_mask(frame: Frame, /, *arguments: P.args, **options: P.kwargs) -> jax.Array:
        if frame.valid is None:
            return function(frame, *arguments, **options)
        return divide_by_mask(function(append_mask(frame), *arguments, **options))

    return with_mask


def append_mask(frame: Frame) -> Frame:
    """Turn the mask into one more channel of a color that is 0 where it is masked.

    Args:
        frame: with ``valid`` (H, W), 1 or True where the color is to be used.

    Returns:
        The frame without ``valid``, color (H, W, C + 1).

    Raises:
        ValueError: shapes disagree.
    """
    frame = check_frame(frame)
    mask = (jnp.asarray(frame.valid) != 0)[..., None]
    # Replaced and not multiplied, because masked colors may be NaN.
    color = jnp.where(mask, frame.color, 0)
    color = jnp.concatenate([color, mask.astype(color.dtype)], axis=-1)
    return dataclasses.replace(frame, color=color, valid=None)


def divide_by_mask(
    filtered: Float[Array, "*batch height width channels_and_mask"],
) -> Float[Array, "*batch height width channels"]:
    """Divide filtered colors by the filtered mask; fill pixels that no valid sample reaches.

    Args:
        filtered: (..., H, W, C + 1), the mask last.

    Returns:
        (..., H, W, C): ratios; where the mask is below `SMALLEST_SHARE` the mean of the 3 x 3
        neighbors that are not, and 0 if there are none.
    """
    color, share = filtered[..., :-1], filtered[..., -1:]
    reached = share > SMALLEST_SHARE
    color = jnp.where(reached, color / jnp.where(reached, share, 1), 0)
    count = _sum_of_neighbors(reached.astype(color.dtype))
    mean = _sum_of_neighbors(color) / jnp.maximum(count, 1)
    return jnp.where(reached, color, mean)


def _sum_of_neighbors(image: jax.Array) -> jax.Array:
    window = (*(1,) * (image.ndim - 3), 3, 3, 1)
    return lax.reduce_window(image, 0.0, lax.add, window, (1,) * image.ndim, "SAME")
