"""Kernels in C++ for gathers along lines and their transpose, from traced functions.

The traced functions stay the one description of a filter: their jaxprs are written out for rows
of neighboring pixels, one to each lane of a vector register. XLA's CPU compiler does not vectorize
a reduction whose order of summation matters.
"""

import dataclasses
import pathlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .expressions import Read, Writer
from .operations import Level, Unsupported, Value, widened

TEMPLATE = pathlib.Path(__file__).with_name("kernel.cc")
LANES = pathlib.Path(__file__).with_name("lanes.h")
_SAMPLE_NUMBER = Value("i", "int32", Level.SAMPLE)


def no_samples(*_: Any) -> tuple[()]:
    """The terms of a pixel that reads nothing along a line."""
    return ()


class Stages(NamedTuple):
    """What happens at a pixel; elementwise but for reads of the tables.

    Attributes:
        moving: from (local, tables) to a (H, W, 1) bool plane, the pixels that are computed, and a
            pytree of what was found out on the way.
        prepare: from (local, tables, found) to a pytree of real (H, W, 1) planes and scalars, once
            a pixel that moves. `sampling.channel` takes a local image apart.
        sample: from (sample indices (n,), prepared, tables) to a tuple of (H, W, n) terms; with
            `no_samples` what is prepared, a sequence of planes, is the result.
        rest: from (local, tables, found) to the result, a sequence of (H, W, 1) planes, of the
            pixels that do not move; None where they keep what they have. With `no_samples` only.
        finish: from (sums (H, W, 1), prepared, local) to a tuple of (H, W, 1) results.
        limit: from prepared to a (H, W, 1) plane: samples from that number on have terms of 0, so
            that they may be left out; None where all count.
    """

    moving: Callable[..., Any]
    prepare: Callable[..., Any]
    sample: Callable[..., Any] = no_samples
    finish: Callable[..., Any] = lambda sums, *_: sums
    limit: Callable[..., Any] | None = None
    rest: Callable[..., Any] | None = None


@dataclasses.dataclass(frozen=True)
class Kernel:
    """A kernel in C++, with ``@NAME@`` still open.

    Attributes:
        source: the program.
        shapes: of every result in turn: (H, W, R) or (H, W) for images, flat for a table that taps
            add to, or leave their marks in.
        dtype: of the results.
    """

    source: str
    shapes: tuple[tuple[int, ...], ...]
    dtype: str = "float32"


