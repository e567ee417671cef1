"""The order in which the statements of a block are printed.

A processor works on the next few hundred instructions at once. Where a program reads a place that
an earlier read leads to, and another one after it, as in a chain of tables, the processor waits for
each read in turn. Several such chains in one block can wait at the same time, but only if they lie
side by side in the text. So statements come in the order of how many reads lie one after the other
before them. Compilers do not do that: they see neither how long a read takes nor how far the
processor looks ahead.
"""

import re
from collections.abc import Iterable, Sequence

FEWEST = 2
"""Reads that lie one after the other, from which on a block is put in order. With fewer, the reads
that come early only take registers."""

_NAME = re.compile(r"\bv\d+\b")
_CONSTANT = re.compile(r"const \w+ (v\d+) = ")
_SUM = re.compile(r"sums\[\d+\] \+= ")


def names_of(statement: str) -> list[str] | None:
    """The variables that a statement defines; None where it must keep its place."""
    if _SUM.match(statement):
        return []
    constant = _CONSTANT.match(statement)
    return [constant[1]] if constant else None


def by_reads(statements: Iterable[tuple[str, Sequence[str] | None, bool]]) -> list[str]:
    """Statements in the order of how many reads lie one after the other before them.

    Args:
        statements: the text of each; the names that it defines, or None where it must keep its
            place; whether it reads a table. A name is defined before it is used.

    Returns:
        The texts.
    """
    ordered: list[str] = []
    block: list[tuple[int, str]] = []
    behind: dict[str, int] = {}

    def end_block() -> None:
        if max((depth for depth, _ in block), default=0) >= FEWEST:
            block.sort(key=lambda pair: pair[0])
        ordered.extend(text for _, text in block)
        block.clear()

    for text, names, reads in statements:
        if names is None:
            end_block()
            ordered.append(text)
            continue
        depth = max((behind.get(name, 0) for name in _NAME.findall(text)), default=0)
        behind.update(dict.fromkeys(names, depth + reads))
        block.append((depth, text))
    end_block()
    return ordered
