"""Frames per second from file to file, compared with reading and writing alone.

python -m experiments.009_throughput.run --frames 12
"""

import argparse
import csv
import dataclasses
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

import jaxblur
from jaxblur import exr, scenes
from jaxblur.batch import blur_batch
from jaxblur.sequence import Job, Stage, run_pipeline

HERE = Path(__file__).parent
SHUTTER = 0.5
DISTINCT = 3
"""Number of frames that are rendered; the others are copies of these."""
FILTER = ("--filter", "guertin2014")
MEMORY_COUNTS = (10, 60)


@dataclasses.dataclass(frozen=True)
class Row:
    """One measurement.

    Attributes:
        what: name of the measurement.
        seconds: wall time per frame.
        cpu: processor seconds per frame.
        note: additional figures.
    """

    what: str
    seconds: float
    cpu: float
    note: str = ""


def make_frames(folder: Path, count: int, size: tuple[int, int], parts: bool = False) -> Path:
    """Write frames of a catalogue scene with depth and vectors to both neighboring frames.

    Args:
        folder: output folder.
        count: number of frames.
        size: (height, width) in pixels.
        parts: write each pass as a part of its own, with normals and object colors, instead of one
            part with color, depth and vectors.

    Returns:
        Pattern of the file names.
    """
    scene = scenes.SCENES["gears"]()
    for frame in range(1, count + 1):
        path = folder / f"in.{frame:04d}.exr"
        if frame <= DISTINCT:
            sharp = scenes.render(scene, frame, SHUTTER, size, path=True)
            exr.write_frame(path, sharp, SHUTTER)
            if parts:
                divide_into_parts(path)
        else:
            path.write_bytes((folder / f"in.{1 + frame % DISTINCT:04d}.exr").read_bytes())
    return folder / "in.####.exr"


def divide_into_parts(path: Path) -> None:
    """Write a frame again as renderers do, each pass in a part, with further passes."""
    names = [channel.name for channel in exr.inspect(path).channels]
    planes = dict(zip(names, np.moveaxis(exr.read_channels(path, names), -1, 0), strict=True))
    down, right = np.gradient(np.minimum(planes["Z"], 1e3))
    further = {
        "Normal": dict(zip("XYZ", (right, down, np.ones_like(down)), strict=True)),
        "Albedo": {name: np.sqrt(planes[name]) for name in "RGB"},
    }
    passes = {
        "Combined": {name: planes[name] for name in "RGB"},
        "Depth": {"Z": planes["Z"]},
        "Vector": {name: values for name, values in planes.items() if "velocity" in name},
        **{name: {f"{name}.{c}": v for c, v in of.items()} for name, of in further.items()},
    }
    height, width = planes["Z"].shape
    specs = []
    for name, channels in passes.items():
        kind = "half" if name in ("Combined", "Albedo") else "float"
        spec = oiio.ImageSpec(width, height, len(channels), kind)
        spec.channelnames = tuple(channels)
        spec.attribute("compression", "zip")
        spec.attribute("oiio:subimagename", name)
        specs.append(spec)
    output = oiio.ImageOutput.create(str(path))
    assert output is not None and output.open(str(path), tuple(specs)), oiio.geterror()
    for number, channels in enumerate(passes.values()):
        if number:
            assert output.open(str(path), specs[number], "AppendSubimage"), output.geterror()
        pixels = np.stack(list(channels.values()), axis=-1).astype(np.float32)
        assert output.write_image(pixels), output.geterror()
    assert output.close(), output.geterror()


