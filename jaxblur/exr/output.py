"""Write through OpenImageIO, with checks that opening, writing and closing succeeded."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import OpenImageIO as oiio

from .._util.errors import JaxblurIOError, PathLike
from .files import open_input, pending_message

PNG_END = b"IEND\xaeB`\x82"


@contextlib.contextmanager
def writer(
    path: PathLike,
    temporary: str,
    specs: Sequence[Any],
    finish: Callable[[], None] | None = None,
) -> Iterator[Any]:
    """Open a writer for one or several parts; check opening and closing.

    Args:
        path: the final name, for messages.
        temporary: the file to write.
        specs: headers of the parts.
        finish: called when the file is closed, to add what is missing.

    Yields:
        An ``OpenImageIO.ImageOutput``, open for the first part.

    Raises:
        JaxblurIOError: opening or closing failed.
    """
    output = oiio.ImageOutput.create(temporary)
    if output is None:
        raise JaxblurIOError(path, f"cannot be written: {pending_message()}")
    for spec in specs:
        # Without it the time of writing is stored, and the bytes differ between runs.
        if spec.getattribute("DateTime") is None:
            spec.attribute("DateTime", "")
    first = specs[0] if len(specs) == 1 else tuple(specs)
    check(path, output, output.open(temporary, first))
    try:
        yield output
    except BaseException:
        output.close()
        pending_message(output)
        raise
    check(path, output, output.close())
    if finish is not None:
        finish()
    _check_end(path, temporary)


def _check_end(path: PathLike, temporary: str) -> None:
    """Check the end of the file: on a full disk, closing may lose it without an error."""
    if temporary.lower().endswith(".png"):
        with open(temporary, "rb") as file:
            whole = file.read().endswith(PNG_END)
    else:
        try:
            whole = _last_row_is_there(temporary)
        except JaxblurIOError as error:
            raise JaxblurIOError(path, f"cannot be written: {error.reason}") from error
    if not whole:
        raise JaxblurIOError(path, "cannot be written: its end is missing; is the disk full?")


def _last_row_is_there(temporary: str) -> bool:
    with open_input(temporary) as source:
        last = 0
        while source.seek_subimage(last + 1, 0):
            last += 1
        source.seek_subimage(last, 0)
        spec = source.spec()
        if spec.tile_width:
            found = source.read_image(last, 0, 0, spec.nchannels, "native")
        else:
            end = spec.y + spec.height
            found = source.read_scanlines(last, 0, end - 1, end, spec.z, 0, 1, "native")
    return found is not None


def check(path: PathLike, output: Any, succeeded: bool) -> None:
    """Raise an error if a writer reports a failure.

    Args:
        path: the final name, for messages.
        output: the writer.
        succeeded: return value of the writer's method.

    Raises:
        JaxblurIOError: the method failed.
    """
    if not succeeded:
        raise JaxblurIOError(path, f"cannot be written: {pending_message(output)}.")
