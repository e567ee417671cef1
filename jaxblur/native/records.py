"""Reads of neighboring elements of a table, as one.

A lane that reads several elements in a row, such as the channels of a texel, loads them all at
once; a transposition then gives one vector an element. That takes a fraction of the time of a
gather instruction for each element.
"""

import dataclasses

WIDEST = 4
"""Elements that one load fetches."""


@dataclasses.dataclass(frozen=True)
class Read:
    """Everything that is read at one base index; a statement in C++ that may still grow.

    Attributes:
        table: expression of the table.
        size: elements of the table.
        base: expression of the index, an integer a lane.
        names: variable of each element, by its offset from the base.
    """

    table: str
    size: int
    base: str
    names: dict[int, str]

    def __str__(self) -> str:
        """The statements, once all reads are known."""
        return "\n".join(self._statement(run) for run in _runs(sorted(self.names)))

    def _statement(self, offsets: list[int]) -> str:
        names = [self.names[offset] for offset in offsets]
        index = f"{self.base} + {offsets[0]}" if offsets[0] else self.base
        if len(names) == 1:
            return f"const Floats {names[0]} = read({self.table}, {index});"
        arguments = ", ".join([self.table, str(self.size), index, *names])
        return f"Floats {', '.join(names)};\nread_{len(names)}({arguments});"


def _runs(offsets: list[int]) -> list[list[int]]:
    """Runs of neighbors, none longer than a load."""
    runs: list[list[int]] = []
    for offset in offsets:
        if runs and offset == runs[-1][-1] + 1 and len(runs[-1]) < WIDEST:
            runs[-1].append(offset)
        else:
            runs.append([offset])
    return runs
