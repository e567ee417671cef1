"""Compares the filters of this tree with those of another: values, derivatives, times, memory.

    python -m experiments.010_fast_paths.guard --before TREE -o OUT
        [--quick] [--filters NAMES] [--values-only | --times-only]

TREE is a checkout of an older commit. Two processes, one for each tree, do the same in turn.
Writes ``guard_values``, ``guard_times`` and the bars, ``guard`` (csv and md); exits with status 1
if a bar is missed.
"""

import multiprocessing
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.common import output_parser, write_table

from .guard_worker import PUBLISHED, Case, clocks, elapsed

HERE = Path(__file__).resolve()
WORKER = [sys.executable, str(HERE.with_name("guard_worker.py"))]
DIFFERENCE, RATIO = 1e-6, 1.03
"""The largest allowed difference of values, and ratio of times."""
PROGRAMS = ("forward", "gradient of scalars", "gradient of every input")
VALUE_COLUMNS = ("case", "frame", "image", "derivatives", "worst", "share above", "same bits")
TIME_COLUMNS = ("case", "what", "CPU ms before", "after", "ratio", "spread", "wall ratio")
BUILD_COLUMNS = ("compile CPU s before", "after", "temporaries MB before", "after")


class Bar(NamedTuple):
    """A figure that must not exceed a limit, and where the worst one was found."""

    name: str
    worst: float
    where: str
    limit: float

    @property
    def holds(self) -> bool:
        """Whether the figure does not exceed the limit."""
        return self.worst <= self.limit


class Times(NamedTuple):
    """Processor milliseconds of both trees; ratios and their interquartile range over rounds."""

    before: float
    after: float
    ratio: float
    spread: float
    wall_ratio: float


def differences(before: np.ndarray, after: np.ndarray, relative: bool) -> np.ndarray:
    """Absolute differences; equal infinities and two NaN are equal, else infinitely different.

    Args:
        before: what is right.
        after: what is compared with it, of the same shape.
        relative: whether to divide by the largest finite magnitude before.

    Raises:
        ValueError: shapes disagree.
    """
    if before.shape != after.shape:
        raise ValueError(f"`after` must have shape {before.shape}, got {after.shape}.")
    old, new = before.astype(float), after.astype(float)
    scale = np.max(np.abs(old), where=np.isfinite(old), initial=0) if relative else 1.0
    with np.errstate(invalid="ignore", divide="ignore"):
        apart = np.nan_to_num(np.abs(new - old) / scale, nan=np.inf, posinf=np.inf)
    return np.where((old == new) | (np.isnan(old) & np.isnan(new)), 0, apart)


def time_both(measure: Callable[[int], tuple[float, float]], rounds: int, most: int) -> Times:
    """Measure both trees in turn; a ratio above what is allowed is given more rounds.

    Args:
        measure: gives wall-clock and processor seconds of tree 0 (before) or 1 (after).
        rounds: at first.
        most: rounds in all.
    """
    times: list[list[tuple[float, float]]] = []
    while True:
        for _ in range(rounds):
            order = (0, 1) if len(times) % 2 == 0 else (1, 0)
            measured = {tree: measure(tree) for tree in order}
            times.append([measured[0], measured[1]])
        table = np.array(times)
        wall, processor = (table[:, 1] / table[:, 0]).T
        low, ratio, high = np.percentile(processor, (25, 50, 75)).tolist()
        if ratio <= RATIO or len(times) + rounds > most:
            before, after = 1e3 * np.median(table[..., 1], axis=0)
            return Times(float(before), float(after), ratio, high - low, float(np.median(wall)))


def environment(tree: Path, cache: str) -> dict[str, str]:
    """The environment of a process that imports a tree and keeps compiled code in a folder."""
    return os.environ | {"PYTHONPATH": str(tree), "XDG_CACHE_HOME": cache, "JAX_PLATFORMS": "cpu"}


@contextmanager
def start_workers(trees: Sequence[Path]) -> Iterator[list[Connection]]:
    """A process for each tree, each with an empty cache; they end with the context.

    Raises:
        SystemExit: a process imports another jaxblur.
    """
    with ExitStack() as stack:
        workers = []
        for tree in trees:
            cache = stack.enter_context(tempfile.TemporaryDirectory())
            here, there = multiprocessing.Pipe()
            with there:
                command = [*WORKER, "serve", str(there.fileno())]
                process = subprocess.Popen(
                    command, cwd=tree, env=environment(tree, cache), pass_fds=[there.fileno()]
                )
            stack.enter_context(process)
            workers.append(stack.enter_context(here))
            if (package := Path(here.recv())) != tree / "jaxblur":
                raise SystemExit(f"{tree}: its process imports {package}")
        yield workers


def ask(workers: Sequence[Connection], name: str, case: Case, *arguments: Any) -> list[Any]:
    """Answers of workers, which work at the same time."""
    for worker in workers:
        worker.send((name, tuple(case), arguments))
    return [worker.recv() for worker in workers]


def make_cases(filters: Sequence[str]) -> list[Case]:
    """Filters, tile choices, fetches and backends."""
    return [
        Case(name, fetch, backend, choice)
        for name in filters
        for choice in (("stochastic", "own", "expected") if name == "guertin2014" else ("",))
        for fetch in ("nearest", "bilinear")
        for backend in ("native", "xla")
    ]


def is_timed(case: Case) -> bool:
    """The published fetch, and native code with the other one but for other tile choices."""
    published = case.fetch == ("bilinear" if case.filter == "layered" else "nearest")
    return published or (case.backend == "native" and case.tile_choice in ("", "stochastic"))


