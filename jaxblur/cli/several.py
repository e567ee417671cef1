"""``jaxblur blur`` on several frames at once: each becomes a file of its name in a folder."""

import argparse
import collections
import logging
import pathlib
from collections.abc import Sequence
from typing import NamedTuple

from . import outputs, sequence, view_files
from .arguments import CommandError, check_outputs, in_option_names
from .choice import Choice
from .errors import FAILED, is_foreseeable, message_of
from .progress import messages_once
from .single import blur_single

LOG = logging.getLogger("jaxblur")

ONE_FRAME = (
    *("before", "after", "subframes", "truth", "result"),
    *("velocity_from", "depth_from", "matte_from"),
)
"""Options whose files belong to one frame, or to the names of a sequence."""


class Place(NamedTuple):
    """Where a frame, or a sequence, comes from and goes to."""

    input: pathlib.Path
    output: pathlib.Path


def places_of(arguments: argparse.Namespace) -> list[Place]:
    """The input and the output of each frame; only names are looked at.

    Args:
        arguments: of the command, with all ``inputs``.

    Raises:
        CommandError: several inputs cannot go where they are to go, or an option is for one frame.
    """
    inputs, output = arguments.inputs, arguments.output
    if len(inputs) > 1:
        _check(arguments)
    if not output.is_dir():
        return [Place(inputs[0], output)]
    return [Place(path, output / path.name) for path in inputs]


def _check(arguments: argparse.Namespace) -> None:
    from jaxblur.sequence import has_frame_number

    inputs, output = arguments.inputs, arguments.output
    if not output.is_dir():
        pattern = sequence.pattern_of(map(str, inputs))
        layers = "; layers of one frame: `jaxblur layers FRONT.exr BACK.exr -o OUT.exr`"
        raise CommandError(
            f"{output}: is no folder, and {len(inputs)} frames need one: create it, and give -o "
            "DIR. A sequence is named by one pattern, in quotes: "
            f"'{pattern or 'name.####.exr'}'{'' if pattern else layers}."
        )
    for path in inputs:
        if has_frame_number(path) or view_files.PLACE in str(path):
            raise CommandError(
                f"{path}: is a pattern, and there are {len(inputs)} inputs; blur what it stands "
                "for by a command of its own."
            )
    if arguments.frames is not None:
        raise CommandError("--frames: is for a sequence; name the frames, or give one pattern.")
    (name, count), *_ = collections.Counter(path.name for path in inputs).most_common(1)
    if count > 1:
        raise CommandError(
            f"{output / name}: {count} inputs have that name; blur them into different folders."
        )
    for option in ONE_FRAME:
        if getattr(arguments, option) is not None:
            raise CommandError(
                f"--{option.replace('_', '-')}: is for one frame, and there are {len(inputs)}; "
                "leave it out, or give a sequence as one pattern: 'name.####.exr'."
            )


def blur_several(arguments: argparse.Namespace, asked: Choice, places: Sequence[Place]) -> int:
    """Blur frames one after the other, each as if it were alone.

    Args:
        arguments: of the command.
        asked: filter, parameters and settings from the options.
        places: from `places_of`.

    Returns:
        0 if every frame is done, 1 if some are not, each with a message.

    Raises:
        CommandError: before any work, since an output must not be replaced.
        JaxblurIOError: before any work, since an output is an input.
    """
    from jaxblur import exr

    frames = [argparse.Namespace(**vars(arguments) | place._asdict()) for place in places]
    for frame in frames:
        outputs.check_output(frame)
        written = outputs.files_of(frame, frame.output, [])
        for output in written:
            exr.refuse_overwrite(output, *(place.input for place in places))
        check_outputs(written, frame.overwrite)
    failed = 0
    with messages_once():
        for frame in frames:
            try:
                blur_single(frame, asked)
            except Exception as error:
                if not is_foreseeable(error):
                    raise
                failed += 1
                LOG.error("%s: %s", frame.input, in_option_names(message_of(error), vars(frame)))
    if failed:
        LOG.error("%d of %d frames are not done.", failed, len(frames))
    return FAILED if failed else 0
