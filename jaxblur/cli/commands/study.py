"""``jaxblur study``: a page that asks which of two pictures is better."""

import argparse
import logging
import pathlib
from typing import Any

from jaxblur._util.atomic import replacing

from ..arguments import (
    CommandError,
    add_command,
    check_outputs,
    check_parent,
    file_path,
    positive_integer,
    positive_number,
)
from ..colors import add_view_option
from ..console import print_line

LOG = logging.getLogger("jaxblur")

LAYOUT = """\
DIR holds a result, as experiments write it, with the pictures of three methods or more; or one
folder for each method, with the same pictures in each: NAME.exr (or .png) is a still,
NAME.0001.exr, NAME.0002.exr ... an animation. The page needs no network. It shows every pair in
random order and saves a CSV file, which `jaxblur votes` analyzes."""


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands, "study", "Make a page on which people choose the better of two pictures.", run
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = LAYOUT
    parser.add_argument("input", type=file_path, metavar="DIR", help="pictures by several methods")
    parser.add_argument(
        "-o", "--output", type=file_path, required=True, metavar="OUT.html", help="page to write"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an existing page")
    parser.add_argument("--title", metavar="TEXT", help="title of the page")
    parser.add_argument("--question", metavar="TEXT", help="what the observer is asked")
    parser.add_argument(
        "--repeats", type=positive_integer, metavar="N", help="how often each pair is shown (2)"
    )
    parser.add_argument(
        "--catch",
        type=int,
        metavar="N",
        help="trials beside a coarse copy, which everybody who looks answers alike (4)",
    )
    parser.add_argument(
        "--side-by-side",
        action="store_true",
        default=None,
        help="both pictures at once (default: one after the other)",
    )
    parser.add_argument("--seconds", type=positive_number, metavar="S", help="time of a still (2)")
    # Not `fps`, which belongs to exposures in seconds.
    parser.add_argument(
        "--fps", dest="rate", type=positive_number, metavar="N", help="of animations (24)"
    )
    parser.add_argument(
        "--max-megabytes", type=positive_number, metavar="MB", help="largest page (100)"
    )
    parser.add_argument(
        "--color-space", metavar="NAME", help="of EXR files, where they do not say, such as ACEScg"
    )
    add_view_option(parser, "pictures")


def run(arguments: argparse.Namespace) -> int:
    """Write the page; see `add_parser`."""
    from jaxblur import perception
    from jaxblur.perception.page import trial_count

    output = arguments.output
    if output.suffix.lower() not in (".html", ".htm"):
        raise CommandError(f"{output}: can write .html only; change the extension.")
    check_parent(output)
    check_outputs([output], arguments.overwrite)
    names = ("title", "question", "repeats", "catch", "side_by_side", "seconds", "max_megabytes")
    given = {name: getattr(arguments, name) for name in names} | {"fps": arguments.rate}
    options = perception.Options(**{k: value for k, value in given.items() if value is not None})
    study = perception.read_study(arguments.input, arguments.view, arguments.color_space)
    LOG.info("%s: %d scenes by %s", study.key, len(study.scenes), ", ".join(study.stimuli))
    LOG.info("%d pairs for each observer", trial_count(study, options) + options.catch)
    html = perception.build_study(study, options)
    with replacing(output) as temporary:
        pathlib.Path(temporary).write_text(html, encoding="utf-8")
    print_line(output)
    return 0
