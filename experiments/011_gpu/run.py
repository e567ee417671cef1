"""The filters on a GPU: are results the same as on the CPU, and how far are times from a floor?

    python experiments/011_gpu/run.py -o OUT                          # on a machine with a GPU
    python experiments/011_gpu/run.py -o OUT --filters layered        # one at a time
    python experiments/011_gpu/run.py -o OUT --allow-cpu --quick      # shows that the script works

Needs jax, numpy and the core of jaxblur; no image library. First compares images and derivatives of
every filter on the device with the CPU in float64. Then times forward pass and gradient, for one
frame and for batches of eight. Those of guertin2014 stand beside the floor, a lower bound of the
time: the larger of compulsory bytes over the measured bandwidth of a copy, and operations over the
measured rate of multiply-adds. Writes results.csv and results.md.
"""

import argparse
import csv
import dataclasses
import datetime
import functools
import itertools
import pathlib
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

# Lets the script run from the root folder without installing the package.
sys.path.insert(0, str(pathlib.Path(__file__).parents[2]))

import jaxblur
from jaxblur.bench.frames import moving_frame
from jaxblur.bench.timing import Timing, time_in_turn
from jaxblur.filters import filter_info

COUNTED = "guertin2014"
"""The filter whose operations are counted, and for which there are goals."""
BYTES_PER_PIXEL = 40
"""Color in and out (24), depth (4), velocity (8), noise (4): read or written once in float32."""
OPERATIONS_PER_TAP = 110
"""Counted by hand in the source of the filter; a multiply-add counts as two."""
TOLERANCE, SHARE = 1e-3, 1e-3
"""Colors in 0..1 may differ by more than the tolerance in this share of the pixels: a tap within
rounding error of the border between two texels may read either texel."""
DERIVATIVE = 0.05
"""Largest relative difference of a derivative."""
GOALS = {(720, 35): 0.2, (1080, 35): 0.45, (2160, 35): 2.2}
"""Milliseconds for one frame, forward, by height and samples."""


class Extent(NamedTuple):
    """Extent of a run: sizes, samples, batches, repeats, runs queued for one timing.

    Filters other than `COUNTED` are run with the numbers of samples in ``usual``.
    """

    sizes: Sequence[tuple[int, int]]
    samples: Sequence[int]
    usual: Sequence[int]
    batches: Sequence[int]
    repeats: int
    queued: int


FULL = Extent(((720, 1280), (1080, 1920), (2160, 3840)), (15, 25, 35, 47), (35,), (1, 8), 15, 10)
QUICK = Extent(((180, 320),), (15,), (15,), (1, 2), 3, 1)


class Floor(NamedTuple):
    """Measured limits of the device: bytes and operations per second."""

    bandwidth: float
    rate: float

    def milliseconds(self, pixels: int, samples: int) -> float:
        """Lower bound of the time of one frame: the larger of memory and arithmetic."""
        memory = pixels * BYTES_PER_PIXEL / self.bandwidth
        arithmetic = pixels * samples * OPERATIONS_PER_TAP / self.rate
        return 1e3 * max(memory, arithmetic)


def find_device(allow_cpu: bool) -> Any:
    """The accelerator, or the CPU if there is none and it is allowed.

    Raises:
        SystemExit: there is no accelerator, and the CPU is not allowed.
    """
    device = jax.devices()[0]
    if device.platform == "cpu" and not allow_cpu:
        raise SystemExit(
            "jax sees no GPU: install jaxblur[cuda12] or [cuda13]; --allow-cpu runs on the CPU."
        )
    return device


class Program(NamedTuple):
    """A filter with its settings.

    Attributes:
        filter: its name.
        settings: of the filter.
    """

    filter: str
    settings: jaxblur.Settings

    @classmethod
    def of(cls, name: str, **settings: Any) -> "Program":
        """A filter with its own settings but for some."""
        return cls(name, dataclasses.replace(filter_info(name).make_settings(), **settings))

    def blur(self, values: Any, frame: jaxblur.Frame, noise: jaxblur.Noise) -> jax.Array:
        """The blurred frame; ``values`` as `values_of` gives them."""
        info = filter_info(self.filter)
        parameters = {name: value for name, value in values.items() if name != "motion"}
        frame = frame.replace(velocity=frame.velocity * values["motion"])
        return info.call(
            frame, info.make_parameters(**parameters), settings=self.settings, noise=noise
        )

    def loss(self, values: Any, frame: jaxblur.Frame, noise: jaxblur.Noise) -> jax.Array:
        """Mean square of the blurred frame."""
        return jnp.mean(jnp.square(self.blur(values, frame, noise)))

    def values_of(self) -> dict[str, jax.Array]:
        """What is differentiated: the parameters, and a factor of all velocities."""
        values = filter_info(self.filter).defaults
        return {name: jnp.asarray(value, float) for name, value in {**values, "motion": 1}.items()}


