"""The answers of a study: read from the files that its page saves, and sorted into rounds."""

import csv
import dataclasses
import io
import math
import pathlib
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Int

from .._util.errors import JaxblurIOError
from .._util.small_files import read_text
from .._util.text import printable

Counts = Int[np.ndarray, "rounds stimuli stimuli"]

COLUMNS = ("study", "observer", "group", "trial", "scene", "first", "second", "chosen", "catch")
"""Columns that a file of votes must have; see `read_votes`."""
NAMED = ("study", "observer", "trial", "scene", "first", "second")
"""Columns in which no vote is empty."""
SAVED = "give a file that the page of `jaxblur study` saved."


@dataclasses.dataclass(frozen=True)
class Votes:
    """The answers of a study.

    Attributes:
        names: of the t stimuli.
        counts: (n, t, t): in round k, how often stimulus i was preferred to stimulus j. A round is
            all pairs once: one observer has as many as the study repeats them, and scenes.
        observers: for each round, who voted.
        groups: for each round, the group of that observer, such as "expert".
        left_out: observers who failed the catch trials, with their share of right answers.
        unfinished: observers with votes in rounds that are not complete, with their number; these
            votes are not counted.
    """

    names: tuple[str, ...]
    counts: Counts
    observers: tuple[str, ...]
    groups: tuple[str, ...]
    left_out: Mapping[str, float] = dataclasses.field(default_factory=dict)
    unfinished: Mapping[str, int] = dataclasses.field(default_factory=dict)

    def of_group(self, group: str) -> "Votes":
        """The votes of one group of observers.

        Args:
            group: its name.

        Returns:
            Those rounds.

        Raises:
            ValueError: there is no such group.
        """
        keep = [index for index, name in enumerate(self.groups) if name == group]
        if not keep:
            known = ", ".join(sorted(set(self.groups)))
            raise ValueError(f"`group` must be one of {known}; got {group!r}.")
        return dataclasses.replace(
            self,
            counts=self.counts[keep],
            observers=tuple(self.observers[index] for index in keep),
            groups=tuple(self.groups[index] for index in keep),
        )


def read_votes(paths: Iterable[str | pathlib.Path], least_right: float = 0.8) -> Votes:
    """Read the files that the page of ``jaxblur study`` saves, one for each observer.

    Args:
        paths: CSV files of one study. An observer may have several, of sessions apart.
        least_right: share of the catch trials that an observer must answer right; others are left
            out.

    Returns:
        The votes. A round that was not finished is left out.

    Raises:
        JaxblurIOError: a file is no such file, is of another study, or holds the same vote twice.
        ValueError: ``least_right`` is not between 0 and 1, or there is no file.
    """
    if not 0 <= least_right <= 1:
        raise ValueError(f"`least_right` must be between 0 and 1, got {least_right}.")
    rows: list[dict[str, str]] = []
    of_study: dict[str, pathlib.Path] = {}
    seen: dict[tuple[str, ...], pathlib.Path] = {}
    for path in map(pathlib.Path, paths):
        found = _rows(path)
        for row in found:
            of_study.setdefault(row["study"], path)
            if len(of_study) > 1:
                first = next(iter(of_study.values()))
                raise JaxblurIOError(path, f"is of another study than {first}; analyze them apart.")
            key = (row["observer"], row.get("started", ""), row["trial"])
            if key in seen:
                raise JaxblurIOError(
                    path, f"holds votes that {seen[key]} holds too; give each file once."
                )
            seen[key] = path
        rows += found
    if not rows:
        raise ValueError("`paths` must name at least one file with votes; these hold none.")
    right = _right_answers(rows)
    left_out = {observer: share for observer, share in right.items() if share < least_right}
    kept = [row for row in rows if row["observer"] not in left_out]
    if not kept:
        listed = ", ".join(f"{name} {100 * share:.0f} %" for name, share in left_out.items())
        raise ValueError(
            f"`paths` hold no votes of observers who answered {100 * least_right:.0f} % of the "
            f"catch trials right ({listed})."
        )
    return _votes(kept, left_out)


def _rows(path: pathlib.Path) -> list[dict[str, str]]:
    """The lines of a file of votes."""
    text = read_text(path, SAVED)
    if "\0" in text:
        raise JaxblurIOError(path, f"is no text; {SAVED}")
    try:
        reader = csv.DictReader(io.StringIO(text))
        missing = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
        if missing:
            raise JaxblurIOError(path, f"has no column {', '.join(missing)}; {SAVED}")
        rows = list(reader)
    except csv.Error as error:
        raise JaxblurIOError(path, f"cannot be read as CSV: {error}.") from error
    for number, row in enumerate(rows, start=2):
        _check_vote(path, number, row)
    return rows


def _check_vote(path: pathlib.Path, number: int, row: Mapping[str, str | None]) -> None:
    """Reject a line of a file of votes that is no vote."""
    if any(row[name] is None for name in COLUMNS):
        raise JaxblurIOError(path, f"line {number} is cut off.")
    if empty := [name for name in NAMED if not (row[name] or "").strip()]:
        raise JaxblurIOError(path, f"line {number} has no {', '.join(empty)}; {SAVED}")
    if row["first"] == row["second"] or row["chosen"] not in (row["first"], row["second"]):
        given = printable(row["chosen"])
        raise JaxblurIOError(path, f"line {number}: {given!r} is none of the two that were shown.")


def _right_answers(rows: Sequence[Mapping[str, str]]) -> dict[str, float]:
    """Share of right answers to catch trials of each observer who had any."""
    answers: dict[str, list[bool]] = {}
    for row in rows:
        if row["catch"]:
            answers.setdefault(row["observer"], []).append(row["chosen"] == row["catch"])
    return {observer: float(np.mean(given)) for observer, given in answers.items()}


def _votes(rows: Sequence[Mapping[str, str]], left_out: Mapping[str, float]) -> Votes:
    """Sort votes into rounds: one observer, one scene, the first or a later repetition."""
    plain = [row for row in rows if not row["catch"]]
    names = tuple(dict.fromkeys(name for row in plain for name in (row["first"], row["second"])))
    place = {name: index for index, name in enumerate(sorted(names))}
    # By preferred and other stimulus: files of many names would fill the memory with tables.
    rounds: dict[tuple[str, str, int], list[tuple[int, int]]] = {}
    groups: dict[str, str] = {}
    times: dict[tuple[str, str, frozenset[str]], int] = {}
    for row in plain:
        pair = (row["observer"], row["scene"], frozenset((row["first"], row["second"])))
        times[pair] = times.get(pair, 0) + 1
        other = row["second"] if row["chosen"] == row["first"] else row["first"]
        votes = rounds.setdefault((*pair[:2], times[pair]), [])
        votes.append((place[row["chosen"]], place[other]))
        groups[row["observer"]] = row["group"]
    whole = math.comb(len(names), 2)
    done = {key: votes for key, votes in rounds.items() if len(votes) == whole}
    unfinished: dict[str, int] = {}
    for (observer, *_), votes in rounds.items():
        if len(votes) != whole:
            unfinished[observer] = unfinished.get(observer, 0) + len(votes)
    counts = np.zeros((len(done), len(names), len(names)), int)
    for table, votes in zip(counts, done.values(), strict=True):
        table[tuple(np.transpose(votes))] = 1
    observers = tuple(observer for observer, _, _ in done)
    return Votes(
        tuple(place), counts, observers, tuple(groups[o] for o in observers), left_out, unfinished
    )