def measure_stages(folder: Path, count: int) -> Iterator[Row]:
    """Measure reading, writing, and both at once, without a filter, in the sequence pipeline."""
    (folder / "alone").mkdir()
    jobs = [
        Job(n, {"input": folder / f"in.{n:04d}.exr"}, (folder / f"alone/a.{n:04d}.exr",), *_ANY)
        for n in range(1, count + 1)
    ]
    kept = exr.read_buffers(jobs[0].inputs["input"])

    def read(job: Job, _: Any) -> np.ndarray:
        return exr.read_buffers(job.inputs["input"]).color

    def write(job: Job, image: Any) -> None:
        image = kept.color if image is None else image
        exr.write_image(job.outputs[0], image, like=job.inputs["input"])

    reading, writing = Stage("read", read, 2), Stage("write", write, 2)
    yield _timed("read alone, 2 threads", jobs, (reading,))
    yield _timed("write alone, 2 threads", jobs, (writing,))
    yield _timed("read and write, no filter: the limit", jobs, (reading, writing))


_ANY: Any = ("blur", "", {})


def _timed(what: str, jobs: Sequence[Job], stages: Sequence[Stage]) -> Row:
    wall, cpu = time.perf_counter(), time.process_time()
    for outcome in run_pipeline(jobs, stages):
        if outcome.error is not None:
            raise outcome.error
    count = len(jobs)
    return Row(what, (time.perf_counter() - wall) / count, (time.process_time() - cpu) / count)


def measure_filter(folder: Path) -> Row:
    """Measure the filter alone, in memory, as published."""
    frame = jaxblur.read_frame(folder / "in.0001.exr", shutter=SHUTTER)
    parameters = jaxblur.GuertinParameters()
    jaxblur.guertin2014(frame, parameters).block_until_ready()
    wall, cpu = time.perf_counter(), time.process_time()
    repeats = 5
    for _ in range(repeats):
        jaxblur.guertin2014(frame, parameters).block_until_ready()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return Row("guertin2014 alone, in memory", wall / repeats, cpu / repeats)


def measure_command(
    what: str, pattern: Path, count: int, cache: Path, options: Sequence[str] = ()
) -> Row:
    """Measure ``jaxblur blur`` from start to end, in its own process.

    Args:
        what: name of the measurement.
        pattern: pattern of the input files.
        count: number of frames to blur.
        cache: folder of compiled code.
        options: more arguments.

    Returns:
        The times, including the start. The note has the time of the first blur, which includes
        compilation, and the median.
    """
    with tempfile.TemporaryDirectory(dir=pattern.parent) as output:
        command = [sys.executable, "-m", "jaxblur", "blur", str(pattern), "--json", "-q", *FILTER]
        command += ["-o", f"{output}/out.####.exr", "--frames", f"1-{count}", *options]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        started = time.perf_counter()
        environment = os.environ | {"XDG_CACHE_HOME": str(cache)}
        outcome = subprocess.run(command, env=environment, capture_output=True, text=True)
        wall = time.perf_counter() - started
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if outcome.returncode:
        raise RuntimeError(outcome.stderr)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    times = [frame["seconds"] for frame in json.loads(outcome.stdout)["frames"]]
    slowest = max(each["blur"] for each in times)
    usual = float(np.median([each["blur"] for each in times]))
    note = f"{wall:.1f} s in all; first blur {slowest:.2f} s, median {usual:.2f} s"
    return Row(what, wall / count, cpu / count, note)


def measure_memory(folder: Path, size: tuple[int, int], cache: Path) -> list[Row]:
    """Measure the largest resident memory of runs of several lengths, each in its own process."""
    folder.mkdir()
    rows, pattern = [], make_frames(folder, max(MEMORY_COUNTS), size)
    for count in MEMORY_COUNTS:
        # `resource` would report the high-water mark of the parent, which is larger.
        code = (
            "import re, sys; from jaxblur.cli import main; main(sys.argv[1:]);"
            "print(re.search(r'VmHWM:\\s*(\\d+)', open('/proc/self/status').read())[1])"
        )
        with tempfile.TemporaryDirectory(dir=pattern.parent) as output:
            command = [sys.executable, "-c", code, "blur", str(pattern), "-q", *FILTER]
            command += ["-o", f"{output}/out.####.exr", "--frames", f"1-{count}"]
            environment = os.environ | {"XDG_CACHE_HOME": str(cache)}
            started = time.perf_counter()
            text = subprocess.run(
                command, env=environment, check=True, capture_output=True, text=True
            ).stdout
            wall = time.perf_counter() - started
        peak = int(text.split()[-1]) / 1024
        what = f"memory, {count} frames of {size[1]}x{size[0]}"
        rows.append(Row(what, wall / count, np.nan, f"{peak:.0f} MiB at most"))
    return rows


