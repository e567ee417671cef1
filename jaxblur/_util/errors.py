"""The error and the warning of files that are read or written."""

import os

from .text import one_line, printable

PathLike = str | os.PathLike[str]


class JaxblurIOError(Exception):
    """A file could not be read or written; the message is one line: file, problem, remedy.

    Names in the message come from files, so characters that are not printable are escaped.

    Attributes:
        path: the file.
        reason: problem and remedy.
    """

    def __init__(self, path: PathLike, reason: str):
        self.path = os.fspath(path)
        self.reason = one_line(reason)
        super().__init__(f"{printable(self.path)}: {self.reason}")

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self.path, self.reason)


class JaxblurIOWarning(UserWarning):
    """Something in a file is suspicious or was changed, but the work went on."""