def compare_values(trees: Sequence[Path], filters: Sequence[str], output: Path) -> list[Bar]:
    """Compare images and derivatives; write ``guard_values``."""
    rows = []
    images: list[tuple[float, str]] = []
    derivatives: list[tuple[float, str]] = []
    with start_workers(trees) as workers:
        for case in make_cases(filters):
            before, after = ask(workers, "values", case)
            for frame, arrays in before.items():
                others = after[frame]
                apart = {
                    name: differences(a, others[name], name != "image")
                    for name, a in arrays.items()
                }
                image = float(apart.pop("image").max())
                worst = max(apart, key=lambda name: apart[name].max())
                derivative, share = float(apart[worst].max()), np.mean(apart[worst] > DIFFERENCE)
                same = sum(a.tobytes() == others[name].tobytes() for name, a in arrays.items())
                figures = f"{image:.1e}", f"{derivative:.1e}", worst, f"{share:.1e}"
                rows.append((str(case), frame, *figures, f"{same} of {len(arrays)}"))
                print(*rows[-1], sep=", ", flush=True)
                images.append((image, f"{case}, {frame}"))
                derivatives.append((derivative, f"{case}, {frame}, {worst}"))
    write_table(output, "guard_values", VALUE_COLUMNS, rows)
    return [
        Bar("difference of images", *max(images), DIFFERENCE),
        Bar("difference of derivatives", *max(derivatives), DIFFERENCE),
    ]


def compare_times(
    trees: Sequence[Path], filters: Sequence[str], output: Path, quick: bool
) -> list[Bar]:
    """Compare times, temporaries and compilation; write ``guard_times``."""
    rows: list[tuple[Any, ...]] = []
    ratios: list[tuple[float, str]] = []
    memory: list[tuple[float, str]] = []
    compiling = np.zeros(2)
    with start_workers(trees) as workers:
        for case in filter(is_timed, make_cases(filters)):
            scale, rounds = (2, 5) if case.backend == "xla" else (1, 9)
            scale, rounds = (2 * scale, 3) if quick else (scale, rounds)
            for program in PROGRAMS:
                if program == "gradient of scalars" and PUBLISHED[case.filter][0] is None:
                    continue
                what = (case, program, (720 // scale, 1280 // scale))
                seconds, temporaries = zip(
                    *(ask([worker], "build", *what)[0] for worker in workers), strict=True
                )
                compiling += seconds
                memory.append((temporaries[1] / max(temporaries[0], 1e-6), f"{case}, {program}"))
                for frame in ("dense", "30 % moves"):

                    def measure(tree: int, what=what, frame=frame) -> tuple[float, float]:
                        return ask([workers[tree]], "visit", *what, frame)[0]

                    times = time_both(measure, rounds, 3 * rounds)
                    row = (str(case), f"{program}, {frame}", *times, *seconds, *temporaries)
                    rows.append(row)
                    print(*row, sep=", ", flush=True)
                    ratios.append((times.ratio, f"{case}, {program}, {frame}"))
    fresh = compare_fresh(trees, filters, 3 if quick else 7)
    rows += [(*key, *times, *[""] * len(BUILD_COLUMNS)) for key, times in fresh.items()]
    write_table(output, "guard_times", TIME_COLUMNS + BUILD_COLUMNS, rows)
    second = [(times.ratio, name) for (name, what), times in fresh.items() if "second" in what]
    return [
        Bar("ratio of processor times", *max(ratios), RATIO),
        Bar("ratio of temporaries", *max(memory), 1.0),
        Bar("ratio of compile times", float(compiling[1] / compiling[0]), "all programs", RATIO),
        Bar("ratio of second processes", *max(second), RATIO),
    ]


def compare_fresh(
    trees: Sequence[Path], filters: Sequence[str], rounds: int
) -> dict[tuple[str, str], Times]:
    """Compare processes that blur one frame: the first, which compiles, and later ones."""
    results = {}
    for name in filters:
        with tempfile.TemporaryDirectory() as folder:

            def measure(tree: int, name=name, folder=folder) -> tuple[float, float]:
                start = clocks()
                own = environment(trees[tree], f"{folder}/{tree}")
                subprocess.run([*WORKER, "fresh", name], cwd=trees[tree], env=own, check=True)
                return elapsed(start)

            results[name, "first process"] = time_both(measure, 1, 1)
            results[name, "second process"] = time_both(measure, rounds, 3 * rounds)
    return results


def report(bars: Sequence[Bar], output: Path) -> bool:
    """Write the bars as ``guard``; whether all of them hold."""
    columns = ("bar", "worst", "limit", "holds", "where")
    rows = [
        (b.name, f"{b.worst:.3g}", f"{b.limit:g}", "yes" if b.holds else "NO", b.where)
        for b in bars
    ]
    write_table(output, "guard", columns, rows)
    return all(bar.holds for bar in bars)


def main() -> None:
    """Parse the command line, compare, write, exit."""
    parser = output_parser("Compare the filters of two trees.")
    parser.add_argument("--before", type=Path, required=True, metavar="TREE")
    parser.add_argument("--quick", action="store_true", help="half the size, 3 rounds")
    parser.add_argument("--filters", default=",".join(PUBLISHED), metavar="NAMES")
    part = parser.add_mutually_exclusive_group()
    part.add_argument("--values-only", action="store_true")
    part.add_argument("--times-only", action="store_true")
    options = parser.parse_args()
    trees, filters = (options.before.resolve(), HERE.parents[2]), options.filters.split(",")
    bars = []
    if not options.times_only:
        bars += compare_values(trees, filters, options.output)
    if not options.values_only:
        bars += compare_times(trees, filters, options.output, options.quick)
    sys.exit(0 if report(bars, options.output) else 1)


if __name__ == "__main__":
    main()
