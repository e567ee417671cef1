"""Run the stages of a program for every pixel, with their derivatives.

On a CPU with a C++ compiler all stages become one native kernel (`.cpp`); elsewhere they run one
after the other, with `sum_samples` in the middle.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero

from ..settings import Backend
from .cpp import native_gather
from .keys import Keyed, key_of
from .operators import Operator
from .stages import NO_TERMS, Grid, Place, Sample, Stages
from .sums import Plan, on_cpu, replaced, sum_samples


def run_stages(
    stages: Stages,
    results: Sequence[str],
    kept: jax.Array | None,
    local: Sequence[jax.Array],
    tables: Sequence[jax.Array],
    grid: Grid,
    backend: Backend = "auto",
) -> jax.Array:
    """The results of a program's stages at every pixel.

    Args:
        stages: of the program. Part of the compilation key.
        results: their types.
        kept: (H, W, K) image that the pixels keep whose results are not wanted, K at most the
            number R of results; further channels are 0 there. None where all are wanted, or the
            others have results of their own.
        local: (H, W, K) images and scalars.
        tables: (h, w, C) images that are read anywhere.
        grid: sizes.
        backend: see `jaxblur.Settings`.

    Returns:
        The results, (H, W, R). Differentiable as `sum_samples`.

    Raises:
        ValueError: the backend is ``native`` and there is no compiler, or no native form.
    """
    sample = stages.sample or NO_TERMS
    plan = Plan(sample, stages.limit, stages.samples, backend, grid, len(local))
    leaves = [jnp.asarray(leaf) for leaf in (*local, *tables)]
    static = _Gather(plan, stages, len(leaves), len(results), jnp.result_type(*results))
    return _gather(static, kept, leaves)


class _Gather(NamedTuple):
    """The static part of a run: operands are the leaves, then the image kept, if there is one."""

    plan: Plan
    stages: Stages
    leaves: int
    results: int
    dtype: Any

    def split(self, operands: Sequence[Any]) -> tuple[list[Any], Any]:
        """Operands as leaves and the image kept."""
        leaves, images = list(operands[: self.leaves]), operands[self.leaves :]
        return leaves, (images[0] if images else None)


def _gather(static: _Gather, kept: jax.Array | None, leaves: Sequence[jax.Array]) -> jax.Array:
    """The results."""
    return _gather_operator(static, (*leaves, *(() if kept is None else (kept,))))[0]


def _shapes(static: _Gather, operands: Sequence[Any]) -> list[jax.ShapeDtypeStruct]:
    """Shape and type of the results."""
    grid, kept = static.plan.grid, static.split(operands)[1]
    dtype = static.dtype if kept is None else jnp.result_type(static.dtype, kept.dtype)
    return [jax.ShapeDtypeStruct((grid.height, grid.width, static.results), dtype)]


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
    functions = [functools.partial(_of_leaves, function, structure) for function in (usual, other)]

    @jax.custom_jvp
    def choose(predicate: Any, leaves: Any) -> Any:
        return lax.cond(predicate, *functions, leaves)

    def of_usual(primals: Any, tangents: Any) -> tuple[Any, Any]:
        (_, leaves), (_, tangents) = primals, tangents
        active = [k for k, tangent in enumerate(tangents) if not isinstance(tangent, SymbolicZero)]

        def of_active(values: Any) -> Any:
            return functions[0](replaced(leaves, active, values))

        return jax.jvp(of_active, ([leaves[k] for k in active],), ([tangents[k] for k in active],))

    choose.defjvp(of_usual, symbolic_zeros=True)
    return choose(predicate, leaves)


def _of_leaves(function: Callable[..., Any], structure: Any, leaves: Any) -> Any:
    return jax.tree.map(_batch_first, function(*jax.tree.unflatten(structure, leaves)))


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


def _gathered(static: _Gather, operands: Sequence[jax.Array]) -> list[jax.Array]:
    """The results, without derivatives."""
    plan, stages, count, *_ = static
    leaves, kept = static.split(operands)
    channels = 0 if kept is None else kept.shape[-1]
    native = native_gather(stages, leaves, plan.locals, plan.grid, plan.backend, channels)

    def by_stages(backend: Backend, *operands: jax.Array) -> jax.Array:
        wanted, results = _by_stages(plan._replace(backend=backend), stages, operands[:count])
        return _select(wanted, results, *operands[count:])

    if native is None:
        return [by_stages(plan.backend, *operands)]
    other = functools.partial(by_stages, "xla")
    return [on_cpu(lambda *operands: native(*operands)[0], other, *operands)]


def _select(wanted: jax.Array, results: jax.Array, kept: jax.Array | None = None) -> jax.Array:
    """Results where they are wanted; elsewhere what is kept, and 0 beyond its channels."""
    if kept is None:
        return results
    missing = results.shape[-1] - kept.shape[-1]
    kept = jnp.pad(kept, ((0, 0), (0, 0), (0, missing))) if missing else kept
    return jnp.where(wanted, results, kept)


def _by_stages(
    plan: Plan, stages: Stages, leaves: Sequence[jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """Which results are wanted (H, W, 1), and the results: one stage after the other."""
    if stages.sample is None and plan.backend == "xla":
        return jax.checkpoint(functools.partial(_at_once, plan, stages))(list(leaves))
    wanted, prepared = _prepared(plan, stages, leaves)
    shape = plan.grid.height, plan.grid.width, 1
    if stages.sample is None or stages.finish is None:
        return wanted, _image(shape, prepared)
    finish_planes = stages.finish
    flat, structure = jax.tree.flatten(prepared)
    sums = sum_samples(
        _of_planes(stages.sample, structure),
        stages.samples,
        wanted[..., 0],
        flat,
        leaves[plan.locals :],
        plan.grid,
        plan.backend,
        stages.limit and _limit_of_planes(stages.limit, structure),
    )
    planes = [total[..., None] for total in sums]

    def finish(sums: Any, prepared: Any, leaves: Any) -> list[jax.Array]:
        local, _ = plan.operands(leaves)
        return finish_planes(plan.grid.place(), sums, prepared, local)

    results = jax.checkpoint(finish)(planes, prepared, list(leaves))
    return wanted, _image(shape, results)


def _at_once(
    plan: Plan, stages: Stages, leaves: Sequence[jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """A program without a sum on whole planes; reverse mode computes it once more."""
    shape = plan.grid.height, plan.grid.width, 1
    place, (local, tables) = plan.grid.place(), plan.operands(leaves)
    wanted, found = stages.where(place, local, tables)
    results = stages.prepare(place, local, tables, found)
    if stages.otherwise is not None:
        rest = stages.otherwise(place, local, tables, found)
        results = [jnp.where(wanted, *pair) for pair in zip(results, rest, strict=True)]
    return jnp.broadcast_to(wanted, shape), _image(shape, results)


def _image(shape: tuple[int, int, int], planes: Sequence[jax.Array]) -> jax.Array:
    """Planes, or scalars, as the channels of one image."""
    return jnp.concatenate([jnp.broadcast_to(plane, shape) for plane in planes], axis=-1)


# Equal arguments give the same function: it is a part of the key under which a kernel is kept once
# it is printed.
@functools.lru_cache(maxsize=512)
def _of_planes(sample: Sample, structure: Any) -> Sample:
    """A sample that takes each prepared value as an image of one channel."""

    def of_planes(index: Any, place: Place, local: Any, tables: Any) -> Any:
        prepared = jax.tree.unflatten(structure, [value for (value,) in local])
        return sample(index, place, prepared, tables)

    return Sample(of_planes, key_of(("of planes", sample, str(structure))), sample.types)


@functools.lru_cache(maxsize=512)
def _limit_of_planes(limit: Callable[..., Any], structure: Any) -> Callable[..., Any]:
    def of_planes(local: Any) -> Any:
        return limit(jax.tree.unflatten(structure, [value for (value,) in local]))

    return Keyed(of_planes, key_of(("limit of planes", limit, str(structure))))


def _prepared(plan: Plan, stages: Stages, leaves: Sequence[jax.Array]) -> tuple[jax.Array, Any]:
    """Which results are wanted, and the prepared values: planes are the terms of one sample.

    Their derivatives are then those of a sum, in native code too, and reverse mode computes these
    stages once more and keeps none of their dozens of planes.
    """
    grid = plan.grid
    prepared, structure = jax.tree.flatten(stages.prepared)
    dtype = jnp.result_type(jnp.float32, *(value.dtype for value in prepared))
    planes = tuple(k for k, value in enumerate(prepared) if value.varies)
    everywhere = jnp.ones((grid.height, grid.width), bool)
    wanted, *found = sum_samples(
        _one_sample(stages, planes, dtype.name),
        1,
        everywhere,
        leaves[: plan.locals],
        leaves[plan.locals :],
        grid,
        plan.backend,
    )
    values: list[Any] = prepared
    if len(planes) < len(prepared):
        # Scalars are as fast to compute as to read.
        values = jax.tree.leaves(_prepare(stages, grid.place(), *plan.operands(leaves))[1])
    values = replaced(values, planes, [plane[..., None] for plane in found])
    return wanted[..., None] > 0, jax.tree.unflatten(structure, values)


def _prepare(stages: Stages, place: Place, local: Any, tables: Any) -> tuple[Any, list[Any]]:
    """Which results are wanted, and the prepared values."""
    wanted, found = stages.where(place, local, tables)
    prepared = stages.prepare(place, local, tables, found)
    if stages.otherwise is None:
        return wanted, prepared
    rest = stages.otherwise(place, local, tables, found)
    return wanted, [jnp.where(wanted, *pair) for pair in zip(prepared, rest, strict=True)]


@functools.lru_cache(maxsize=512)
def _one_sample(stages: Stages, planes: tuple[int, ...], dtype: str) -> Sample:
    """The preparation as a sample: whether results are wanted, and those values that are planes."""

    def one_sample(_: Any, place: Place, local: Any, tables: Any) -> list[Any]:
        wanted, prepared = _prepare(stages, place, local, tables)
        values = jax.tree.leaves(prepared)
        return [wanted.astype(dtype), *(values[k].astype(dtype) for k in planes)]

    key = key_of(("one sample", tuple(stages), planes, dtype))
    return Sample(one_sample, key, [dtype] * (1 + len(planes)))


def _gather_jvp(
    static: _Gather, primals: Any, tangents: Any
) -> tuple[list[jax.Array], list[jax.Array]]:
    """Derivatives are those of the stages; only inputs with a tangent are differentiated."""
    plan, stages = static.plan, static.stages
    (leaves, kept), (tangents, kept_change) = static.split(primals), static.split(tangents)
    active = [k for k, tangent in enumerate(tangents) if tangent is not None]
    directions = [tangents[k] for k in active]
    if all(leaves[k].ndim == 0 for k in active):
        values, change = _scalar_derivatives(static, kept, leaves, active, directions)
        if kept_change is None:
            return [values], [change]
        wanted = stages.where(plan.grid.place(), *plan.operands(leaves))[0]
    else:

        def results(values: Any) -> tuple[jax.Array, jax.Array]:
            wanted, results = _by_stages(plan, stages, replaced(leaves, active, values))
            return results, wanted

        values, change, wanted = jax.jvp(
            results, ([leaves[k] for k in active],), (directions,), has_aux=True
        )
        values = _select(wanted, values, kept)
    if kept is None:
        return [values], [change]
    other = jnp.zeros_like(kept) if kept_change is None else kept_change
    return [values], [_select(wanted, change, other)]


def _scalar_derivatives(
    static: _Gather,
    kept: jax.Array | None,
    leaves: list[jax.Array],
    active: Sequence[int],
    directions: Sequence[jax.Array],
) -> tuple[jax.Array, jax.Array]:
    """The results and their change with some scalars, from one kernel: derivatives are images."""
    stages = _with_scalar_derivatives(static.stages, tuple(active))
    size = static.results
    images = _gather(static._replace(stages=stages, results=size * (1 + len(active))), kept, leaves)
    blocks = [images[..., k : k + size] for k in range(0, images.shape[-1], size)]
    change = jnp.zeros_like(blocks[0])
    for block, direction in zip(blocks[1:], directions, strict=True):
        change = change + block * direction
    return blocks[0], change


def _carrying(
    stages: Stages, active: Sequence[int], stage: Callable[..., Any]
) -> Callable[..., Any]:
    """A stage before the samples, and its derivative with respect to each active scalar."""

    def carried(place: Place, local: Any, tables: Any, found: Any) -> tuple[Any, list[Any]]:
        def of_scalar(position: int, value: Any) -> Any:
            moved = replaced(local, [position], [(value,)])
            return stage(place, moved, tables, stages.where(place, moved, tables)[1])

        changes = []
        for k in active:
            (value,) = local[k]
            along = functools.partial(of_scalar, k)
            changes.append(jax.jvp(along, (value,), (jnp.ones_like(value),))[1])
        return stage(place, local, tables, found), changes

    return carried


@functools.lru_cache(maxsize=512)
def _with_scalar_derivatives(stages: Stages, active: tuple[int, ...]) -> Stages:
    """Stages that carry the derivative with respect to each active scalar along."""
    carrying = functools.partial(_carrying, stages, active)

    def key(name: str) -> str | None:
        return key_of(("carrying", name, tuple(stages), active))

    def keyed(name: str, stage: Callable[..., Any]) -> Keyed:
        return Keyed(stage, key(name))

    whole_sample, whole_finish = stages.sample, stages.finish
    if whole_sample is None or whole_finish is None:
        otherwise = stages.otherwise
        if otherwise is not None:
            otherwise = keyed("otherwise", _flat(carrying(otherwise)))
        prepare = keyed("values", _flat(carrying(stages.prepare)))
        return stages._replace(
            prepare=prepare, otherwise=otherwise, prepared=stages.prepared * (1 + len(active))
        )

    def sample(index: Any, place: Place, prepared: Any, tables: Any) -> tuple[Any, ...]:
        value, changes = prepared

        def terms(value: Any) -> Any:
            return whole_sample(index, place, value, tables)

        return _with_changes(terms, (value,), [(change,) for change in changes])

    def finish(place: Place, sums: Any, prepared: Any, local: Any) -> tuple[Any, ...]:
        value, changes = prepared
        size = len(sums) // (1 + len(changes))
        blocks = [list(sums[k : k + size]) for k in range(0, len(sums), size)]

        def results(sums: Any, value: Any) -> Any:
            return whole_finish(place, sums, value, local)

        return _with_changes(
            results, (blocks[0], value), list(zip(blocks[1:], changes, strict=True))
        )

    limit = stages.limit
    if limit is not None:
        limit = keyed("limit", functools.partial(_of_value, limit))
    return stages._replace(
        prepare=keyed("prepare", carrying(stages.prepare)),
        sample=Sample(sample, key("sample"), whole_sample.types * (1 + len(active))),
        finish=keyed("finish", finish),
        limit=limit,
        counts=None,
        prepared=(stages.prepared, (stages.prepared,) * len(active)),
    )


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


_gather_operator = Operator("run_stages", _gathered, _shapes, _gather_jvp)
