"""Print stages as kernels in C++, and the transpose of a sum.

The traced program stays the one description of a filter: its jaxprs are printed for rows of
neighboring pixels, one to each lane of a vector register. XLA's CPU compiler does not vectorize a
reduction whose order of summation matters.
"""

import dataclasses
import functools
import pathlib
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..stages import Kind, Place, Stages, table_shape
from .values import Additions, Level, Own, Scalar, Table, Unsupported, Value, widened
from .writer import Scope, Writer

TEMPLATE = pathlib.Path(__file__).with_name("kernel.cc")
LANES = pathlib.Path(__file__).with_name("lanes.h")

_BUFFERS = {"float32": "float", "int32": "int32_t", "bool": "uint8_t"}
_SAMPLE_NUMBER = Scalar("i", "int32", Level.SAMPLE)
_OWN_NUMBER = Scalar("i", "int32", Level.TAP)
"""Of a sample that each pixel chooses for itself."""
_INDEX = jax.ShapeDtypeStruct((), jnp.int32)


@dataclasses.dataclass(frozen=True)
class Operands:
    """The inputs of a kernel.

    Attributes:
        local: scalars (no channels), and images of which a pixel uses its own channels.
        tables: images that are read anywhere.
        sizes: how many rows and columns of images the program knows, both counted.
    """

    local: tuple[Kind, ...]
    tables: tuple[Kind, ...]
    sizes: int

    @classmethod
    def of(cls, leaves: Sequence[Any], locals_: int, sizes: int) -> "Operands":
        """The inputs of arrays: local ones, then tables."""
        kinds = [Kind(leaf.dtype.name, leaf.shape[-1] if leaf.ndim else 0) for leaf in leaves]
        return cls(tuple(kinds[:locals_]), tuple(kinds[locals_:]), sizes)

    def place(self) -> Place:
        """Shapes of the place."""
        return Place(_INDEX, _INDEX, (_INDEX,) * self.sizes)

    def local_shapes(self) -> list[tuple[jax.ShapeDtypeStruct, ...]]:
        """Shapes of the channels of each local input."""
        return [
            tuple(jax.ShapeDtypeStruct((), kind.dtype) for _ in range(max(kind.channels, 1)))
            for kind in self.local
        ]

    def table_shapes(self) -> list[jax.ShapeDtypeStruct]:
        """Shapes of the flat tables."""
        return [table_shape(kind) for kind in self.tables]


@dataclasses.dataclass(frozen=True)
class Kernel:
    """A kernel in C++, with ``@NAME@`` still open.

    Attributes:
        source: the program.
        planes: number of results of a pixel.
        tables: number of flat tables that samples add to, or leave their marks in.
        is_image: whether the results of a pixel are the channels of one image, or a plane each.
        parts: the text that is filled into the template, by its name there.
    """

    source: str
    planes: int
    tables: int
    is_image: bool
    parts: dict[str, str]


