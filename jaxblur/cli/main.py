"""Entry point: the parser of all commands, logging, and errors as one line."""

import contextlib
import io
import logging
import os
import sys
import traceback
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jaxblur
from jaxblur._util.text import one_line, printable

from . import shutter
from .arguments import Parser, in_option_names
from .commands import (
    bench,
    blur,
    demo,
    doctor,
    export,
    fit,
    info,
    integrate,
    jod,
    layers,
    play,
    post,
    report,
    scene,
    study,
    vectors,
    votes,
)
from .errors import is_foreseeable, message_of, place_in_filter
from .interrupts import never_lost, with_termination

LOG = logging.getLogger("jaxblur")
COMMANDS = (
    *(blur, fit, layers, post, info, vectors, report, demo, scene, bench),
    *(export, integrate, jod, play, study, votes, doctor),
)

USAGE = 2
INTERRUPTED = 130
TERMINATED = 143
BROKEN_PIPE = 141


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: arguments after the program's name; those of the process if None.

    Returns:
        The exit status.

    Raises:
        SystemExit: ``--help`` and ``--version``, with status 0.
    """
    options: dict[str, Any] = {}
    with _diagnostics(options), never_lost(), with_termination() as terminated:
        try:
            arguments = build_parser().parse_args(argv)
            shutter.resolve(arguments)
            options |= vars(arguments)
            arguments.argv = list(sys.argv[1:] if argv is None else argv)
            LOG.setLevel(_level(arguments.verbose, arguments.quiet))
            status = arguments.run(arguments)
            sys.stdout.flush()
            return status
        except KeyboardInterrupt as interruption:
            LOG.error("%s", str(interruption) or "interrupted")
            return TERMINATED if terminated else INTERRUPTED
        except BrokenPipeError:
            _discard_stdout()
            return BROKEN_PIPE
        except Exception as error:
            if not is_foreseeable(error):
                raise
            if options.get("verbose", 0) > (0 if place_in_filter(error) else 1):
                LOG.debug("%s", traceback.format_exc().rstrip())
            LOG.error("%s", in_option_names(message_of(error), options))
            return USAGE


def build_parser() -> Parser:
    """Make the parser of all commands."""
    parser = Parser(prog="jaxblur", description="Motion blur for rendered frames, in JAX.")
    parser.add_argument("--version", action="version", version=f"%(prog)s {jaxblur.__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add_parser(commands)
    return parser


class _LineFormatter(logging.Formatter):
    """``jaxblur: message``, with the level from warnings upward."""

    def format(self, record: logging.LogRecord) -> str:
        level = f"{record.levelname.lower()}: " if record.levelno >= logging.WARNING else ""
        text = record.getMessage()
        if record.levelno > logging.DEBUG:
            return f"jaxblur: {level}{one_line(text)}"
        # A traceback keeps its lines.
        return "\n".join(map(printable, f"jaxblur: {text}".splitlines()))


@contextlib.contextmanager
def _diagnostics(options: Mapping[str, Any]) -> Iterator[None]:
    """Send log records and warnings to stderr while a command runs."""

    def log_warning(message: Warning | str, *_: Any) -> None:
        LOG.warning("%s", in_option_names(str(message), options))

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # File and channel names may contain characters that the terminal's encoding lacks.
            stream.reconfigure(errors="backslashreplace")
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_LineFormatter())
    LOG.addHandler(handler)
    level = LOG.level
    LOG.setLevel(logging.INFO)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("always", category=UserWarning)
            warnings.showwarning = log_warning
            yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)


def _level(verbose: int, quiet: bool) -> int:
    if quiet:
        return logging.ERROR
    return logging.DEBUG if verbose else logging.INFO


def _discard_stdout() -> None:
    """Keep Python from reporting the closed pipe once more when it flushes at exit."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
