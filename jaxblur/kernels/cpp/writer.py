"""The C++ form of a jaxpr of scalars: elementwise operations, and reads of tables."""

import dataclasses
import functools
import operator
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend import core

from ..inlining import opened
from .order import by_reads, names_of
from .values import (
    OPERATIONS,
    Additions,
    Facts,
    Level,
    Own,
    Scalar,
    Table,
    Unsupported,
    Value,
    c_type,
    literal,
    widened,
)

_LOADS = {
    "float32": "read_plane({}, own)",
    "int32": "read_plane({}, own)",
    "bool": "(read_bytes({}, own) != 0)",
}
_INNER = ("jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "remat2")
_SAME = ("broadcast_in_dim", "copy", "expand_dims", "reshape", "squeeze", "stop_gradient")


class Read:
    """A read of a table; of up to five neighbors in memory the first reads all.

    Attributes:
        names: of the variables, one for each neighbor; none where an earlier read has it.
        room: elements from the first to the end of the texel, at least.
    """

    def __init__(
        self, function: str, table: str, base: str, distance: int, name: str, room: int
    ) -> None:
        self._function, self._table, self._base, self._distance = function, table, base, distance
        self.names, self.room = [name], room

    def __str__(self) -> str:
        if not self.names:
            return ""
        place = f"{self._table} + {self._distance}, {self._base}"
        if len(self.names) == 1:
            return f"const Floats {self.names[0]} = {self._function}({place});"
        names = self.names
        if len(names) == 3 and self.room > 3:
            # A load of three needs a mask.
            names = [*names, f"{names[-1]}_next"]
        names = ", ".join(names)
        return f"Floats {names}; read({place}, {names});"


class Scope:
    """A block of statements, inside another one or not.

    Attributes:
        outer: the block around it, whose variables it sees.
        statements: in order; a loop is a scope with a head.
        head: of a loop, before its brace.
        own: variables of the pixel's own values that are loaded in this block.
        reads: reads in this block by (table, base, distance).
    """

    def __init__(self, outer: "Scope | None" = None, head: str = "") -> None:
        self.outer, self.head = outer, head
        self.statements: list[str | Read | Scope] = []
        self.own: dict[Own, Scalar] = {}
        self.reads: dict[tuple[str, str, int], Read] = {}

    def __str__(self) -> str:
        body = "\n".join(by_reads(self._described()))
        return f"{self.head} {{\n{body}\n}}" if self.head else body

    def _described(self) -> Iterator[tuple[str, Sequence[str] | None, bool]]:
        """The statements, as `by_reads` takes them."""
        for statement in self.statements:
            text = str(statement)
            if isinstance(statement, Read):
                if text:
                    yield text, statement.names, True
            elif isinstance(statement, Scope):
                yield text, None, False
            else:
                yield text, names_of(text), " = read" in text

    def find_own(self, value: Own) -> Scalar | None:
        """The variable of a pixel's own value, of this block or one around it."""
        scope: Scope | None = self
        while scope is not None:
            if value in scope.own:
                return scope.own[value]
            scope = scope.outer
        return None


def _is_flat(equation: Any) -> bool:
    """Whether a read or an addition is that of one element of a flat table, known to be inside."""
    promised = equation.params["mode"] == jax.lax.GatherScatterMode.PROMISE_IN_BOUNDS
    return promised and equation.invars[0].aval.ndim == 1


def _addition(equation: Any, table: Value, index: Value, value: Value) -> Value:
    """An addition of a sample to a table of zeros."""
    if not (_is_flat(equation) and _is_zero(table) and isinstance(index, Scalar)):
        raise Unsupported("a scatter other than into a flat table of zeros at promised indices")
    if not isinstance(value, Scalar):
        raise Unsupported("an addition of a whole table to a table")
    index = widened(index, Level.TAP)
    return Additions(value.dtype, ((index, widened(value, Level.TAP)),))


def _merged(first: Value, second: Value) -> Value:
    """The sum of two tables that samples add to, or of one thing and zeros."""
    if _is_zero(first) or _is_zero(second):
        return second if _is_zero(first) else first
    if not (isinstance(first, Additions) and isinstance(second, Additions)):
        raise Unsupported("a sum of a table and a plane")
    return dataclasses.replace(first, pairs=first.pairs + second.pairs)


def _is_zero(value: Value) -> bool:
    """Whether a value is a zero that is written out."""
    return isinstance(value, Scalar) and value.number is not None and not np.any(value.number)


def _without_zeros(name: str, inputs: Sequence[Scalar]) -> Scalar | None:
    """The result where it follows from a zero that is written out, None elsewhere.

    Derivatives that vanish are such zeros; a product with one is 0 even for NaN, as it is for the
    symbolic zeros of JAX.
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


def _reciprocal(inputs: Sequence[Scalar]) -> str:
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


def _base(name: str, code: str, inputs: Sequence[Scalar]) -> tuple[str, int, int] | None:
    """Base of an index: the expression that it is a known distance from."""
    if name not in ("add", "mul") or inputs[1].dtype != "int32" or inputs[1].number is None:
        return None
    number = int(inputs[1].number)
    if name == "mul":
        return code, 0, number
    factor = inputs[0].facts.base[2] if inputs[0].facts.base else 1
    return inputs[0].code, number, factor


def _compared(name: str, operands: Sequence[Scalar]) -> tuple[str, str, str] | None:
    """The function that chooses between two floats as their comparison does."""
    functions = {"gt": "larger", "lt": "smaller"}
    if name not in functions or operands[0].dtype != "float32":
        return None
    return functions[name], operands[0].code, operands[1].code


class Writer:
    """Collects the statements of each scope while it walks through jaxprs.

    The blocks of a kernel lie in one another: uniform values, then for each group of pixels the
    condition, then (where it holds for one of them) their values, the loop over samples with values
    of the sample and of the tap, and the finish.

    Attributes:
        uniform: values that are the same everywhere.
        pixel: the block that values of a pixel are written to now.
        sample: values that depend on the number of the sample alone.
        tap: values of a sample of a pixel.
    """

    def __init__(self) -> None:
        self.uniform = Scope()
        self.pixel = Scope(self.uniform)
        self._names = 0
        self.begin_samples()

    def begin_samples(self) -> None:
        """Go on in new blocks for what depends on a sample."""
        self.sample, self.tap = Scope(self.uniform), Scope(self.pixel)

    def enter(self) -> Scope:
        """Go on in a block inside the present one, which is returned."""
        self.pixel = Scope(self.pixel)
        self.tap.outer = self.pixel
        return self.pixel

    def _name(self) -> str:
        self._names += 1
        return f"v{self._names}"

    def _scope(self, level: Level) -> Scope:
        """The block that statements of a level are written to now."""
        return {
            Level.UNIFORM: self.uniform,
            Level.SAMPLE: self.sample,
            Level.PIXEL: self.pixel,
            Level.TAP: self.tap,
        }[level]

    def define(self, code: str, dtype: Any, level: Level, changes: bool = False) -> Scalar:
        """A variable for an expression, beside the others of its level."""
        dtype, name = np.dtype(dtype).name, self._name()
        kind = c_type(dtype, level >= Level.PIXEL)
        kind = kind if changes else f"const {kind}"
        self._scope(level).statements.append(f"{kind} {name} = {code};")
        return Scalar(name, dtype, level)

    def walk(self, jaxpr: Any, constants: Sequence[Any], inputs: Sequence[Value]) -> list[Value]:
        """Write the statements of a jaxpr.

        Raises:
            Unsupported: an operation has no form in C++.
        """
        values: dict[Any, Value] = {}
        values.update(zip(jaxpr.constvars, map(_constant, constants), strict=True))
        values.update(zip(jaxpr.invars, inputs, strict=True))

        def read(atom: Any) -> Value:
            if isinstance(atom, core.Literal):
                return literal(np.asarray(atom.val, getattr(atom.aval, "dtype", None)))
            return self.resolve(values[atom])

        for equation in jaxpr.eqns:
            results = self._equation(equation, [read(atom) for atom in equation.invars])
            values.update(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def resolve(self, value: Value) -> Value:
        """The variable of a value of the pixel itself, loaded where it is first used."""
        if not isinstance(value, Own):
            return value
        found = self.pixel.find_own(value)
        if found is None:
            if value.channels == 1:
                code = _LOADS[value.dtype].format(value.code)
                found = self.define(code, value.dtype, Level.PIXEL)
            else:
                base = f"own * {value.channels}"
                found = self._define_read(
                    value.code, base, value.channel, value.channels, Level.PIXEL
                )
            self.pixel.own[value] = found
        return found

    def _equation(self, equation: Any, inputs: list[Value]) -> list[Value]:
        name, parameters = equation.primitive.name, equation.params
        if name in _INNER:
            inner = parameters.get("jaxpr") or parameters.get("call_jaxpr")
            return self.walk(*opened(inner), inputs)
        if name == "scan":
            return self._loop(equation, inputs)
        if name == "gather":
            return [self._read(equation, *inputs)]
        if name == "scatter-add":
            return [_addition(equation, *inputs)]
        if name in _SAME:
            return inputs[:1]
        if name in ("add", "add_any") and any(isinstance(v, Additions) for v in inputs):
            return [_merged(*inputs)]
        dtype = equation.outvars[0].aval.dtype
        scalars = [value for value in inputs if isinstance(value, Scalar)]
        if len(scalars) < len(inputs) or equation.outvars[0].aval.ndim:
            raise Unsupported(f"{name} of a whole array")
        if name == "convert_element_type" and scalars[0].number is not None:
            return [literal(scalars[0].number.astype(dtype))]
        return [self._operation(name, parameters, scalars, dtype)]

    def _loop(self, equation: Any, inputs: list[Value]) -> list[Value]:
        """A loop that carries values on, as `lax.fori_loop` of known length makes it."""
        length, (body, consts) = equation.params["length"], opened(equation.params["jaxpr"])
        constants = len(inputs) - len(body.outvars)
        # Arrays that it runs over have an axis less within.
        outside, within = (*equation.invars, *equation.outvars), (*body.invars, *body.outvars)
        pairs = zip(outside, within, strict=True)
        if any(a.aval.shape != b.aval.shape for a, b in pairs) or equation.params["reverse"]:
            raise Unsupported("a scan over arrays")
        if any(isinstance(value, Scalar) and value.level & Level.SAMPLE for value in inputs):
            raise Unsupported("a loop within a sample")
        start = [self._carried(value) for value in inputs[constants:]]
        carried = [self.define(v.code, v.dtype, Level.PIXEL, changes=True) for v in start]
        around = self.pixel
        step = self._name()
        head = f"for (int32_t {step} = 0; {step} < {length}; ++{step})"
        self.pixel = Scope(around, head)
        results = self.walk(body, consts, [*inputs[:constants], *carried])
        # All of them are found before one changes.
        found = [self.define(v.code, v.dtype, Level.PIXEL) for v in map(self._carried, results)]
        pairs = zip(carried, found, strict=True)
        self.pixel.statements.extend(f"{old.code} = {new.code};" for old, new in pairs)
        around.statements.append(self.pixel)
        self.pixel = around
        return list(carried)

    def _carried(self, value: Value) -> Scalar:
        if not isinstance(value, Scalar):
            raise Unsupported("a loop that carries a whole table")
        return widened(value, Level.PIXEL)

    def _operation(self, name: str, parameters: Any, inputs: list[Scalar], dtype: Any) -> Scalar:
        """An elementwise operation."""
        if name not in OPERATIONS:
            raise Unsupported(f"the operation {name}")
        if (known := _without_zeros(name, inputs)) is not None:
            return known
        level = Level(functools.reduce(operator.or_, (value.level for value in inputs), 0))
        operands = [widened(value, level) for value in inputs]
        if name == "select_n":
            # A choice that all pixels make alike, as for every odd tap, is a jump, which is faster
            # than blends.
            operands[0] = inputs[0]
        code = OPERATIONS[name](parameters, *operands)
        if code == inputs[0].code:
            return inputs[0]
        result = self.define(code, dtype, level)
        facts = Facts(
            base=_base(name, result.code, inputs),
            compared=_compared(name, operands),
            floored=inputs[0].code if name == "floor" else "",
            reciprocal=_reciprocal(inputs) if name == "select_n" else "",
        )
        return dataclasses.replace(result, facts=facts)

    def _read(self, equation: Any, table: Value, index: Value) -> Scalar:
        """A read of a flat table at one index, known to lie inside."""
        single = _is_flat(equation) and equation.params["slice_sizes"] == (1,)
        if not (isinstance(table, Table) and isinstance(index, Scalar) and single):
            raise Unsupported("a gather other than of a flat table at promised indices")
        if not index.wide:
            return self.define(f"{table.code}[{index.code}]", table.dtype, index.level)
        base, distance, factor = index.facts.base or (index.code, 0, 1)
        plane = factor == 1 and (index.level == Level.PIXEL or table.dtype == "int32")
        function = "read_plane" if plane else "read"
        if table.dtype == "int32":
            return self.define(f"{function}({table.code}, {index.code})", "int32", index.level)
        if table.dtype != "float32":
            raise Unsupported(f"a table of type {table.dtype}")
        return self._define_read(table.code, base, distance, factor, index.level, function)

    def _define_read(
        self,
        table: str,
        base: str,
        distance: int,
        factor: int,
        level: Level,
        function: str = "read",
    ) -> Scalar:
        """A variable for the element at a distance from an index, a multiple of a factor."""
        scope = self._scope(level)
        name = self._name()
        read = Read(function, table, base, distance, name, factor - distance % factor)
        # Rows of four begin at multiples of four, of five at those of five, pairs at even
        # distances. The place of the first is earlier in the same block: there all indices are
        # known.
        positions = distance % 4, distance % 2, distance % 5 if factor == 5 else 0
        for position in positions:
            first = scope.reads.get((table, base, distance - position))
            if position and first and len(first.names) == position:
                first.names.append(name)
                read.names = []
                break
        scope.reads[table, base, distance] = read
        scope.statements.append(read)
        return Scalar(name, "float32", level)


def _constant(value: Any) -> Scalar:
    """A closed-over number."""
    array = np.asarray(value)
    if array.size != 1:
        raise Unsupported(f"a constant of shape {array.shape}; pass it as an Image")
    return literal(array.reshape(()))
