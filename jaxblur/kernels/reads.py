"""How a program reads: one element of a table, and the texel nearest to an offset."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import ShapedArray
from jax.dtypes import float0
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jax.typing import ArrayLike
from jaxtyping import Array

_ONE_ELEMENT = lax.GatherDimensionNumbers(
    offset_dims=(), collapsed_slice_dims=(0,), start_index_map=(0,)
)


def read_table(table: jax.Array, index: Array) -> Array:
    """Elements of a flat table at places that are known to lie inside it.

    Args:
        table: (elements,) values.
        index: places, of any shape.

    Returns:
        Values of the index's shape.
    """
    return lax.gather(
        table,
        lax.expand_dims(index, (index.ndim,)),
        _ONE_ELEMENT,
        (1,),
        mode=lax.GatherScatterMode.PROMISE_IN_BOUNDS,
    )


place_primitive = Primitive("nearest_place")
place_primitive.multiple_results = True


def rounded(x: ArrayLike, y: ArrayLike) -> list[Array]:
    """The nearest whole numbers of both, ``floor(x + 1/2)``."""
    return [jnp.floor(jnp.asarray(part) + 0.5).astype(jnp.int32) for part in (x, y)]


def texel_of(x: ArrayLike, y: ArrayLike, *, blends: bool, still: bool) -> list[Array]:
    """The value of a place: whole pixels; 0 of one that is still."""
    return [jnp.zeros(jnp.shape(x), jnp.int32)] * 2 if still else rounded(x, y)


place_primitive.def_impl(texel_of)
place_primitive.def_abstract_eval(
    lambda x, y, **_: [ShapedArray(part.shape, jnp.int32) for part in (x, y)]
)
mlir.register_lowering(place_primitive, mlir.lower_fun(texel_of, multiple_results=True))


def _rounded_jvp(primals: Any, _: Any, **kind: bool) -> tuple[Any, Any]:
    wholes = place_primitive.bind(*primals, **kind)
    return wholes, [np.zeros(whole.shape, float0) for whole in wholes]


def _rounded_batched(operands: Any, axes: Any, **kind: bool) -> tuple[Any, list[int]]:
    size = next(o.shape[axis] for o, axis in zip(operands, axes, strict=True) if axis is not None)
    moved = [batching.bdim_at_front(o, axis, size) for o, axis in zip(operands, axes, strict=True)]
    return place_primitive.bind(*moved, **kind), [0, 0]


# Where a filter's functions run outside a program, on arrays, the texel is held.
ad.primitive_jvps[place_primitive] = _rounded_jvp
batching.primitive_batchers[place_primitive] = _rounded_batched


def nearest_place(x: Array, y: Array, blends: bool = False) -> tuple[Array, Array]:
    """The texel nearest to an offset, by which a program reads images; to be differentiated.

    The derivative of what a program computes from the texel is that of an interpolation between the
    results for this texel and for the ones beside it, see `.places`.

    Args:
        x: offset in pixels to the right.
        y: offset in pixels downward.
        blends: whether the value is mixed too, bilinearly of the results for the four texels around
            the offset, with exactly the derivative of that mix.

    Returns:
        Whole pixels to the right and downward, ``floor(x + 1/2)`` and ``floor(y + 1/2)``.
    """
    operands = jnp.asarray(x), jnp.asarray(y)
    across, down = place_primitive.bind(*operands, blends=blends, still=False)
    return across, down


def still_place(x: Array, y: Array) -> tuple[Array, Array]:
    """No offset at all, with the derivative of `nearest_place`.

    For images that move while a program reads them at one place. The value needs neither x nor y,
    so that it costs nothing to find them.

    Args:
        x: offset in pixels to the right, at most 1/2 either way.
        y: offset in pixels downward, likewise.

    Returns:
        0 and 0. The derivative of what a program computes from them is that of an interpolation
        between the results for 0 and for the texels beside it, as the offset changes.
    """
    across, down = place_primitive.bind(jnp.asarray(x), jnp.asarray(y), blends=False, still=True)
    return across, down