class _Program:
    """A kernel that is being written.

    Attributes:
        writer: holds what has been written.
        place: values of the place.
        local: values of the local inputs.
        tables: values of the tables.
    """

    def __init__(self, operands: Operands) -> None:
        self.writer = Writer()
        self._declarations: list[str] = []
        self.local = [self._local(k, kind) for k, kind in enumerate(operands.local)]
        first = len(operands.local)
        self.tables = [self._table(first + k, kind) for k, kind in enumerate(operands.tables)]
        sizes = tuple(Scalar(f"size{k}", "int32") for k in range(operands.sizes))
        for k, size in enumerate(sizes):
            self._declarations.append(f"const int32_t {size.code} = job->sizes[{k}];")
        row, column = (Scalar(name, "int32", Level.PIXEL) for name in ("y", "x"))
        self.place = Place(row, column, sizes)
        self._where: Scope | None = None
        self._before: Scope | None = None
        self._numbers: dict[str, Any] = {"KEPT": 0, "IMAGE": 0, "SUMS": 0, "REST": 0, "COUNT": 0}
        self._numbers["APART"] = 0
        self._numbers |= {"ARGUMENTS_READ": first + len(operands.tables), "ELEMENT": "float"}
        self._rows_of_three: list[int] = []
        self._all_move = True
        self._choice: list[str] = []
        self._leaves_marks = False

    def _pointer(self, position: int, kind: Kind) -> str:
        if kind.dtype not in _BUFFERS:
            raise Unsupported(f"operands of type {kind.dtype}")
        name, of = f"argument{position}", _BUFFERS[kind.dtype]
        self._declarations.append(f"const auto {name} = (const {of}*)job->arguments[{position}];")
        return name

    def _local(self, position: int, kind: Kind) -> tuple[Value, ...]:
        name = self._pointer(position, kind)
        if not kind.channels:
            return (Scalar(f"{name}[0]", kind.dtype),)
        if kind.channels > 1 and kind.dtype != "float32":
            raise Unsupported(f"images of type {kind.dtype}")
        return tuple(Own(name, kind.dtype, kind.channels, k) for k in range(kind.channels))

    def more(self, first: int, kinds: Sequence[Kind]) -> list[Value]:
        """Planes that are arguments after all others, from number `first` on."""
        self._numbers["ARGUMENTS_READ"] = first + len(kinds)
        return [self._local(first + k, kind)[0] for k, kind in enumerate(kinds)]

    def _table(self, position: int, kind: Kind) -> Table:
        return Table(self._pointer(position, kind), kind.dtype)

    def write(self, function: Callable[..., Any], shapes: Any, inputs: Any) -> tuple[Any, Any]:
        """Write a function of scalars.

        Args:
            function: what is printed.
            shapes: of its arguments.
            inputs: their values, a pytree alike.

        Returns:
            The values of its results, and their shapes and types, both in its own structure.
        """
        closed, results = jax.make_jaxpr(function, return_shape=True)(*shapes)
        flat = jax.tree.leaves(inputs, is_leaf=_is_value)
        values = self.writer.walk(closed.jaxpr, closed.consts, flat)
        return jax.tree.unflatten(jax.tree.structure(results), values), results

    def split(self, where: Value, rest: Sequence[Value] = ()) -> None:
        """The statements so far give the condition; the others run only for pixels that meet it.

        Args:
            where: the condition.
            rest: results of the other pixels, none where they keep what they have.
        """
        scope = self.writer.pixel
        scope.statements.append(f"const Ints moving = {_wide(where)};")
        for k, value in enumerate(rest):
            scope.statements.append(f"results[{k}] = {_wide(value)};")
        self._numbers["REST"] = len(rest)
        self._all_move = isinstance(where, Scalar) and where.number is not None
        self._where, self._before = scope, self.writer.enter()

    def loop(self, count: int, limit: Value | None) -> None:
        """How many samples the loop takes.

        Args:
            count: of all pixels.
            limit: of this pixel; the loop ends at the largest of its vector. None for the count.
        """
        self._numbers["COUNT"] = count
        if isinstance(limit, Scalar):
            code = _wide(limit)
            code = f"to_ints({code})" if limit.dtype == "float32" else code
            self.writer.pixel.statements.append(f"last = largest({code} & moving);")

    def choose(self, counts: Value) -> None:
        """Each pixel takes only the samples that count for it.

        Args:
            counts: whether a sample does; its statements come before those of the samples.
        """
        tap = self.writer.tap
        tap.statements.append(f"left |= {_wide(counts)} & moving & (1 << (i - some));")
        self._choice = [str(self.writer.sample), str(tap)]
        self.writer.begin_samples()

    def sums(self, terms: Sequence[Value]) -> list[Scalar]:
        """Sum terms over the samples."""
        tap, sums = self.writer.tap, []
        self._numbers["SUMS"] = len(terms)
        for k, term in enumerate(terms):
            if not isinstance(term, Scalar):
                raise Unsupported("a sum of a whole table")
            if term.number is not None and not np.any(term.number):
                sums.append(term)
                continue
            code = widened(term, Level.TAP).code
            code = f"(counts ? {code} : Floats{{}})" if self._choice else code
            tap.statements.append(f"sums[{k}] += {code};")
            sums.append(Scalar(f"sums[{k}]", "float32", Level.PIXEL))
        self.writer.enter()
        return sums

    def add(self, tables: Sequence[tuple[Value, int]]) -> None:
        """Write the additions of a sample to tables, each with so many channels."""
        for k, (table, channels) in enumerate(tables):
            rows = _rows(table)
            three = all(factor == 3 and max(row) < 3 for (_, factor), row in rows.items())
            self._rows_of_three.append(int(three and bool(rows)))
            for (base, factor), row in rows.items():
                four = factor % 4 == 0 and channels % 4 == 0
                lines = _add_row(k, base, row, 3 * three + 4 * four)
                self.writer.tap.statements.extend(lines)

    def mark(self, marks: Sequence[tuple[Value, Value]], apart: int) -> None:
        """Write the marks of a sample in the one table: (place, mark) pairs of whole numbers."""
        self._numbers |= {"ELEMENT": "int32_t", "APART": apart}
        self._leaves_marks = True
        self._rows_of_three = [0]
        for place, mark in marks:
            self.writer.tap.statements.append(
                f"keep_larger(tables[0], {_wide(place)}, {_wide(mark)});"
            )

    def kernel(
        self, results: Sequence[Value], tables: int = 0, kept: int = 0, is_image: bool = False
    ) -> Kernel:
        """The program.

        Args:
            results: of a pixel.
            tables: number of tables that samples add to.
            kept: channels of an image, the last argument, that the other pixels keep.
            is_image: whether the results are channels of one image, or a plane each.

        Returns:
            The kernel.
        """
        for k, result in enumerate(results):
            code = _wide(result)
            code = f"moving ? {code} : results[{k}]" if self._numbers["REST"] else code
            self.writer.pixel.statements.append(f"results[{k}] = {code};")
            if not isinstance(result, Scalar) or result.dtype != "float32":
                raise Unsupported("results of another type than float32")
        writer, finish = self.writer, self.writer.pixel
        assert self._where is not None and self._before is not None
        parts = {
            "ARGUMENTS": [*self._declarations, str(writer.uniform)],
            "MOVING": [str(self._where)],
            "PIXEL": [str(self._before)] if self._before is not finish else [],
            "CHOICE": self._choice,
            "SAMPLE": [str(writer.sample)],
            "TAP": [str(writer.tap)],
            "FINISH": [str(finish)],
        }
        self._numbers |= {"KEPT": kept, "IMAGE": int(is_image)}
        numbers = self._numbers | {"TABLES": tables, "RESULTS": len(results)}
        numbers["CHOOSES"] = int(bool(self._choice))
        numbers["PACKED"] = int(not (self._leaves_marks or self._all_move))
        numbers["ROWS_OF_THREE"] = ", ".join(map(str, [*self._rows_of_three, 0]))
        texts = {name: "\n".join(filter(None, lines)) for name, lines in parts.items()}
        texts |= {name: str(number) for name, number in numbers.items()}
        source = TEMPLATE.read_text(encoding="utf-8")
        for name, text in (texts | {"LANES": LANES.read_text(encoding="utf-8")}).items():
            source = source.replace(f"@{name}@", text)
        return Kernel(source, len(results), tables, is_image, texts)


