"""``jaxblur vectors --draw OUT.png``: arrows of the motion over the picture."""

import argparse
import dataclasses

from jaxblur._util.atomic import replacing

from ..arguments import CommandError, check_outputs, check_parent
from ..console import print_line

WIDTH, TITLE, DOTS = 12.8, 0.4, 100
"""Width of the picture and height of its title in inches, and pixels per inch."""
INSTEAD = ("next", "previous", "conform")


def check(arguments: argparse.Namespace) -> None:
    """Reject options that belong to another use of the command.

    Raises:
        CommandError: one is given.
    """
    if arguments.draw is None:
        for name in ("preset", "overwrite"):
            if getattr(arguments, name):
                raise CommandError(f"--{name}: is for --draw OUT.png.")
        return
    for name in INSTEAD:
        if getattr(arguments, name) is not None:
            raise CommandError(f"--{name}: --draw draws one frame; leave out one of the two.")


def run(arguments: argparse.Namespace) -> int:
    """Draw the path of points while the shutter is open; see `jaxblur.show.velocity_arrows`.

    Args:
        arguments: of ``vectors``, with ``draw``.

    Returns:
        0.

    Raises:
        CommandError: the output cannot be written, or matplotlib is missing.
        JaxblurIOError: the frame cannot be read.
    """
    from jaxblur import exr

    output = arguments.draw
    if output.suffix.lower() != ".png":
        raise CommandError(f"{output}: can draw .png only; change the extension.")
    check_parent(output)
    exr.refuse_overwrite(output, arguments.file)
    check_outputs([output], arguments.overwrite)
    buffers = exr.read_buffers(
        arguments.file,
        arguments.preset or "auto",
        arguments.shutter,
        depth=arguments.depth,
        depth_channel=arguments.depth_channel,
        file_shutter=arguments.shutter,
        max_displace=arguments.max_displace,
        layer=arguments.layer,
        velocity_channels=arguments.velocity_channels,
        nonfinite="ignore",
    )
    colors = exr.conversion_of(exr.inspect(arguments.file), buffers.color_channels[0])
    shown = dataclasses.replace(buffers, color=colors.light(buffers.color))

    from jaxblur import show

    try:
        figure = show.new_figure(
            WIDTH, WIDTH * buffers.depth.shape[0] / buffers.depth.shape[1] + TITLE
        )
    except ImportError as error:
        raise CommandError(f"--draw: {error}") from error
    show.velocity_arrows(shown.frame(), axes=figure.subplots())
    with replacing(output) as temporary:
        figure.savefig(temporary, dpi=DOTS)
    channels, preset = ", ".join(buffers.guess.channels), buffers.guess.preset.name
    print_line(f"{channels} as preset {preset}, for a shutter of {arguments.shutter:g} frames")
    print_line(output)
    return 0
