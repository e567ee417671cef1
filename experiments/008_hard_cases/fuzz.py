"""Does a damaged EXR always give one clear error or a finite result?

    python experiments/008_hard_cases/fuzz.py -o OUT [--count 5000] [--seed 1]

Each damaged file goes through ``jaxblur info``, and is read, checked and written as by
``jaxblur blur``, in worker processes with a memory limit and a watchdog. Every tenth file that
could be read also goes through ``jaxblur blur`` itself. Writes fuzz.csv and fuzz.md.
"""

import argparse
import collections
import contextlib
import importlib
import io
import json
import os
import queue
import resource
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2]))

import numpy as np

from jaxblur import exr
from jaxblur.cli import main as command_line

mutations = importlib.import_module("experiments.008_hard_cases.mutations")

SECONDS, MEMORY_MB = 20.0, 1024
"""Limits for one file: seconds, and address space above that of an idle process."""

GOOD = ("refused", "read")
COLUMNS = ("damage", "files", "refused by info", "refused by blur", "read, finite", "wrong")


def damaged_file(originals: Sequence[Path], seed: int, number: int) -> tuple[str, str, bytes]:
    """The damaged file with this number: name of the original, kind of damage, content."""
    generator = np.random.default_rng((seed, number))
    original = originals[number % len(originals)]
    return original.stem, *mutations.mutate(original.read_bytes(), generator)


def check(path: Path, folder: Path, whole: bool = False) -> dict[str, Any]:
    """Put one file through ``info`` and through reading and writing.

    Args:
        path: a damaged file.
        folder: folder for the output, without hidden files.
        whole: run ``jaxblur blur`` itself, which loads jax, instead of reading and writing.

    Returns:
        The outcomes of ``info`` and ``blur``: "refused", "read", or a description of the failure.
    """
    output = folder / "out.exr"
    info = _command("info", str(path))
    if whole:
        quick = ("--filter", "pixel_velocity", "--samples", "3", "--no-compile-cache")
        blur = _command("blur", str(path), "-o", str(output), *quick)
    else:
        blur = _read_and_write(path, output)
    if blur == "read" and not output.exists():
        blur = "no output"
    elif blur == "read":
        blur = _judge(output)
    elif output.exists():
        blur = "partial output"
    output.unlink(missing_ok=True)
    left = [name for name in os.listdir(folder) if name.startswith(".")]
    return {"info": info, "blur": f"left {left}" if left else blur}


def _command(*arguments: str) -> str:
    """Run a command in this process: "read", "refused", or a description of the failure."""
    out = io.StringIO()
    with _captured_errors() as err, contextlib.redirect_stdout(out):
        try:
            status = command_line(arguments)
        except Exception as error:
            return f"raised {type(error).__name__}: {error}"
        err.seek(0)
        said = err.read()
    for text in (out.getvalue(), said):
        if any(not (c.isprintable() or c == "\n") for c in text):
            return "control characters in the output"
    errors = said.count("jaxblur: error: ")
    if status == 2 and errors == 1:
        return "refused"
    return "read" if status == 0 and errors == 0 else f"status {status}, {errors} errors"


@contextlib.contextmanager
def _captured_errors() -> Iterator[Any]:
    """Collect what this process and its children write to stderr.

    The command reads a file in a child process if its header claims far more than the file holds.
    """
    kept = os.dup(2)
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as file:
        os.dup2(file.fileno(), 2)
        try:
            with contextlib.redirect_stderr(file):
                yield file
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def _read_and_write(path: Path, output: Path) -> str:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            buffers = exr.read_buffers(path)
            if not _is_sound(buffers):
                return "unsound buffers"
            exr.write_image(output, buffers.color, like=path)
    except exr.JaxblurIOError as error:
        return "refused" if str(error).isprintable() else "control characters in the error"
    except Exception as error:
        return f"raised {type(error).__name__}: {error}"
    return "read"


def _is_sound(buffers: Any) -> bool:
    finite = all(np.isfinite(values).all() for values in (buffers.color, buffers.velocity))
    return finite and bool((buffers.depth > 0).all()) and np.abs(buffers.velocity).max() <= 1e6


def _judge(output: Path) -> str:
    try:
        return "read" if np.isfinite(exr.read_image(output)).all() else "output is not finite"
    except exr.JaxblurIOError as error:
        return f"output is damaged: {error}"


def work(corpus: Path, seed: int, numbers: Sequence[int], whole: bool) -> None:
    """Check files by number within the memory limit; print one line of JSON for each."""
    originals = sorted(corpus.glob("*.exr"))
    # The htj2k decoder prints its own remarks to stdout.
    records = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    # Libraries that the first call loads do not count against the limit.
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "first.exr").write_bytes(originals[-1].read_bytes())
        check(Path(name) / "first.exr", Path(name), whole)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_MB * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    with tempfile.TemporaryDirectory() as name:
        for number in numbers:
            kind, way, data = damaged_file(originals, seed, number)
            path = Path(name) / "damaged.exr"
            path.write_bytes(data)
            started = time.perf_counter()
            found = check(path, Path(name), whole)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
            seconds = time.perf_counter() - started
            record = {"number": number, "file": kind, "way": way, **found}
            record |= {"seconds": seconds, "peak_mb": peak}
            print(json.dumps(record), file=records, flush=True)


