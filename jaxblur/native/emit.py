"""Kernels in C++ for a sum over samples and for its transpose, from the traced sample function.

The sample function stays the one description of a filter: its jaxpr is written out for rows of
neighboring pixels, one to each lane of a vector register. XLA's CPU compiler does not vectorize
a reduction whose order of summation matters.
"""

import dataclasses
import pathlib
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .expressions import Level, Unsupported, Value, Writer

TEMPLATE = pathlib.Path(__file__).with_name("kernel.cc")


@dataclasses.dataclass(frozen=True)
class Kernel:
    """A kernel in C++, with ``@NAME@`` still open.

    Attributes:
        source: the program.
        shapes: of every result in turn; (H, W) is a sum, a flat one a table that taps add to.
    """

    source: str
    shapes: tuple[tuple[int, ...], ...]


def _statements(results: Sequence[Value], adds: Sequence[bool]) -> list[str]:
    """What a tap does to the results."""
    planes = [result for result, table in zip(results, adds, strict=True) if not table]
    tables = [result for result, table in zip(results, adds, strict=True) if table]
    lines = [f"sums[{k}] += {plane.code};" for k, plane in enumerate(planes)]
    for k, table in enumerate(tables):
        if not table.additions and table.number != 0:
            raise Unsupported("a table as a result that is not added to")
        for index, value in table.additions:
            lines.append(f"add(tables[{k}], {index.code}, {value.code}, lanes);")
    return lines


def _fill(
    writer: Writer, declarations: list[str], numbers: dict[str, Any], results: list[str]
) -> str:
    """The program, from the template and what was collected."""
    parts = {
        "CONSTANTS": writer.constants,
        "ARGUMENTS": declarations + writer.statements[Level.UNIFORM],
        "PIXEL": writer.statements[Level.PIXEL],
        "SAMPLE": writer.statements[Level.SAMPLE],
        "TAP": writer.statements[Level.TAP] + results,
    }
    source = TEMPLATE.read_text(encoding="utf-8")
    for name, number in numbers.items():
        source = source.replace(f"@{name}@", str(number))
    for name, lines in parts.items():
        source = source.replace(f"@{name}@", "\n".join(lines))
    return source


def _emit(
    closed: Any, count: int, size: tuple[int, int], leaves: Sequence[tuple[Any, bool]]
) -> Kernel:
    """A kernel for a jaxpr of (sample number, leaves); each leaf says whether it is a table."""
    writer = Writer()
    declarations, inputs = [], [Value("i", "int32", Level.SAMPLE)]
    for position, (leaf, table) in enumerate(leaves, start=1):
        declaration, value = writer.argument(position, leaf, table)
        declarations.append(declaration)
        inputs.append(value)
    results = writer.walk(closed.jaxpr, closed.consts, inputs)
    if any(np.dtype(variable.aval.dtype) != np.float32 for variable in closed.jaxpr.outvars):
        raise Unsupported("sums of another type than float32")
    adds = tuple(variable.aval.ndim == 1 for variable in closed.jaxpr.outvars)
    numbers = {"HEIGHT": size[0], "WIDTH": size[1], "COUNT": count}
    numbers |= {"ARGUMENT_COUNT": len(leaves) + 1, "SUMS": adds.count(False)}
    sizes = [variable.aval.size for variable in closed.jaxpr.outvars if variable.aval.ndim == 1]
    numbers |= {"TABLES": len(sizes), "TABLE_SIZES": ", ".join(map(str, [*sizes, 0]))}
    source = _fill(writer, declarations, numbers, _statements(results, adds))
    shapes = tuple(
        variable.aval.shape if variable.aval.ndim == 1 else size
        for variable in closed.jaxpr.outvars
    )
    return Kernel(source, shapes)


def _leaves(local: Any, tables: Any) -> list[tuple[Any, bool]]:
    """Every leaf, and whether it is a table."""
    return [(leaf, False) for leaf in jax.tree.leaves(local)] + [
        (leaf, True) for leaf in jax.tree.leaves(tables)
    ]


def emit_sum(
    sample: Callable[..., Any], count: int, size: tuple[int, int], local: Any, tables: Any
) -> Kernel:
    """Write the sum over samples of `jaxblur.sample_sums.sum_samples` in C++.

    Args:
        sample: maps (sample indices (n,), local, tables) to a tuple of (H, W, n) arrays.
        count: number of samples N.
        size: (H, W).
        local: pytree of (H, W, 1) planes and scalars.
        tables: pytree of (H * W,) arrays.

    Returns:
        The kernel; its operands are the moving pixels, the leaves of local, those of tables.

    Raises:
        Unsupported: the sample uses an operation or a type that has no form in C++ here.
    """
    index = jax.ShapeDtypeStruct((count,), jnp.int32)
    closed = jax.make_jaxpr(sample)(index, local, tables)
    return _emit(closed, count, size, _leaves(local, tables))


def emit_pull(
    sample: Callable[..., Any],
    count: int,
    size: tuple[int, int],
    operands: tuple[Any, Any],
    active: Sequence[int],
    terms: Sequence[Any],
) -> Kernel:
    """Write the transposed derivative of the sum in C++: from images to inputs.

    Args:
        sample: as `emit_sum`.
        count: as `emit_sum`.
        size: as `emit_sum`.
        operands: (local, tables).
        active: positions of the leaves of (local, tables) that are differentiated.
        terms: shapes and types of the images, one for each sum.

    Returns:
        The kernel; its operands are the moving pixels, the leaves, the images. Its results are in
        the order of `active`: a plane for each plane *and each scalar*, a table for each table.

    Raises:
        Unsupported: the sample uses an operation or a type that has no form in C++ here.
    """
    structure = jax.tree.structure(operands)
    leaves = _leaves(*operands)
    # One sample at a time, and scalars as planes: then nothing is summed over an axis in there.
    plane = (*size, 1)
    traced = [
        jax.ShapeDtypeStruct(leaf.shape if table or leaf.ndim else plane, leaf.dtype)
        for leaf, table in leaves
    ]
    images = [jax.ShapeDtypeStruct(plane, term.dtype) for term in terms]

    def pull(index: jax.Array, leaves: list[jax.Array], images: list[jax.Array]):
        def of_active(values):
            changed = list(leaves)
            for position, value in zip(active, values, strict=True):
                changed[position] = value
            return sample(index, *jax.tree.unflatten(structure, changed))

        _, transpose = jax.vjp(of_active, [leaves[position] for position in active])
        return transpose(tuple(images))[0]

    closed = jax.make_jaxpr(pull)(jax.ShapeDtypeStruct((1,), jnp.int32), traced, images)
    operands_of_kernel = leaves + [(image, False) for image in images]
    return _emit(closed, count, size, operands_of_kernel)
