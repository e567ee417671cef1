"""What commands must keep with any file, and a process in which they are tried.

The process reads a path a line and answers with a line of JSON: the rules that the file broke, and
the outcome of each command.
"""

import json
import os
import resource
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jaxblur.cli import main
from tests.fuzz.make_corpus import frame, write_single

MEMORY = 1 << 30
"""Bytes of address space that a file may take above an idle process."""
PRINTED = 200_000
"""Bytes that a command may print about one file."""
BLUR = ("--filter", "pixel_velocity", "--samples", "3", "--backend", "xla", "--no-compile-cache")


@contextmanager
def printed_to(path: Path) -> Iterator[None]:
    """What this process, its libraries and its children print goes to a file."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = os.dup(1), os.dup(2)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    try:
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for target, old in zip((1, 2), kept, strict=True):
            os.dup2(old, target)
            os.close(old)
        os.close(descriptor)


def broken_rules(status: Any, printed: bytes, file: Path) -> list[str]:
    """The rules that one command broke.

    Args:
        status: its exit status.
        printed: everything that was printed.
        file: the file that it was given.
    """
    text = printed.decode("utf-8", "replace")
    lines = text.split("\n")
    errors = [line for line in lines if "error: " in line and line.startswith("jaxblur")]
    broken = []
    if status not in (0, 1, 2):
        broken.append(f"exit status {status}")
    if "Traceback (most recent call last)" in text:
        broken.append(f"a traceback: {text[-2000:]}")
    if (status == 2) != (len(errors) == 1) or len(errors) > 1:
        broken.append(f"exit status {status} with {len(errors)} errors: {text[-500:]!r}")
    if errors and file.name not in errors[0]:
        broken.append(f"an error without the file's name: {errors[0]!r}")
    if any(not (c.isprintable() or c == "\n") for line in errors for c in line):
        broken.append(f"control characters in an error: {errors!r}")
    if len(printed) > PRINTED:
        broken.append(f"{len(printed)} bytes printed")
    return broken


def check(file: Path) -> dict[str, Any]:
    """Try the commands on one file, alone in its folder.

    Returns:
        "broken", rules by the command that broke them; "outcomes", exit status by command.
    """
    commands: dict[str, tuple[str, ...]] = {
        "info": ("info", str(file)),
        "json": ("info", str(file), "--json"),
        "blur": ("blur", str(file), "-o", str(file.with_name("out.exr")), *BLUR),
        "blur --drop-extra": (
            *("blur", str(file), "-o", str(file.with_name("color.exr")), "--drop-extra"),
            *("--nonfinite", "ignore", *BLUR),
        ),
    }
    before = file.read_bytes()
    broken, outcomes = [], {}
    with tempfile.NamedTemporaryFile() as log:
        for name, command in commands.items():
            status: Any
            with printed_to(Path(log.name)):
                try:
                    status = main(command)
                except BaseException as error:
                    status = f"{type(error).__name__}: {error}"
            outcomes[name] = status
            printed = Path(log.name).read_bytes()
            found = broken_rules(status, printed, file)
            if name.startswith("blur"):
                written = sorted({path.name for path in file.parent.iterdir()} - {file.name})
                expected = [Path(command[3]).name] if status == 0 else []
                if written != expected:
                    found.append(f"exit status {status} left the files {written}")
                for path in written:
                    file.with_name(path).unlink()
            broken += [f"{name}: {rule}" for rule in found]
    if file.read_bytes() != before:
        broken.append("the file was changed")
    return {"broken": broken, "outcomes": outcomes}


def serve() -> None:
    """Answer until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    with tempfile.TemporaryDirectory() as folder:
        # What the libraries take once does not count against the limit.
        check(write_single(Path(folder, "first.exr"), frame()))
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    print("ready", file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(check(Path(json.loads(line)))), file=answers, flush=True)


if __name__ == "__main__":
    serve()
