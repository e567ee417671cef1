"""Keys by which kernels are found again in a later run, before they are printed.

To print a kernel takes as long as to trace a filter, and its derivative several times as long. All
kernels of a program follow from its jaxpr and from what the engine does to its stages. So a stage
has a key: the text of the jaxpr, and the names of the steps that led from it to the stage.
"""

import enum
import functools
import hashlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.extend import core


class Keyed:
    """A function with a key: equal keys mean equal functions, in other processes too."""

    def __init__(self, function: Callable[..., Any], key: str | None) -> None:
        """Make it.

        Args:
            function: it.
            key: None where it is not known.
        """
        self._function, self.key = function, key

    def __call__(self, *operands: Any) -> Any:
        """Call the function."""
        return self._function(*operands)


def key_of(part: Any) -> str | None:
    """The key of a function, of a tuple of parts, or of a value that its text describes.

    Args:
        part: a function, None, a number, a string, or a tuple of parts.

    Returns:
        The key; None if that of a function is not known.
    """
    if isinstance(part, tuple):
        keys = [key_of(one) for one in part]
        return None if None in keys else _hashed("(" + ", ".join(map(str, keys)) + ")")
    if callable(part):
        return getattr(part, "key", None)
    return repr(part)


def _hashed(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def key_of_jaxpr(jaxpr: Any, constants: Sequence[Any] = ()) -> str | None:
    """The key of a jaxpr.

    Args:
        jaxpr: it, without its constants.
        constants: their values.

    Returns:
        The key; None if an equation has a parameter that no text describes, such as a function.
    """
    try:
        return _hashed("\n".join([*_lines(jaxpr), *map(_of_array, constants)]))
    except _UnknownError:
        return None


class _UnknownError(Exception):
    """Something has no text."""


def _lines(jaxpr: Any) -> list[str]:
    """The text of a jaxpr; variables are numbered in the order in which they appear."""
    numbers: dict[Any, int] = {}

    def name(atom: Any) -> str:
        if isinstance(atom, core.Literal):
            return _of_array(atom.val) + _of_type(atom.aval)
        return f"{numbers.setdefault(atom, len(numbers))}:{_of_type(atom.aval)}"

    lines = [" ".join(map(name, [*jaxpr.constvars, *jaxpr.invars]))]
    for equation in jaxpr.eqns:
        ends = [" ".join(map(name, atoms)) for atoms in (equation.outvars, equation.invars)]
        parameters = [f"{key}={_text(value)}" for key, value in sorted(equation.params.items())]
        lines.append(" ".join([ends[0], "=", str(equation.primitive), *parameters, ends[1]]))
    return [*lines, " ".join(map(name, jaxpr.outvars))]


def _text(value: Any) -> str:
    """The text of a parameter of an equation."""
    if isinstance(value, core.ClosedJaxpr):
        return "\n".join(["{", *_lines(value.jaxpr), *map(_of_array, value.consts), "}"])
    if isinstance(value, core.Jaxpr):
        return "\n".join(["{", *_lines(value), "}"])
    if isinstance(value, tuple | list):
        return "(" + ", ".join(map(_text, value)) + ")"
    if value is None or isinstance(value, bool | int | float | str | enum.Enum | np.dtype):
        return repr(value)
    raise _UnknownError(f"{value!r}")


_of_type = functools.lru_cache(maxsize=512)(str)


def _of_array(value: Any) -> str:
    """The text of a number or an array, all digits of it."""
    array = np.asarray(value)
    return f"{array.dtype}{array.shape}{array.tobytes().hex()}"
