"""Jobs, cases on subjects, and those of them that are not measured yet."""

from collections.abc import Iterable

from ..scenes import SCENES
from .cases import RENDERERS, Case
from .programs import machine
from .results import Row, code_digest, identity
from .subjects import Subject, catalogue_subject

_SOURCE = "accumulate "


def batches(
    jobs: Iterable[tuple[Subject, Case]], done: Iterable[Row], size: int
) -> list[tuple[Subject, list[Case]]]:
    """The jobs that are not measured yet, in batches of one subject that are timed in turn.

    Args:
        jobs: all measurements that are wanted.
        done: rows of the file so far; those of this code and machine are not measured again.
        size: most cases in a batch.

    Returns:
        Subjects and cases.
    """
    known = {row.key for row in done}
    # Renderers are slow: in a batch with filters they would use up the time of the rounds.
    left: dict[tuple[Subject, bool], list[Case]] = {}
    for subject, case in dict.fromkeys(jobs):
        if (*identity(subject, case), code_digest(), machine()) not in known:
            left.setdefault((subject, case.method in RENDERERS), []).append(case)
    return [
        (subject, cases[start : start + size])
        for (subject, _), cases in left.items()
        for start in range(0, len(cases), size)
    ]


def catalogue_jobs(rows: Iterable[Row]) -> list[tuple[Subject, Case]]:
    """The jobs of rows that were measured on scenes of the catalogue, to repeat them.

    Args:
        rows: of an older file.

    Returns:
        Subjects and cases; rows of files are left out.

    Raises:
        ValueError: the method or a setting no longer exists.
    """
    jobs = []
    for row in rows:
        if row["scene"] in SCENES and row["source"].startswith(_SOURCE):
            size = int(row["height"]), int(row["width"])
            samples = int(row["source"].removeprefix(_SOURCE))
            shutter = float(row["shutter"])
            jobs.append((catalogue_subject(row["scene"], size, shutter, samples), row.case))
    return jobs
