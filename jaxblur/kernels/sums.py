"""Sums over the samples of every pixel, and their derivatives.

A sample is a function of scalars that works on planes too (`.planes`). On a CPU with a C++
compiler the sum becomes a native kernel (`.cpp`); elsewhere one variadic reduction over a trailing
axis of samples sums all terms, and XLA fuses it with the reads. Neither way keeps an array of
shape (H, W, N) in memory.

A pixel's sums depend on its own local values only, so derivatives with respect to those are
images, summed in the same kernel. Tables are read anywhere: their derivatives are a linear
operator of its own, `_push`, whose transpose is native code again, or a scan over the samples with
rematerialization.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from ..settings import Backend
from .cpp import native_gather, native_pull
from .keys import Keyed, key_of
from .operators import Operator
from .stages import Grid, Place, Sample, Stages

Terms = tuple[jax.Array, ...]


class Plan(NamedTuple):
    """What is fixed when a sum is traced.

    Attributes:
        sample: maps (index, place, local, tables) to terms.
        limit: maps local to the number of samples, or None.
        samples: number of samples N.
        backend: see `jaxblur.Settings`.
        grid: sizes.
        locals: how many of the leaves are local; the others are tables.
    """

    sample: Sample
    limit: Callable[..., Any] | None
    samples: int
    backend: Backend
    grid: Grid
    locals: int

    def numbers(self) -> jax.Array:
        """Numbers of the samples, (N,)."""
        return jnp.arange(self.samples, dtype=jnp.int32)

    def terms(self, index: jax.Array, leaves: Sequence[jax.Array]) -> Terms:
        """The terms of the samples of these numbers."""
        place = self.grid.place()
        terms = self.sample(index, place, *self.operands(leaves))
        shape = self.grid.height, self.grid.width, index.size
        return tuple(jnp.broadcast_to(term, shape) for term in terms)

    def operands(self, leaves: Sequence[Any]) -> tuple[Any, Any]:
        """Leaves as (channels of each local one, flat tables)."""
        local = [channels_of(leaf) for leaf in leaves[: self.locals]]
        return local, [table.reshape(-1) for table in leaves[self.locals :]]


def channels_of(leaf: jax.Array) -> tuple[jax.Array, ...]:
    """The channels of an image as planes (H, W, 1); a scalar stays one."""
    if leaf.ndim == 0 or leaf.shape[-1] == 1:
        return (leaf,)
    return tuple(lax.slice_in_dim(leaf, k, k + 1, axis=2) for k in range(leaf.shape[-1]))


def sum_samples(
    sample: Sample,
    count: int,
    moving: jax.Array,
    local: Sequence[jax.Array],
    tables: Sequence[jax.Array],
    grid: Grid,
    backend: Backend = "auto",
    limit: Callable[..., Any] | None = None,
) -> Terms:
    """Sum the terms of all samples of every pixel, ``sum_i sample(i, place, local, tables)``.

    Args:
        sample: a function of scalars that works on planes too; part of the compilation key.
        count: number of samples N.
        moving: (H, W) bool, the pixels whose sums are wanted; those of others are finite and have
            no meaning.
        local: (H, W, K) images and scalars that a pixel uses at its own place.
        tables: (h, w, C) images that samples read anywhere.
        grid: sizes.
        backend: see `jaxblur.Settings`.
        limit: maps local to the number of samples of each pixel.

    Returns:
        A tuple of (H, W) sums. Differentiable in local and tables, forward and reverse, to any
        order. Derivatives with respect to ``local`` alone come out of one kernel and need no
        scatter, unless there is only one sample: its terms may be many.

    Raises:
        ValueError: the backend is ``native`` and there is no compiler, or no native form.
    """
    plan = Plan(sample, limit, count, backend, grid, len(local))
    return _sum(plan, moving, [jnp.asarray(leaf) for leaf in (*local, *tables)])


def _sum(plan: Plan, moving: jax.Array, leaves: Sequence[jax.Array]) -> Terms:
    """The sums."""
    return tuple(_sum_operator(plan, (moving, *leaves)))


def _sums(plan: Plan, operands: Sequence[jax.Array]) -> Terms:
    """The sums, without derivatives."""
    moving, *leaves = operands
    by_xla = functools.partial(_sum_by_xla, plan)
    images = [moving[..., None], *leaves]
    stages = _only(plan.sample, plan.limit, plan.samples)
    native = native_gather(stages, images, plan.locals + 1, plan.grid, plan.backend)
    if native is None:
        return by_xla(moving, *leaves)
    return on_cpu(native, by_xla, moving, *leaves)


# Equal arguments give the same object here and below: it is a part of the key under which a kernel
# is kept once it is printed.
@functools.lru_cache(maxsize=512)
def _only(sample: Sample, limit: Callable[..., Any] | None, samples: int) -> Stages:
    """Stages that sum a sample where a plane, the first of the local values, is not 0."""
    return Stages(
        where=Keyed(lambda place, local, tables: (local[0][0], ()), "where the first"),
        prepare=Keyed(lambda place, local, tables, found: local[1:], "the others"),
        sample=sample,
        finish=Keyed(lambda place, sums, prepared, local: sums, "sums"),
        limit=limit,
        samples=samples,
    )


def _sum_by_xla(plan: Plan, moving: jax.Array, *leaves: jax.Array) -> Terms:
    """All terms of all samples in one reduction; nothing at all if no pixel moves.

    The conditional also keeps XLA from fusing what is computed once per pixel into the kernel,
    where it would be computed again at every tap that reads it.
    """

    def sums(*leaves: jax.Array) -> Terms:
        terms = plan.terms(plan.numbers(), leaves)
        zeros = tuple(jnp.zeros((), term.dtype) for term in terms)
        return tuple(lax.reduce(terms, zeros, _add, (2,)))

    return lax.cond(jnp.any(moving), sums, lambda *_: _zero_sums(plan), *leaves)


def on_cpu(native: Callable[..., Any], other: Callable[..., Any], *operands: jax.Array) -> Any:
    """The native form on a CPU, the other one elsewhere; not traced where there is only a CPU."""
    if {device.platform for device in jax.devices()} == {"cpu"}:
        return native(*operands)
    return lax.platform_dependent(*operands, cpu=native, default=other)


def _add(totals: Terms, more: Terms) -> Terms:
    """Term by term."""
    return tuple(a + b for a, b in zip(totals, more, strict=True))


def _shapes(plan: Plan) -> list[jax.ShapeDtypeStruct]:
    """Shapes and types of the sums."""
    plane = plan.grid.height, plan.grid.width
    return [jax.ShapeDtypeStruct(plane, jnp.dtype(of)) for of in plan.sample.types]


def _zero_sums(plan: Plan) -> Terms:
    """Sums of no samples."""
    return tuple(jnp.zeros(shape.shape, shape.dtype) for shape in _shapes(plan))


def replaced(leaves: Sequence[Any], positions: Sequence[int], values: Sequence[Any]) -> list[Any]:
    """The leaves, some of them replaced."""
    replaced = list(leaves)
    for position, value in zip(positions, values, strict=True):
        replaced[position] = value
    return replaced


def _sum_jvp(plan: Plan, primals: Any, tangents: Any) -> tuple[Terms, Terms]:
    """Derivatives of the sums; only what has a tangent is differentiated."""
    (moving, *leaves), tangents = primals, tangents[1:]
    active = [k for k, tangent in enumerate(tangents) if tangent is not None]
    directions = [tangents[k] for k in active]
    if not active or (plan.samples > 1 and active[-1] < plan.locals):
        return _local_derivatives(plan, moving, leaves, active, directions)
    change = _push.bind(moving, *leaves, *directions, plan=plan, active=tuple(active))
    return _sum(plan, moving, leaves), tuple(change)


_sum_operator = Operator("sum_samples", _sums, lambda plan, _: _shapes(plan), _sum_jvp)


@functools.lru_cache(maxsize=512)
def _augmented(sample: Sample, active: tuple[int, ...]) -> Sample:
    """`_with_derivatives` of a sample."""
    augmented = functools.partial(_with_derivatives, sample, active)
    types = sample.types * (1 + len(active))
    return Sample(augmented, key_of(("augmented", sample, active)), types)


def _with_derivatives(
    sample: Sample, active: Sequence[int], index: Any, place: Place, local: Any, tables: Any
) -> Terms:
    """The terms of a sample, then their derivatives with respect to each active local value."""

    def terms(*values: Any) -> Terms:
        changed = replaced(local, active, [(value,) for value in values])
        return tuple(sample(index, place, changed, tables))

    values = [local[position][0] for position in active]
    results, push = jax.linearize(terms, *values)
    zeros = [jnp.zeros_like(value) for value in values]
    directions = [replaced(zeros, [k], [jnp.ones_like(v)]) for k, v in enumerate(values)]
    return sum((tuple(push(*direction)) for direction in directions), start=tuple(results))


def _local_derivatives(
    plan: Plan,
    moving: jax.Array,
    leaves: list[jax.Array],
    active: Sequence[int],
    directions: Sequence[jax.Array],
) -> tuple[Terms, Terms]:
    """The sums and their change, from one kernel that sums terms and derivatives."""
    augmented = plan._replace(sample=_augmented(plan.sample, tuple(active)))
    sums = _sum(augmented, moving, leaves)
    size = len(sums) // (1 + len(active))
    change = [jnp.zeros_like(total) for total in sums[:size]]
    for block, tangent in enumerate(directions, start=1):
        tangent = tangent[..., 0] if tangent.ndim == 3 else tangent
        for term in range(size):
            change[term] = change[term] + sums[block * size + term] * tangent
    return tuple(sums[:size]), tuple(change)


def _pushed(plan: Plan, active: Sequence[int], leaves: Any, directions: Any) -> Terms:
    """Change of the sums as the active leaves change, sample after sample."""

    @jax.checkpoint
    def change(index: jax.Array, values: list[Any], directions: list[Any]) -> Terms:
        def terms(values: Any) -> Terms:
            return plan.terms(index, replaced(leaves, active, values))

        return jax.jvp(terms, (values,), (directions,))[1]

    def step(totals: Terms, index: jax.Array) -> tuple[Terms, None]:
        changes = change(index[None], [leaves[k] for k in active], list(directions))
        return _add(totals, tuple(term[..., 0] for term in changes)), None

    return lax.scan(step, _zero_sums(plan), plan.numbers())[0]


class _Pull(NamedTuple):
    """The static part of a transpose: of a plan, by the active leaves of a number of them."""

    plan: Plan
    active: tuple[int, ...]
    leaves: int


def _pull(plan: Plan, active: tuple[int, ...], moving: Any, leaves: Any, images: Any) -> Any:
    """The transpose of `_pushed`: from images to the active leaves."""
    return _pull_operator(_Pull(plan, active, len(leaves)), (moving, *leaves, *images))


def _pulled(static: _Pull, operands: Sequence[jax.Array]) -> Any:
    """The same, without derivatives."""
    plan, active, count = static
    moving, leaves, images = operands[0], operands[1 : 1 + count], operands[1 + count :]

    def by_xla(_, *operands: jax.Array) -> tuple[jax.Array, ...]:
        return _pulled_by_scan(plan, active, operands[: len(leaves)], operands[len(leaves) :])

    native = native_pull(
        plan.sample,
        plan.limit,
        plan.samples,
        leaves,
        plan.locals,
        active,
        [image.dtype for image in images],
        plan.grid,
        plan.backend,
    )
    if native is None:
        return by_xla(moving, *leaves, *images)

    def by_kernel(moving: jax.Array, *operands: jax.Array) -> tuple[jax.Array, ...]:
        images = [image[..., None] for image in operands[len(leaves) :]]
        values = iter(native(moving[..., None], *operands[: len(leaves)], *images))
        return tuple(_like(leaves[k], k >= plan.locals, values) for k in active)

    return on_cpu(by_kernel, by_xla, moving, *leaves, *images)


def _like(leaf: jax.Array, is_table: bool, values: Iterator[jax.Array]) -> jax.Array:
    """The derivative by a leaf, from the next results of the kernel."""
    if is_table:
        return next(values).reshape(leaf.shape)
    if leaf.ndim == 0:
        return jnp.sum(next(values))
    return jnp.stack([next(values) for _ in range(leaf.shape[-1])], axis=-1)


def _pulled_by_scan(plan: Plan, active: Sequence[int], leaves: Any, images: Any) -> Terms:
    """The same by XLA, sample after sample; none of them is kept."""

    @jax.checkpoint
    def pull(index: jax.Array, leaves: list[Any], images: list[Any]) -> Terms:
        def terms(*values: Any) -> Terms:
            found = plan.terms(index, replaced(leaves, active, values))
            return tuple(term[..., 0] for term in found)

        return tuple(jax.vjp(terms, *(leaves[k] for k in active))[1](tuple(images)))

    def step(totals: Terms, index: jax.Array) -> tuple[Terms, None]:
        # What does not depend on the sample would be computed before the loop, and kept.
        operands = lax.optimization_barrier((index[None], list(leaves), list(images)))
        return _add(totals, pull(*operands)), None

    zeros = tuple(jnp.zeros_like(leaves[k]) for k in active)
    return lax.scan(step, zeros, plan.numbers(), reverse=True)[0]


def _pull_jvp(static: _Pull, primals: Any, tangents: Any) -> tuple[Any, Any]:
    """Second derivatives go through the scan."""
    plan, chosen, count = static
    rest, tangents = list(primals[1:]), tangents[1:]
    active = [k for k, tangent in enumerate(tangents) if tangent is not None]

    def pulled(values: Any) -> Any:
        every = replaced(rest, active, values)
        return _pulled_by_scan(plan, chosen, every[:count], every[count:])

    values, directions = [rest[k] for k in active], [tangents[k] for k in active]
    return _pull_operator(static, primals), jax.jvp(pulled, (values,), (directions,))[1]


_pull_operator = Operator(
    "pull_samples",
    _pulled,
    lambda static, operands: [operands[1 + k] for k in static.active],
    _pull_jvp,
)


# `_pushed` as an operator that JAX knows to be linear in its directions.
_push = Primitive("push_samples")
_push.multiple_results = True


def _split(operands: Sequence[Any], active: tuple[int, ...]) -> tuple[Any, list[Any], list[Any]]:
    """Operands of the operator as (moving, leaves, directions)."""
    return operands[0], list(operands[1 : -len(active)]), list(operands[-len(active) :])


def _push_by_scan(*operands: Any, plan: Plan, active: tuple[int, ...]) -> Terms:
    """`_pushed` of flat operands."""
    _, leaves, directions = _split(operands, active)
    return _pushed(plan, active, leaves, directions)


def _push_shapes(*_: Any, plan: Plan, active: tuple[int, ...]) -> list[ShapedArray]:
    """Shapes and types of the change, those of the sums."""
    return [ShapedArray(shape.shape, shape.dtype) for shape in _shapes(plan)]


def _push_transpose(images: Any, *operands: Any, plan: Plan, active: tuple[int, ...]) -> list[Any]:
    """Reverse mode."""
    moving, leaves, _ = _split(operands, active)
    images = [ad.instantiate_zeros(image) for image in images]
    return [None] * (1 + len(leaves)) + list(_pull(plan, active, moving, leaves, images))


def _push_jvp(
    primals: Any, tangents: Any, *, plan: Plan, active: tuple[int, ...]
) -> tuple[Any, Any]:
    """Derivatives of the derivatives."""
    moving, *rest = primals
    tangents = [ad.instantiate_zeros(tangent) for tangent in tangents[1:]]
    by_scan = functools.partial(_push_by_scan, moving, plan=plan, active=active)
    change = jax.jvp(by_scan, tuple(rest), tuple(tangents))[1]
    return _push.bind(*primals, plan=plan, active=active), change


def _push_batched(
    operands: Any, axes: Any, *, plan: Plan, active: tuple[int, ...]
) -> tuple[Any, list[int]]:
    """One element of the batch after the other: memory stays that of one."""
    mapped = [k for k, axis in enumerate(axes) if axis is not None]
    moved = [jnp.moveaxis(operands[k], axes[k], 0) for k in mapped]

    def one(values: Any) -> Any:
        return _push.bind(*replaced(operands, mapped, values), plan=plan, active=active)

    results = lax.map(one, moved)
    return results, [0] * len(results)


_push.def_impl(_push_by_scan)
_push.def_abstract_eval(_push_shapes)
mlir.register_lowering(_push, mlir.lower_fun(_push_by_scan, multiple_results=True))
ad.primitive_transposes[_push] = _push_transpose
ad.primitive_jvps[_push] = _push_jvp
batching.primitive_batchers[_push] = _push_batched
