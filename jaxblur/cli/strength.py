"""Options for the strength of the blur, and a frame's motion changed by them."""

import argparse
import dataclasses
import logging
import pathlib
from typing import Any, NamedTuple

from jaxblur._util.text import nearest

from .arguments import CommandError, file_path, from_zero
from .camera_share import camera_file, keeps_camera, with_camera_share
from .selections import FORMS, parse_scale, select

LOG = logging.getLogger("jaxblur")

LIMITS = ("valve",)
"""Keys of `jaxblur.MOTION_LIMITS`, which loads jax."""

SOURCES = ("auto", "header", "fit")

SELECTS_NOTHING = "--scale-motion: none is for any pixel"


class Limit(NamedTuple):
    """``--limit-motion``: a name, or a length in pixels or as a share of the width."""

    name: str | None
    length: float
    of_width: bool


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options; `apply` reads them."""
    group = parser.add_argument_group(
        "strength of the blur (first the camera's share, then the scales, then the limit)"
    )
    group.add_argument(
        "--scale-motion",
        type=parse_scale,
        action="append",
        default=[],
        metavar="WHAT=FACTOR",
        help=f"{FORMS}: the motion of everything, of a thing by its Cryptomatte name (* and ? "
        "stand for letters), of the pixels whose channel has a value, of a matte; or factors from "
        "a channel. 0.5 blurs as half the exposure does. Repeat for several; factors multiply",
    )
    group.add_argument(
        "--matte-from",
        type=file_path,
        metavar="FILE",
        help="file with the Cryptomattes, mattes and identifiers (default: the frame); outside of "
        "its data window motion stays as it is",
    )
    which = group.add_mutually_exclusive_group()
    which.add_argument(
        "--camera-motion",
        type=_share,
        metavar="SHARE",
        help="share of the camera's motion that is kept, 0 to 1 or more; McGuire et al. recommend "
        "0 to 0.15 where the camera follows somebody",
    )
    which.add_argument("--objects-only", action="store_true", help="the same as --camera-motion 0")
    which.add_argument(
        "--camera-only", action="store_true", help="blur as if nothing but the camera moved"
    )
    group.add_argument(
        "--camera",
        type=_camera,
        metavar="auto|header|fit|FILE.json",
        help="the camera's motion: from worldToCamera and worldToNDC in this and the neighboring "
        "files, fitted to the vectors, or from a file (see docs/how-to/strength.md); auto: header, "
        "else fit",
    )
    group.add_argument(
        "--limit-motion",
        type=_limit,
        metavar="valve|PX|P%",
        help="longest blur from end to end, in pixels or percent of the width of the display "
        "window; valve: at most 15 %% of the frame's time, and 4 %% of that width",
    )


def check(arguments: argparse.Namespace) -> None:
    """Reject options that do not go together, before any work.

    Raises:
        CommandError: there are some.
    """
    given = _given(arguments)
    if arguments.camera is not None and keeps_camera(arguments):
        raise CommandError(
            "--camera: is for --camera-motion, --objects-only and --camera-only; add one of them, "
            "or leave it out."
        )
    if arguments.matte_from is not None and not any(s.kind for s in arguments.scale_motion):
        raise CommandError(
            "--matte-from: is for --scale-motion crypto:, id:, matte: or map:; leave it out."
        )
    if given and arguments.subframes is not None:
        raise CommandError(
            f"--{given[0]}: with --subframes the motion of each is that between them, and another "
            "one would leave gaps; leave out one of the two."
        )
    if (file := camera_file(arguments)) is not None:
        from jaxblur import exr

        exr.read_camera_file(file)


def looks_at_neighbors(arguments: argparse.Namespace) -> bool:
    """Whether the headers of the frames before and after may change a frame."""
    return not keeps_camera(arguments) and arguments.camera in (None, "auto", "header")


class Changed(NamedTuple):
    """A frame with another motion.

    Attributes:
        buffers: as `jaxblur.exr.read_buffers` gives them.
        words: what was done; empty if nothing was.
        selects: False if every ``--scale-motion`` names something that no pixel shows.
    """

    buffers: Any
    words: str
    selects: bool


def apply(arguments: argparse.Namespace, buffers: Any) -> Changed:
    """Change the motion of a frame as the options say.

    Args:
        arguments: of the command; those of others have none of these options.
        buffers: as `jaxblur.exr.read_buffers` gives them.

    Returns:
        The frame with another motion.

    Raises:
        CommandError: the camera's motion cannot be found.
        JaxblurIOError: a channel, a name or a matrix is missing or wrong.
    """
    from jaxblur.sequence import frame_number

    if not _given(arguments) or frame_number(arguments.input) in (arguments.cut or ()):
        return Changed(buffers, "", True)
    import numpy as np

    import jaxblur

    frame, words, matches = buffers.frame(), [], []
    if not keeps_camera(arguments):
        frame, said = with_camera_share(arguments, buffers, frame)
        words.append(said)
    source = arguments.matte_from or arguments.input
    for scale in arguments.scale_motion:
        factors, chosen = select(source, scale, arguments.input, buffers.windows)
        matches.append(chosen)
        frame = jaxblur.scale_motion(frame, factors)
        words.append(f"scaled {scale.text}")
    if (limit := arguments.limit_motion) is not None:
        width, full_width = buffers.windows.data[2], buffers.windows.display[2]
        if limit.name is not None:
            # Shares are of the frame's own width there.
            limits = jaxblur.MOTION_LIMITS[limit.name]
            limits = dataclasses.replace(limits, width=limits.width * full_width / width)
            frame = jaxblur.within_limits(frame, limits, arguments.shutter)
        else:
            share = full_width if limit.of_width else 1
            frame = jaxblur.limit_motion(frame, limit.length * share / 2)
        words.append(f"limited {_limit_text(limit)}")
    path = None if frame.path is None else np.asarray(frame.path)
    changed = dataclasses.replace(buffers, velocity=np.asarray(frame.velocity), path=path)
    text = "; ".join(words)
    LOG.info("motion: %s: %s", arguments.input, text)
    return Changed(changed, text, any(matches) or not matches)


def _given(arguments: argparse.Namespace) -> list[str]:
    """The options that change a motion, as far as they are given."""
    names = ("scale_motion", "camera_motion", "objects_only", "camera_only", "limit_motion")
    values = {name: getattr(arguments, name, None) for name in names}
    # By identity: a share of 0 is equal to False, and is given.
    given = (n for n, v in values.items() if v is not None and v is not False and v != [])
    return [name.replace("_", "-") for name in given]


def _share(text: str) -> float:
    """Parse ``--camera-motion``; percents are taken too."""
    return from_zero(text.removesuffix("%")) / (100 if text.endswith("%") else 1)


def _limit(text: str) -> Limit:
    """Parse ``--limit-motion``.

    Raises:
        ArgumentTypeError: it is no name and no length.
    """
    if text in LIMITS:
        return Limit(text, 0.0, False)
    of_width = text.endswith("%")
    try:
        length = from_zero(text.removesuffix("%").removesuffix("px"))
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(
            f"expected {', '.join(LIMITS)}, pixels such as 40, or a share of the width such as 4%, "
            f"got {text!r}{nearest(text, LIMITS)}"
        ) from None
    return Limit(None, length / 100 if of_width else length, of_width)


def _limit_text(limit: Limit) -> str:
    if limit.name is not None:
        return limit.name
    return f"{100 * limit.length:g}% of the width" if limit.of_width else f"{limit.length:g} px"


def _camera(text: str) -> str | pathlib.Path:
    """Parse ``--camera``; a file has its folder, since workers of a sequence stand elsewhere.

    Raises:
        ArgumentTypeError: it is neither a word nor a JSON file.
    """
    if text in SOURCES:
        return text
    if not text.lower().endswith(".json"):
        raise argparse.ArgumentTypeError(
            f"expected {', '.join(SOURCES)} or a .json file, got {text!r}{nearest(text, SOURCES)}"
        )
    return file_path(text).absolute()
