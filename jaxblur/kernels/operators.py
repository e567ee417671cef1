"""Functions with a derivative rule that outlives a loop.

`jax.custom_jvp` loses its rule where JAX splits a loop (`lax.scan`) into what is known and what is
linear, so that a second derivative of a loop would differentiate the function's own operations:
native code, which has no derivative, or reductions that JAX cannot differentiate. The rule of a
primitive stays.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
from jax.core import ShapedArray
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

Arrays = Sequence[jax.Array]
Rule = Callable[[Any, Arrays, Sequence[jax.Array | None]], tuple[Arrays, Arrays]]
"""Maps what is static, operands and tangents, None for zero, to results and their tangents."""


class _Batched(NamedTuple):
    """The static part of a call under `jax.vmap`: that of one element, and the operands' axes."""

    static: Any
    axes: tuple[int | None, ...]


class Operator:
    """A function of arrays with a derivative rule; called as ``operator(static, operands)``."""

    def __init__(self, name: str, function: Callable[[Any, Arrays], Arrays], rule: Rule) -> None:
        """Make the operator.

        Args:
            name: of the primitive.
            function: maps what is static (hashable) and a list of arrays to a list of arrays.
            rule: of first derivatives; it may call the operator, so that there are second ones.
        """
        self._function, self._rule = function, rule
        self._primitive = Primitive(name)
        self._primitive.multiple_results = True
        self._primitive.def_impl(_evaluate)
        self._primitive.def_abstract_eval(_shapes)
        mlir.register_lowering(self._primitive, mlir.lower_fun(_evaluate, multiple_results=True))
        ad.primitive_jvps[self._primitive] = self._jvp
        batching.primitive_batchers[self._primitive] = self._batched

    def __call__(self, static: Any, operands: Arrays) -> list[jax.Array]:
        """Apply it.

        Args:
            static: as the function takes it.
            operands: as the function takes them.

        Returns:
            The results of the function.
        """
        avals = [jax.typeof(operand) for operand in operands]
        traced = jax.make_jaxpr(lambda *values: self._function(static, values))(*avals)
        return self._primitive.bind(*operands, static=static, traced=traced)

    def _jvp(
        self, primals: Any, tangents: Any, *, static: Any, traced: ClosedJaxpr
    ) -> tuple[list[Any], list[Any]]:
        changes = [None if type(change) is ad.Zero else change for change in tangents]
        results, changes = self._derivative(static, list(primals), changes)
        return list(results), list(changes)

    def _derivative(
        self, static: Any, operands: Arrays, changes: Sequence[jax.Array | None]
    ) -> tuple[Arrays, Arrays]:
        """The rule, also of a batch."""
        if not isinstance(static, _Batched):
            return self._rule(static, operands, changes)
        active = [k for k, change in enumerate(changes) if change is not None]

        def of_one(operands: Any, directions: Any) -> tuple[Arrays, Arrays]:
            changes: list[jax.Array | None] = [None] * len(operands)
            for k, direction in zip(active, directions, strict=True):
                changes[k] = direction
            return self._derivative(static.static, operands, changes)

        axes = list(static.axes), [static.axes[k] for k in active]
        return jax.vmap(of_one, axes)(list(operands), [changes[k] for k in active])

    def _batched(
        self, operands: Any, axes: Any, *, static: Any, traced: ClosedJaxpr
    ) -> tuple[list[jax.Array], list[int]]:
        every = jax.make_jaxpr(jax.vmap(jaxpr_as_fun(traced), tuple(axes)))(
            *map(jax.typeof, operands)
        )
        results = self._primitive.bind(
            *operands, static=_Batched(static, tuple(axes)), traced=every
        )
        return results, [0] * len(results)


def _evaluate(*operands: jax.Array, static: Any, traced: ClosedJaxpr) -> list[jax.Array]:
    return jaxpr_as_fun(traced)(*operands)


def _shapes(*_: Any, static: Any, traced: ClosedJaxpr) -> list[ShapedArray]:
    return list(traced.out_avals)
