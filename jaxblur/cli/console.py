"""Output of the commands, with control characters from files escaped."""

import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from jaxblur._util.text import printable

GAP = "  "


def print_line(text: Any = "") -> None:
    """Print one line of results to stdout."""
    print(printable(text))


def print_table(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Print a table: ruled on a terminal, plain aligned columns elsewhere.

    Args:
        columns: headings; a leading ``>`` aligns the column to the right.
        rows: cells, one for each column.
    """
    cells = [[printable(cell) for cell in row] for row in rows]
    if sys.stdout.isatty():
        _print_ruled(columns, cells)
        return
    headings = [column.removeprefix(">") for column in columns]
    widths = [max(len(cell) for cell in column) for column in zip(headings, *cells, strict=True)]
    for row in (headings, *cells):
        aligned = [
            cell.rjust(width) if column.startswith(">") else cell.ljust(width)
            for cell, width, column in zip(row, widths, columns, strict=True)
        ]
        print(GAP.join(aligned).rstrip())


def track(frames: Sequence[int], description: str) -> Iterator[int]:
    """Show a progress bar on stderr while iterating, if stderr is a terminal.

    Args:
        frames: the items.
        description: text before the bar.

    Yields:
        The frames.
    """
    if not sys.stderr.isatty():
        yield from frames
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import track as rich_track

    console = Console(stderr=True)
    yield from rich_track(frames, escape(printable(description)), console=console)


def _print_ruled(columns: Sequence[str], cells: Sequence[Sequence[str]]) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=SIMPLE_HEAD)
    for column in columns:
        side = "right" if column.startswith(">") else "left"
        table.add_column(column.removeprefix(">"), justify=side, overflow="fold")
    for row in cells:
        # Text and not str: square brackets in a name are not markup.
        table.add_row(*(Text(cell) for cell in row))
    Console().print(table)
