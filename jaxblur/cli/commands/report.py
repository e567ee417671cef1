"""``jaxblur report``: a folder of results as one HTML page."""

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
    positive_number,
)
from ..colors import add_view_option
from ..console import print_line

LOG = logging.getLogger("jaxblur")


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands, "report", "Make one HTML page of a folder of results; it needs no network.", run
    )
    parser.add_argument(
        "input",
        type=file_path,
        metavar="RESULT_DIR",
        help="what `jaxblur blur --result DIR` or an experiment wrote",
    )
    parser.add_argument(
        "-o", "--output", type=file_path, required=True, metavar="OUT.html", help="page to write"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an existing page")
    add_view_option(parser, "pictures, error maps and scores")
    parser.add_argument(
        "--max-megabytes",
        type=positive_number,
        default=20.0,
        metavar="MB",
        help="to stay below, crop pictures to where their error, or without a truth their motion, "
        "is largest (default %(default)g)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the page; see `add_parser`."""
    output = arguments.output
    if output.suffix.lower() not in (".html", ".htm"):
        raise CommandError(f"{output}: can write .html only; change the extension.")
    check_parent(output)
    check_outputs([output], arguments.overwrite)
    write_page(arguments.input, output, arguments.max_megabytes, arguments.view)
    print_line(output)
    return 0


def write_page(
    folder: pathlib.Path,
    output: pathlib.Path,
    max_megabytes: float = 20.0,
    view: str | None = None,
) -> None:
    """Make the page of a result, whole or not at all, and log its warnings.

    Args:
        folder: with a result.
        output: HTML file to write.
        max_megabytes: largest size.
        view: OpenColorIO view to show the pictures in.
    """
    from jaxblur.report import COLORS, build_page, in_view, read_result

    result = read_result(folder)
    if view is not None:
        result = in_view(result, view)
        LOG.info("colors: %s", result.settings[COLORS])
    page = build_page(result, max_megabytes)
    for warning in page.warnings:
        LOG.warning("%s", warning)
    with replacing(output) as temporary:
        pathlib.Path(temporary).write_text(page.html, encoding="utf-8")
