"""Marks: what the samples along lines leave in a table, at places that they find out."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from .native import native_marks
from .sample_sums import image_size, on_cpu
from .settings import Backend

Marks = tuple[tuple[Array, Array], ...]


def largest_marks(
    sample: Callable[..., Marks],
    limit: Callable[..., jax.Array],
    local: Any,
    tables: Any,
    length: int,
    backend: Backend = "auto",
) -> Int[Array, " length"]:
    """The largest of the marks that are left at each place.

    Args:
        sample: maps (sample indices (n,), local, tables) to (place, mark) pairs of (H, W, n)
            arrays of whole numbers, the places inside the table; elementwise but for reads of the
            tables.
        limit: from local to a (H, W, 1) plane, the number of samples. Marks of samples beyond it
            are 0, so that they may be left out.
        local: pytree of (H, W, 1) planes and scalars.
        tables: pytree of flat arrays that are read anywhere.
        length: of the table.
        backend: see `jaxblur.Settings`.

    Returns:
        (length,), 0 where there is no mark above 0. Without derivatives.

    Raises:
        ValueError: the backend is ``native`` and there is no compiler, or no native form.
    """
    leaves, structure = jax.tree.flatten((local, tables))
    size = next(image_size(leaf) for leaf in jax.tree.leaves(local) if leaf.ndim == 3)

    def by_xla(*leaves: jax.Array) -> jax.Array:
        local, tables = jax.tree.unflatten(structure, leaves)

        def add(index: jax.Array, table: jax.Array) -> jax.Array:
            pairs = zip(*sample(index[None], local, tables), strict=True)
            places, marks = (jnp.stack(part).reshape(-1) for part in pairs)
            return table.at[places].max(
                marks, mode="promise_in_bounds", wrap_negative_indices=False
            )

        most = jnp.max(limit(local)).astype(jnp.int32)
        return lax.fori_loop(0, most, add, jnp.zeros(length, jnp.int32))

    native = native_marks(sample, limit, size, (local, tables), length, backend)
    if native is None:
        return by_xla(*leaves)
    return on_cpu(lambda *leaves: native(*leaves)[0], by_xla, *leaves)
