"""Gathers: what the samples along a line make of every pixel.

A filter describes in stages what happens at a pixel: does anything move there, what do its samples
need, what does each sample give, what follows from their sums. On a CPU with a C++ compiler all
stages become one native kernel (`jaxblur.native`); elsewhere they run one after the other, with
`sum_samples` in the middle.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero

from .native import Stages, native_gather, no_samples
from .sample_sums import Plan, image_size, on_cpu, replaced, sum_samples
from .settings import Backend


def gather_samples(
    stages: Stages,
    count: int,
    kept: jax.Array,
    local: Any,
    tables: Any,
    backend: Backend = "auto",
) -> jax.Array:
    """Prepare each pixel that moves, sum the terms of its samples, and finish it.

    The same as the stages one after the other with `sum_samples` between them; native code does
    all of them in one pass over the pixels.

    Args:
        stages: ``moving(local, tables)`` gives a (H, W, 1) bool plane, the pixels that are
            computed, and what it found out; ``prepare(local, tables, found)`` a pytree of real
            (H, W, 1) planes and scalars; ``sample(indices (n,), prepared, tables)`` a tuple of
            (H, W, n) terms; ``finish(sums, prepared, local)`` a tuple of (H, W, 1) results.
            Elementwise but for reads of the tables. Part of the compilation key.
        count: number of samples N; 0 with `jaxblur.native.no_samples`.
        kept: (H, W, K) image, what the other pixels keep, K at most the number R of results;
            further channels are 0 there.
        local: pytree of (H, W, K) images, which `sampling.channel` takes apart, and scalars.
        tables: pytree of flat arrays that are read anywhere.
        backend: see `jaxblur.Settings`.

    Returns:
        The results, (H, W, R). Differentiable as `sum_samples`.

    Raises:
        ValueError: the stages have both samples and a `rest`, or the backend is ``native`` and
            there is no compiler, or no native form.
    """
    if stages.rest is not None and stages.sample is not no_samples:
        raise ValueError("`stages.rest` is for stages without samples; leave out one of both.")
    leaves, structure = jax.tree.flatten((local, tables))
    plan = Plan(stages.sample, stages.limit, count, backend, structure)
    return _gather(plan, stages, kept, [jnp.asarray(leaf) for leaf in leaves])


def cond_of_values(
    predicate: jax.Array, usual: Callable[..., Any], other: Callable[..., Any], operands: Any
) -> Any:
    """`lax.cond` for values; derivatives are those of `usual`, whatever the predicate.

    For a shortcut whose result and derivatives `usual` gives too. A conditional in a derivative
    copies every image that reverse mode keeps.

    Args:
        predicate: bool, whether `usual` is computed.
        usual: function of the operands.
        other: the shortcut, a function of the operands.
        operands: tuple of pytrees of arrays; the functions use nothing else that is traced.

    Returns:
        The result of one of both.
    """
    leaves, structure = jax.tree.flatten(operands)
    functions = [
        lambda leaves, f=f: jax.tree.map(_batch_first, f(*jax.tree.unflatten(structure, leaves)))
        for f in (usual, other)
    ]

    @jax.custom_jvp
    def choose(predicate, leaves):
        return lax.cond(predicate, *functions, leaves)

    def of_usual(primals, tangents):
        (_, leaves), (_, tangents) = primals, tangents
        active = [k for k, tangent in enumerate(tangents) if not isinstance(tangent, SymbolicZero)]

        def of_active(values):
            return functions[0](replaced(leaves, active, values))

        return jax.jvp(of_active, ([leaves[k] for k in active],), ([tangents[k] for k in active],))

    choose.defjvp(of_usual, symbolic_zeros=True)
    return choose(predicate, leaves)


def unchanged(color: jax.Array, computed: jax.Array) -> jax.Array:
    """The shortcut of `cond_of_values` that gives a picture back.

    Args:
        color: the picture, an operand.
        computed: the predicate, an operand too.

    Returns:
        The color, where it is not computed.
    """
    # By a product with one: XLA copies a result that is an operand three times over.
    return color * jnp.where(computed, 0, 1).astype(color.dtype)


def _batch_first(result: jax.Array) -> jax.Array:
    """The same; under vmap the batch comes first.

    The result of a map has it second; with jax 0.10.2 the derivative of a custom_jvp then came out
    with the batch taken for another axis.
    """
    return result.T.T


def everywhere(prepare: Callable[..., Any]) -> Stages:
    """Stages of a pass over all pixels, in which nothing but `prepare` happens.

    Args:
        prepare: from (local, tables, found) to the results, a sequence of (H, W, 1) planes.

    Returns:
        Stages for `gather_samples` without samples.
    """
    return Stages(_all_pixels, prepare)


def _all_pixels(local: Any, _tables: Any) -> tuple[jax.Array, tuple[()]]:
    height, width, _ = jax.tree.leaves(local)[0].shape
    return jnp.ones((height, width, 1), bool), ()


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _gather(plan: Plan, stages: Stages, kept: jax.Array, leaves: list[jax.Array]) -> jax.Array:
    """The results, without derivatives."""
    native = native_gather(
        *(stages, plan.count, image_size(kept), plan.operands(leaves), plan.backend),
        kept.shape[-1],
    )

    def by_stages(backend, *operands):
        moving, results = _by_stages(plan._replace(backend=backend), stages, operands[:-1])
        return _select(moving, results, operands[-1])

    if native is None:
        return by_stages(plan.backend, *leaves, kept)
    return on_cpu(
        lambda *operands: native(*operands)[0], functools.partial(by_stages, "xla"), *leaves, kept
    )


def _select(moving: jax.Array | bool, results: jax.Array, kept: jax.Array) -> jax.Array:
    """Results where something moves; elsewhere what is kept, and 0 beyond its channels."""
    missing = results.shape[-1] - kept.shape[-1]
    kept = jnp.pad(kept, ((0, 0), (0, 0), (0, missing))) if missing else kept
    return jnp.where(moving, results, kept)


def _by_stages(
    plan: Plan, stages: Stages, leaves: Sequence[jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """Which pixels move (H, W, 1), and their results: one stage after the other."""
    local, tables = plan.operands(leaves)
    moving, prepared = _prepared(plan, stages, local, tables)
    if stages.sample is no_samples:
        return moving, jnp.concatenate(prepared, axis=-1)
    sums = sum_samples(
        *(stages.sample, plan.count, moving[..., 0], prepared, tables),
        *(plan.backend, stages.limit),
    )
    planes = tuple(total[..., None] for total in sums)
    results = jax.checkpoint(stages.finish)(planes, prepared, local)
    return moving, jnp.concatenate(results, axis=-1)


def _prepared(plan: Plan, stages: Stages, local: Any, tables: Any) -> tuple[jax.Array, Any]:
    """Which pixels move, and what is prepared: planes are the terms of one sample.

    So that derivatives are those of a sum, in native code too; reverse mode computes these stages
    once more and keeps none of their planes, which are dozens.
    """

    def prepare(local, tables):
        moving, found = stages.moving(local, tables)
        prepared = stages.prepare(local, tables, found)
        if stages.rest is None:
            return moving, prepared
        rest = stages.rest(local, tables, found)
        chosen = [jnp.where(moving, *pair) for pair in zip(prepared, rest, strict=True)]
        return jnp.ones_like(moving), chosen

    moving, prepared = jax.eval_shape(prepare, local, tables)
    leaves, structure = jax.tree.flatten(prepared)
    planes = [k for k, leaf in enumerate(leaves) if leaf.ndim == 3]

    def one_sample(_, local, tables):
        moving, prepared = prepare(local, tables)
        values = jax.tree.leaves(prepared)
        return moving.astype(values[planes[0]].dtype), *(values[k] for k in planes)

    everywhere = jnp.ones(moving.shape[:2], bool)
    moving, *found = sum_samples(one_sample, 1, everywhere, local, tables, plan.backend)
    # Scalars are as quick to compute as to read.
    scalars = jax.tree.leaves(prepare(local, tables)[1])
    values = replaced(scalars, planes, [plane[..., None] for plane in found])
    return moving[..., None] > 0, jax.tree.unflatten(structure, values)


def _gather_jvp(plan, stages, primals, tangents):
    """Derivatives are those of the stages; only what has a tangent is differentiated."""
    (kept, leaves), (kept_change, tangents) = primals, tangents
    active = [k for k, tangent in enumerate(tangents) if not isinstance(tangent, SymbolicZero)]
    directions = [tangents[k] for k in active]
    if all(leaves[k].ndim == 0 for k in active):
        values, change = _scalar_derivatives(plan, stages, kept, leaves, active, directions)
        if isinstance(kept_change, SymbolicZero):
            return values, change
        moving = True if stages.rest else stages.moving(*plan.operands(leaves))[0]
    else:

        def results(values):
            moving, results = _by_stages(plan, stages, replaced(leaves, active, values))
            return results, moving

        values, change, moving = jax.jvp(
            results, ([leaves[k] for k in active],), (directions,), has_aux=True
        )
        values = _select(moving, values, kept)
    if isinstance(kept_change, SymbolicZero):
        kept_change = jnp.zeros_like(kept)
    return values, _select(moving, change, kept_change)


def _scalar_derivatives(plan, stages, kept, leaves, active, directions):
    """The results and their change with some scalars, from one kernel: derivatives are images."""
    augmented = _with_scalar_derivatives(plan, stages, active)
    images = _gather(plan, augmented, kept, leaves)
    size = images.shape[-1] // (1 + len(active))
    blocks = [images[..., k : k + size] for k in range(0, images.shape[-1], size)]
    change = jnp.zeros_like(blocks[0])
    for block, direction in zip(blocks[1:], directions, strict=True):
        change = change + block * direction
    return blocks[0], change


def _carrying(
    plan: Plan, stages: Stages, active: Sequence[int], stage: Callable[..., Any]
) -> Callable[..., Any]:
    """A stage before the samples, and its derivative with respect to each active scalar."""

    def carried(local, tables, found):
        leaves = jax.tree.leaves((local, tables))

        def of_scalar(position, value):
            local, tables = plan.operands(replaced(leaves, [position], [value]))
            return stage(local, tables, stages.moving(local, tables)[1])

        changes = [
            jax.jvp(functools.partial(of_scalar, k), (leaves[k],), (jnp.ones_like(leaves[k]),))[1]
            for k in active
        ]
        return stage(local, tables, found), changes

    return carried


def _with_scalar_derivatives(plan: Plan, stages: Stages, active: Sequence[int]) -> Stages:
    """Stages that carry the derivative with respect to each active scalar along."""
    carrying = functools.partial(_carrying, plan, stages, active)
    if stages.sample is no_samples:
        rest = stages.rest and _flat(carrying(stages.rest))
        return Stages(stages.moving, _flat(carrying(stages.prepare)), rest=rest)

    prepare = carrying(stages.prepare)

    def sample(index, prepared, tables):
        value, changes = prepared

        def terms(value):
            return stages.sample(index, value, tables)

        return _with_changes(terms, (value,), [(change,) for change in changes])

    def finish(sums, prepared, local):
        value, changes = prepared
        size = len(sums) // (1 + len(changes))
        blocks = [sums[k : k + size] for k in range(0, len(sums), size)]

        def results(sums, value):
            return stages.finish(sums, value, local)

        return _with_changes(
            results, (blocks[0], value), list(zip(blocks[1:], changes, strict=True))
        )

    limit = stages.limit
    if limit is not None:
        limit = functools.partial(_of_value, limit)
    return Stages(stages.moving, prepare, sample, finish, limit)


def _with_changes(
    function: Callable[..., Any], values: tuple[Any, ...], changes: Sequence[tuple[Any, ...]]
) -> tuple[jax.Array, ...]:
    """Results of a function, then how they change in each direction; what is shared comes once."""
    results, push = jax.linearize(function, *values)
    return sum((tuple(push(*change)) for change in changes), start=tuple(results))


def _flat(stage: Callable[..., Any]) -> Callable[..., Any]:
    """A stage whose planes follow each other."""
    return lambda *operands: jax.tree.leaves(stage(*operands))


def _of_value(limit: Callable[..., Any], prepared: tuple[Any, Any]) -> Any:
    """The limit, of what is prepared without its derivatives."""
    return limit(prepared[0])


_gather.defjvp(_gather_jvp, symbolic_zeros=True)