def _is_value(leaf: Any) -> bool:
    return isinstance(leaf, Scalar | Own | Table | Additions)


def _wide(value: Value) -> str:
    """The code of a value, one a lane."""
    if not isinstance(value, Scalar):
        raise Unsupported("a whole table where a number is wanted")
    return value.code if value.wide else f"wide({value.code})"


def emit_pass(pass_: Any) -> Kernel:
    """Print a pass of a filter.

    Args:
        pass_: a `jaxblur.kernels.Pass`.

    Returns:
        The kernel that runs it where native code does.

    Raises:
        Unsupported: the program uses an operation or a type that has no form in C++ here.
    """
    traced = pass_.traced
    sizes = 2 * sum(kind.channels > 0 for kind in traced.kinds)
    local = tuple(traced.kinds[k] for k in traced.local)
    operands = Operands(local, tuple(traced.kinds[k] for k in traced.tables), sizes)
    if pass_.kind == "marks":
        return emit_marks(traced.stages, operands, pass_.apart)
    return emit_gather(traced.stages, operands, pass_.kept)


@functools.lru_cache(maxsize=512)
def emit_gather(stages: Stages, operands: Operands, kept: int = 0, is_image: bool = True) -> Kernel:
    """Print the stages of a program.

    Args:
        stages: see `jaxblur.kernels.stages.Stages`.
        operands: the inputs.
        kept: channels of the image that pixels keep whose results are not wanted; 0 if there is
            none.
        is_image: whether the result is one image, or a plane each.

    Returns:
        The kernel; its operands are the local inputs, the tables, and the image kept if there is
        one. Channels beyond those kept, and planes of blocks of which no pixel is wanted, are 0.

    Raises:
        Unsupported: a stage uses an operation or a type that has no form in C++ here.
    """
    program = _Program(operands)
    shapes = operands.place(), operands.local_shapes(), operands.table_shapes()
    inputs = program.place, program.local, program.tables
    (where, found), (_, found_shapes) = program.write(stages.where, shapes, inputs)
    shapes, inputs = (*shapes, found_shapes), (*inputs, found)
    rest = []
    if stages.otherwise is not None:
        rest, _ = program.write(stages.otherwise, shapes, inputs)
    program.split(where, rest)
    prepared, prepared_shapes = program.write(stages.prepare, shapes, inputs)
    if stages.sample is None or stages.finish is None:
        return program.kernel(prepared, 0, kept, is_image)
    limit = None
    if stages.limit is not None:
        limit, _ = program.write(stages.limit, (prepared_shapes,), (prepared,))
    program.loop(stages.samples, limit)
    place, local, tables, _ = shapes
    shapes_of_sample = _INDEX, place, prepared_shapes, tables
    number, of_place = _SAMPLE_NUMBER, (program.place, prepared, program.tables)
    if stages.counts is not None:
        counts, _ = program.write(stages.counts, shapes_of_sample, (number, *of_place))
        program.choose(counts)
        number = _OWN_NUMBER
    terms, term_shapes = program.write(stages.sample, shapes_of_sample, (number, *of_place))
    sums = program.sums(list(terms))
    results, _ = program.write(
        stages.finish,
        (place, list(term_shapes), prepared_shapes, local),
        (program.place, sums, prepared, program.local),
    )
    return program.kernel(list(results), 0, kept, is_image)


