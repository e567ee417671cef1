"""Prints the program of one pixel in any of the languages."""

import collections
import contextlib
import textwrap
from collections.abc import Callable, Container, Generator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jax.extend import core

from ..kernels.inlining import opened
from ..kernels.program import marks_primitive, sum_primitive
from ..kernels.reads import place_primitive
from .expressions import ATOM, Dialect, NotExpressible, Value
from .names import Names, Origin, origin_of, place_of

WIDTH = 96
"""Longest line, as far as lines can be broken."""

LONGEST_INLINE = 72
"""Longest expression that is written into another one rather than named."""

_SAME = ("broadcast_in_dim", "copy", "expand_dims", "reshape", "squeeze", "stop_gradient")


class Table(NamedTuple):
    """An image that is read at places of its own.

    Attributes:
        name: of the buffer in the pass.
        channels: of it.
        dtype: of its elements.
    """

    name: str
    channels: int
    dtype: str


class Printer:
    """Writes the statements of a program.

    Attributes:
        lines: what is written so far, indented.
        unnamed: name of values whose author gave them none.
    """

    def __init__(
        self,
        dialect: Dialect,
        names: Names,
        read: Callable[[Table, Value], str],
        depth: int = 1,
        program: str = "",
    ) -> None:
        """Start with nothing.

        Args:
            dialect: the language.
            names: that are taken.
            read: the text of a read of a table at an index.
            depth: of the indentation.
            program: name of the program, whose results have no names.
        """
        self._program = program
        self.unnamed = "value"
        self.dialect, self.names, self._read = dialect, names, read
        self.lines: list[str] = []
        self._depth = depth
        self._values: dict[Any, Value | Table] = {}
        self._uses: collections.Counter[Any] = collections.Counter()
        self._origins: dict[Any, Origin] = {}
        self._leaving: collections.Counter[Any] = collections.Counter()
        self._given: collections.Counter[Any] = collections.Counter()
        self._readers: dict[Any, Any] = {}
        self._own: dict[Any, tuple[Value, str]] = {}

    def add(self, text: str) -> None:
        """Add a statement or a brace."""
        if text.startswith("}"):
            self._depth -= 1
        indent = "    " * self._depth
        if len(indent) + len(text) > WIDTH and not text.startswith(("//", "/*")):
            lines = textwrap.wrap(
                text,
                WIDTH,
                initial_indent=indent,
                subsequent_indent=indent + "        ",
                break_long_words=False,
                break_on_hyphens=False,
            )
            self.lines.extend(lines)
        else:
            self.lines.append(indent + text if text else "")
        if text.endswith("{"):
            self._depth += 1

    def begin(
        self,
        jaxpr: Any,
        inputs: Sequence[Value | Table],
        own: Sequence[tuple[Any, Value, str]] = (),
    ) -> None:
        """Take up a program.

        Args:
            jaxpr: of it.
            inputs: values of its inputs.
            own: inputs that are named where they are first used, and the names wanted.
        """
        self._values |= dict(zip(jaxpr.invars, inputs, strict=True))
        self._count(jaxpr)
        self._count_leaving(jaxpr)
        for variable, value, name in own:
            del self._values[variable]
            self._own[variable] = value, name

    def _count(self, jaxpr: Any) -> None:
        """How often each value is used; what a loop uses is named before it."""
        same: dict[Any, Any] = {}
        for equation in needed_for(jaxpr.eqns, jaxpr.outvars):
            if equation.primitive.name in _SAME:
                source = equation.invars[0]
                same[equation.outvars[0]] = same.get(source, source) if _varies(source) else source
                continue
            loops = equation.primitive.name == "scan" or equation.primitive in _SUMS
            for atom in filter(_varies, _read_by(equation)):
                atom = same.get(atom, atom)
                if _varies(atom):
                    self._uses[atom] += 2 if loops else 1
                    self._readers[atom] = equation
            if loops:
                self._count(opened(equation.params["jaxpr"])[0])
        for atom in filter(_varies, jaxpr.outvars):
            atom = same.get(atom, atom)
            if _varies(atom):
                self._uses[atom] += 1

    def _count_leaving(self, jaxpr: Any) -> None:
        """How many values of a statement that assigns to a tuple are used outside of it."""
        for equation in jaxpr.eqns:
            origin = origin_of(equation)
            if len(origin.names) > 1 and equation.primitive.name not in _SAME:
                self._leaving[origin.statement] += sum(
                    self._uses[v] > 0 and not self._stays(v, origin) for v in equation.outvars
                )
            if equation.primitive.name == "scan" or equation.primitive in _SUMS:
                self._count_leaving(opened(equation.params["jaxpr"])[0])

    def _stays(self, variable: Any, origin: Origin) -> bool:
        """Whether a value is used in its own statement."""
        reader = self._readers.get(variable)
        return reader is not None and origin_of(reader).statement == origin.statement

    def value(self, atom: Any) -> Any:
        """The value of a variable or a literal."""
        if isinstance(atom, core.Literal):
            return self.dialect.literal(np.asarray(atom.val, getattr(atom.aval, "dtype", None)))
        if atom in self._own and atom not in self._values:
            self._values[atom] = self.define(*self._own[atom])
        return self._values[atom]

    @contextlib.contextmanager
    def block(self, head: str) -> Generator[None, None, None]:
        """A block whose variables end with it."""
        before = dict(self._values)
        self.add(head)
        yield
        self.add("}")
        self._values = before

    def scalar(self, atom: Any) -> Value:
        """The value of a variable that is a number.

        Raises:
            NotExpressible: it is a table.
        """
        value = self.value(atom)
        if not isinstance(value, Value):
            raise NotExpressible(f"{self.dialect.name}: a whole image where a number is wanted.")
        return value

    def write(self, equations: Sequence[Any], wanted: Sequence[Any]) -> list[Value]:
        """Write what the wanted values need and is not written yet."""
        for equation in needed_for(equations, wanted, set(self._values)):
            self._write(equation)
        return [self.scalar(atom) for atom in wanted]

    def define(self, value: Value, wanted: str, changes: bool = False) -> Value:
        """A variable with a value."""
        name = self.names.new(wanted)
        pattern = self.dialect.variable if changes else self.dialect.constant
        kind = self.dialect.type_of(value.dtype)
        self.add(pattern.format(type=kind, name=name, value=value.code))
        return Value(name, value.dtype)

    def _write(self, equation: Any) -> None:
        name = equation.primitive.name
        if equation.primitive in _SUMS:
            if equation.primitive is marks_primitive:
                raise NotExpressible(f"{self.dialect.name}: marks inside a sum.")
            self._write_sum(equation)
        elif name == "scan":
            self._write_loop(equation)
        elif equation.primitive is place_primitive:
            for variable, result in zip(equation.outvars, self._place(equation), strict=True):
                self._keep(equation, variable, result)
        elif name in _SAME:
            self._values[equation.outvars[0]] = self.value(equation.invars[0])
        elif name == "gather":
            self._write_read(equation)
        else:
            self._write_operation(equation)

    def _write_read(self, equation: Any) -> None:
        table, index = self.value(equation.invars[0]), self.scalar(equation.invars[1])
        if not isinstance(table, Table):
            raise NotExpressible(f"{self.dialect.name}: a read of what is no image.")
        self._keep(equation, equation.outvars[0], Value(self._read(table, index), table.dtype))

    def _write_operation(self, equation: Any) -> None:
        name = equation.primitive.name
        if equation.primitive.multiple_results or equation.outvars[0].aval.ndim:
            raise NotExpressible(f"{self.dialect.name}: the operation {name} has no form.")
        inputs = [self.scalar(atom) for atom in equation.invars]
        value = folded(equation, inputs, self.dialect)
        if value is None:
            dtype = equation.outvars[0].aval.dtype
            try:
                value = self.dialect.operation(name, equation.params, inputs, dtype)
            except NotExpressible as error:
                place = place_of(equation)
                raise NotExpressible(
                    f"{error} It is at {place}." if place else str(error)
                ) from None
        self._keep(equation, equation.outvars[0], value)

    def _keep(self, equation: Any, variable: Any, value: Value) -> None:
        """Name a value, or leave it to be written where it is used."""
        origin = origin_of(equation)
        self._origins[variable] = origin
        simple = value.binds == ATOM and value.code.replace("_", "a").isalnum()
        index = value.place is not None
        if simple or index or value.number is not None or self._inlines(variable, value, origin):
            self._values[variable] = value
            return
        self._values[variable] = self.define(value, self._wanted(origin, variable))

    def _inlines(self, variable: Any, value: Value, origin: Origin) -> bool:
        """Whether a value is part of the expression of its only user."""
        if self._uses[variable] > 1 or len(value.code) > LONGEST_INLINE:
            return False
        reader = self._readers.get(variable)
        if reader is None or origin_of(reader).statement != origin.statement:
            return False
        # An index that several reads share stays one.
        scales = value.dtype == "int32" and not _varies(reader.invars[-1])
        return not scales or all(self._uses[v] <= 1 for v in reader.outvars)

    def _wanted(self, origin: Origin, variable: Any) -> str:
        """The name of a value: the parts of a tuple are taken in turn where they leave it."""
        if len(origin.names) == 1:
            if origin.names[0] == self._program:
                return "result"
            return origin.names[0] if origin.statement else self.unnamed
        if self._stays(variable, origin):
            return "part"
        number = self._given[origin.statement]
        self._given[origin.statement] += 1
        if self._leaving[origin.statement] != len(origin.names):
            # Which is which cannot be told.
            return "_".join(origin.names[:3])
        return origin.names[min(number, len(origin.names) - 1)]

    def _place(self, equation: Any) -> list[Value]:
        if equation.params["blends"]:
            raise NotExpressible(f"{self.dialect.name}: fetch='blend' has no printed form.")
        if equation.params["still"]:
            return [self.dialect.literal(np.int32(0))] * 2
        results = []
        for atom in equation.invars:
            half = self.dialect.literal(np.float32(0.5))
            shifted = self.dialect.operation("add", {}, [self.scalar(atom), half], np.float32)
            floored = self.dialect.operation("floor", {}, [shifted], np.float32)
            results.append(self.dialect.cast(floored, np.int32))
        return results

    def _write_sum(self, equation: Any) -> None:
        """A sum over samples."""
        inner = equation.params["jaxpr"]
        sums = []
        for variable, term in zip(equation.outvars, inner.outvars, strict=True):
            origin = origin_of(equation)
            zero = self.dialect.literal(np.zeros((), term.aval.dtype))
            sums.append(self.define(zero, f"sum_of_{self._term(term, inner, origin)}", True))
            self._values[variable] = sums[-1]
        with_limit = equation.invars[-1] if equation.params["limited"] else None
        self._open_samples(inner, equation, with_limit)
        for total, term in zip(sums, self.write(inner.eqns, inner.outvars), strict=True):
            self.add(f"{total.code} += {term.code};")
        self.add("}")

    def _term(self, term: Any, inner: Any, origin: Origin) -> str:
        """What is summed."""
        for equation in inner.eqns:
            if term in equation.outvars:
                found = origin_of(equation)
                return found.names[0]
        return origin.names[0]

    def _open_samples(self, inner: Any, equation: Any, limit: Any, only: str = "") -> None:
        """The head of a loop over samples, or of the only one of it that is computed."""
        count = len(inner.constvars)
        for variable, atom in zip(inner.constvars, equation.invars[:count], strict=True):
            self._values[variable] = self.value(atom)
        end = self.dialect.literal(np.int32(equation.params["count"]))
        if limit is not None:
            bound = self.dialect.cast(self.scalar(limit), np.int32)
            if equation.params["count"]:
                bound = self.dialect.operation("min", {}, [bound, end], np.int32)
            end = self.define(bound, "last_sample")
        step = Value(self.names.new("i"), "int32")
        self._values[inner.invars[0]] = step
        if only:
            kind = self.dialect.type_of("int32")
            self.add(self.dialect.constant.format(type=kind, name=step.code, value=only))
        self.add(f"if ({step.code} < {end.code}) {{" if only else self._for(step.code, end.code))

    def _for(self, name: str, end: str) -> str:
        kind = self.dialect.type_of("int32")
        start = f"var {name}: {kind} = 0" if self.dialect.name == "wgsl" else f"{kind} {name} = 0"
        return f"for ({start}; {name} < {end}; {name}++) {{"

    def write_marks(
        self, equation: Any, leave: Callable[[Value, Value], str], only: str = ""
    ) -> None:
        """Write a loop that leaves marks, or the step of it whose number is given."""
        inner = equation.params["jaxpr"]
        self._open_samples(inner, equation, equation.invars[-1], only)
        found = self.write(inner.eqns, inner.outvars)
        if only and len(found) > 2:
            raise NotExpressible(f"{self.dialect.name}: several marks in one step.")
        for place, mark in zip(found[::2], found[1::2], strict=True):
            self.add(leave(place, mark))
        self.add("}")

    def _write_loop(self, equation: Any) -> None:
        """A loop that carries values on, as `lax.fori_loop` of known length makes it."""
        params = equation.params
        constants, carried = params["num_consts"], params["num_carry"]
        body, closed_over = opened(params["jaxpr"])
        if constants + carried != len(equation.invars) or params["reverse"]:
            raise NotExpressible(f"{self.dialect.name}: a loop over arrays.")
        for variable, constant in zip(body.constvars, closed_over, strict=True):
            self._values[variable] = self.dialect.literal(np.asarray(constant))
        for variable, atom in zip(body.invars[:constants], equation.invars, strict=False):
            self._values[variable] = self.value(atom)
        state = []
        for variable, atom, result in zip(
            body.invars[constants:], equation.invars[constants:], body.outvars, strict=True
        ):
            name = self._carried_name(variable, result, body)
            state.append(self.define(self.scalar(atom), name, True))
            self._values[variable] = state[-1]
        step = self.names.new("turn")
        self.add(self._for(step, str(params["length"])))
        found = self.write(body.eqns, body.outvars)
        # All are found before one changes.
        changed = [
            (old, new) for old, new in zip(state, found, strict=True) if old.code != new.code
        ]
        several = len(changed) > 1
        new_values = [
            self.define(new, f"next_{old.code}") if several and new.binds != ATOM else new
            for old, new in changed
        ]
        for (old, _), new in zip(changed, new_values, strict=True):
            self.add(f"{old.code} = {new.code};")
        self.add("}")
        self._values |= dict(zip(equation.outvars, state, strict=True))

    def _carried_name(self, variable: Any, result: Any, body: Any) -> str:
        for equation in body.eqns:
            if result in equation.outvars:
                return origin_of(equation).names[0]
        return "state"


