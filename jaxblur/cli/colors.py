"""How colors are shown: the options that say so, and the conversion of a frame's colors."""

import argparse
import logging
import pathlib
from typing import Any

from .arguments import CommandError

LOG = logging.getLogger("jaxblur")


def add_view_option(parser: Any, what: str) -> None:
    """Add the option for the view of what people look at.

    Args:
        parser: of a command, or a group of it.
        what: what is shown in that view.
    """
    parser.add_argument(
        "--view",
        metavar="NAME",
        help=f'show {what} in an OpenColorIO view, such as "ACES 2.0 - SDR 100 nits (Rec.709)", of '
        "the configuration in $OCIO or the built-in one (default: plain sRGB, no tone curve)",
    )


def add_color_options(parser: argparse.ArgumentParser, shown: str = "pictures and scores") -> None:
    """Add the options of how colors are shown; `check_colors` and `shown_colors` read them.

    Args:
        parser: of a command.
        shown: what the command shows.
    """
    group = parser.add_argument_group(
        f"colors of {shown}; an .exr and floats in a .tif keep their own"
    )
    add_view_option(group, shown)
    group.add_argument(
        "--color-space",
        metavar="NAME",
        help="color space of the frame and of a truth in EXR, such as ACEScg, where the files do "
        "not name it or name a wrong one (default: as in the file, else linear sRGB)",
    )


def check_colors(arguments: argparse.Namespace) -> None:
    """Reject colors that nothing would be shown in, or that the configuration lacks.

    Raises:
        CommandError: nothing would be shown in them.
        ValueError: the configuration lacks them.
    """
    if arguments.view is None and arguments.color_space is None:
        return
    from jaxblur import exr

    exr.check_view(arguments.view)
    exr.check_color_space(arguments.color_space)
    if not _shows_any(arguments):
        option = "--view" if arguments.view else "--color-space"
        raise CommandError(
            f"{option}: is for pictures and scores, and an .exr and floats in a .tif keep their "
            "colors; write a picture, such as .png, or add --truth, or leave it out."
        )


def shown_colors(arguments: argparse.Namespace, path: pathlib.Path, channel: str) -> Any:
    """How the colors of a frame are shown; said in one line if they are shown and converted.

    Args:
        arguments: of the command.
        path: the file with the color.
        channel: full name of one of its color channels.

    Returns:
        A `jaxblur.exr.Conversion`.
    """
    from jaxblur import exr

    colors = exr.conversion_of(exr.inspect(path), channel, arguments.color_space, arguments.view)
    if not colors.is_identity and _shows_any(arguments):
        LOG.info("colors: %s", colors.words)
    return colors


def _shows_any(arguments: argparse.Namespace) -> bool:
    """Whether a command writes scores, a result, or a picture as a screen shows it."""
    from jaxblur import exr

    output, bits = arguments.output, arguments.bits
    shown = output.suffix.lower() in exr.BITS and exr.bits_of(output, bits) != exr.LINEAR_BITS
    return shown or any(getattr(arguments, name, None) for name in ("png", "truth", "result"))
