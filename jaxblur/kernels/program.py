"""What the author of a program writes with: images, the pixel's place, a sum over samples.

A program is a function of one pixel,

    def program(at, images, parameters, settings) -> Outcome

in which every number is a scalar. `images` is a NamedTuple of `Image`, `parameters` a pytree of
scalars (or None), `settings` any hashable object that is fixed when the program is traced. The
engine traces the program once and runs it for all pixels of a grid.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.typing import ArrayLike
from jaxtyping import Array

from .inlining import inlined
from .reads import read_table

T = TypeVar("T")


class At(NamedTuple):
    """The pixel that a program computes, whole numbers from 0 at the top left."""

    row: Array
    column: Array


class Image:
    """An image that a program reads: the pixel's own values by `here`, those of any by `read`.

    Outside a program `read` works too, on arrays of places.

    Attributes:
        height: rows.
        width: columns.
        channels: values of a pixel.
    """

    def __init__(self, values: ArrayLike) -> None:
        """Wrap an array.

        Args:
            values: (H, W, C), or (H, W) for one channel.

        Raises:
            ValueError: it has another number of axes.
        """
        array = jnp.asarray(values)
        if array.ndim == 2:
            array = array[..., None]
        if array.ndim != 3:
            raise ValueError(f"an image must have shape (H, W, C), got {array.shape}.")
        self.values: jax.Array = array
        self.height: int | Array = array.shape[0]
        self.width: int | Array = array.shape[1]
        self.channels: int = array.shape[2]
        self._table: jax.Array | None = None
        self._own: tuple[Array, ...] | None = None

    @classmethod
    def inside(
        cls,
        table: jax.Array,
        own: tuple[Array, ...],
        size: tuple[Array, Array],
    ) -> "Image":
        """An image as a program sees it while it is traced.

        Args:
            table: all values in a row.
            own: those of the pixel.
            size: rows and columns.

        Returns:
            The image.
        """
        image = object.__new__(cls)
        image._table, image._own = table, own
        image.height, image.width = size
        image.channels = len(own)
        return image

    def at(self, place: At) -> "Image":
        """The same image as the program of another pixel sees it.

        Args:
            place: that pixel, known to lie inside the image.

        Returns:
            An image whose `here` gives the values there.
        """
        table = self.values.reshape(-1) if self._table is None else self._table
        own = self.read_inside(place.row, place.column)
        size = jnp.asarray(self.height), jnp.asarray(self.width)
        return Image.inside(table, own, size)

    def here(self) -> tuple[Array, ...]:
        """The channels of the pixel that is computed; the image must be as large as the grid."""
        if self._own is None:
            raise ValueError("`Image.here` works only inside a program that the engine traces.")
        return self._own

    def read(
        self, row: ArrayLike, column: ArrayLike, count: int | None = None
    ) -> tuple[Array, ...]:
        """The channels of any pixel; outside the image those of the nearest pixel at its edge.

        Args:
            row: of the pixel, a whole number.
            column: of the pixel, a whole number.
            count: read only so many channels, the first ones; all if None.

        Returns:
            One value a channel. Differentiable in the image; the place has no derivative.

        Raises:
            ValueError: the place is no whole number.
        """
        for name, place in (("row", row), ("column", column)):
            if not jnp.issubdtype(jnp.result_type(place), jnp.integer):
                raise ValueError(
                    f"`{name}` of Image.read must be a whole number, got one of type "
                    f"{jnp.result_type(place)}; round it: jnp.floor({name} + 0.5).astype(int)."
                )
        row, column = jnp.clip(row, 0, self.height - 1), jnp.clip(column, 0, self.width - 1)
        return self.read_inside(row, column, count)

    def read_inside(self, row: Array, column: Array, count: int | None = None) -> tuple[Array, ...]:
        """The channels of a pixel that is known to lie inside the image.

        Faster than `read`, and not checked: native code reads other memory for a place outside.

        Args:
            row: of the pixel, a whole number.
            column: of the pixel, a whole number.
            count: as `read`.

        Returns:
            As `read`.
        """
        return self.read_texel(row * self.width + column, count)

    def read_texel(self, index: Array, count: int | None = None) -> tuple[Array, ...]:
        """The channels of the pixel with a row-major number.

        Args:
            index: ``row * width + column``, known to lie inside the image.
            count: as `read`.

        Returns:
            As `read`.
        """
        table = self.values.reshape(-1) if self._table is None else self._table
        start = index * self.channels
        channels = range(self.channels if count is None else count)
        return tuple(read_table(table, start + k if k else start) for k in channels)


class Outcome(NamedTuple):
    """What a program computes.

    Attributes:
        values: of the pixel, one a channel of the result.
        where: whether they are wanted at this pixel; None means everywhere. The engine skips
            blocks of pixels none of which wants them, so it may not depend on a sum.
        otherwise: values of the other pixels, for programs without a sum; None where such pixels
            keep those of the image that `each_pixel` is given as `kept`.
    """

    values: tuple[Array, ...]
    where: Array | None = None
    otherwise: tuple[Array, ...] | None = None


def check_outcome(outcome: object, name: str) -> None:
    """Reject what a program must not return.

    Args:
        outcome: what it returned.
        name: of the program.

    Raises:
        ValueError: it is no `Outcome`, its values are no tuple of scalars, or ``where`` is no
            condition.
    """
    if not isinstance(outcome, Outcome):
        raise ValueError(
            f"`{name}` must return an Outcome, such as Outcome(values, where=...), got "
            f"{type(outcome).__name__}."
        )
    if not isinstance(outcome.values, tuple | list):
        raise ValueError(
            f"`Outcome.values` of `{name}` must be a tuple of scalars, one a channel, got "
            f"{type(outcome.values).__name__}; for a single channel write (value,)."
        )
    for number, value in enumerate(outcome.values):
        if jnp.shape(value):
            raise ValueError(
                f"`Outcome.values` of `{name}` must be scalars, one a channel, got shape "
                f"{jnp.shape(value)} for channel {number}; give its elements one by one."
            )
    if outcome.where is not None and jnp.result_type(outcome.where) != jnp.bool_:
        raise ValueError(
            f"`Outcome.where` of `{name}` must be a condition, such as speed > 0.5, got a value of "
            f"type {jnp.result_type(outcome.where)}."
        )


sum_primitive = Primitive("sum_over_samples")
sum_primitive.multiple_results = True
sum_primitive.def_abstract_eval(
    lambda *operands, jaxpr, **_: [ShapedArray(v.aval.shape, v.aval.dtype) for v in jaxpr.outvars]
)


def sum_over(
    count: int,
    sample: Callable[[Array], T],
    limit: Array | None = None,
    where: Callable[[Array], Array] | None = None,
) -> T:
    """The sum ``sum_{i < count} sample(i)``, one in a program at most.

    Args:
        count: number of samples N.
        sample: from the number of a sample, int32, to a pytree of scalars; it may use everything
            that the program has computed before.
        limit: number of samples of this pixel; the terms of samples from it on must be 0, so that
            they may be left out. None where all N count.
        where: from the number of a sample to whether it counts for this pixel; the terms of the
            others must be 0, so that they may be left out. None where all count.

    Returns:
        The sums, in the structure of the terms.

    Raises:
        ValueError: the count is no number that is known while the program is traced, or ``where``
            gives no condition.
    """
    if not isinstance(count, int | np.integer):
        raise ValueError(
            "`count` must be a whole number that is known while the program is traced, such as "
            f"settings.samples, got {count!r}; for a number of each pixel pass it as `limit`."
        )
    structure: list[Any] = []

    def flat(index: Array) -> list[Array]:
        leaves, tree = jax.tree.flatten(sample(index))
        structure[:] = [tree]
        return [jnp.asarray(leaf) for leaf in leaves]

    closed = inlined(jax.make_jaxpr(flat)(jax.ShapeDtypeStruct((), jnp.int32)))
    limits = [] if limit is None else [jnp.asarray(limit)]
    condition, conditions = None, []
    if where is not None:
        traced = inlined(jax.make_jaxpr(where)(jax.ShapeDtypeStruct((), jnp.int32)))
        condition, conditions = traced.jaxpr, traced.consts
        types = [variable.aval.dtype for variable in condition.outvars]
        if types != [jnp.bool_]:
            raise ValueError(
                "`where` must give a condition, such as `lambda i: i < last`, got "
                f"{', '.join(str(one) for one in types)}."
            )
    sums = sum_primitive.bind(
        *closed.consts,
        *conditions,
        *limits,
        jaxpr=closed.jaxpr,
        count=count,
        limited=bool(limits),
        where=condition,
    )
    return jax.tree.unflatten(structure[0], sums)


marks_primitive = Primitive("largest_marks")
marks_primitive.multiple_results = True
marks_primitive.def_abstract_eval(lambda *operands, **_: [ShapedArray((), jnp.int32)])


def mark_over(
    limit: Array, mark: Callable[[Array], tuple[tuple[Array, Array], ...]]
) -> tuple[Array, ...]:
    """Leave marks in a table, of which the largest at each place stays (a scatter-max).

    Args:
        limit: number of steps of this pixel.
        mark: from the number of a step, int32, to (place, mark) pairs of whole numbers: places lie
            inside the table, and marks from step `limit` on must be 0, as if there were none.

    Returns:
        The values of the `Outcome` of a program for `largest_marks`.
    """

    def flat(index: Array) -> list[Array]:
        return [jnp.asarray(number, jnp.int32) for pair in mark(index) for number in pair]

    closed = inlined(jax.make_jaxpr(flat)(jax.ShapeDtypeStruct((), jnp.int32)))
    operands = *closed.consts, jnp.asarray(limit)
    return tuple(marks_primitive.bind(*operands, jaxpr=closed.jaxpr, count=0, limited=True))