class _Program:
    """A kernel that is being written.

    Attributes:
        writer: holds what has been written.
        leaves: value of each operand.
    """

    def __init__(
        self, count: int, size: tuple[int, int], operands: Sequence[tuple[Any, bool]], kept: int = 0
    ) -> None:
        self.writer = Writer()
        pairs = [self.writer.argument(k, *operand) for k, operand in enumerate(operands)]
        self._declarations = [declaration for declaration, _ in pairs]
        self.leaves = [value for _, value in pairs]
        self._moving: list[str | Read] = []
        self._numbers: dict[str, Any] = {"HEIGHT": size[0], "WIDTH": size[1], "COUNT": count}
        self._numbers |= {"ARGUMENTS_READ": len(operands), "KEPT": kept, "SUMS": 0, "REST": 0}
        self._numbers["ELEMENT"] = "float"
        self._rows_of_three: list[int] = []

    def write(self, function: Callable[..., Any], shapes: Any, inputs: Sequence[Value]) -> Any:
        """Write a function of arrays of these shapes.

        Returns:
            The values of its results, and a pytree of their shapes and types.
        """
        closed, results = jax.make_jaxpr(function, return_shape=True)(*shapes)
        return self.writer.walk(closed.jaxpr, closed.consts, inputs), results

    def split(self, moving: Value, rest: Sequence[Value] = ()) -> None:
        """What was written so far tells which pixels move; nothing else is done for the others.

        Args:
            moving: the pixels that do.
            rest: results of the others, none where they keep what they have.
        """
        code = moving.code if moving.wide else f"wide({moving.code})"
        self._moving = [*self.writer.statements[Level.PIXEL], f"const Ints moving = {code};"]
        for k, value in enumerate(rest):
            self._moving.append(f"results[{k}] = {widened(value, Level.PIXEL).code};")
        self._numbers["REST"] = len(rest)
        self.writer.statements[Level.PIXEL] = []

    def stop_at(self, limit: Callable[..., Any] | None, shapes: Any, prepared: Any) -> None:
        """Leave out the samples from a number on that depends on the pixel."""
        if limit is None:
            return
        (value,), _ = self.write(limit, (shapes,), prepared)
        code = value.code if value.wide else f"wide({value.code})"
        code = f"to_ints({code})" if value.dtype == "float32" else code
        self.writer.statements[Level.PIXEL].append(f"last = largest({code} & moving);")

    def sums(self, terms: Sequence[Value]) -> list[Value]:
        """Sum terms over the samples."""
        tap = self.writer.statements[Level.TAP]
        self._numbers["SUMS"] = len(terms)
        self.writer.finishing = True
        sums = []
        for k, term in enumerate(terms):
            known = term.number is not None and not np.any(term.number)
            sums.append(term if known else Value(f"sums[{k}]", "float32", Level.PIXEL))
            tap.extend([] if known else [f"sums[{k}] += {widened(term, Level.TAP).code};"])
        return sums

    def add(self, tables: Sequence[tuple[Value, int]]) -> None:
        """Write what a tap adds to tables, of so many elements each."""
        for k, (table, length) in enumerate(tables):
            rows = _rows(table)
            three = all(factor == 3 and max(row) < 3 for (_, factor), row in rows.items())
            self._rows_of_three.append(int(three and bool(rows)))
            for (base, factor), row in rows.items():
                four = factor % 4 == 0 and length % 4 == 0
                lines = _add_row(k, base, row, 3 * three + 4 * four)
                self.writer.statements[Level.TAP].extend(lines)

    def mark(self, marks: Sequence[tuple[Value, Value]]) -> None:
        """Write what a tap leaves in the one table: (place, mark) pairs of whole numbers."""
        self._numbers["ELEMENT"] = "int32_t"
        self._rows_of_three = [0]
        for pair in marks:
            if any(value.dtype != "int32" for value in pair):
                raise Unsupported("marks of another type than int32")
            place, mark = (widened(value, Level.TAP).code for value in pair)
            self.writer.statements[Level.TAP].append(
                f"keep_larger(tables[0], {place}, {mark}, lanes);"
            )

    def kernel(self, results: Sequence[Value], tables: Sequence[int] = ()) -> str:
        """The program, with planes as results and tables of these sizes."""
        for k, result in enumerate(results):
            if result.dtype != "float32":
                raise Unsupported("results of another type than float32")
            code = result.code if result.wide else f"wide({result.code})"
            code = f"moving ? {code} : results[{k}]" if self._numbers["REST"] else code
            self.writer.last_statements.append(f"results[{k}] = {code};")
        statements = self.writer.statements
        parts = {
            "CONSTANTS": self.writer.constants,
            "ARGUMENTS": self._declarations + statements[Level.UNIFORM],
            "MOVING": self._moving,
            "PIXEL": statements[Level.PIXEL],
            "SAMPLE": statements[Level.SAMPLE],
            "TAP": statements[Level.TAP],
            "FINISH": self.writer.last_statements,
        }
        sizes = {"TABLES": len(tables), "TABLE_SIZES": ", ".join(map(str, [*tables, 0]))}
        sizes["ROWS_OF_THREE"] = ", ".join(map(str, [*self._rows_of_three, 0]))
        numbers = self._numbers | sizes | {"RESULTS": len(results)}
        texts = {name: "\n".join(map(str, lines)) for name, lines in parts.items()}
        texts["LANES"] = LANES.read_text(encoding="utf-8")
        source = TEMPLATE.read_text(encoding="utf-8")
        for name, text in ({name: str(number) for name, number in numbers.items()} | texts).items():
            source = source.replace(f"@{name}@", text)
        return source


def _shaped(tree: Any) -> Any:
    """Shapes and types of a pytree of arrays."""
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(jnp.shape(leaf), leaf.dtype), tree)


