"""``jaxblur jod``: how much worse than a reference a clip or an image looks, by ColorVideoVDP."""

import argparse
import json
import logging
import pathlib
from typing import Any

from ..arguments import (
    CommandError,
    add_command,
    add_compute_options,
    file_path,
    positive_number,
)
from ..colors import add_view_option
from ..compute import start_jax
from ..console import print_line
from ..sequence import frames_on_disk

LOG = logging.getLogger("jaxblur")
DISPLAY = "standard_4k"


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands, "jod", "Judge a clip or an image beside its reference: 10 JOD is equal.", run
    )
    parser.add_argument("test", type=file_path, help="image, or frames such as 'blurred.####.exr'")
    parser.add_argument(
        "reference", type=file_path, help="image or frames to compare with, of the same numbers"
    )
    parser.add_argument(
        "--fps",
        dest="frames_per_second",
        type=positive_number,
        metavar="N",
        help="frames per second; needed for a clip",
    )
    parser.add_argument(
        "--display",
        default=DISPLAY,
        metavar="NAME",
        help="screen that shows them, of `jaxblur.metrics.DISPLAYS` (default %(default)s, whose "
        "white is 1; values are cd/m2 on standard_hdr_linear)",
    )
    parser.add_argument(
        "--pixels-per-degree",
        type=positive_number,
        metavar="N",
        help="pixels per degree of visual angle, in place of the display's",
    )
    parser.add_argument("--layer", metavar="NAME", help="view layer, view or part to look in")
    parser.add_argument("--color-space", metavar="NAME", help="of the files, if they name none")
    add_view_option(parser, "both")
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_compute_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print the quality; see `add_parser`."""
    tests, references = _files(arguments)
    if len(tests) > 1 and arguments.frames_per_second is None:
        raise CommandError(f"{arguments.test}: a clip needs its frame rate; add --fps, such as 24.")
    start_jax(not arguments.no_compile_cache)
    from jaxblur import metrics

    screen = metrics.find_display(arguments.display)
    if arguments.view is not None and screen.highest > 1:
        raise CommandError(
            f"--view ends at white, and pixels of {arguments.display} are cd/m2; leave out --view, "
            "or choose a display such as standard_4k."
        )
    clip, truth = (_light(files, arguments) for files in (tests, references))
    if clip.shape != truth.shape:
        (rows, columns), (height, width) = clip.shape[1:3], truth.shape[1:3]
        raise CommandError(
            f"{arguments.reference}: has {width}x{height} pixels, but {arguments.test} has "
            f"{columns}x{rows}; give images of one size."
        )
    quality = float(
        metrics.cvvdp(
            clip,
            truth,
            frames_per_second=arguments.frames_per_second,
            display=screen,
            pixels_per_degree=arguments.pixels_per_degree,
        )
    )
    if arguments.json:
        print_line(json.dumps({"jod": quality, "frames": len(clip), "display": arguments.display}))
    else:
        print_line(f"{quality:.3f} JOD")
    return 0


def _files(arguments: argparse.Namespace) -> tuple[list[pathlib.Path], list[pathlib.Path]]:
    """The files of both, frame by frame."""
    from jaxblur.sequence import has_frame_number, parse_names

    both = [arguments.test, arguments.reference]
    if not any(has_frame_number(path) for path in both):
        return [arguments.test], [arguments.reference]
    names = [parse_names(path) for path in both]
    frames = frames_on_disk(names[0])
    if missing := sorted(set(frames) - set(frames_on_disk(names[1]))):
        raise CommandError(
            f"{arguments.reference}: has no frame {missing[0]}, which {arguments.test} has; render "
            "it, or remove the other."
        )
    tests, references = ([each.path(frame) for frame in frames] for each in names)
    return tests, references


def _light(files: list[pathlib.Path], arguments: argparse.Namespace) -> Any:
    """(F, H, W, 3) of files, as the screen shows them."""
    import numpy as np

    from jaxblur import exr, metrics

    images, words = [], set()
    for path in files:
        info = exr.inspect(path)
        channel = exr.choose_color(info, arguments.layer).channels[0]
        colors = exr.conversion_of(info, channel, arguments.color_space, arguments.view)
        words.add(colors.words)
        images.append(np.asarray(metrics.rgb(colors.light(exr.read_image(path, arguments.layer)))))
        if images[-1].shape != images[0].shape:
            (rows, columns), (height, width) = images[-1].shape[:2], images[0].shape[:2]
            raise CommandError(
                f"{path}: has {columns}x{rows} pixels, but {files[0]} has {width}x{height}; give "
                "frames of one size."
            )
    for each in sorted(words):
        LOG.info("colors: %s", each)
    return np.stack(images)
