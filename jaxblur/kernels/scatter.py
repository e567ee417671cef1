"""Scatter-max: the largest mark that the samples of all pixels leave at each place of a table."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from ..settings import Backend
from .cpp import native_marks
from .stages import NO_TERMS, Grid, Stages
from .sums import Plan, on_cpu


def run_marks(
    stages: Stages,
    leaves: list[jax.Array],
    locals_: int,
    grid: Grid,
    length: int,
    backend: Backend,
    apart: int = 0,
) -> Int[Array, " length"]:
    """The largest of the marks that are left at each place.

    Args:
        stages: of a program that ends in `mark_over`.
        leaves: local inputs, then tables.
        locals_: how many of them are local.
        grid: sizes.
        length: of the table.
        backend: see `jaxblur.Settings`.
        apart: see `jaxblur.kernels.largest_marks`.

    Returns:
        (length,), 0 where there is no mark above 0. Without derivatives.

    Raises:
        ValueError: the backend is ``native`` and there is no compiler, or no native form.
    """

    def by_xla(*leaves: jax.Array) -> jax.Array:
        return _by_scatter(stages, Plan(NO_TERMS, None, 0, backend, grid, locals_), leaves, length)

    native = native_marks(stages, leaves, locals_, grid, length, backend, apart)
    if native is None:
        return by_xla(*leaves)
    return on_cpu(lambda *leaves: native(*leaves)[0], by_xla, *leaves)


def _by_scatter(stages: Stages, plan: Plan, leaves: Any, length: int) -> jax.Array:
    """One step of all pixels after the other."""
    sample, limit = stages.sample, stages.limit
    assert sample is not None and limit is not None
    place, (local, tables) = plan.grid.place(), plan.operands(leaves)
    _, found = stages.where(place, local, tables)
    prepared = stages.prepare(place, local, tables, found)
    most = jnp.max(limit(prepared)).astype(jnp.int32)

    def add(index: jax.Array, table: jax.Array) -> jax.Array:
        numbers = sample(jnp.asarray(index)[None], place, prepared, tables)
        shape = plan.grid.height, plan.grid.width, 1
        places, marks = (
            jnp.stack([jnp.broadcast_to(number, shape) for number in part]).reshape(-1)
            for part in (numbers[::2], numbers[1::2])
        )
        return table.at[places].max(marks, mode="promise_in_bounds", wrap_negative_indices=False)

    return lax.fori_loop(0, most, add, jnp.zeros(length, jnp.int32))