def measure_batches(size: tuple[int, int], chunks: Sequence[int]) -> Iterator[tuple[str, float]]:
    """Temporary memory of `blur_batch`, by XLA's account, in bytes per pixel of one frame.

    Args:
        size: (height, width) in pixels.
        chunks: chunk sizes.

    Yields:
        A label and the number of bytes.
    """
    import jax
    import jax.numpy as jnp

    frames = jaxblur.Frame(
        color=jnp.zeros((4, *size, 3)), depth=jnp.ones((4, *size)), velocity=jnp.ones((4, *size, 2))
    )
    settings = jaxblur.Settings(samples=35, radius=20)
    for chunk in chunks:

        def image(parameters: Any, frames: Any, chunk: int = chunk) -> jax.Array:
            return blur_batch("guertin2014", frames, parameters, settings=settings, chunk=chunk)

        def loss(parameters: Any, frames: Any, image: Any = image) -> jax.Array:
            return jnp.sum(image(parameters, frames) ** 2)

        for name, function in (("forward", image), ("reverse derivative", jax.grad(loss))):
            compiled = jax.jit(function).lower(jaxblur.GuertinParameters(), frames).compile()
            account: Any = compiled.memory_analysis()
            yield f"{name}, chunk {chunk}", account.temp_size_in_bytes / (size[0] * size[1])


def write_report(path: Path, rows: Sequence[Row]) -> None:
    """Write the measurements as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["what", "seconds a frame", "frames a second", "CPU s a frame", "note"])
        for row in rows:
            figures = f"{row.seconds:.3f}", f"{1 / row.seconds:.2f}", f"{row.cpu:.3f}"
            writer.writerow([row.what, *figures, row.note])


def main() -> None:
    """Measure everything and write the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--size", type=int, nargs=2, default=(1080, 1920), metavar=("H", "W"))
    parser.add_argument("--parts", action="store_true", help="each pass in a part of its own")
    parser.add_argument("--workers", type=int, nargs="*", default=(1, 2))
    parser.add_argument("-o", "--output", type=Path, default=HERE / "results.csv")
    arguments = parser.parse_args()
    size = (arguments.size[0], arguments.size[1])
    count, rows = arguments.frames, []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pattern, cache = make_frames(folder, count, size, arguments.parts), folder / "cache"
        steps: list[Any] = [lambda: list(measure_stages(folder, count))]
        steps.append(lambda: [measure_filter(folder)])
        for label in ("first process, nothing compiled", "second process"):
            steps.append(
                lambda label=label: [measure_command(f"blur, {label}", pattern, count, cache)]
            )
        for workers in arguments.workers:
            options = ("--scheduler", "local", "--workers", str(workers))
            steps.append(
                lambda w=workers, o=options: [
                    measure_command(
                        f"blur --scheduler local, workers {w}", pattern, count, cache, o
                    )
                ]
            )
        steps.append(lambda: measure_memory(folder / "small", (size[0] // 3, size[1] // 3), cache))
        for step in steps:
            for row in step():
                rows.append(row)
                print(f"{row.what}: {row.seconds:.3f} s per frame, CPU {row.cpu:.3f} s {row.note}")
    write_report(arguments.output, rows)
    for what, bytes_a_pixel in measure_batches((180, 320), (1, 2, 4)):
        print(f"blur_batch of 4 frames, {what}: {bytes_a_pixel:.0f} bytes per pixel of one frame")


if __name__ == "__main__":
    main()
