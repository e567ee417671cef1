"""How quick guertin2014 and layered are, against what they should be compared with, in one run.

    python -m experiments.010_fast_paths.run -o OUT [--quick]

Frames of 1280x720 in which every tile moves, 30 % of them do, or none; N = 35 and 15; native code
and XLA; both fetches; one direction and two; gradients; numba where it is installed. Everything is
timed in turn. Then two fresh processes a filter, the second of which finds its code compiled.
Writes speed.csv and speed.md.
"""

import argparse
import dataclasses
import functools
import importlib
import importlib.util
import os
import pathlib
import subprocess
import sys
import tempfile
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

import jaxblur
from experiments.common import write_table
from jaxblur.bench.frames import moving_frame
from jaxblur.bench.timing import time_in_turn
from jaxblur.filters import FILTERS, filter_info

SIZE = (720, 1280)
COLUMNS = ("what", "ms", "CPU ms", "times the reference", "reference", "temporaries, MB")
SETTINGS = jaxblur.Settings(samples=35, radius=40, noise="none", backend="native")
REFERENCE = "native, N = 35"
LAYERED = "layered, N = 35"
# Imports jax and jaxblur, then blurs one frame; prints the seconds of each.
FRESH_PROCESS = """
import sys, time
start = time.perf_counter()
import jax
from jaxblur.cli.compute import start_jax
from jaxblur.bench.frames import moving_frame
from jaxblur.filters import filter_info
start_jax(compile_cache=True)
jax.block_until_ready(jax.numpy.ones(1))
imported = time.perf_counter()
frame = moving_frame(720, 1280)
info = filter_info(sys.argv[1])
info.call(frame, info.make_parameters(), settings=info.settings).block_until_ready()
print(imported - start, time.perf_counter() - imported)
"""


@dataclasses.dataclass(frozen=True)
class Row:
    """One thing that is timed.

    Attributes:
        name: what it is.
        run: does it once and waits.
        reference: name of the row that it is divided by.
        temporaries: peak in MB, None if unknown.
    """

    name: str
    run: Callable[[], Any]
    reference: str
    temporaries: float | None = None


def compiled_row(name: str, function: Callable[..., Any], reference: str, *arguments: Any) -> Row:
    """Compile a function of arrays."""
    program = jax.jit(function).lower(*arguments).compile()
    memory = program.memory_analysis()
    temporaries = None if memory is None else memory.temp_size_in_bytes / 1e6
    return Row(name, lambda: jax.block_until_ready(program(*arguments)), reference, temporaries)


@dataclasses.dataclass(frozen=True)
class Subject:
    """A filter that is timed in many ways.

    Attributes:
        filter: its name.
        free: four of its parameters.
        prefix: of the names of its rows.
    """

    filter: str
    free: tuple[str, ...]
    prefix: str = ""

    def row(self, name: str, frame: jaxblur.Frame, reference: str, **changes: Any) -> Row:
        """A run with some settings changed."""
        info = filter_info(self.filter)
        settings = info.kind(**dataclasses.asdict(SETTINGS) | changes)
        parameters = info.make_parameters()
        blur = functools.partial(info.call, parameters=parameters, settings=settings)
        return compiled_row(name, lambda frame: blur(frame), reference, frame)

    def gradient_rows(self, frame: jaxblur.Frame, fetch: str) -> list[Row]:
        """Loss, gradient of four parameters, gradient of everything."""
        settings = dataclasses.replace(SETTINGS, fetch=fetch)
        parameters = jax.tree.map(jnp.float32, filter_info(self.filter).make_parameters())

        def loss(frame, parameters):
            blurred = FILTERS[self.filter](frame, parameters, settings=settings)
            return jnp.mean((blurred - 0.5) ** 2)

        def of_free(free, frame, parameters):
            return loss(frame, dataclasses.replace(parameters, **free))

        free = {name: getattr(parameters, name) for name in self.free}
        reference = f"{self.prefix}loss, {fetch}"
        programs = (
            ("loss", loss, (frame, parameters)),
            (
                "value and gradient of four scalars",
                jax.value_and_grad(of_free),
                (free, frame, parameters),
            ),
            (
                "value and gradient of every input",
                jax.value_and_grad(loss, (0, 1)),
                (frame, parameters),
            ),
        )
        return [
            compiled_row(f"{self.prefix}{name}, {fetch}", program, reference, *arguments)
            for name, program, arguments in programs
        ]


GUERTIN = Subject("guertin2014", ("kappa", "gamma", "tau", "phi"))
SLICES = Subject(
    "layered",
    # The surface sharpness changes the motion, which is an image: its derivative costs as much as
    # that of every input.
    ("front_sharpness", "landing_tolerance", "own_tolerance", "bend"),
    "layered, ",
)


