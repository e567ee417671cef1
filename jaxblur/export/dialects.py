"""The languages, as tables."""

from .expressions import Dialect

_COMMON = {
    **{name: name for name in ("ceil", "cos", "exp", "exp2", "floor", "log", "pow", "sin", "sqrt")},
    **{name: name for name in ("tan", "tanh", "abs", "max", "min")},
    **{name: name for name in ("acos", "asin", "atan", "cosh", "sinh")},
    **{"abs_int": "abs", "max_int": "max", "min_int": "min"},
}
_LARGEST = "3.4028234e38"

C = Dialect(
    name="c",
    types={"float32": "float", "int32": "int32_t", "bool": "bool"},
    functions={
        **{name: f"{name}f" for name in ("ceil", "cos", "exp", "expm1", "floor", "log", "log1p")},
        **{name: f"{name}f" for name in ("pow", "sin", "sqrt", "tan", "tanh", "exp2", "atan2")},
        **{name: f"{name}f" for name in ("acos", "asin", "atan", "cosh", "sinh")},
        **{"abs": "fabsf", "max": "larger", "min": "smaller", "sign": "sign_of", "rem": "fmodf"},
        **{"abs_int": "abs", "max_int": "larger_int", "min_int": "smaller_int"},
        **{"sign_int": "sign_of_int", "round_even": "rintf", "round_away": "roundf"},
        "is_finite": "isfinite",
    },
    infinity="INFINITY",
    not_a_number="NAN",
    suffix="f",
    select=lambda which, usual, other: f"{which} ? {usual} : {other}",
    constant="const {type} {name} = {value};",
    variable="{type} {name} = {value};",
    named_casts=False,
)

WGSL = Dialect(
    name="wgsl",
    types={"float32": "f32", "int32": "i32", "bool": "bool"},
    functions={
        **_COMMON,
        **{"sign": "sign", "sign_int": "sign", "round_even": "round", "atan2": "atan2"},
    },
    infinity=f"{_LARGEST}f",
    suffix="f",
    select=lambda which, usual, other: f"select({other}, {usual}, {_bare(which)})",
    constant="let {name} = {value};",
    variable="var {name}: {type} = {value};",
    shift="{0} >> u32({1})",
)

HLSL = Dialect(
    name="hlsl",
    types={"float32": "float", "int32": "int", "bool": "bool"},
    functions={
        **_COMMON,
        **{"sign": "sign_of", "sign_int": "sign_of_int", "round_even": "round", "atan2": "atan2"},
        "rem": "fmod",
    },
    infinity=f"{_LARGEST}f",
    suffix="f",
    select=lambda which, usual, other: f"{which} ? {usual} : {other}",
    constant="const {type} {name} = {value};",
    variable="{type} {name} = {value};",
)

GLSL = Dialect(
    name="glsl",
    types={"float32": "float", "int32": "int", "bool": "bool"},
    functions={
        **_COMMON,
        **{"sign": "sign", "sign_int": "sign", "round_even": "roundEven", "atan2": "atan"},
    },
    infinity=_LARGEST,
    suffix="",
    select=lambda which, usual, other: f"{which} ? {usual} : {other}",
    constant="{type} {name} = {value};",
    variable="{type} {name} = {value};",
    remainder="rem_int({0}, {1})",
)


def _bare(code: str) -> str:
    """An expression without the parentheses around all of it."""
    if not code.startswith("("):
        return code
    depth = 0
    for position, letter in enumerate(code):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return code[1:-1] if position == len(code) - 1 else code
    return code