def _operands(local: Any, tables: Any) -> list[tuple[Any, bool]]:
    """Every leaf, and whether it is a table."""
    planes = [(leaf, False) for leaf in jax.tree.leaves(local)]
    return planes + [(leaf, True) for leaf in jax.tree.leaves(tables)]


def emit_gather(
    stages: Stages, count: int, size: tuple[int, int], local: Any, tables: Any, kept: int = 0
) -> Kernel:
    """Write `jaxblur.gathers.gather_samples` in C++.

    Args:
        stages: what happens at a pixel.
        count: number of samples N.
        size: (H, W).
        local: pytree of (H, W, K) images and scalars.
        tables: pytree of flat arrays.
        kept: channels of an image that pixels keep which do not move; 0 if there is none.

    Returns:
        The kernel; its operands are the leaves of local, those of tables, and the image kept if
        there is one. With one, its result is an image, whose channels beyond those kept are 0
        where a pixel does not move; else a plane each, 0 where no pixel of a block moves.

    Raises:
        Unsupported: a stage uses an operation or a type that has no form in C++ here.
    """
    program = _Program(count, size, _operands(local, tables), kept)
    table_values = program.leaves[len(jax.tree.leaves(local)) :]
    shapes, table_shapes = _shaped(local), _shaped(tables)
    (moving, *found), (_, found_shapes) = program.write(
        stages.moving, (shapes, table_shapes), program.leaves
    )
    found_operands = (shapes, table_shapes, found_shapes), [*program.leaves, *found]
    rest = [] if stages.rest is None else program.write(stages.rest, *found_operands)[0]
    program.split(moving, rest)
    prepared, prepared_shapes = program.write(stages.prepare, *found_operands)
    results = prepared
    if stages.sample is not no_samples:
        program.stop_at(stages.limit, prepared_shapes, prepared)
        index = jax.ShapeDtypeStruct((count,), jnp.int32)
        terms, term_shapes = program.write(
            stages.sample,
            (index, prepared_shapes, table_shapes),
            [_SAMPLE_NUMBER, *prepared, *table_values],
        )
        sums = program.sums(terms)
        sum_shapes = tuple(jax.ShapeDtypeStruct((*size, 1), term.dtype) for term in term_shapes)
        results, _ = program.write(
            stages.finish,
            (sum_shapes, prepared_shapes, shapes),
            [*sums, *prepared, *program.leaves[: len(jax.tree.leaves(local))]],
        )
    buffers = ((*size, len(results)),) if kept else (size,) * len(results)
    return Kernel(program.kernel(results), buffers)


def emit_pull(
    sample: Callable[..., Any],
    limit: Callable[..., Any] | None,
    count: int,
    size: tuple[int, int],
    operands: tuple[Any, Any],
    active: Sequence[int],
    terms: Sequence[Any],
) -> Kernel:
    """Write the transposed derivative of a sum over samples in C++: from images to inputs.

    Args:
        sample: maps (sample indices (n,), local, tables) to a tuple of (H, W, n) arrays.
        limit: as that of `Stages`, from local.
        count: number of samples N.
        size: (H, W).
        operands: (local, tables).
        active: positions of the leaves of (local, tables) that are differentiated.
        terms: shapes and types of the images, one for each sum.

    Returns:
        The kernel; its operands are the moving pixels, the leaves, the images. Its results are in
        the order of `active`: a plane for each plane *and each scalar*, and for each channel of an
        image; a table for each table.

    Raises:
        Unsupported: the sample uses an operation or a type that has no form in C++ here.
    """
    leaves = _operands(*operands)
    # One sample at a time, and scalars that are differentiated as planes: then nothing is summed
    # over an axis in there.
    plane = (*size, 1)
    shapes = [
        jax.ShapeDtypeStruct(plane if k in active and not leaf.ndim else leaf.shape, leaf.dtype)
        for k, (leaf, _) in enumerate(leaves)
    ]
    images = [jax.ShapeDtypeStruct(plane, term.dtype) for term in terms]
    moving = jax.ShapeDtypeStruct(plane, jnp.bool_)
    planes_too = [(moving, False), *leaves, *((image, False) for image in images)]
    program = _Program(count, size, planes_too)
    program.split(program.leaves[0])
    local = jax.tree.leaves(operands[0])
    local_shapes = jax.tree.unflatten(jax.tree.structure(operands[0]), shapes[: len(local)])
    program.stop_at(limit, local_shapes, program.leaves[1 : 1 + len(local)])
    results, result_shapes = program.write(
        _pull_one(sample, jax.tree.structure(operands), active),
        (jax.ShapeDtypeStruct((1,), jnp.int32), shapes, images),
        [_SAMPLE_NUMBER, *program.leaves[1:]],
    )
    planes, tables, flat = [], [], []
    for value, shape in zip(results, result_shapes, strict=True):
        if shape.ndim == 1:
            tables.append((value, shape.size))
            flat.append(shape.shape)
        else:
            channels = shape.shape[-1]
            planes.extend(value.columns or [value] * channels)
            flat.extend([size] * channels)
    program.add(tables)
    source = program.kernel(program.sums(planes), [length for _, length in tables])
    return Kernel(source, tuple(flat))