def numba_rows(frame: jaxblur.Frame) -> list[Row]:
    """The filter in numba, whole, where numba is installed."""
    if importlib.util.find_spec("numba") is None:
        return []
    folder = "experiments.007_speed_vs_error"
    common = importlib.import_module(f"{folder}.alternatives")
    numba = importlib.import_module(f"{folder}.alternatives_numba")
    rows = []
    for samples in (35, 15):
        settings = dataclasses.replace(SETTINGS, samples=samples)
        common.check("numba", numba.guertin2014, frame, settings)
        inputs = common.make_inputs(frame, settings)
        run = functools.partial(numba.guertin2014, inputs)
        rows.append(Row(f"numba, N = {samples}", run, f"numba, N = {samples}"))
    return rows


def published_rows(frame: jaxblur.Frame) -> list[Row]:
    """Every filter with its own parameters and settings."""
    reference = "guertin2014 as published"
    rows = []
    for name in FILTERS:
        info = filter_info(name)
        parameters = info.make_parameters()
        blur = functools.partial(info.call, parameters=parameters, settings=info.settings)
        rows.append(
            compiled_row(f"{name} as published", lambda f, blur=blur: blur(f), reference, frame)
        )
    return rows


def make_rows(size: tuple[int, int]) -> list[Row]:
    """Everything that is timed."""
    dense, sparse, still = (moving_frame(*size, moving=share) for share in (1.0, 0.3, 0.0))
    rows = numba_rows(dense)
    numba = {35: "numba, N = 35", 15: "numba, N = 15"} if rows else {}
    few = "native, N = 15"
    rows += [
        GUERTIN.row(REFERENCE, dense, numba.get(35, REFERENCE)),
        GUERTIN.row(few, dense, numba.get(15, few), samples=15),
        GUERTIN.row("XLA, N = 35", dense, REFERENCE, backend="xla"),
        GUERTIN.row("XLA, N = 15", dense, few, backend="xla", samples=15),
        GUERTIN.row("native, N = 35, bilinear", dense, REFERENCE, fetch="bilinear"),
        GUERTIN.row("native, N = 15, bilinear", dense, few, fetch="bilinear", samples=15),
        GUERTIN.row("native, N = 35, one direction", dense, REFERENCE, directions="one"),
        GUERTIN.row("native, N = 35, 30 % of the tiles move", sparse, REFERENCE),
        GUERTIN.row("native, N = 35, nothing moves", still, REFERENCE),
        SLICES.row(LAYERED, dense, REFERENCE),
        SLICES.row(f"{LAYERED}, XLA", dense, LAYERED, backend="xla"),
        SLICES.row(f"{LAYERED}, bilinear", dense, LAYERED, fetch="bilinear"),
        SLICES.row(f"{LAYERED}, 30 % of the tiles move", sparse, LAYERED),
        SLICES.row(f"{LAYERED}, nothing moves", still, LAYERED),
    ]
    rows += published_rows(dense)
    for subject in (GUERTIN, SLICES):
        for fetch in ("nearest", "bilinear"):
            rows += subject.gradient_rows(dense, fetch)
    return rows


def measure(rows: list[Row], repeats: int) -> list[tuple[str, ...]]:
    """Time all rows in turn; the lines of the table. Ratios are those of processor time."""
    times = time_in_turn({row.name: row.run for row in rows}, repeats, settle=True)
    lines = []
    for row in rows:
        own, reference = times[row.name], times[row.reference]
        ratio = own.cpu_median / reference.cpu_median
        milliseconds = (f"{1e3 * own.median:.0f}", f"{1e3 * own.cpu_median:.0f}")
        temporaries = "" if row.temporaries is None else f"{row.temporaries:.0f}"
        lines.append((row.name, *milliseconds, f"{ratio:.2f}", row.reference, temporaries))
        print("  ".join(lines[-1]), flush=True)
    return lines


def fresh_processes(subject: Subject) -> list[tuple[str, ...]]:
    """Seconds of two fresh processes with one cache folder, empty at first."""
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"XDG_CACHE_HOME": folder}
        for name in (f"{subject.prefix}first process", f"{subject.prefix}second process"):
            command = [sys.executable, "-c", FRESH_PROCESS, subject.filter]
            done = subprocess.run(
                command, env=environment, check=True, capture_output=True, text=True
            )
            imported, blurred = map(float, done.stdout.split())
            ratio = f"{(imported + blurred) / imported:.2f}"
            total = f"{1e3 * (imported + blurred):.0f}"
            lines.append((f"{name}, until the first frame is blurred", total, "", ratio))
            lines[-1] += (f"its imports, {1e3 * imported:.0f} ms", "")
            print("  ".join(lines[-1]), flush=True)
    return lines


def main() -> None:
    """Parse the command line, measure, write."""
    parser = argparse.ArgumentParser(description="How quick guertin2014 and layered are.")
    parser.add_argument("-o", "--output", type=pathlib.Path, required=True, metavar="DIR")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--quick", action="store_true", help="a quarter of the size, 3 repeats")
    options = parser.parse_args()
    size = (SIZE[0] // 2, SIZE[1] // 2) if options.quick else SIZE
    lines = measure(make_rows(size), 3 if options.quick else options.repeats)
    options.output.mkdir(parents=True, exist_ok=True)
    lines += [*fresh_processes(GUERTIN), *fresh_processes(SLICES)]
    write_table(options.output, "speed", COLUMNS, lines)


if __name__ == "__main__":
    main()
