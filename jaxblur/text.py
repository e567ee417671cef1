"""Text that came from a file: nothing in it can steer a terminal."""

from typing import Any


def printable(text: Any) -> str:
    r"""Escape control characters, so that names from files cannot move the cursor or recolor.

    Args:
        text: anything that has a text.

    Returns:
        The text on one line; what is not printable stands as its Python escape.

    Example:
        >>> printable("a" + chr(27) + "[31m")
        'a\\x1b[31m'
    """
    return "".join(c if c.isprintable() else _escaped(c) for c in str(text))


def one_line(text: str) -> str:
    """Join lines, then escape as `printable` does."""
    return printable(" ".join(text.split()))


def _escaped(character: str) -> str:
    return " " if character == "\n" else character.encode("unicode_escape").decode("ascii")
