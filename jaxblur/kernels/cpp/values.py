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
class Scalar:
    """An expression: one value for all pixels or samples, or one a lane.

    Attributes:
        code: the expression, or the name of a variable.
        dtype: name of its type.
        level: where it is computed.
        facts: known properties, used to print shorter code.
    """

    code: str
    dtype: str
    level: Level = Level.UNIFORM
    facts: "Facts" = dataclasses.field(default_factory=lambda: NOTHING)

    @property
    def wide(self) -> bool:
        """Whether there is one value a lane."""
        return self.level >= Level.PIXEL

    @property
    def number(self) -> Any:
        """Its value where that is a literal, else None."""
        return self.facts.number

    @property
    def ordered(self) -> bool:
        """Whether it is known not to be NaN."""
        return self.number is not None and not np.isnan(self.number)


@dataclasses.dataclass(frozen=True)
class Facts:
    """Known properties of the value of an expression.

    Attributes:
        number: its value.
        base: (expression, whole number, factor) of an index that is that number more than the
            expression, which is a multiple of the factor.
        compared: of a comparison of two floats, the function that gives the first or the second as
            it holds or not, and the two.
        floored: the expression that it is the floor of.
        reciprocal: the expression of one divided by it, where that is exact.
    """

    number: Any = None
    base: tuple[str, int, int] | None = None
    compared: tuple[str, str, str] | None = None
    floored: str = ""
    reciprocal: str = ""


NOTHING = Facts()


@dataclasses.dataclass(frozen=True)
class Table:
    """A flat array in memory that is read at places of its own.

    Attributes:
        code: name of the pointer.
        dtype: name of the type of its elements.
    """

    code: str
    dtype: str


@dataclasses.dataclass(frozen=True)
class Own:
    """A channel of an image at the pixel itself, loaded where it is first used.

    Attributes:
        code: name of the pointer.
        dtype: name of the type.
        channels: of the image.
        channel: which one.
    """

    code: str
    dtype: str
    channels: int = 1
    channel: int = 0


@dataclasses.dataclass(frozen=True)
class Additions:
    """A flat array of zeros that samples add to.

    Attributes:
        dtype: name of the type of its elements.
        pairs: (index, value) of each addition.
    """

    dtype: str
    pairs: "tuple[tuple[Scalar, Scalar], ...]" = ()


Value = Scalar | Own | Table | Additions


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


def literal(number: Any) -> Scalar:
    """A constant, its float digits kept exactly."""
    array = np.asarray(number)
    dtype = array.dtype.name
    if dtype == "bool":
        return _known("true" if array else "false", dtype, array)
    if np.issubdtype(array.dtype, np.integer):
        return _known(f"int32_t({int(array)})", "int32", array)
    if dtype != "float32":
        raise Unsupported(f"constants of type {dtype}")
    code = float(array).hex() if np.isfinite(array) else "NAN"
    if np.isinf(array):
        code = "INFINITY" if array > 0 else "-INFINITY"
    return _known(f"float({code})", dtype, array)


def _known(code: str, dtype: str, number: Any) -> Scalar:
    return Scalar(code, dtype, facts=Facts(number=number))


def _operator(symbol: str) -> Callable[..., str]:
    return lambda _, a, b: f"({a.code} {symbol} {b.code})"


def _order(symbol: str) -> Callable[..., str]:
    def write(_, a: Scalar, b: Scalar) -> str:
        # True is -1 in a lane, which reverses the order.
        first, second = (b, a) if a.dtype == "bool" and a.wide else (a, b)
        return f"({first.code} {symbol} {second.code})"

    return write


def _quotient(_, a: Scalar, b: Scalar) -> str:
    return f"({a.code} * {b.facts.reciprocal})" if b.facts.reciprocal else f"({a.code} / {b.code})"


def _function(name: str) -> Callable[..., str]:
    return lambda _, *values: f"{name}({', '.join(value.code for value in values)})"


def _extreme(name: str, ordered: str) -> Callable[..., str]:
    """Maximum or minimum; the second form keeps a NaN where a literal stands first."""

    def write(_, a: Scalar, b: Scalar) -> str:
        if a.dtype == "bool":
            # As integers they would be compared wrongly: true is -1 in a lane.
            return f"({a.code} {'|' if name == 'max' else '&'} {b.code})"
        if a.dtype != "float32":
            return f"{name}_int({a.code}, {b.code})"
        if a.ordered:
            return f"{ordered}({a.code}, {b.code})"
        if b.ordered:
            return f"{ordered}({b.code}, {a.code})"
        return f"{name}_float({a.code}, {b.code})"

    return write


