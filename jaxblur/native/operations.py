"""Values in C++, and the elementwise operations on them."""

import dataclasses
import enum
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

_SCALARS = {"float32": "float", "int32": "int32_t", "bool": "bool"}
_VECTORS = {"float32": "Floats", "int32": "Ints", "bool": "Ints"}


class Unsupported(Exception):
    """The sample uses something that has no form in C++ here."""


class Level(enum.IntEnum):
    """What a value depends on: nothing, the sample's number, the pixel, or both."""

    UNIFORM = 0
    SAMPLE = 1
    PIXEL = 2
    TAP = 3


@dataclasses.dataclass(frozen=True)
class Value:
    """An expression in C++.

    Attributes:
        code: the expression, or the name of a variable.
        dtype: name of the array type.
        level: where it is computed.
        table: whether it is an array that samples read at other pixels.
        channels: of an image that a pixel reads at its own place only; 0 for any other value.
        number: what it is, where that is known.
        base: (expression, whole number, factor) if it is an index that is known to be that number
            more than the expression, and that a multiple of the factor.
        compared: the function that gives the first or the second of two expressions as it holds or
            not, and the two, where it is the comparison of two floats.
        floored: the expression that it is the floor of, where that is known.
        reciprocal: the expression of one by it, where that is exact.
        additions: (index, value) pairs, where it is a table that taps add to.
        columns: its channels, where it is an image that is put together from planes.
    """

    code: str
    dtype: str
    level: Level = Level.UNIFORM
    table: bool = False
    channels: int = 0
    number: Any = None
    base: tuple[str, int, int] | None = None
    compared: tuple[str, str, str] | None = None
    floored: str = ""
    reciprocal: str = ""
    additions: "tuple[tuple[Value, Value], ...]" = ()
    columns: "tuple[Value, ...]" = ()

    @property
    def ordered(self) -> bool:
        """Whether it is known not to be NaN."""
        return self.number is not None and not np.isnan(self.number)

    @property
    def wide(self) -> bool:
        """Whether there is one value a lane."""
        return self.level >= Level.PIXEL


def c_type(dtype: Any, wide: bool) -> str:
    """Name of the C++ type of values of an array type, one alone or one a lane.

    Raises:
        Unsupported: there is none.
    """
    kinds = _VECTORS if wide else _SCALARS
    try:
        return kinds[np.dtype(dtype).name]
    except KeyError:
        raise Unsupported(f"values of type {np.dtype(dtype).name}") from None


def literal(number: Any) -> Value:
    """A constant, its float digits kept exactly."""
    array = np.asarray(number)
    dtype = array.dtype.name
    if dtype == "bool":
        return Value("true" if array else "false", dtype, number=array)
    if np.issubdtype(array.dtype, np.integer):
        return Value(f"int32_t({int(array)})", "int32", number=array)
    if dtype != "float32":
        raise Unsupported(f"constants of type {dtype}")
    code = float(array).hex() if np.isfinite(array) else "NAN"
    if np.isinf(array):
        code = "INFINITY" if array > 0 else "-INFINITY"
    return Value(f"float({code})", dtype, number=array)


def _operator(symbol: str) -> Callable[..., str]:
    return lambda _, a, b: f"({a.code} {symbol} {b.code})"


def _quotient(_, a: Value, b: Value) -> str:
    return f"({a.code} * {b.reciprocal})" if b.reciprocal else f"({a.code} / {b.code})"


def _function(name: str) -> Callable[..., str]:
    return lambda _, *values: f"{name}({', '.join(value.code for value in values)})"


def _extreme(name: str, ordered: str) -> Callable[..., str]:
    """Maximum or minimum; the second form keeps a NaN where a literal stands first."""

    def write(_, a: Value, b: Value) -> str:
        if a.dtype != "float32":
            return f"{name}_int({a.code}, {b.code})"
        if a.ordered:
            return f"{ordered}({a.code}, {b.code})"
        if b.ordered:
            return f"{ordered}({b.code}, {a.code})"
        return f"{name}_float({a.code}, {b.code})"

    return write


