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
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

Arrays = Sequence[jax.Array]
Rule = Callable[[Any, Arrays, Sequence[jax.Array | None]], tuple[Arrays, Arrays]]
"""Maps what is static, operands and tangents, None for zero, to results and their tangents."""


class _Batched(NamedTuple):
    """The static part of a call under `jax.vmap`.

    Attributes:
        static: of one element.
        axes: of the operands, None for one that all elements share.
        size: number of elements.
    """

    static: Any
    axes: tuple[int | None, ...]
    size: int


class Operator:
    """A function of arrays with a derivative rule; called as ``operator(static, operands)``.

    The function is traced where its value is wanted: not under a derivative, whose rule gives the
    value too.
    """

    def __init__(
        self,
        name: str,
        function: Callable[[Any, Arrays], Arrays],
        shapes: Callable[[Any, Sequence[Any]], Sequence[Any]],
        rule: Rule,
    ) -> None:
        """Make the operator.

        Args:
            name: of the primitive.
            function: maps what is static (hashable) and a list of arrays to a list of arrays.
            shapes: the same for shapes and types.
            rule: of first derivatives; it may call the operator, so that there are second ones.
        """
        self._function, self._shapes_of, self._rule = function, shapes, rule
        self._primitive = Primitive(name)
        self._primitive.multiple_results = True
        self._primitive.def_impl(self._values)
        self._primitive.def_abstract_eval(self._shapes)
        mlir.register_lowering(self._primitive, mlir.lower_fun(self._values, multiple_results=True))
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
        return self._primitive.bind(*operands, static=static)

    def _values(self, *operands: jax.Array, static: Any) -> list[jax.Array]:
        if not isinstance(static, _Batched):
            return list(self._function(static, operands))

        def of_one(*operands: jax.Array) -> list[jax.Array]:
            return self._values(*operands, static=static.static)

        return jax.vmap(of_one, static.axes)(*operands)

    def _shapes(self, *operands: Any, static: Any) -> list[ShapedArray]:
        if not isinstance(static, _Batched):
            return [ShapedArray(s.shape, s.dtype) for s in self._shapes_of(static, operands)]
        ones = [
            operand if axis is None else _without(operand, axis)
            for operand, axis in zip(operands, static.axes, strict=True)
        ]
        shapes = self._shapes(*ones, static=static.static)
        return [ShapedArray((static.size, *shape.shape), shape.dtype) for shape in shapes]

    def _jvp(self, primals: Any, tangents: Any, *, static: Any) -> tuple[list[Any], list[Any]]:
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
        self, operands: Any, axes: Any, *, static: Any
    ) -> tuple[list[jax.Array], list[int]]:
        sizes = [o.shape[a] for o, a in zip(operands, axes, strict=True) if a is not None]
        results = self(_Batched(static, tuple(axes), sizes[0]), operands)
        return results, [0] * len(results)


def _without(operand: Any, axis: int) -> ShapedArray:
    """The shape of one element of a batch."""
    return ShapedArray(operand.shape[:axis] + operand.shape[axis + 1 :], operand.dtype)
