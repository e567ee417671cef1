"""Expressions: values, operators by how tightly they bind, and what the languages differ in."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

ATOM, PRODUCT, SUM, LOOSE = 3, 2, 1, 0
"""How tightly an expression binds."""


class NotExpressible(ValueError):
    """A program has no form in a language."""


@dataclasses.dataclass(frozen=True)
class Value:
    """An expression.

    Attributes:
        code: text.
        dtype: name of its type.
        binds: how tightly, `ATOM` to `LOOSE`.
        number: its value where that is a literal.
        place: (expression, factor, distance) of an index ``factor * expression + distance``.
    """

    code: str
    dtype: str
    binds: int = ATOM
    number: Any = None
    place: "tuple[Value, int, int] | None" = None

    def within(self, level: int) -> str:
        """The text, in parentheses where it binds less tightly than that."""
        return self.code if self.binds >= level else f"({self.code})"


@dataclasses.dataclass(frozen=True)
class Dialect:
    """What the languages differ in.

    Attributes:
        name: of the language.
        types: names of types, by those of NumPy.
        functions: names of functions, by those of JAX; operations that are not here and are no
            operators are refused.
        infinity: text of the largest number.
        suffix: of a float literal.
        select: text of a choice: condition, value if it holds, value else.
        constant: a statement: type, name, value.
        variable: a statement that declares what changes.
        remainder: text of the remainder of whole numbers.
        shift: text of an arithmetic shift.
        named_casts: whether casts look like calls.
    """

    name: str
    types: dict[str, str]
    functions: dict[str, str]
    infinity: str
    suffix: str
    select: Callable[[str, str, str], str]
    constant: str
    variable: str
    remainder: str = "{0} % {1}"
    shift: str = "{0} >> {1}"
    named_casts: bool = True
    not_a_number: str = ""

    def type_of(self, dtype: Any) -> str:
        """The name of a type.

        Raises:
            NotExpressible: there is none.
        """
        name = np.dtype(dtype).name
        if name not in self.types:
            raise NotExpressible(f"{self.name}: values of type {name}.")
        return self.types[name]

    def literal(self, number: Any) -> Value:
        """A constant, exact to the bit."""
        array = np.asarray(number)
        dtype = array.dtype.name
        if dtype == "bool":
            return Value("true" if array else "false", dtype, ATOM, array)
        if np.issubdtype(array.dtype, np.integer):
            code = str(int(array))
            return Value(code, "int32", ATOM if int(array) >= 0 else LOOSE, array)
        if dtype != "float32":
            raise NotExpressible(f"{self.name}: constants of type {dtype}.")
        if np.isnan(array):
            if not self.not_a_number:
                raise NotExpressible(f"{self.name}: a constant that is not a number.")
            return Value(self.not_a_number, dtype, ATOM, array)
        negative = bool(np.signbit(array))
        code = self.infinity if np.isinf(array) else f"{np.abs(array)!s}{self.suffix}"
        return Value(f"-{code}" if negative else code, dtype, LOOSE if negative else ATOM, array)

    def cast(self, value: Value, dtype: Any) -> Value:
        """A conversion."""
        name = np.dtype(dtype).name
        if name == value.dtype:
            return value
        if value.number is not None:
            return self.literal(value.number.astype(name))
        if name == "bool":
            zero = self.literal(np.zeros((), value.dtype)).code
            return Value(f"{value.within(SUM)} != {zero}", "bool", LOOSE)
        if value.dtype == "bool":
            one, zero = (self.literal(np.asarray(k, name)).code for k in (1, 0))
            code = self.select(value.within(ATOM), one, zero)
            return Value(code, name, ATOM if code.endswith(")") and code[0] != "(" else LOOSE)
        kind = self.type_of(name)
        if self.named_casts:
            return Value(f"{kind}({value.code})", name)
        return Value(f"({kind}){value.within(ATOM)}", name)

    def operation(self, name: str, params: Any, inputs: Sequence[Value], dtype: Any) -> Value:
        """An elementwise operation.

        Raises:
            NotExpressible: it has no form in the language.
        """
        dtype = np.dtype(dtype).name
        if name == "convert_element_type":
            return self.cast(inputs[0], dtype)
        if name in _BINARY:
            return _binary(name, inputs, dtype)
        if name in _COMPARISONS:
            a, b = (value.within(SUM) for value in inputs)
            return Value(f"{a} {_COMPARISONS[name]} {b}", "bool", LOOSE)
        if name in _WRITTEN:
            return _WRITTEN[name](self, params, inputs, dtype)
        if dtype == "int32" and name in ("max", "min", "abs", "sign"):
            name = f"{name}_int"
        return self.call(name, inputs, dtype)

    def call(self, name: str, inputs: Sequence[Value], dtype: str) -> Value:
        """A call of the function that the language has for an operation.

        Raises:
            NotExpressible: it has none.
        """
        if name not in self.functions:
            raise NotExpressible(
                f"{self.name}: the operation {name} has no form; write it with others, such as "
                "comparisons and jnp.where."
            )
        return Value(f"{self.functions[name]}({', '.join(v.code for v in inputs)})", dtype)


_BINARY = {"add": "+", "add_any": "+", "sub": "-", "mul": "*", "div": "/"}
_COMPARISONS = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
_LOGIC = {"and": ("&", "&&"), "or": ("|", "||"), "xor": ("^", "!=")}


def _logic(name: str) -> Callable[..., Value]:
    def write(_: Dialect, __: Any, inputs: Sequence[Value], dtype: str) -> Value:
        a, b = (value.within(ATOM) for value in inputs)
        return Value(f"{a} {_LOGIC[name][dtype == 'bool']} {b}", dtype, LOOSE)

    return write


def _not(_: Dialect, __: Any, inputs: Sequence[Value], dtype: str) -> Value:
    return Value(f"{'!' if dtype == 'bool' else '~'}{inputs[0].within(ATOM)}", dtype)


def _negative(_: Dialect, __: Any, inputs: Sequence[Value], dtype: str) -> Value:
    return Value(f"-{inputs[0].within(ATOM)}", dtype, LOOSE)


def _choice(dialect: Dialect, _: Any, inputs: Sequence[Value], dtype: str) -> Value:
    if inputs[0].dtype != "bool" or len(inputs) != 3:
        raise NotExpressible(f"{dialect.name}: a choice of more than two values.")
    which, other, usual = (value.within(ATOM) for value in inputs)
    code = dialect.select(which, usual, other)
    return Value(code, dtype, ATOM if code.startswith("select(") else LOOSE)


def _square(_: Dialect, __: Any, inputs: Sequence[Value], dtype: str) -> Value:
    a = inputs[0].within(ATOM)
    return Value(f"{a} * {a}", dtype, PRODUCT)


def _clamp(dialect: Dialect, _: Any, inputs: Sequence[Value], dtype: str) -> Value:
    low, value, high = inputs
    ends = ("max_int", "min_int") if dtype == "int32" else ("max", "min")
    return dialect.call(ends[1], [dialect.call(ends[0], [value, low], dtype), high], dtype)


def _remainder(dialect: Dialect, _: Any, inputs: Sequence[Value], dtype: str) -> Value:
    if dtype != "int32":
        return dialect.call("rem", inputs, dtype)
    a, b = (value.within(ATOM) for value in inputs)
    binds = PRODUCT if dialect.remainder.startswith("{0}") else ATOM
    return Value(dialect.remainder.format(a, b), dtype, binds)


def _shift(dialect: Dialect, _: Any, inputs: Sequence[Value], dtype: str) -> Value:
    a, b = (value.within(ATOM) for value in inputs)
    return Value(dialect.shift.format(a, b), dtype, LOOSE)


def _inverse_root(dialect: Dialect, _: Any, inputs: Sequence[Value], dtype: str) -> Value:
    return Value(
        f"1.0{dialect.suffix} / {dialect.call('sqrt', inputs, dtype).code}", dtype, PRODUCT
    )


def _logistic(dialect: Dialect, _: Any, inputs: Sequence[Value], dtype: str) -> Value:
    power = dialect.call("exp", [_negative(dialect, _, inputs, dtype)], dtype).code
    one = f"1.0{dialect.suffix}"
    return Value(f"{one} / ({one} + {power})", dtype, PRODUCT)


def _round(dialect: Dialect, params: Any, inputs: Sequence[Value], dtype: str) -> Value:
    even = params["rounding_method"] == jax.lax.RoundingMethod.TO_NEAREST_EVEN
    return dialect.call("round_even" if even else "round_away", inputs, dtype)


def _power(dialect: Dialect, params: Any, inputs: Sequence[Value], dtype: str) -> Value:
    exponent = params["y"]
    if not 1 <= abs(exponent) <= 8:
        raise NotExpressible(f"{dialect.name}: a power of {exponent}.")
    product = " * ".join([inputs[0].within(ATOM)] * abs(exponent))
    if exponent > 0:
        return Value(product, dtype, PRODUCT)
    return Value(f"1.0{dialect.suffix} / ({product})", dtype, PRODUCT)


_WRITTEN: dict[str, Callable[..., Value]] = {
    "and": _logic("and"),
    "or": _logic("or"),
    "xor": _logic("xor"),
    "not": _not,
    "neg": _negative,
    "select_n": _choice,
    "square": _square,
    "clamp": _clamp,
    "rem": _remainder,
    "shift_right_arithmetic": _shift,
    "rsqrt": _inverse_root,
    "logistic": _logistic,
    "round": _round,
    "integer_pow": _power,
}


def _binary(name: str, inputs: Sequence[Value], dtype: str) -> Value:
    """Sum, difference, product, quotient; the order of evaluation stays."""
    first, second = inputs
    whole = dtype == "int32"
    if whole and second.number is not None:
        number = int(second.number)
        base, factor, distance = first.place or (first, 1, 0)
        if name in ("add", "add_any") and first.place and base is not first:
            return _place(base, factor, distance + number)
        if name == "mul" and distance == 0 and number > 0:
            return _place(base, factor * number, 0)
        if name in ("add", "add_any", "sub") and number == 0:
            return first
        if name == "add" and number < 0:
            return Value(f"{first.within(SUM)} - {-number}", dtype, SUM)
    level = SUM if name in ("add", "add_any", "sub") else PRODUCT
    # To the right a sum within a sum keeps its parentheses, for its rounding.
    return Value(f"{first.within(level)} {_BINARY[name]} {second.within(level + 1)}", dtype, level)


def _place(base: Value, factor: int, distance: int) -> Value:
    code = base.code if factor == 1 else f"{factor} * {base.within(ATOM)}"
    binds = base.binds if factor == 1 else PRODUCT
    if distance:
        code, binds = f"{code} {'+' if distance > 0 else '-'} {abs(distance)}", SUM
    return Value(code, "int32", binds, place=(base, factor, distance))
