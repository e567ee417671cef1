"""Read files that are small by their kind: settings, tables, manifests, states."""

import os
import stat

from .errors import JaxblurIOError, PathLike

MOST_BYTES = 20_000_000
"""Largest such file; the objects of a JSON file take about twenty times its size."""
_NO_WAITING = getattr(os, "O_NONBLOCK", 0)


def read_bytes(path: PathLike, remedy: str, most: int = MOST_BYTES) -> bytes:
    """Read a whole file; a pipe or a device, which may never end, is rejected.

    Args:
        path: the file.
        remedy: advice for messages, with its full stop.
        most: largest size, bytes.

    Returns:
        Its contents.

    Raises:
        JaxblurIOError: it is missing, no regular file, too large, or the system refuses it.
    """
    try:
        with open(path, "rb", opener=_opened) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise JaxblurIOError(path, f"is not a file; {remedy}")
            contents = file.read(most + 1)
    except FileNotFoundError as error:
        raise JaxblurIOError(path, f"no such file; {remedy}") from error
    except IsADirectoryError as error:
        raise JaxblurIOError(path, f"is a folder; {remedy}") from error
    except OSError as error:
        raise JaxblurIOError(path, f"cannot be read ({error.strerror}); {remedy}") from error
    if len(contents) > most:
        raise JaxblurIOError(path, f"is larger than {most / 1e6:.0f} MB; {remedy}")
    return contents


def read_text(path: PathLike, remedy: str, most: int = MOST_BYTES) -> str:
    """Read a whole file of text in UTF-8, with or without a byte order mark.

    Args:
        path: the file.
        remedy: as for `read_bytes`.
        most: as for `read_bytes`.

    Returns:
        Its contents.

    Raises:
        JaxblurIOError: as by `read_bytes`, or it is no such text.
    """
    try:
        return read_bytes(path, remedy, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise JaxblurIOError(path, f"is no text in UTF-8; {remedy}") from error


def _opened(path: str, flags: int) -> int:
    """Open without waiting: a pipe waits for somebody who writes."""
    return os.open(path, flags | _NO_WAITING)