def supervise(
    corpus: Path, seed: int, numbers: Sequence[int], whole: bool = False
) -> Iterator[dict[str, Any]]:
    """Run workers over the numbers; a worker that dies or hangs fails one file and is replaced.

    Args:
        corpus: folder of undamaged files.
        seed: seed of the damage.
        numbers: numbers of the damaged files.
        whole: as `check`.

    Yields:
        One record for each number.
    """
    originals = sorted(corpus.glob("*.exr"))
    left = list(numbers)
    while left:
        for record in _one_worker(corpus, seed, list(left), whole):
            yield record
            left.remove(record["number"])
            if "died" in record["blur"] or "hung" in record["blur"]:
                break
        else:
            if left:
                kind, way, _ = damaged_file(originals, seed, left[0])
                lost = {"number": left.pop(0), "file": kind, "way": way}
                yield lost | {"info": "died", "blur": "died", "seconds": 0.0, "peak_mb": 0}


def _one_worker(
    corpus: Path, seed: int, numbers: Sequence[int], whole: bool
) -> Iterator[dict[str, Any]]:
    """Records of one worker; the last one says "hung" if the worker had to be stopped."""
    command = [sys.executable, __file__, "--worker", str(corpus), "--seed", str(seed)]
    worker = subprocess.Popen(
        [*command, *(["--whole"] if whole else [])],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        # The htj2k decoder prints to stderr too.
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert worker.stdin and worker.stdout
    worker.stdin.write(json.dumps(list(numbers)))
    worker.stdin.close()
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_pump, args=(worker.stdout, lines), daemon=True).start()
    wait = 120.0
    for number in numbers:
        try:
            line = lines.get(timeout=wait)
        except queue.Empty:
            worker.kill()
            yield {"number": number, "file": "?", "way": "?", "info": "hung", "blur": "hung"} | {
                "seconds": wait,
                "peak_mb": 0,
            }
            break
        if not line:
            break
        yield json.loads(line)
        wait = SECONDS
    worker.kill()
    worker.wait()
    worker.stdout.close()


def _pump(stream: Any, lines: "queue.Queue[str]") -> None:
    with contextlib.suppress(ValueError):
        for line in stream:
            lines.put(line)
    lines.put("")


def is_good(record: dict[str, Any]) -> bool:
    """Whether a file was cleanly rejected or read."""
    return record["info"] in GOOD and record["blur"] in GOOD


def table(records: Sequence[dict[str, Any]]) -> list[tuple[Any, ...]]:
    """Rows for `COLUMNS`, one for each kind of damage and one for all."""
    by_way = collections.defaultdict(list)
    for record in records:
        by_way[record["way"]].append(record)
        by_way["all"].append(record)
    rows = []
    for way in (*sorted(set(by_way) - {"all"}), "all"):
        found = by_way[way]
        counts = (
            sum(record["info"] == "refused" for record in found),
            sum(record["blur"] == "refused" for record in found),
            sum(record["blur"] == "read" for record in found),
            sum(not is_good(record) for record in found),
        )
        rows.append((way, len(found), *counts))
    return rows


def make_corpus(folder: Path) -> None:
    """Write undamaged files of every kind, and copy the frames of the tests."""
    mutations.write_corpus(folder)
    for path in (Path(__file__).parents[2] / "tests" / "data").glob("*.exr"):
        (folder / path.name).write_bytes(path.read_bytes())


def main() -> None:
    """Damage files, check them, and write the table."""
    parser = argparse.ArgumentParser(description="Fuzz reading and writing.")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR")
    parser.add_argument("--count", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--whole", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        work(options.worker, options.seed, json.loads(sys.stdin.read()), options.whole)
        return
    if options.output is None:
        parser.error("give a folder with -o")
    from experiments.common import write_table

    options.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        make_corpus(Path(name))
        records = list(supervise(Path(name), options.seed, range(options.count)))
        again = [r["number"] for r in records if r["blur"] == "read"][::10]
        blurred = list(supervise(Path(name), options.seed, again, whole=True))
    write_table(options.output, "fuzz", COLUMNS, table(records))
    for record in (*records, *blurred):
        if not is_good(record):
            print(record)
    slowest = max(record["seconds"] for record in records)
    peak = max(record["peak_mb"] for record in records)
    done = sum(record["blur"] == "read" for record in blurred)
    wrong = sum(not is_good(record) for record in blurred)
    print(f"slowest {slowest:.2f} s, peak {peak} MB; blurred {done} of {len(again)}, {wrong} wrong")


if __name__ == "__main__":
    main()
