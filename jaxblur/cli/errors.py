"""The errors that a user can correct, their messages, and the exit status of some."""

import traceback

from jaxblur._util.errors import JaxblurIOError

from .arguments import CommandError

FAILED = 1
"""Exit status where some files or frames are not done."""


HINTS = {
    "TracerBoolConversionError": "values are not known while a filter is compiled: take jnp.where "
    "in place of `if`, `and`, `or`, `not`",
    "TracerArrayConversionError": "values are not known while a filter is compiled: take jax.numpy "
    "in place of numpy",
    "ConcretizationTypeError": "values are not known while a filter is compiled: take jax.numpy in "
    "place of math, int() and float()",
    "TracerIntegerConversionError": "values are not known while a filter is compiled: take "
    "jax.lax.fori_loop in place of range(), jnp.where in place of an index of a list",
}
"""What to do about errors of JAX in a filter of one's own, by the name of their class."""


def place_in_filter(error: BaseException) -> str:
    """The line of a filter of one's own where an error arose: ``FILE:LINE``.

    Args:
        error: that was caught.

    Returns:
        The innermost line of a file that registered a filter; empty if none is concerned.
    """
    if isinstance(error, CommandError | JaxblurIOError):
        return ""
    from jaxblur.filters.registry import filter_info, names

    functions = [filter_info(name).function for name in names()]
    modules = {
        function.partition(":")[0]
        if isinstance(function, str)
        else getattr(function, "__module__", "")
        for function in functions
    }
    others = {module for module in modules if module.partition(".")[0] != "jaxblur"}
    places = [
        f"{frame.f_code.co_filename}:{line}"
        for frame, line in traceback.walk_tb(error.__traceback__)
        if frame.f_globals.get("__name__") in others
    ]
    return places[-1] if places else ""


def is_foreseeable(error: BaseException) -> bool:
    """Whether an error is one that a user can correct, rather than a bug of this program.

    A closed pipe is neither: the command ends quietly.
    """
    if isinstance(error, BrokenPipeError):
        return False
    if isinstance(error, CommandError | JaxblurIOError | ValueError | OSError | MemoryError):
        return True
    if isinstance(error, RuntimeError) and "RESOURCE_EXHAUSTED" in str(error):
        return True
    return place_in_filter(error) != ""


def message_of(error: BaseException) -> str:
    """The message of an error, one or several lines."""
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
        return f"out of memory; use a smaller frame or fewer samples ({error})"
    if "std::bad_alloc" in str(error):
        return f"{error} (out of memory; with --isolate, a larger --memory allows more)"
    if place := place_in_filter(error):
        kind, first = type(error).__name__, str(error).strip().partition("\n")[0].rstrip(".:")
        hint = f"; {HINTS[kind]}" if kind in HINTS else ""
        return f"{place}: {kind}: {first}{hint}; -v shows the traceback."
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    return str(error)
