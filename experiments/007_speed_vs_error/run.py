"""Speed against error of every filter, beside the alternatives.

    python -m experiments.007_speed_vs_error.run -o OUT [--reference-data DIR] [--quick | --full]

Resumable: cases that OUT/results.csv holds for this code and machine are not measured again. Writes
the CSV, pareto.md, pareto_flip.png, pareto_rmse.png, growth.md, growth.png, claims.md and
alternatives.md. Noise is a fixed pattern; only ``stochastic`` is random, with seed 0.
"""

import argparse
import importlib
import importlib.util
import logging
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxblur import bench
from jaxblur.bench import Row
from jaxblur.cli.console import track
from jaxblur.settings import Settings

from . import plan, tables
from .alternatives import check, make_inputs
from .plan import Extent, Job

ALTERNATIVES = {"numba": "numba", "numpy": "numpy", "torch": "torch"}
"""The package that each module `alternatives_NAME` needs, by NAME."""
BATCH = 12
ROUND_LIMIT = 20.0
LOG = logging.getLogger("jaxblur")


def installed_alternatives() -> list[str]:
    """Alternatives whose package is installed; the others are logged."""
    found = []
    for name, package in ALTERNATIVES.items():
        if importlib.util.find_spec(package):
            found.append(name)
        else:
            LOG.warning("%s is left out: pip install %s", name, package)
    return found


def alternative_method(name: str) -> Any:
    """An alternative in the form that `jaxblur.bench.measure` takes, with its check."""

    def method(subject: bench.Subject, settings: Settings) -> Any:
        module = importlib.import_module(f".alternatives_{name}", __package__)
        frame = subject.load().frame
        check(name, module.guertin2014, frame, settings)
        inputs = make_inputs(frame, settings)
        return lambda: module.guertin2014(inputs)

    return method


def all_jobs(options: argparse.Namespace, extent: Extent) -> list[Job]:
    """Everything to measure, with the short comparisons of time first."""
    jobs = plan.alternative_jobs(extent, installed_alternatives())
    jobs += plan.claim_jobs(extent) + plan.growth_jobs(extent) + plan.scene_jobs(extent)
    if options.reference_data:
        jobs += plan.reference_jobs(extent, options.reference_data)
    return list(dict.fromkeys(jobs))


def measure_all(path: Path, jobs: Sequence[Job], extent: Extent) -> list[Row]:
    """Measure the jobs that the file lacks, write it after every batch; the rows of all jobs."""
    known = bench.read_rows(path) if path.exists() else []
    batches = bench.batches(jobs, known, BATCH)
    others = {name: alternative_method(name) for name in ALTERNATIVES}
    programs, started = bench.Programs(), time.perf_counter()
    for number in track(range(len(batches)), "measuring"):
        subject, cases = batches[number]
        repeats = extent.repeats if cases[0].has_settings else 3
        known += bench.measure(subject, cases, programs, repeats, ROUND_LIMIT, others)
        bench.write_rows(path, known)
        elapsed = time.perf_counter() - started
        height, width = subject.size
        print(
            f"{number + 1} of {len(batches)} batches, {elapsed:.0f} s: {subject.name} "
            f"{width}x{height}, {len(cases)} cases",
            flush=True,
        )
    wanted = {bench.identity(*job) for job in jobs}
    return [row for row in bench.latest(known) if row.identity in wanted]


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description="Speed against error of every filter.")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT")
    parser.add_argument(
        "--reference-data",
        type=Path,
        metavar="DIR",
        help="rendered scenes as experiments/blender writes them",
    )
    extent = parser.add_mutually_exclusive_group()
    extent.add_argument("--quick", action="store_true", help="small, within two minutes")
    extent.add_argument("--full", action="store_true", help="the whole product, hours")
    return parser.parse_args()


def main() -> None:
    """Measure, then write tables and figures."""
    logging.basicConfig(format="%(message)s")
    options = parse_arguments()
    extent = plan.QUICK if options.quick else plan.FULL if options.full else plan.DEFAULT
    options.output.mkdir(parents=True, exist_ok=True)
    rows = measure_all(options.output / "results.csv", all_jobs(options, extent), extent)
    tables.write_all(options.output, rows, extent, options.reference_data)


if __name__ == "__main__":
    main()
