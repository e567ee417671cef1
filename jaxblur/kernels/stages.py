"""What a program is cut into, and the sizes and types with which it runs."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from .keys import Keyed

_TABLE_ROWS = 1 << 20
"""Pixels of an image while it is traced; nothing depends on it."""


class Kind(NamedTuple):
    """Type and channels of an input, all that a trace depends on.

    Attributes:
        dtype: name of its type.
        channels: of an image; 0 for a scalar.
    """

    dtype: str
    channels: int = 0


class Place(NamedTuple):
    """Where a program runs: scalars, or arrays that broadcast against planes.

    Attributes:
        row: of the pixel.
        column: of the pixel.
        sizes: rows, columns, rows, columns, ... of the images.
    """

    row: Any
    column: Any
    sizes: tuple[Any, ...]


class Grid(NamedTuple):
    """Sizes of a run; native code gets them when it runs.

    Attributes:
        height: rows of the result.
        width: columns of the result.
        sizes: rows, columns, rows, columns, ... of the images.
    """

    height: int
    width: int
    sizes: tuple[int, ...] = ()

    def place(self) -> Place:
        """Row and column of every pixel, (H, W, 1), and the sizes."""
        shape = self.height, self.width, 1
        row, column = (lax.broadcasted_iota(jnp.int32, shape, axis) for axis in (0, 1))
        return Place(row, column, tuple(jnp.int32(size) for size in self.sizes))


class Sample(Keyed):
    """One sample: (index, place, local, tables) to its terms, of scalars and of planes.

    Attributes:
        types: names of the types of the terms.
    """

    def __init__(self, function: Callable[..., Any], key: str | None, types: Sequence[str]) -> None:
        """Make it.

        Args:
            function: it.
            key: None where it is not known.
            types: names of the types of the terms.
        """
        super().__init__(function, key)
        self.types = tuple(types)


NO_TERMS = Sample(lambda *_: (), "no terms", ())
"""The sample of a program without a sum."""


@dataclasses.dataclass(frozen=True)
class Prepared:
    """A value that is found before the samples; a leaf of the structure that `prepare` returns.

    Attributes:
        dtype: name of its type.
        varies: whether it differs between pixels, so that all of them are a plane.
    """

    dtype: str
    varies: bool


class Stages(NamedTuple):
    """A program, cut at its sum. Each part works on scalars and on whole planes alike.

    `local` holds what a pixel uses as it is: a scalar, or the channels of an image at the pixel.
    `tables` holds flat images that are read anywhere.

    Attributes:
        where: (place, local, tables) to the condition of the `Outcome`, and a list of values that
            were found on the way.
        prepare: (place, local, tables, found) to a list: values that the samples and the finish
            use, or the results where there is no sum.
        otherwise: (place, local, tables, found) to the results of the other pixels, or None.
        sample: (index, place, prepared, tables) to the terms of a sample; None without a sum.
        finish: (place, sums, prepared, local) to the results.
        limit: from prepared to the number of samples; None where all count.
        counts: (index, place, prepared, tables) to whether a sample may be other than 0; None where
            all may.
        samples: number of samples N.
        prepared: what the values that `prepare` returns are, or those chosen between them and
            `otherwise`; in the same structure, of tuples.
    """

    where: Callable[..., Any]
    prepare: Callable[..., Any]
    otherwise: Callable[..., Any] | None = None
    sample: Sample | None = None
    finish: Callable[..., Any] | None = None
    limit: Callable[..., Any] | None = None
    counts: Callable[..., Any] | None = None
    samples: int = 1
    prepared: Any = ()


def table_shape(kind: Kind) -> jax.ShapeDtypeStruct:
    """The shape of a flat image while it is traced."""
    return jax.ShapeDtypeStruct((_TABLE_ROWS * kind.channels,), kind.dtype)
