"""Open image files, and notice those that change while they are used."""

import contextlib
import dataclasses
import os
import pathlib
import textwrap
from collections.abc import Iterable, Iterator
from typing import Any

import OpenImageIO as oiio

from jaxblur._util.errors import JaxblurIOError, PathLike

EXTENSIONS = (".exr", ".png", ".tif", ".tiff", ".jpg", ".jpeg", ".hdr")

IMAGE_SIZE_LIMIT_MB = 4096
LONGEST_MESSAGE = 400
"""Characters of what the reader says that are printed."""


@contextlib.contextmanager
def open_input(path: PathLike) -> Iterator[Any]:
    """Open an image with the reader of its extension and close it afterwards.

    Args:
        path: an image file.

    Yields:
        An ``OpenImageIO.ImageInput``.

    Raises:
        JaxblurIOError: the file is missing, a folder, of another kind, or unreadable; or memory
            ended while it was open.
    """
    check_readable(path)
    # A crafted header may request all memory, and trying the readers of other formats is a needless
    # risk.
    oiio.attribute("limits:imagesize_MB", IMAGE_SIZE_LIMIT_MB)
    oiio.attribute("try_all_readers", 0)
    try:
        source = oiio.ImageInput.open(os.fspath(path))
    except (RuntimeError, UnicodeDecodeError, ValueError) as error:
        raise JaxblurIOError(path, _unopened(path, str(error))) from error
    if source is None:
        raise JaxblurIOError(path, _unopened(path, pending_message()))
    try:
        yield source
    except MemoryError as error:
        raise JaxblurIOError(
            path, f"needs more memory than this process may use ({error}); allow it more."
        ) from error
    finally:
        source.close()
        pending_message(source)


def _unopened(path: PathLike, message: str) -> str:
    kind = pathlib.Path(path).suffix.lower().removeprefix(".").upper()
    return (
        f"cannot be opened: truncated, damaged or no {kind} file at all; copy or render it again "
        f"(the reader says: {message})."
    )


def check_readable(path: PathLike) -> None:
    """Check that a path can be an image before it is passed to a reader.

    Args:
        path: an image file.

    Raises:
        JaxblurIOError: the file is missing, a folder, empty, or has an unsupported extension.
    """
    file = pathlib.Path(path)
    if not file.exists():
        raise JaxblurIOError(path, "no such file.")
    if not file.is_file():
        raise JaxblurIOError(path, "is not a file; give an image, such as an .exr.")
    if file.suffix.lower() not in EXTENSIONS:
        raise JaxblurIOError(path, f"is not one of {', '.join(EXTENSIONS)}; convert it to .exr.")
    if file.stat().st_size == 0:
        raise JaxblurIOError(path, "is empty; write it again.")


def pending_message(source: Any = None) -> str:
    """Fetch and clear OpenImageIO's pending error messages.

    Args:
        source: the reader or writer that failed, if there is one.

    Returns:
        The message on one line, of `LONGEST_MESSAGE` characters at most; a message that is not text
        is replaced by a note that says so.
    """
    messages = []
    for get in ([source.geterror] if source is not None else []) + [oiio.geterror]:
        try:
            messages.append(get())
        except (UnicodeDecodeError, RuntimeError):
            messages.append("the reader's message is not text, the file is probably damaged")
    text = "; ".join(dict.fromkeys(escaped(m).strip() for m in messages if m.strip()))
    # Of a damaged table the reader complains chunk by chunk.
    return textwrap.shorten(text, LONGEST_MESSAGE, placeholder=" ...") or "no reason given"


def escaped(text: str) -> str:
    """The text with bytes that are not UTF-8 escaped, which local encodings leave in names."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


@dataclasses.dataclass(frozen=True)
class FileStates:
    """Sizes and modification times of files, to notice that one changed while it was used.

    Attributes:
        states: path, inode, bytes and nanoseconds of each.
    """

    states: tuple[tuple[str, int, int, int], ...]

    @classmethod
    def of(cls, paths: Iterable[PathLike]) -> "FileStates":
        """Record the present states.

        Args:
            paths: the files.

        Raises:
            JaxblurIOError: a file is missing.
        """
        return cls(tuple(_state(path) for path in paths))

    def check(self) -> None:
        """Check that no file has changed since.

        Raises:
            JaxblurIOError: one has; the message names it.
        """
        for state in self.states:
            if _state(state[0]) != state:
                raise JaxblurIOError(
                    state[0], "changed while it was being used; nothing was written, run again."
                )


def _state(path: PathLike) -> tuple[str, int, int, int]:
    try:
        found = os.stat(path)
    except OSError as error:
        raise JaxblurIOError(path, f"{error.strerror}.") from error
    return os.fspath(path), found.st_ino, found.st_size, found.st_mtime_ns