def emit_marks(
    sample: Callable[..., Any],
    limit: Callable[..., Any],
    size: tuple[int, int],
    operands: tuple[Any, Any],
    length: int,
) -> Kernel:
    """Write `jaxblur.marks.largest_marks` in C++.

    Args:
        sample: maps (sample indices (n,), local, tables) to (place, mark) pairs of (H, W, n)
            arrays of whole numbers.
        limit: from local to a (H, W, 1) plane, the number of samples.
        size: (H, W).
        operands: (local, tables).
        length: of the table that marks are left in.

    Returns:
        The kernel; its operands are the leaves, its result is the table.

    Raises:
        Unsupported: a function uses an operation or a type that has no form in C++ here.
    """
    program = _Program(0, size, _operands(*operands))
    local = program.leaves[: len(jax.tree.leaves(operands[0]))]
    shapes, table_shapes = _shaped(operands)
    (moving,), _ = program.write(lambda local: limit(local) > 0, (shapes,), local)
    program.split(moving)
    program.stop_at(limit, shapes, local)
    index = jax.ShapeDtypeStruct((1,), jnp.int32)
    marks, _ = program.write(
        sample, (index, shapes, table_shapes), [_SAMPLE_NUMBER, *program.leaves]
    )
    program.mark(list(zip(marks[::2], marks[1::2], strict=True)))
    return Kernel(program.kernel([], [length]), ((length,),), "int32")


def _pull_one(
    sample: Callable[..., Any], structure: Any, active: Sequence[int]
) -> Callable[[jax.Array, list[jax.Array], list[jax.Array]], Any]:
    """From the images to the active leaves, for one sample."""

    def pull(index: jax.Array, leaves: list[jax.Array], images: list[jax.Array]) -> Any:
        def of_active(values: list[jax.Array]) -> Any:
            changed = list(leaves)
            for position, value in zip(active, values, strict=True):
                changed[position] = value
            return sample(index, *jax.tree.unflatten(structure, changed))

        _, transpose = jax.vjp(of_active, [leaves[position] for position in active])
        return transpose(tuple(images))[0]

    return pull


def _rows(table: Value) -> dict[tuple[str, int], dict[int, str]]:
    """What a tap adds to a table: by index and the factor of that, the sums at each distance."""
    if not table.additions and (table.number is None or np.any(table.number != 0)):
        raise Unsupported("a table as a result that is not added to")
    rows: dict[tuple[str, int], dict[int, str]] = {}
    for index, value in table.additions:
        base, distance, factor = index.base or (index.code, 0, 1)
        row = rows.setdefault((base, factor), {})
        row[distance] = f"{row[distance]} + {value.code}" if distance in row else value.code
    return rows


def _add_row(table: int, base: str, row: dict[int, str], whole: int) -> list[str]:
    """Additions at known distances from one index, four at a time, or whole rows of 3 or 4."""
    lines = []
    width, name = (3, "add_three") if whole == 3 else (4, "add")
    for first in range(0, max(row) + 1, width):
        distances = range(first, first + width if whole else min(first + width, max(row) + 1))
        values = ", ".join(row.get(distance, "Floats{}") for distance in distances)
        lines.append(f"{name}(tables[{table}], {base} + {first}, {{{values}}}, lanes);")
    return lines