def _clamp(parameters: Any, low: Scalar, value: Scalar, high: Scalar) -> str:
    raised = dataclasses.replace(value, code=_extreme("max", "larger")(parameters, low, value))
    return _extreme("min", "smaller")(parameters, raised, high)


def widened(value: Scalar, level: Level) -> Scalar:
    """The value with one copy a lane, if the result has one a lane."""
    if value.wide or level < Level.PIXEL:
        return value
    return dataclasses.replace(value, code=f"wide({value.code})")


def _sign(parameters: Any, value: Scalar) -> str:
    if value.dtype == "float32":
        return f"sign_float({value.code})"
    low, high = (widened(literal(np.int32(end)), value.level) for end in (-1, 1))
    return _clamp(parameters, low, value, high)


def _select(_, which: Scalar, *cases: Scalar) -> str:
    if which.dtype != "bool" or len(cases) != 2:
        raise Unsupported("select_n of an integer")
    if which.facts.compared and which.facts.compared[1:] == (cases[1].code, cases[0].code):
        return f"{which.facts.compared[0]}({cases[1].code}, {cases[0].code})"
    return f"({which.code} ? {cases[1].code} : {cases[0].code})"


def _power(parameters: Any, value: Scalar) -> str:
    exponent = parameters["y"]
    if not 1 <= abs(exponent) <= 8:
        raise Unsupported(f"integer_pow with exponent {exponent}")
    product = "(" + " * ".join([value.code] * abs(exponent)) + ")"
    return product if exponent > 0 else f"(1.0f / {product})"


def _convert(parameters: Any, value: Scalar) -> str:
    dtype = np.dtype(parameters["new_dtype"]).name
    if dtype == "bool":
        return f"({value.code} != 0)"
    kind = c_type(dtype, value.wide)
    if not value.wide:
        return f"{kind}({value.code})"
    integer = f"(-{value.code})" if value.dtype == "bool" else value.code
    if kind == "Ints":
        if value.facts.floored:
            return f"floor_to_ints({value.facts.floored})"
        return f"to_ints({value.code})" if value.dtype == "float32" else integer
    return value.code if value.dtype == "float32" else f"to_floats({integer})"


def _remainder(_, a: Scalar, b: Scalar) -> str:
    return f"fmodf({a.code}, {b.code})" if a.dtype == "float32" else f"({a.code} % {b.code})"


def _absolute(_, a: Scalar) -> str:
    return f"fabsf({a.code})" if a.dtype == "float32" else f"max_int({a.code}, -{a.code})"


def _negation(_, a: Scalar) -> str:
    return f"(!{a.code})" if a.dtype == "bool" and not a.wide else f"(~{a.code})"


def _round(parameters: Any, a: Scalar) -> str:
    to_even = parameters["rounding_method"] == jax.lax.RoundingMethod.TO_NEAREST_EVEN
    return f"{'rintf' if to_even else 'roundf'}({a.code})"


_FUNCTIONS = (
    *("acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil", "cos", "cosh"),
    *("erf", "exp", "exp2", "expm1", "floor", "log", "log1p", "pow", "sin", "sinh", "sqrt", "tan"),
    "tanh",
)

OPERATIONS: dict[str, Callable[..., str]] = {
    **{name: _function(f"{name}f") for name in _FUNCTIONS},
    "abs": _absolute,
    "add": _operator("+"),
    "add_any": _operator("+"),
    "and": _operator("&"),
    "clamp": _clamp,
    "convert_element_type": _convert,
    "div": _quotient,
    "eq": _operator("=="),
    "ge": _order(">="),
    "gt": _order(">"),
    "integer_pow": _power,
    "le": _order("<="),
    "is_finite": lambda _, a: f"(fabsf({a.code}) < INFINITY)",
    "logistic": lambda _, a: f"(1.0f / (1.0f + expf(-{a.code})))",
    "lt": _order("<"),
    "max": _extreme("max", "larger"),
    "min": _extreme("min", "smaller"),
    "mul": _operator("*"),
    "ne": _operator("!="),
    "neg": lambda _, a: f"(-{a.code})",
    "not": _negation,
    "or": _operator("|"),
    "rem": _remainder,
    "round": _round,
    "rsqrt": lambda _, a: f"(1.0f / sqrtf({a.code}))",
    "select_n": _select,
    "shift_left": _operator("<<"),
    "shift_right_arithmetic": _operator(">>"),
    "sign": _sign,
    "square": lambda _, a: f"({a.code} * {a.code})",
    "sub": _operator("-"),
    "xor": _operator("^"),
}
