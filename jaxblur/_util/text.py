"""Text of messages: names from files are escaped, and the nearest known name is suggested."""

import difflib
from collections.abc import Iterable
from typing import Any


def printable(text: Any) -> str:
    r"""Escape control characters, so that names from files cannot move the cursor or change colors.

    Args:
        text: any value; ``str`` converts it.

    Returns:
        The text on one line; characters that are not printable are replaced by their Python
        escapes.

    Examples:
        >>> printable("a" + chr(27) + "[31m")
        'a\\x1b[31m'
    """
    return "".join(c if c.isprintable() else _escaped(c) for c in str(text))


def one_line(text: str) -> str:
    """Join lines, then escape with `printable`."""
    return printable(" ".join(text.split()))


def nearest(name: str, known: Iterable[str]) -> str:
    """Suggest up to three known names near a mistyped one, in any case, or nothing.

    Examples:
        >>> nearest("herro", ["hero", "Hero2", "ground"])
        ' (did you mean hero or Hero2?)'
    """
    lowered: dict[str, str] = {}
    for each in known:
        lowered.setdefault(each.lower(), each)
    near = difflib.get_close_matches(name.lower(), lowered, n=3)
    return f" (did you mean {' or '.join(lowered[each] for each in near)}?)" if near else ""


def _escaped(character: str) -> str:
    return " " if character == "\n" else character.encode("unicode_escape").decode("ascii")
