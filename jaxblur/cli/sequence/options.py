"""The options that only sequences have, and whether a sequence is given."""

import argparse
import glob
import pathlib
import re
from collections.abc import Iterable
from typing import Any

from .. import stack
from ..arguments import CommandError, frame_numbers, positive_integer


def add_options(parser: argparse.ArgumentParser, existing: Any) -> None:
    """Add the options that only sequences have.

    Args:
        parser: of the command.
        existing: group of the ways to treat outputs that exist.
    """
    existing.add_argument(
        "--skip-existing",
        action="store_true",
        help="keep frames that were made in the same way, and make those again whose inputs have "
        "changed (the default without --overwrite); any other file in the place of an output is "
        "an error",
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="print what would be read and written, of a sequence what would be done with each "
        "frame, and write nothing; says whether nothing moves in the frame, or in the first one",
    )
    group = parser.add_argument_group("sequences, whose names hold ####, %04d, @@@@ or $F4")
    group.add_argument(
        "-F",
        "--frames",
        type=frame_numbers,
        metavar="A-B[xN]",
        help="such as 1001-1240 or 1-100x2,107 (default: all frames found)",
    )
    group.add_argument(
        "--cut",
        type=frame_numbers,
        default=[],
        metavar="A,B",
        help="pass these frames through unblurred: at a camera cut vectors mean nothing",
    )
    group.add_argument(
        "--neighbors",
        choices=("auto", "off"),
        help="auto (the default): a filter that takes them, as layered does, sees the frames "
        "before and after, if they exist and no cut lies between; off: each frame alone",
    )
    group.add_argument(
        "--allow-resize",
        action="store_true",
        help="accept frames of another size than most (otherwise they give exit status 1)",
    )
    group.add_argument("--json", action="store_true", help="print the plan or the outcome as JSON")
    group.add_argument(
        "--scheduler",
        metavar="local|ADDRESS",
        help="hand frames to processes on this machine, or to the Dask scheduler at an address "
        "such as tcp://farm:8786",
    )
    group.add_argument(
        "--workers",
        type=positive_integer,
        metavar="N",
        help="processes of --scheduler local (default 2)",
    )


def is_asked_for(arguments: argparse.Namespace) -> bool:
    """Whether the name of the input is that of a sequence."""
    from jaxblur.sequence import has_frame_number

    return arguments.frames is not None or has_frame_number(arguments.input)


def pattern_of(names: Iterable[str]) -> str:
    """The pattern of a sequence that files belong to, by their last numbers; empty if none."""
    patterns = {re.sub(r"\d+(?=\D*$)", lambda found: "#" * len(found[0]), n) for n in names}
    pattern = patterns.pop() if len(patterns) == 1 else ""
    return pattern if "#" in pattern else ""


def refuse_shell_pattern(path: pathlib.Path) -> None:
    """Reject names that only a shell would expand, where a sequence is meant.

    Raises:
        CommandError: there is no such file, and its name holds ``*``, ``?`` or ``[``.
    """
    if path.exists() or not set(path.name) & set("*?["):
        return
    found = pattern_of(sorted(glob.glob(str(path))))
    raise CommandError(
        f"{path}: no such file, and the shell has not replaced it; the frames of a sequence are "
        f"named by one pattern, in quotes: '{found or 'name.####.exr'}'."
    )


def refuse_options(arguments: argparse.Namespace) -> None:
    """Reject options and names of sequences for a single frame.

    Raises:
        CommandError: one is given.
    """
    for role in stack.roles(arguments):
        refuse_shell_pattern(getattr(arguments, role))
    options = ("cut", "json", "skip_existing", "scheduler", "workers", "neighbors")
    for name in options:
        if getattr(arguments, name):
            raise CommandError(
                f"--{name.replace('_', '-')}: is for sequences; write the input as name.####.exr."
            )
