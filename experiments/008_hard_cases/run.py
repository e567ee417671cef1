"""Do the filters stay finite, precise and true to their invariants where it is hard?

    python experiments/008_hard_cases/run.py -o OUT [--quick]

Every filter of `jaxblur.FILTERS` on every case of cases.py, in float32 with float64 as the
reference: hard_cases.csv and .md; the worst of all filters: summary.csv and .md. What the
transformations of jax change: transformations.csv and .md. What the door refuses is checked and
printed. Seeds are fixed.
"""

import argparse
import contextlib
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2]))

import importlib

import jax
import numpy as np

import jaxblur
from experiments.common import write_table
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
SUMMARY_COLUMNS = ("case", "filters", *COLUMNS[3:])
ODD = "must be odd"


def row(name: str, fetch: str, case: Any) -> tuple[Any, ...]:
    """The figures of one filter on one case."""
    frame, _ = jaxblur.finite_frame(case.frame, case.nonfinite)
    settings = jaxblur.Settings(samples=case.samples, radius=case.radius, **MODES[fetch])
    setup = measuring.Setup(name, settings)
    try:
        numbers = measuring.measure(setup, frame)
        broken = measuring.broken_invariants(setup, frame)
    except ValueError as error:
        if ODD not in str(error):
            raise
        return (name, fetch, case.label, "refused: N must be odd", *["-"] * 8)
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


def rows(quick: bool) -> Iterator[tuple[Any, ...]]:
    """All rows; the first filter and a third of the cases if it must be quick."""
    for name in list(FILTERS)[: 1 if quick else None]:
        for fetch in list(MODES)[: 1 if quick else None]:
            for case in cases.all_cases()[:: 3 if quick else 1]:
                # Each size compiles anew.
                if case.group != "shape" or not (quick or fetch == "nearest"):
                    measured = row(name, fetch, case)
                    print(*measured, sep="  ", flush=True)
                    yield measured
        jax.clear_caches()


def main() -> None:
    """Measure, write the tables, say what failed."""
    parser = argparse.ArgumentParser(description="Hard cases of every filter.")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    parser.add_argument("--quick", action="store_true", help="one filter, fewer cases")
    parser.add_argument("--large", action="store_true", help="4096x2160 too (4 GB, minutes)")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    start, used = time.perf_counter(), time.process_time()
    measured = list(rows(options.quick))
    write_table(options.output, "hard_cases", COLUMNS, measured)
    write_table(options.output, "summary", SUMMARY_COLUMNS, summary(measured))
    names = list(FILTERS)[: 1 if options.quick else None]
    changes = transformations.rows(names, large=options.large)
    write_table(options.output, "transformations", transformations.COLUMNS, changes)
    passed = check_door()
    print(f"door: {'all refused' if not passed else 'NOT refused: ' + ', '.join(passed)}")
    seconds = f"{time.perf_counter() - start:.0f} s ({time.process_time() - used:.0f} s of CPU)"
    print(f"{seconds}, numpy {np.__version__}, jax {jax.__version__}")


if __name__ == "__main__":
    main()
