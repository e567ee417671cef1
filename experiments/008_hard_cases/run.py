"""Do the filters stay finite, precise and true to their invariants where it is hard?

    python experiments/008_hard_cases/run.py -o OUT [--quick] [--jobs N] [--resume]

Every filter of `jaxblur.FILTERS` on every case of cases.py, in float32 with float64 as the
reference: hard_cases.csv and .md; the worst of all filters: summary.csv and .md. What the
transformations of jax change, and a frame of 4096x2160: transformations.csv and .md. What the door
refuses is checked and printed. Seeds are fixed. ``--quick`` leaves out sizes, masks and most
transformations. Rows are written as they are measured; ``--resume`` takes those of OUT as they are.
"""

import contextlib
import csv
import functools
import itertools
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parents[2]))

import importlib

import jax
import numpy as np

import jaxblur
from experiments.common import output_parser, write_table
from jaxblur.filters import FILTERS

cases = importlib.import_module("experiments.008_hard_cases.cases")
measuring = importlib.import_module("experiments.008_hard_cases.measure")
transformations = importlib.import_module("experiments.008_hard_cases.transformations")

MODES: dict[str, dict[str, Any]] = {
    "bilinear": {"fetch": "bilinear", "tile_choice": "expected"},
    "nearest": {"fetch": "nearest", "tile_choice": "stochastic"},
}
COLUMNS = (
    "filter",
    "fetch",
    "case",
    "finite value",
    "finite gradient",
    "float32 error",
    "flipped",
    "gradient float32 error",
    "reverse - forward",
    "gradient wrong",
    "at a jump",
    "invariants broken",
)
HEADERS = {"hard_cases": COLUMNS, "transformations": transformations.COLUMNS}
KEYS = {"hard_cases": COLUMNS[:3], "transformations": transformations.COLUMNS[:2]}
"""Cells that name a row."""

SUMMARY_COLUMNS = ("case", "filters", *COLUMNS[3:])
TOO_FEW, ODD = "samples` must be at least", "must be odd"


def row(name: str, fetch: str, case: Any) -> tuple[Any, ...]:
    """The figures of one filter on one case."""
    frame, _ = jaxblur.finite_frame(case.frame, case.nonfinite)
    settings = jaxblur.GuertinSettings(samples=case.samples, radius=case.radius, **MODES[fetch])
    setup = measuring.Setup(name, settings)
    try:
        numbers = measuring.measure(setup, frame)
        broken = measuring.broken_invariants(setup, frame)
    except ValueError as error:
        if not any(text in str(error) for text in (TOO_FEW, ODD)):
            raise
        reason = "N must be odd" if ODD in str(error) else "N is too small"
        return (name, fetch, case.label, f"refused: {reason}", *["-"] * 8)
    return (
        *(name, fetch, case.label),
        *("yes" if finite else "NO" for finite in numbers[:2]),
        f"{numbers.error:.1e}",
        f"{100 * numbers.flipped:.2f} %",
        f"{numbers.gradient_error:.1e}",
        f"{numbers.modes:.0e}",
        f"{100 * numbers.wrong:.2f} %",
        f"{100 * numbers.jumps:.2f} %",
        ", ".join(broken) or "none",
    )


def summary(rows: Sequence[Sequence[str]]) -> list[tuple[str, ...]]:
    """One row for each case: the worst of all filters that took it."""
    by_case: dict[str, list[Sequence[str]]] = {}
    for cells in rows:
        if cells[3] in ("yes", "NO"):
            by_case.setdefault(cells[2], []).append(cells)
    found = []
    for case, taken in by_case.items():
        columns = list(zip(*taken, strict=True))
        finite = ("NO" if "NO" in column else "yes" for column in columns[3:5])
        worst = (max(column, key=_number) for column in columns[5:11])
        broken = sorted({name for name in columns[11] if name != "none"})
        count = str(len(set(columns[0])))
        found.append((case, count, *finite, *worst, ", ".join(broken) or "none"))
    return found


def _number(cell: str) -> float:
    return float(cell.removesuffix(" %"))


def check_door() -> list[str]:
    """Frames that got past the door though they must not."""
    passed = []
    for name, frame in cases.refused_frames():
        with contextlib.suppress(ValueError):
            jaxblur.finite_frame(frame)
            passed.append(name)
    return passed


