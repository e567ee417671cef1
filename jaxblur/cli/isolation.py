"""``--isolate``: run a command in a process of its own, with limits of memory and time."""

import argparse
import json
import os
import signal
import subprocess
import sys
from typing import Any

from .arguments import CommandError, positive_integer

LARGE, EXPANSION = 500_000_000, 100
"""Bytes of pixels above which a file is read in isolation if it holds less than a hundredth."""
LEAST_MEMORY = 256
"""MB in which Python and the libraries start."""
CHILD = """
import json, os, resource, signal, sys, threading
sys.path[:], limits, argv, parent = map(json.loads, sys.argv[1:])
for name, (soft, hard) in limits.items():
    resource.setrlimit(getattr(resource, name), (soft, hard))
def end_with_parent():
    # The parent writes nothing: reading ends when its end of the pipe is closed.
    os.read(parent, 1)
    os.kill(os.getpid(), signal.SIGTERM)
threading.Thread(target=end_with_parent, daemon=True).start()
from jaxblur.cli import isolation, main
isolation.in_child = True
sys.exit(main(argv))
"""

in_child = False
"""Whether this process is the one with the limits."""


def add_options(parser: argparse.ArgumentParser, memory: int, seconds: int) -> None:
    """Add the options.

    Args:
        parser: of a command.
        memory: default limit in MB.
        seconds: default limit.
    """
    group = parser.add_argument_group("files that are not trusted")
    group.add_argument(
        "--isolate",
        action="store_true",
        default=None,
        help="run in a child process with limits of memory and time, so that a crafted file can "
        "crash or exhaust only that (not on Windows)",
    )
    group.add_argument(
        "--memory",
        type=_megabytes,
        default=memory,
        metavar="MB",
        help="memory of that process (default %(default)s)",
    )
    group.add_argument(
        "--time-limit",
        type=positive_integer,
        default=seconds,
        metavar="S",
        help="processor time of that process (default %(default)s)",
    )


def _megabytes(text: str) -> int:
    """Parse ``--memory``.

    Raises:
        ArgumentTypeError: the libraries alone would not fit.
    """
    value = positive_integer(text)
    if value < LEAST_MEMORY:
        raise argparse.ArgumentTypeError(f"expected at least {LEAST_MEMORY} MB, got {text}")
    return value


def declares_too_much(info: Any) -> bool:
    """Whether a file claims so much more than it holds that reading it calls for isolation.

    Args:
        info: a `jaxblur.exr.FileInfo`.
    """
    sizes = {"half": 2, "uint8": 1, "uint16": 2}
    claimed = sum(
        part.data_window[2] * part.data_window[3] * sum(sizes.get(c.type, 4) for c in part.channels)
        for part in info.parts
    )
    return claimed > max(LARGE, EXPANSION * os.path.getsize(info.path))


def run(arguments: argparse.Namespace) -> int:
    """Run a command in a child process with limits.

    Args:
        arguments: of the command, with ``argv``, the texts that they were parsed from.

    Returns:
        The exit status of the child.

    Raises:
        CommandError: the child crashed, or a limit ended it; or the system has no such limits.
    """
    if os.name == "nt":
        raise CommandError("--isolate: Windows has no such limits; leave it out.")
    memory, seconds = arguments.memory * 1_000_000, arguments.time_limit
    limits = {
        "RLIMIT_CORE": (0, 0),
        "RLIMIT_DATA": (memory, memory),
        # The first ends the process with SIGXCPU, which tells this end from others.
        "RLIMIT_CPU": (seconds, seconds + 5),
    }
    argv = [text for text in arguments.argv if text != "--isolate"]
    sys.stdout.flush()
    read, write = os.pipe()
    # Modules come from where this process has them, not from the working folder.
    given = map(json.dumps, (sys.path, limits, argv, read))
    try:
        with subprocess.Popen(
            [sys.executable, "-P", "-c", CHILD, *given], pass_fds=[read]
        ) as child:
            try:
                status = child.wait()
            except BaseException:
                child.terminate()
                raise
    finally:
        os.close(read)
        os.close(write)
    if status >= 0:
        return status
    file = arguments.file if "file" in arguments else arguments.input
    if -status == signal.SIGXCPU:
        raise CommandError(
            f"{file}: took more than {arguments.time_limit} s of processor time; if you trust the "
            "file, pass a larger --time-limit."
        )
    raise CommandError(
        f"{file}: reading it crashed ({signal.Signals(-status).name}), perhaps at the limit of "
        f"{arguments.memory} MB; the file is damaged or crafted, or needs a larger --memory."
    )
