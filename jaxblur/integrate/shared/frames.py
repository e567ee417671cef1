"""Files of rendered frames: one, or the sequences that lie in a folder."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Callable, Iterable

RESULTS = "blurred"
"""Folder of blurred frames, beside the sharp ones."""


@dataclasses.dataclass(frozen=True)
class Frames:
    """One file, or the numbered files of a sequence.

    Attributes:
        before: path up to the number; of a single file the whole path.
        digits: least digits of a number, padded with zeros; 0 for a single file.
        after: the name behind the number.
        numbers: of the frames, ascending; empty for a single file.
    """

    before: str
    digits: int = 0
    after: str = ""
    numbers: tuple[int, ...] = ()

    @property
    def names(self) -> str:
        """The path as the command takes it, ``shot_%04d.exr`` for a sequence."""
        return f"{self.before}%0{self.digits}d{self.after}" if self.digits else self.before

    @property
    def count(self) -> int:
        """How many files these are."""
        return len(self.numbers) if self.digits else 1

    def paths(self) -> list[str]:
        """The path of each file."""
        if not self.digits:
            return [self.before]
        return [f"{self.before}{number:0{self.digits}d}{self.after}" for number in self.numbers]

    def within(self, folder: str) -> Frames:
        """The same names in another folder."""
        before = os.path.join(folder, os.path.basename(self.before))
        return dataclasses.replace(self, before=before)

    def results(self) -> Frames:
        """The same names in the folder for blurred frames."""
        return self.within(os.path.join(os.path.dirname(self.before), RESULTS))

    def on_disk(self) -> Frames:
        """Those of the numbers whose files exist."""
        pairs = zip(self.numbers, self.paths(), strict=True)
        return dataclasses.replace(
            self, numbers=tuple(number for number, path in pairs if os.path.isfile(path))
        )


def numbered(path_of: Callable[[int], str], numbers: Iterable[int]) -> Frames:
    """Find where a host puts the number of a frame into a path.

    Args:
        path_of: path of the file of a frame.
        numbers: of the frames.

    Returns:
        The frames, whether they exist or not.

    Raises:
        ValueError: the paths of two frames do not differ in one run of digits.
    """
    # 0 and 9, 0 and 99 and so on: all digits of the number differ, and no others.
    first, digits = path_of(0), 0
    while len(path_of(10 ** (digits + 1) - 1)) == len(first) and digits < 20:
        digits += 1
    last = path_of(10**digits - 1)
    places = [at for at, (a, b) in enumerate(zip(first, last, strict=True)) if a != b]
    if not places or places[-1] - places[0] + 1 != digits:
        raise ValueError(f"{first}: has no number of a frame; put #### into the name.")
    start, end = places[0], places[0] + digits
    return Frames(first[:start], digits, first[end:], tuple(sorted(set(numbers))))


def in_folder(folder: str) -> list[Frames]:
    """Find the EXR files of a folder, without hidden ones.

    Args:
        folder: to look in, not below it.

    Returns:
        Sequences and single files in the order of their names. Of a file with several numbers the
        last one is that of the frame.

    Raises:
        OSError: the folder cannot be read.
    """
    found: dict[tuple[str, int, str], list[int]] = {}
    for name in sorted(os.listdir(folder)):
        if name.startswith(".") or not name.lower().endswith(".exr"):
            continue
        match = re.fullmatch(r"(.*?)(\d+)(\D*)", name)
        before, digits, after = match.groups() if match else (name, "", "")
        key = (os.path.join(folder, before), len(digits), after)
        found.setdefault(key, []).extend([int(digits)] if digits else [])
    return [Frames(*key, tuple(sorted(numbers))) for key, numbers in found.items()]


def ranges(numbers: Iterable[int]) -> str:
    """Write numbers of frames as the command takes them.

    Examples:
        >>> ranges([1, 2, 3, 7])
        '1-3,7'
    """
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ",".join(str(a) if a == b else f"{a}-{b}" for a, b in runs)
