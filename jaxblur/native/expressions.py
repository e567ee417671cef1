"""The C++ form of a jaxpr of elementwise operations, reads of tables and additions to tables."""

import dataclasses
import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend import core

from .operations import OPERATIONS, Level, Unsupported, Value, c_type, literal, widened

_BUFFERS = {"float32": "float", "int32": "int32_t", "bool": "uint8_t"}
_LOADS = {
    "float32": "load_floats({}, lanes)",
    "int32": "load<Ints>({}, lanes)",
    "bool": "(load<Ints>({}, lanes) != 0)",
}
_INNER = ("jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "remat2")


class Read:
    """A read of a table or an image; of two neighbors in memory the first reads both.

    Attributes:
        name: of the variable.
        second: that of what comes next in memory, where both are read together.
        done: whether its neighbor reads it.
    """

    def __init__(
        self, table: str, base: str, distance: int, name: str, function: str = "read"
    ) -> None:
        self._table, self._base, self._distance = table, base, distance
        self._function, self.name, self.second, self.done = function, name, "", False

    def __str__(self) -> str:
        if self.done:
            return ""
        place = f"{self._table} + {self._distance}, {self._base}"
        if self.second:
            return f"Floats {self.name}, {self.second}; read({place}, {self.name}, {self.second});"
        return f"const Floats {self.name} = {self._function}({place});"


def _opened(jaxpr: Any) -> tuple[Any, Sequence[Any]]:
    """A jaxpr and its constants; versions of JAX differ in whether it comes closed."""
    return (jaxpr.jaxpr, jaxpr.consts) if isinstance(jaxpr, core.ClosedJaxpr) else (jaxpr, ())


def _is_flat(equation: Any) -> bool:
    """Whether a read or an addition is that of one element of a flat table, known to be inside."""
    promised = equation.params["mode"] == jax.lax.GatherScatterMode.PROMISE_IN_BOUNDS
    return promised and equation.invars[0].aval.ndim == 1


def _addition(equation: Any, table: Value, index: Value, value: Value) -> Value:
    """What a tap adds to a table of zeros."""
    if not _is_flat(equation) or table.number is None or table.number != 0 or not index.wide:
        raise Unsupported("a scatter other than into a flat table of zeros at promised indices")
    return Value("", value.dtype, additions=((index, widened(value, Level.TAP)),))


def _merged(first: Value, second: Value) -> Value:
    """The sum of two tables that taps add to, or of one thing and zeros."""
    if _is_zero(first) or _is_zero(second):
        return second if _is_zero(first) else first
    if not (first.additions and second.additions):
        raise Unsupported("a sum of a table and a plane")
    return dataclasses.replace(first, additions=first.additions + second.additions)


def _is_zero(value: Value) -> bool:
    """Whether a value is a zero that is written out."""
    return value.number is not None and not np.any(value.number)


def _padded(equation: Any, plane: Value, filling: Value) -> Value:
    """An image of zeros but for one channel: the derivative of taking a channel out."""
    *sides, (before, after, inside) = equation.params["padding_config"]
    if any(map(any, sides)) or inside or min(before, after) < 0 or not _is_zero(filling):
        raise Unsupported("a pad other than of a channel to an image")
    if _is_zero(plane):
        return plane
    return dataclasses.replace(
        filling, columns=(*[filling] * before, plane, *[filling] * after), number=None
    )


def _without_zeros(name: str, inputs: Sequence[Value]) -> Value | None:
    """The result where it follows from a zero that is written out, None elsewhere.

    Such zeros are those of derivatives that vanish; a product with one is 0 even for NaN, as it
    is for the symbolic zeros of JAX.
    """
    zeros = [_is_zero(value) for value in inputs]
    if inputs[0].dtype != "float32" and name != "select_n":
        return None
    if name in ("mul", "div") and zeros[0]:
        return inputs[0]
    if name == "mul" and zeros[1]:
        return inputs[1]
    if name in ("add", "add_any") and any(zeros):
        return inputs[1] if zeros[0] else inputs[0]
    if name == "select_n" and all(zeros[1:]) and inputs[1].dtype == "float32":
        return inputs[1]
    return inputs[0] if name == "neg" and zeros[0] else None


def _reciprocal(inputs: Sequence[Value]) -> str:
    """One by a choice of two powers of two.

    The derivatives of maximum and minimum are divided by 2 where both are equal, else by 1.
    """
    which, *cases = inputs
    if any(case.dtype != "float32" or case.number is None for case in cases):
        return ""
    numbers = [float(case.number) for case in cases]
    if any(abs(np.frexp(number)[0]) != 0.5 for number in numbers):
        return ""
    one, other = (widened(literal(np.float32(1 / number)), which.level) for number in numbers)
    return f"({which.code} ? {other.code} : {one.code})"


def _base(name: str, code: str, inputs: Sequence[Value]) -> tuple[str, int, int] | None:
    """What an index, with this variable, is a known distance from."""
    if name not in ("add", "mul") or inputs[1].dtype != "int32" or inputs[1].number is None:
        return None
    number = int(inputs[1].number)
    if name == "mul":
        return code, 0, number
    factor = inputs[0].base[2] if inputs[0].base else 1
    return inputs[0].code, number, factor


def _compared(name: str, operands: Sequence[Value]) -> tuple[str, str, str] | None:
    """What chooses between two floats as their comparison does."""
    functions = {"gt": "larger", "lt": "smaller"}
    if name not in functions or operands[0].dtype != "float32":
        return None
    return functions[name], operands[0].code, operands[1].code


class Writer:
    """Collects the statements of each level while walking through jaxprs.

    Attributes:
        statements: by level.
        finishing: set once the samples are done; what a pixel needs then is written after them.
        last_statements: what is written after the samples.
        constants: tables of numbers.
    """

    def __init__(self) -> None:
        self.statements: dict[Level, list[str | Read]] = {level: [] for level in Level}
        self.finishing = False
        self.last_statements: list[str | Read] = []
        self.constants: list[str] = []
        self._names = 0
        self._reads: dict[tuple[int, str, str, int], Read] = {}

    def _name(self) -> str:
        self._names += 1
        return f"v{self._names}"

    def _statements(self, level: Level) -> list[str | Read]:
        """Where statements of a level are written now."""
        late = self.finishing and level == Level.PIXEL
        return self.last_statements if late else self.statements[level]

    def define(self, code: str, dtype: Any, level: Level, changes: bool = False) -> Value:
        """A variable for an expression, beside the others of its level."""
        dtype, name = np.dtype(dtype).name, self._name()
        kind = c_type(dtype, level >= Level.PIXEL)
        kind = kind if changes else f"const {kind}"
        self._statements(level).append(f"{kind} {name} = {code};")
        return Value(name, dtype, level)

    def constant(self, value: Any) -> Value:
        """A closed-over array: a number, or one number a sample."""
        array = np.asarray(value)
        if array.size == 1:
            return literal(array.reshape(()))
        if array.ndim == 0 or array.shape[-1] != array.size:
            raise Unsupported(f"a constant of shape {array.shape}")
        name, kind = self._name(), c_type(array.dtype, wide=False)
        numbers = ", ".join(literal(number).code for number in array.reshape(-1))
        self.constants.append(f"static const {kind} {name}[] = {{{numbers}}};")
        return Value(f"{name}[i]", array.dtype.name, Level.SAMPLE)

    def walk(self, jaxpr: Any, constants: Sequence[Any], inputs: Sequence[Value]) -> list[Value]:
        """Write the statements of a jaxpr.

        Raises:
            Unsupported: an operation has no form in C++.
        """
        values: dict[Any, Value] = {}
        values.update(zip(jaxpr.constvars, map(self.constant, constants), strict=True))
        values.update(zip(jaxpr.invars, inputs, strict=True))

        def read(atom: Any) -> Value:
            if isinstance(atom, core.Literal):
                return literal(np.asarray(atom.val, getattr(atom.aval, "dtype", None)))
            return values[atom]

        for equation in jaxpr.eqns:
            results = self._equation(equation, [read(atom) for atom in equation.invars])
            values.update(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def _equation(self, equation: Any, inputs: list[Value]) -> list[Value]:
        name, parameters = equation.primitive.name, equation.params
        if name in _INNER:
            inner = parameters.get("jaxpr") or parameters.get("call_jaxpr")
            return self.walk(*_opened(inner), inputs)
        if name == "scan":
            return self._loop(equation, inputs)
        if name in _OF_ARRAYS:
            return [_OF_ARRAYS[name](self, equation, *inputs)]
        if name in ("add", "add_any") and any(v.additions or v.columns for v in inputs):
            return [self._sum(equation, *inputs)]
        dtype = equation.outvars[0].aval.dtype
        if name == "convert_element_type" and inputs[0].number is not None:
            return [literal(inputs[0].number.astype(dtype))]
        return [self._operation(name, parameters, inputs, dtype)]

    def _loop(self, equation: Any, inputs: list[Value]) -> list[Value]:
        """A loop that carries values on, as `lax.fori_loop` of known length makes it."""
        length, (body, consts) = equation.params["length"], _opened(equation.params["jaxpr"])
        constants = len(inputs) - len(body.outvars)
        # Arrays that it runs over have an axis less within.
        outside, within = (*equation.invars, *equation.outvars), (*body.invars, *body.outvars)
        pairs = zip(outside, within, strict=True)
        if any(a.aval.shape != b.aval.shape for a, b in pairs) or equation.params["reverse"]:
            raise Unsupported("a scan over arrays")
        if any(value.level & Level.SAMPLE for value in inputs):
            raise Unsupported("a loop within a sample")
        carried = [
            self.define(widened(value, Level.PIXEL).code, value.dtype, Level.PIXEL, changes=True)
            for value in inputs[constants:]
        ]
        statements = self._statements(Level.PIXEL)
        statements.append(f"for (int32_t step = 0; step < {length}; ++step) {{")
        results = self.walk(body, consts, [*inputs[:constants], *carried])
        # All of them are found before one changes.
        found = [
            self.define(widened(value, Level.PIXEL).code, value.dtype, Level.PIXEL)
            for value in results
        ]
        pairs = zip(carried, found, strict=True)
        statements.extend(f"{variable.code} = {value.code};" for variable, value in pairs)
        statements.append("}")
        return carried

    def _operation(self, name: str, parameters: Any, inputs: list[Value], dtype: Any) -> Value:
        """An elementwise operation."""
        if name not in OPERATIONS:
            raise Unsupported(f"the operation {name}")
        if (known := _without_zeros(name, inputs)) is not None:
            return known
        if any(v.table or v.additions or v.channels or v.columns for v in inputs):
            raise Unsupported(f"{name} of a whole table or image")
        level = Level(functools.reduce(operator.or_, (value.level for value in inputs), 0))
        operands = [widened(value, level) for value in inputs]
        if name == "select_n":
            # What all pixels choose alike, as every odd tap does, is a jump: quicker than blends.
            operands[0] = inputs[0]
        code = OPERATIONS[name](parameters, *operands)
        if code == inputs[0].code:
            return inputs[0]
        floored = inputs[0].code if name == "floor" else ""
        reciprocal = _reciprocal(inputs) if name == "select_n" else ""
        result = self.define(code, dtype, level)
        return dataclasses.replace(
            result,
            base=_base(name, result.code, inputs),
            compared=_compared(name, operands),
            floored=floored,
            reciprocal=reciprocal,
        )

    def _sum(self, equation: Any, first: Value, second: Value) -> Value:
        """The sum of two tables that taps add to, or of two images put together from planes."""
        if not (first.columns and second.columns):
            return _merged(first, second)
        dtype = equation.outvars[0].aval.dtype
        pairs = zip(first.columns, second.columns, strict=True)
        columns = tuple(self._operation("add", {}, list(pair), dtype) for pair in pairs)
        return dataclasses.replace(first, columns=columns)

    def _read(self, equation: Any, table: Value, index: Value) -> Value:
        """A read of a flat table at one index a tap, known to lie inside."""
        if not (table.table and _is_flat(equation) and equation.params["slice_sizes"] == (1,)):
            raise Unsupported("a gather other than of a flat table at promised indices")
        if table.dtype != "float32" or not index.wide:
            raise Unsupported(f"a table of type {table.dtype} or read at the same place by all")
        base, distance, factor = index.base or (index.code, 0, 1)
        plane = factor == 1 and index.level == Level.PIXEL
        function = "read_plane" if plane else "read"
        return self._define_read(table.code, base, distance, index.level, function)

    def _define_read(
        self, table: str, base: str, distance: int, level: Level, function: str = "read"
    ) -> Value:
        """A variable for what is read at a distance from an index."""
        statements = self._statements(level)
        read = Read(table, base, distance, self._name(), function)
        # The place where its neighbor stands is earlier: there both indices are known.
        first = self._reads.get((id(statements), table, base, distance - 1))
        if distance % 2 and first and not first.second:
            first.second, read.done = read.name, True
        self._reads[id(statements), table, base, distance] = read
        statements.append(read)
        return Value(read.name, "float32", level)

    def _channel(self, equation: Any, image: Value) -> Value:
        """A channel of an image, at the pixel itself; all of anything is that itself."""
        if equation.outvars[0].aval.shape == equation.invars[0].aval.shape:
            return image
        parameters = equation.params
        (*corner, channel), last = parameters["start_indices"], parameters["limit_indices"]
        if not image.channels or any(corner) or last[2] != channel + 1:
            raise Unsupported("a slice other than of one channel")
        return self._define_read(image.code, f"own * {image.channels}", channel, Level.PIXEL)

    def _position(self, equation: Any) -> Value:
        """Number of the sample, row, or column."""
        parameters = equation.params
        rank, axis = len(parameters["shape"]), parameters["dimension"]
        if rank not in (1, 3):
            raise Unsupported(f"an iota of rank {rank}")
        names = ("y", "x", "i") if rank == 3 else ("i",)
        levels = (Level.PIXEL, Level.PIXEL, Level.SAMPLE) if rank == 3 else (Level.SAMPLE,)
        return self.define(names[axis], parameters["dtype"], levels[axis])

    def argument(self, position: int, leaf: Any, table: bool) -> tuple[str, Value]:
        """Declaration of an operand, and the value that the sample sees."""
        dtype = np.dtype(leaf.dtype).name
        if dtype not in _BUFFERS:
            raise Unsupported(f"operands of type {dtype}")
        name = f"argument{position}"
        declaration = f"const auto {name} = (const {_BUFFERS[dtype]}*)job->arguments[{position}];"
        if table:
            return declaration, Value(name, dtype, table=True)
        if leaf.ndim == 0:
            return declaration, Value(f"{name}[0]", dtype)
        if leaf.shape[-1] > 1:
            if dtype != "float32":
                raise Unsupported(f"images of type {dtype}")
            return declaration, Value(name, dtype, channels=leaf.shape[-1])
        return declaration, self.define(_LOADS[dtype].format(f"{name} + pixel"), dtype, Level.PIXEL)


_OF_ARRAYS: dict[str, Callable[..., Value]] = {
    "gather": Writer._read,
    "iota": Writer._position,
    "pad": lambda _, *operands: _padded(*operands),
    "scatter-add": lambda _, *operands: _addition(*operands),
    "slice": Writer._channel,
}
"""Operations that are not elementwise: of the writer, the equation and its inputs."""