def _clamp(parameters: Any, low: Value, value: Value, high: Value) -> str:
    raised = dataclasses.replace(value, code=_extreme("max", "larger")(parameters, low, value))
    return _extreme("min", "smaller")(parameters, raised, high)


def widened(value: Value, level: Level) -> Value:
    """The value with one copy a lane, if the result has one a lane."""
    if value.wide or value.table or level < Level.PIXEL:
        return value
    return dataclasses.replace(value, code=f"wide({value.code})")


def _select(_, which: Value, *cases: Value) -> str:
    if which.dtype != "bool" or len(cases) != 2:
        raise Unsupported("select_n of an integer")
    if which.compared and which.compared[1:] == (cases[1].code, cases[0].code):
        return f"{which.compared[0]}({cases[1].code}, {cases[0].code})"
    return f"({which.code} ? {cases[1].code} : {cases[0].code})"


def _power(parameters: Any, value: Value) -> str:
    exponent = parameters["y"]
    if not 1 <= abs(exponent) <= 8:
        raise Unsupported(f"integer_pow with exponent {exponent}")
    product = "(" + " * ".join([value.code] * abs(exponent)) + ")"
    return product if exponent > 0 else f"(1.0f / {product})"


def _convert(parameters: Any, value: Value) -> str:
    dtype = np.dtype(parameters["new_dtype"]).name
    if dtype == "bool":
        return f"({value.code} != 0)"
    kind = c_type(dtype, value.wide)
    if not value.wide:
        return f"{kind}({value.code})"
    integer = f"(-{value.code})" if value.dtype == "bool" else value.code
    if kind == "Ints":
        if value.floored:
            return f"floor_to_ints({value.floored})"
        return f"to_ints({value.code})" if value.dtype == "float32" else integer
    return value.code if value.dtype == "float32" else f"to_floats({integer})"


def _remainder(_, a: Value, b: Value) -> str:
    return f"fmodf({a.code}, {b.code})" if a.dtype == "float32" else f"({a.code} % {b.code})"


def _absolute(_, a: Value) -> str:
    return f"fabsf({a.code})" if a.dtype == "float32" else f"max_int({a.code}, -{a.code})"


def _negation(_, a: Value) -> str:
    return f"(!{a.code})" if a.dtype == "bool" and not a.wide else f"(~{a.code})"


def _round(parameters: Any, a: Value) -> str:
    to_even = parameters["rounding_method"] == jax.lax.RoundingMethod.TO_NEAREST_EVEN
    return f"{'rintf' if to_even else 'roundf'}({a.code})"


def _same(_, value: Value, *_more: Value) -> str:
    return value.code


OPERATIONS: dict[str, Callable[..., str]] = {
    "abs": _absolute,
    "add": _operator("+"),
    "add_any": _operator("+"),
    "and": _operator("&"),
    "broadcast_in_dim": _same,
    "ceil": _function("ceilf"),
    "clamp": _clamp,
    "convert_element_type": _convert,
    "copy": _same,
    "cos": _function("cosf"),
    "div": _quotient,
    "eq": _operator("=="),
    "exp": _function("expf"),
    "expand_dims": _same,
    "floor": _function("floorf"),
    "ge": _operator(">="),
    "gt": _operator(">"),
    "integer_pow": _power,
    "le": _operator("<="),
    "log": _function("logf"),
    "log1p": _function("log1pf"),
    "lt": _operator("<"),
    "max": _extreme("max", "larger"),
    "min": _extreme("min", "smaller"),
    "mul": _operator("*"),
    "ne": _operator("!="),
    "neg": lambda _, a: f"(-{a.code})",
    "not": _negation,
    "or": _operator("|"),
    "pow": _function("powf"),
    "rem": _remainder,
    "reshape": _same,
    "round": _round,
    "rsqrt": lambda _, a: f"(1.0f / sqrtf({a.code}))",
    "select_n": _select,
    "sign": _function("sign_float"),
    "sin": _function("sinf"),
    "sqrt": _function("sqrtf"),
    "square": lambda _, a: f"({a.code} * {a.code})",
    "squeeze": _same,
    "stop_gradient": _same,
    "sub": _operator("-"),
    "tanh": _function("tanhf"),
}