class Outcome(NamedTuple):
    """An image and derivatives, in float64."""

    image: np.ndarray
    derivatives: dict[str, float]


def outcome(device: Any, dtype: str, program: Program, size: tuple[int, int]) -> Outcome:
    """Blur a frame on a device."""
    generator = np.random.default_rng(0)
    tap = generator.uniform(-1, 1, size)
    tile = generator.uniform(-0.5, 0.5, (*size, 2))
    frame = moving_frame(*size)
    with jax.default_device(device), jax.enable_x64(dtype == "float64"):
        frame = jax.tree.map(lambda a: jnp.asarray(np.asarray(a), dtype), frame)
        noise = jaxblur.Noise(jnp.asarray(tap, dtype), jnp.asarray(tile, dtype))
        values = program.values_of()
        image = jax.jit(program.blur)(values, frame, noise)
        gradient = jax.jit(jax.grad(program.loss))(values, frame, noise)
        derivatives = {name: float(value) for name, value in gradient.items()}
        return Outcome(np.asarray(image, np.float64), derivatives)


def worst_derivative(found: Outcome, expected: Outcome) -> float:
    """The largest relative difference; derivatives below a hundredth of the largest count as it."""
    least = 0.01 * max(map(abs, expected.derivatives.values()))
    return max(
        abs(found.derivatives[name] - value) / max(abs(value), least)
        for name, value in expected.derivatives.items()
    )


def check(device: Any, filters: Sequence[str], size: tuple[int, int]) -> list[tuple[str, ...]]:
    """Compare the device with the CPU in float64.

    Returns:
        One row for each filter, fetch and precision: worst difference, share of pixels beyond the
        tolerance, worst relative difference of a derivative.

    Raises:
        SystemExit: the results differ too much.
    """
    rows, cpu = [], jax.devices("cpu")[0]
    for name, fetch in itertools.product(filters, ("nearest", "bilinear")):
        on_device = Program.of(name, fetch=fetch, samples=15, radius=20)
        plain = Program.of(name, fetch=fetch, samples=15, radius=20, backend="xla")
        expected = outcome(cpu, "float64", plain, size)
        for dtype in ("float64", "float32"):
            found = outcome(device, dtype, on_device, size)
            difference = np.abs(found.image - expected.image).max(axis=-1)
            share = float(np.mean(~(difference <= TOLERANCE)))
            relative = worst_derivative(found, expected)
            rows.append(
                (name, fetch, dtype, f"{difference.max():.2g}", f"{share:.2g}", f"{relative:.2g}")
            )
            print("  ".join(("correctness", *rows[-1])), flush=True)
            if share > SHARE or not relative < DERIVATIVE:
                raise SystemExit(f"{device.device_kind} differs from the CPU: {rows[-1]}")
    return rows


