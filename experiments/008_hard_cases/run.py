"""Do the filters stay finite and precise and keep their invariants on hard cases?

    python experiments/008_hard_cases/run.py -o OUT [--quick] [--jobs N] [--resume]

Writes hard_cases.csv and .md (every filter of `jaxblur.FILTERS` on every case of cases.py, in
float32 with float64 as the reference), summary.csv and .md (the worst of all filters), and
transformations.csv and .md (effects of the transformations of jax, and a frame of 4096x2160).
Checks that `jaxblur.finite_frame` rejects invalid frames, and prints the result. Seeds are fixed.
``--quick`` leaves out sizes, masks and most transformations. Rows are written as they are measured;
``--resume`` keeps the rows that OUT has and measures the others.
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
"""Columns that identify a row."""

SUMMARY_COLUMNS = ("case", "filters", *COLUMNS[3:])
TOO_FEW, ODD = "samples` must be at least", "must be odd"


def row(name: str, fetch: str, case: Any) -> tuple[Any, ...]:
    """Measure one filter on one case: its row."""
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
    """One row for each case: the worst of all filters that accept it."""
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
    """Names of invalid frames that `jaxblur.finite_frame` fails to reject."""
    passed = []
    for name, frame in cases.refused_frames():
        with contextlib.suppress(ValueError):
            jaxblur.finite_frame(frame)
            passed.append(name)
    return passed


class Task(NamedTuple):
    """A unit of work for one process; its cases share their compiled programs.

    Attributes:
        table: ``hard_cases`` or ``transformations``.
        labels: the first cells of each of its rows.
        measure: returns the rows.
    """

    table: str
    labels: tuple[tuple[str, ...], ...]
    measure: Callable[[], list[tuple[Any, ...]]]


def tasks(quick: bool) -> Iterator[Task]:
    """All tasks, or a part of them if `quick`."""
    for name, fetch in itertools.product(FILTERS, list(MODES)[: 1 if quick else None]):
        for batch in batches(fetch, quick):
            labels = tuple((name, fetch, case.label) for case in batch)
            yield Task("hard_cases", labels, functools.partial(case_rows, name, fetch, batch))
    for name in list(FILTERS)[: 1 if quick else None]:
        for what in transformations.CHECKS | ({} if quick else transformations.LARGE_CHECKS):
            measure = functools.partial(transformations.rows, name, what)
            yield Task("transformations", ((name, what),), measure)


def batches(fetch: str, quick: bool) -> Iterator[list[Any]]:
    """Cases that share compiled programs: same size, samples and radius, all masked or none."""
    by_program: dict[Any, list[Any]] = {}
    for case in cases.all_cases():
        frame, _ = jaxblur.finite_frame(case.frame, case.nonfinite)
        program = frame.color.shape, case.samples, case.radius, frame.valid is not None
        by_program.setdefault(program, []).append(case)
    usual, *others = by_program.values()
    yield usual[:: 3 if quick else 1]
    for batch in others:
        # Each of these batches compiles its own programs.
        if not quick and (batch[0].group != "shape" or fetch == "bilinear"):
            yield batch


def case_rows(name: str, fetch: str, batch: Sequence[Any]) -> list[tuple[Any, ...]]:
    """Measure one filter on some cases: their rows."""
    return [row(name, fetch, case) for case in batch]


def run(task: Task) -> list[tuple[Any, ...]]:
    """Measure one task, then drop its compiled programs to bound memory."""
    measured = task.measure()
    jax.clear_caches()
    return measured


def measure_all(output: Path, planned: Sequence[Task], jobs: int) -> None:
    """Measure the rows that the tables in the folder lack, and append each when it is done."""
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
    """Path of the CSV file of a table."""
    return output / f"{table}.csv"


def read(output: Path, table: str) -> list[tuple[str, ...]]:
    """The complete rows that have been measured so far."""
    with path(output, table).open(newline="", encoding="utf-8") as file:
        rows = [tuple(row) for row in csv.reader(file)][1:]
    return [row for row in rows if len(row) == len(HEADERS[table])]


def write(output: Path, planned: Sequence[Task]) -> None:
    """Write the tables, in the order of the plan, and the summary."""
    for table, keys in KEYS.items():
        found = {row[: len(keys)]: row for row in read(output, table)}
        labels = itertools.chain(*(task.labels for task in planned if task.table == table))
        ordered = [found[label] for label in labels]
        write_table(output, table, HEADERS[table], ordered)
        if table == "hard_cases":
            write_table(output, "summary", SUMMARY_COLUMNS, summary(ordered))


def main() -> None:
    """Measure, write the tables, and print which invalid frames were not rejected."""
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
    print(f"invalid frames: {'NOT rejected: ' + ', '.join(passed) if passed else 'all rejected'}")
    seconds = f"{time.perf_counter() - start:.0f} s"
    print(f"{seconds}, numpy {np.__version__}, jax {jax.__version__}")


if __name__ == "__main__":
    main()