@functools.lru_cache(maxsize=512)
def emit_pull(
    sample: Callable[..., Any],
    limit: Callable[..., Any] | None,
    count: int,
    operands: Operands,
    active: tuple[int, ...],
    terms: tuple[str, ...],
) -> Kernel:
    """Print the transposed derivative of a sum over samples: from images to inputs.

    Args:
        sample: maps (index, place, local, tables) to a tuple of terms.
        limit: maps local to the number of samples, or None.
        count: number of samples N.
        operands: the inputs.
        active: positions of the differentiated inputs among the local ones, then the tables.
        terms: names of the types of the images, one for each sum.

    Returns:
        The kernel; its operands are the wanted pixels, the inputs, the images. Its results are in
        the order of `active`: a plane for each channel of a local input *and for each scalar*,
        a table for each table.

    Raises:
        Unsupported: the sample uses an operation or a type that has no form in C++ here.
    """
    planes = tuple(Kind(term, 1) for term in terms)
    # All local inputs, so that the wanted pixels come first; the images come after the tables.
    every = Operands((Kind("bool", 1), *operands.local), operands.tables, operands.sizes)
    program = _Program(every)
    first = len(every.local) + len(every.tables)
    images = program.more(first, planes)
    wanted, local = program.local[0][0], program.local[1:]
    program.split(program.writer.resolve(wanted))
    shapes, table_shapes = operands.local_shapes(), operands.table_shapes()
    most = None
    if limit is not None:
        most, _ = program.write(limit, (shapes,), (local,))
    program.loop(count, most)
    image_shapes = [jax.ShapeDtypeStruct((), kind.dtype) for kind in planes]
    results, _ = program.write(
        _pull_one(sample, active),
        (_INDEX, operands.place(), shapes, table_shapes, image_shapes),
        (_SAMPLE_NUMBER, program.place, local, program.tables, images),
    )
    planes_out: list[Value] = []
    tables_out: list[tuple[Value, int]] = []
    for position, result in zip(active, results, strict=True):
        if position < len(operands.local):
            planes_out.extend(result)
        else:
            channels = operands.tables[position - len(operands.local)].channels
            tables_out.append((result, channels))
    program.add(tables_out)
    return program.kernel(program.sums(planes_out), len(tables_out))