_SUMS = (sum_primitive, marks_primitive)


def needed_for(
    equations: Sequence[Any], wanted: Sequence[Any], known: Container[Any] = ()
) -> list[Any]:
    """The equations that make the wanted variables from the known ones, in order."""
    needed = {v for v in wanted if _varies(v) and v not in known}
    chosen = []
    for equation in reversed(equations):
        if needed & set(equation.outvars):
            needed |= {v for v in _read_by(equation) if _varies(v) and v not in known}
            chosen.append(equation)
    return chosen[::-1]


def _read_by(equation: Any) -> list[Any]:
    """What an equation reads; a still place needs its operands for derivatives only."""
    still = equation.primitive is place_primitive and equation.params["still"]
    return [] if still else equation.invars


_WHOLE = {
    "add": np.add,
    "mul": np.multiply,
    "sub": np.subtract,
    "max": np.maximum,
    "min": np.minimum,
}


def folded(equation: Any, inputs: Sequence[Value], dialect: Dialect) -> Value | None:
    """The result of whole numbers that are known, and of operations that change nothing."""
    name = equation.primitive.name
    if equation.outvars[0].aval.dtype != np.int32 or len(inputs) != 2:
        return None
    first, second = (value.number for value in inputs)
    if first is not None and second is not None and name in _WHOLE:
        return dialect.literal(_WHOLE[name](np.int32(first), np.int32(second)))
    if second is not None and int(second) == 0 and name.startswith(("add", "sub", "shift")):
        return inputs[0]
    if first is not None and int(first) == 0 and name.startswith("add"):
        return inputs[1]
    return inputs[0] if second is not None and int(second) == 1 and name == "mul" else None


def _varies(atom: Any) -> bool:
    return not isinstance(atom, core.Literal)
