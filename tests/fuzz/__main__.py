"""Try the corpus and mutants of it on the command line.

    python -m tests.fuzz [--seed 1] [--count 1000] [--keep FOLDER] [--corpus FOLDER]

Prints each file that broke a rule (`tests.fuzz.rules`), keeps it in FOLDER, and exits with 1 if
there was one. A file that is worth keeping goes into the corpus as ``mutant_WHAT.exr``.
"""

import argparse
import collections
import contextlib
import json
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from tests.fuzz import mutants
from tests.fuzz.make_corpus import CORPUS

SECONDS = 60.0
"""Limit for all commands on one file, on a machine that others use too."""
START = 300.0
"""Limit for the start of a process."""


class Child:
    """A process that tries files; see `tests.fuzz.rules.serve`."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.rules"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=Path(__file__).parents[2],
        )
        self._lines: queue.Queue[str] = queue.Queue()
        self._reader = threading.Thread(target=self._pump, daemon=True)
        self._reader.start()
        assert self._answer(START) == "ready\n", "the process does not start"

    def _pump(self) -> None:
        assert self._process.stdout
        for line in self._process.stdout:
            self._lines.put(line)
        self._lines.put("")

    def _answer(self, seconds: float) -> str:
        return self._lines.get(timeout=seconds)

    def check(self, file: Path, seconds: float = SECONDS) -> dict[str, Any]:
        """As `tests.fuzz.rules.check`; a crash or a hang is a broken rule, and ends the child."""
        assert self._process.stdin
        try:
            self._process.stdin.write(json.dumps(str(file)) + "\n")
            self._process.stdin.flush()
            line = self._answer(seconds)
        except queue.Empty:
            self.close()
            return {"broken": [f"took more than {seconds:g} s"], "outcomes": {}}
        except BrokenPipeError:
            line = ""
        if line:
            return json.loads(line)
        self.close()
        return {"broken": [f"the process died: {self._process.returncode}"], "outcomes": {}}

    def is_alive(self) -> bool:
        """Whether it can take another file."""
        return self._process.poll() is None

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        self._reader.join()
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(BrokenPipeError):
                pipe.close()  # type: ignore[union-attr]


def check_all(files: Iterable[tuple[str, bytes]]) -> Iterator[tuple[str, bytes, dict[str, Any]]]:
    """Try files by name and contents, each alone in a folder.

    Yields:
        Name, contents, and the result of `tests.fuzz.rules.check`.
    """
    child = Child()
    try:
        for name, data in files:
            if not child.is_alive():
                child = Child()
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder, "damaged.exr")
                file.write_bytes(data)
                yield name, data, child.check(file)
    finally:
        child.close()


def main() -> int:
    """Try the corpus and the mutants; see the module."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description="Fuzz the EXR reader."
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=1000, help="number of mutants")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="for files that break a rule")
    parser.add_argument("--corpus", type=Path, metavar="FOLDER", default=CORPUS)
    options = parser.parse_args()
    corpus = sorted(options.corpus.glob("*.exr"))
    stored = [(path.name, path.read_bytes()) for path in corpus]
    made = (
        (f"seed {options.seed} number {number}: {name}", data)
        for number in range(options.count)
        for name, data in [mutants.make(corpus, options.seed, number)]
    )
    counts, wrong = collections.Counter(), 0
    for files in (stored, made):
        for name, data, result in check_all(files):
            counts.update(f"{command} {status}" for command, status in result["outcomes"].items())
            if not result["broken"]:
                continue
            wrong += 1
            print(name, *result["broken"], sep="\n    ", flush=True)
            if options.keep:
                options.keep.mkdir(parents=True, exist_ok=True)
                (options.keep / f"wrong_{options.seed}_{wrong}.exr").write_bytes(data)
    print(", ".join(f"{what}: {count}" for what, count in sorted(counts.items())))
    print(f"{wrong} of {len(stored) + options.count} files broke a rule")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
