"""Escape text from files, so that it cannot control a terminal."""

from typing import Any


def printable(text: Any) -> str:
    r"""Escape control characters, so that names from files cannot move the cursor or change colors.

    Args:
        text: any value; ``str`` converts it.

    Returns:
        The text on one line; characters that are not printable are replaced by their Python
        escapes.

    Example:
        >>> printable("a" + chr(27) + "[31m")
        'a\\x1b[31m'
    """
    return "".join(c if c.isprintable() else _escaped(c) for c in str(text))


def one_line(text: str) -> str:
    """Join lines, then escape with `printable`."""
    return printable(" ".join(text.split()))


def _escaped(character: str) -> str:
    return " " if character == "\n" else character.encode("unicode_escape").decode("ascii")