@functools.lru_cache(maxsize=512)
def emit_marks(stages: Stages, operands: Operands, apart: int = 0) -> Kernel:
    """Print `jaxblur.kernels.scatter.largest_marks`.

    Args:
        stages: of a program whose samples are marks: place, mark, place, mark, ...
        operands: the inputs.
        apart: number of steps if each has a share of the table of its own, else 0.

    Returns:
        The kernel; its result is the table that marks are left in.

    Raises:
        Unsupported: a stage uses an operation or a type that has no form in C++ here.
    """
    program = _Program(operands)
    shapes = operands.place(), operands.local_shapes(), operands.table_shapes()
    inputs = program.place, program.local, program.tables
    assert stages.sample is not None and stages.limit is not None
    (where, found), (_, found_shapes) = program.write(stages.where, shapes, inputs)
    program.split(where)
    prepared, prepared_shapes = program.write(
        stages.prepare, (*shapes, found_shapes), (*inputs, found)
    )
    limit, _ = program.write(stages.limit, (prepared_shapes,), (prepared,))
    program.loop(0, limit)
    place, _, tables = shapes
    marks, _ = program.write(
        stages.sample,
        (_INDEX, place, prepared_shapes, tables),
        (_SAMPLE_NUMBER, program.place, prepared, program.tables),
    )
    program.mark(list(zip(marks[::2], marks[1::2], strict=True)), apart)
    program.sums([])
    return program.kernel([], 1)


def _pull_one(sample: Callable[..., Any], active: Sequence[int]) -> Callable[..., Any]:
    """From the images to the active inputs, for one sample."""

    def pull(index: Any, place: Place, local: Any, tables: Any, images: Any) -> Any:
        def of_active(values: list[Any]) -> Any:
            changed = [*local, *tables]
            for position, value in zip(active, values, strict=True):
                changed[position] = value
            terms = sample(index, place, changed[: len(local)], changed[len(local) :])
            return tuple(map(jnp.asarray, terms))

        values = [*local, *tables]
        _, transpose = jax.vjp(of_active, [values[position] for position in active])
        return transpose(tuple(images))[0]

    return pull


def _rows(table: Value) -> dict[tuple[str, int], dict[int, str]]:
    """Additions to a table: by index and the factor of that, the sums at each distance."""
    if isinstance(table, Scalar) and table.number is not None and not np.any(table.number):
        return {}
    if not isinstance(table, Additions):
        raise Unsupported("a table as a result that is not added to")
    rows: dict[tuple[str, int], dict[int, str]] = {}
    for index, value in table.pairs:
        base, distance, factor = index.facts.base or (index.code, 0, 1)
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