class Task(NamedTuple):
    """What one process measures in one go; its cases share their programs.

    Attributes:
        table: ``hard_cases`` or ``transformations``.
        labels: the first cells of each of its rows.
        measure: returns the rows.
    """

    table: str
    labels: tuple[tuple[str, ...], ...]
    measure: Callable[[], list[tuple[Any, ...]]]


def tasks(quick: bool) -> Iterator[Task]:
    """All there is to measure, or a part of it if it must be quick."""
    for name, fetch in itertools.product(FILTERS, list(MODES)[: 1 if quick else None]):
        for batch in batches(fetch, quick):
            labels = tuple((name, fetch, case.label) for case in batch)
            yield Task("hard_cases", labels, functools.partial(case_rows, name, fetch, batch))
    for name in list(FILTERS)[: 1 if quick else None]:
        for what in transformations.CHECKS | ({} if quick else transformations.LARGE_CHECKS):
            measure = functools.partial(transformations.rows, name, what)
            yield Task("transformations", ((name, what),), measure)


def batches(fetch: str, quick: bool) -> Iterator[list[Any]]:
    """Cases that share their programs: the same size, samples and radius, masked or not."""
    by_program: dict[Any, list[Any]] = {}
    for case in cases.all_cases():
        frame, _ = jaxblur.finite_frame(case.frame, case.nonfinite)
        program = frame.color.shape, case.samples, case.radius, frame.valid is not None
        by_program.setdefault(program, []).append(case)
    usual, *others = by_program.values()
    yield usual[:: 3 if quick else 1]
    for batch in others:
        # Each size compiles anew.
        if not quick and (batch[0].group != "shape" or fetch == "bilinear"):
            yield batch


def case_rows(name: str, fetch: str, batch: Sequence[Any]) -> list[tuple[Any, ...]]:
    """The figures of one filter on some cases."""
    return [row(name, fetch, case) for case in batch]


def run(task: Task) -> list[tuple[Any, ...]]:
    """Measure, and keep no programs: memory stays that of one task."""
    measured = task.measure()
    jax.clear_caches()
    return measured


def measure_all(output: Path, planned: Sequence[Task], jobs: int) -> None:
    """Measure what the tables of the folder lack, and append it as it comes."""
    present = {table: {row[: len(KEYS[table])] for row in read(output, table)} for table in KEYS}
    missing = [task for task in planned if not present[task.table].issuperset(task.labels)]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        running = {pool.submit(run, task): task for task in missing}
        for future in as_completed(running):
            with path(output, running[future].table).open(
                "a", newline="", encoding="utf-8"
            ) as file:
                csv.writer(file).writerows(future.result())
            for measured in future.result():
                print(*measured, sep="  ", flush=True)


def path(output: Path, table: str) -> Path:
    """Where a table is kept."""
    return output / f"{table}.csv"


def read(output: Path, table: str) -> list[tuple[str, ...]]:
    """The rows measured so far, whole ones."""
    with path(output, table).open(newline="", encoding="utf-8") as file:
        rows = [tuple(row) for row in csv.reader(file)][1:]
    return [row for row in rows if len(row) == len(HEADERS[table])]


def write(output: Path, planned: Sequence[Task]) -> None:
    """The tables in the order of the plan, and the summary."""
    for table, keys in KEYS.items():
        found = {row[: len(keys)]: row for row in read(output, table)}
        labels = itertools.chain(*(task.labels for task in planned if task.table == table))
        ordered = [found[label] for label in labels]
        write_table(output, table, HEADERS[table], ordered)
        if table == "hard_cases":
            write_table(output, "summary", SUMMARY_COLUMNS, summary(ordered))


def main() -> None:
    """Measure, write the tables, say what failed."""
    parser = output_parser("Hard cases of every filter.")
    parser.add_argument("--quick", action="store_true", help="fewer cases and transformations")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default: 2)")
    parser.add_argument("--resume", action="store_true", help="keep the rows that OUT has")
    options = parser.parse_args()
    for table in KEYS:
        if not (options.resume and path(options.output, table).exists()):
            write_table(options.output, table, HEADERS[table], [])
    start = time.perf_counter()
    planned = list(tasks(options.quick))
    measure_all(options.output, planned, options.jobs)
    write(options.output, planned)
    passed = check_door()
    print(f"door: {'all refused' if not passed else 'NOT refused: ' + ', '.join(passed)}")
    seconds = f"{time.perf_counter() - start:.0f} s"
    print(f"{seconds}, numpy {np.__version__}, jax {jax.__version__}")


if __name__ == "__main__":
    main()
