"""The errors that a user can correct, their messages, and the exit status of some."""

from jaxblur._util.errors import JaxblurIOError

from .arguments import CommandError

FAILED = 1
"""Exit status where some files or frames are not done."""


def is_foreseeable(error: BaseException) -> bool:
    """Whether an error is one that a user can correct, rather than a bug of this program.

    A closed pipe is neither: the command ends quietly.
    """
    if isinstance(error, BrokenPipeError):
        return False
    if isinstance(error, CommandError | JaxblurIOError | ValueError | OSError | MemoryError):
        return True
    return isinstance(error, RuntimeError) and "RESOURCE_EXHAUSTED" in str(error)


def message_of(error: BaseException) -> str:
    """The message of an error, one or several lines."""
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
        return f"out of memory; use a smaller frame or fewer samples ({error})"
    if "std::bad_alloc" in str(error):
        return f"{error} (out of memory; with --isolate, a larger --memory allows more)"
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    return str(error)