def measure_floor(device: Any, quick: bool) -> Floor:
    """Measure the bandwidth of a copy and the rate of multiply-adds."""
    numbers = (1 << 22) if quick else (1 << 27)
    data = jax.device_put(jnp.arange(numbers, dtype=jnp.float32), device)
    steps, chains = 64, 8
    small = data[: numbers // 32]

    @jax.jit
    def arithmetic(x: jax.Array) -> jax.Array:
        # Several chains, because each step of a single chain would wait for the step before.
        values = [x + chain for chain in range(chains)]
        for _ in range(steps):
            values = [value * 0.999 + 0.001 for value in values]
        return functools.reduce(jnp.add, values)

    copy = jax.jit(lambda x: x + 1)
    runs = {"copy": lambda: copy(data), "arithmetic": lambda: arithmetic(small)}
    times = time_in_turn({k: _waiting(run, 4) for k, run in runs.items()}, 7)
    bandwidth = 4 * 2 * data.nbytes / times["copy"].median
    operations = 4 * 2 * steps * chains * small.size
    return Floor(bandwidth, operations / times["arithmetic"].median)


def _waiting(run: Callable[[], Any], queued: int) -> Callable[[], Any]:
    """Queue several runs on the device, then wait: launches overlap with the work."""

    def wait() -> Any:
        for _ in range(queued - 1):
            run()
        return jax.block_until_ready(run())

    return wait


def measure(
    filters: Sequence[str], size: tuple[int, int], batch: int, extent: Extent, floor: Floor
) -> list[tuple[str, ...]]:
    """Time forward and gradient of every filter for every number of samples, in turn."""
    frame = moving_frame(*size)
    noise = jaxblur.Noise(jnp.zeros(size), jnp.zeros((*size, 2)))
    frames = jax.tree.map(lambda buffer: jnp.stack([buffer] * batch), frame)
    runs: dict[str, Callable[[], Any]] = {}
    compiled: dict[str, tuple[tuple[str, int, str], tuple[Any, float]]] = {}
    for name in filters:
        counts = extent.samples if name == COUNTED else extent.usual
        for samples, kind in itertools.product(counts, ("forward", "gradient")):
            program = Program.of(name, samples=samples, noise="none")
            one = program.blur if kind == "forward" else jax.value_and_grad(program.loss)
            arguments = program.values_of(), frames if batch > 1 else frame, noise
            started = time.perf_counter()
            several = jax.vmap(one, (None, 0, None)) if batch > 1 else one
            ready = jax.jit(several).lower(*arguments).compile()
            label = f"{name} {samples} {kind}"
            compiled[label] = (name, samples, kind), (ready, time.perf_counter() - started)
            runs[label] = _waiting(functools.partial(ready, *arguments), extent.queued)
    times = time_in_turn(runs, extent.repeats)
    return [
        _row(size, batch, key, times[label], program, extent.queued, floor)
        for label, (key, program) in compiled.items()
    ]


def _row(
    size: tuple[int, int],
    batch: int,
    key: tuple[str, int, str],
    timing: Timing,
    compiled: tuple[Any, float],
    queued: int,
    floor: Floor,
) -> tuple[str, ...]:
    height, width = size
    name, samples, kind = key
    program, compile_seconds = compiled
    per_frame = 1e3 * timing.median / queued / batch
    counted = name == COUNTED
    least = floor.milliseconds(height * width, samples)
    goal = GOALS.get((height, samples)) if counted and kind == "forward" and batch == 1 else None
    met = "" if goal is None else f"{goal:g}: {'met' if per_frame < goal else 'missed'}"
    temporary = program.memory_analysis().temp_size_in_bytes / 1e6
    row = (
        *(name, f"{width}x{height}", str(batch), str(samples), kind),
        f"{per_frame:.3f}",
        f"{1e3 * timing.spread / queued / batch:.3f}",
        f"{least:.3f}" if counted else "",
        f"{per_frame / least:.1f}" if counted else "",
        met,
        f"{temporary:.0f}",
        f"{compile_seconds:.1f}",
    )
    print("  ".join(row), flush=True)
    return row


CHECKED = ("filter", "fetch", "precision", "worst", "share beyond 0.001", "derivative, relative")
COLUMNS = (
    "filter",
    "size",
    "batch",
    "samples",
    "what",
    "ms per frame",
    "IQR",
    "floor ms",
    "times the floor",
    "goal ms",
    "temporaries MB",
    "compile s",
)


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def describe(device: Any, floor: Floor) -> str:
    """Describe the run: date, device, versions, measured limits."""
    return (
        f"{datetime.date.today().isoformat()}, {device.device_kind} ({device.platform}), "
        f"jax {jax.__version__}, jaxblur {jaxblur.__version__}. Measured: "
        f"{floor.bandwidth / 1e9:.0f} GB/s, {floor.rate / 1e12:.2f} TFLOP/s.\n"
    )


def main() -> None:
    """Check, measure, and write the tables."""
    parser = argparse.ArgumentParser(description="The filters on a GPU.")
    parser.add_argument("-o", "--output", type=pathlib.Path, required=True, metavar="OUT")
    parser.add_argument("--allow-cpu", action="store_true", help="run where there is no GPU")
    parser.add_argument("--quick", action="store_true", help="one small size")
    parser.add_argument(
        "--filters", nargs="+", choices=list(jaxblur.FILTERS), default=list(jaxblur.FILTERS)
    )
    options = parser.parse_args()
    device = find_device(options.allow_cpu)
    extent = QUICK if options.quick else FULL
    checks = check(device, options.filters, (90, 160) if options.quick else (360, 640))
    floor = measure_floor(device, options.quick)
    head = describe(device, floor), table(CHECKED, checks)
    rows: list[tuple[str, ...]] = []
    for size, batch in itertools.product(extent.sizes, extent.batches):
        rows += measure(options.filters, size, batch, extent, floor)
        # After each, so that a case that does not fit into memory takes nothing with it.
        write(options.output, head, rows)


def write(folder: pathlib.Path, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Write what has been measured so far."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "results.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])
    text = "\n".join((*head, table(COLUMNS, rows)))
    (folder / "results.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
