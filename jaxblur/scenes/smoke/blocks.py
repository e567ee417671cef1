"""Loops over many points in blocks, of which a part may be left out.

All points of a block take as many steps as the one that needs most. So blocks hold neighbors, and
points of no interest are sorted out beforehand.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

TILE = 8
"""Pixels across a tile."""

Inputs = TypeVar("Inputs")


def in_blocks(
    function: Callable[[Inputs, Bool[Array, " width"]], Float[Array, "values width"]],
    inputs: Inputs,
    order: Int[Array, " points"],
    count: Int[Array, ""],
    width: int,
    empty: Float[Array, " values"],
) -> Float[Array, "values points"]:
    """Apply a function to the first points of an order, block by block.

    Args:
        function: from the inputs of `width` points, and whether they are wanted, to their values.
            The last block is filled up with points that are not wanted.
        inputs: arrays whose last axis are the points.
        order: (P,) the points.
        count: () how many of them are wanted.
        width: static, of a block.
        empty: (M,) the values of the others.

    Returns:
        (M, P) values, by point.
    """
    total = order.shape[0]
    padded = jnp.pad(order, (0, -total % width))

    def one(i: Array, found: Array) -> Array:
        chosen = jax.lax.dynamic_slice(padded, (i * width,), (width,))
        part = jax.tree.map(lambda values: values[..., chosen], inputs)
        values = function(part, i * width + jnp.arange(width) < count)
        return jax.lax.dynamic_update_slice(found, values, (0, i * width))

    start = jnp.broadcast_to(empty[:, None], (len(empty), len(padded)))
    found = jax.lax.fori_loop(0, (count + width - 1) // width, one, start)
    inside = jnp.arange(len(padded)) < count
    found = jnp.where(inside, found, start)[:, :total]
    return jnp.zeros_like(found).at[:, order].set(found)


def wanted_first(
    order: Int[Array, " points"], wanted: Bool[Array, " points"]
) -> tuple[Int[Array, " points"], Int[Array, ""]]:
    """Move points of interest to the front; otherwise the order stays.

    Args:
        order: (P,) the points.
        wanted: (P,) by point.

    Returns:
        The new order, and the number of points of interest.
    """
    return order[jnp.argsort(~wanted[order], stable=True)], jnp.sum(wanted)


def tile_order(size: tuple[int, int]) -> Int[Array, " pixels"]:
    """The pixels of an image in row-major order, rearranged tile by tile."""
    rows, columns = np.divmod(np.arange(size[0] * size[1]), size[1])
    keys = (columns % TILE, rows % TILE, columns // TILE, rows // TILE)
    return jnp.asarray(np.lexsort(keys), jnp.int32)
