"""Run the command line inside a test."""

import contextlib
import io
import subprocess
import sys
from typing import NamedTuple

from jaxblur.cli import main

COMPUTING = ("blur", "demo", "doctor", "export", "fit", "jod", "layers", "play", "post", "scene")


class Outcome(NamedTuple):
    """Status and output of a command."""

    status: int
    out: str
    err: str


def run(*arguments):
    """Run a command in this process, without the compile cache, which is global to a process."""
    texts = [str(argument) for argument in arguments]
    if texts and texts[0] in COMPUTING:
        texts.append("--no-compile-cache")
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(texts)
    return Outcome(status, out.getvalue(), err.getvalue())


def refused(*arguments):
    """Run a command that must fail with status 2 and one line of error; return that line."""
    outcome = run(*arguments)
    assert outcome.status == 2, outcome
    errors = [line for line in outcome.err.splitlines() if line.startswith("jaxblur: error: ")]
    assert len(errors) == 1 and errors[0] == outcome.err.splitlines()[-1], outcome.err
    return errors[0]


def spawn(*arguments, code=None, **options):
    """Run ``python -m jaxblur``, or Python code, in a process of its own."""
    program = ["-c", code] if code else ["-m", "jaxblur"]
    return subprocess.run(
        [sys.executable, *program, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        **options,
    )
