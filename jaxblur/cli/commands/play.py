"""``jaxblur play``: a page in which a frame is blurred live, with a slider for each parameter."""

import argparse
import logging
import pathlib
from collections.abc import Mapping
from typing import Any

from jaxblur._util.atomic import replacing

from .. import sources
from ..arguments import (
    CommandError,
    add_command,
    add_compute_options,
    check_outputs,
    check_parent,
    file_path,
    positive_number,
)
from ..compute import start_jax
from ..console import print_line
from ..filtering import (
    add_filter_options,
    add_nonfinite_option,
    add_parameters_option,
    complete,
    describe_filters,
    find_filter,
    read_fitted,
    report_ignored,
)
from ..loading import read_truth
from ..sources import add_source_options, add_vector_options

LOG = logging.getLogger("jaxblur")


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        *(commands, "play", "Make one HTML page that blurs a frame live; it needs WebGPU.", run)
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.more_help = describe_filters
    parser.add_argument("input", type=file_path, help="frame with color, depth and vectors")
    parser.add_argument(
        "-o", "--output", type=file_path, required=True, metavar="OUT.html", help="page to write"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an existing page")
    parser.add_argument(
        "--truth", type=file_path, metavar="FILE", help="true blur, for the error map and PSNR"
    )
    parser.add_argument("--truth-layer", metavar="NAME", help="layer of the truth to look in")
    parser.add_argument(
        "--color-space",
        metavar="NAME",
        help="color space of the frame and of the truth, where the files do not name it",
    )
    parser.add_argument(
        "--max-megabytes",
        type=positive_number,
        default=60.0,
        metavar="MB",
        help="reject a frame whose page would be larger (default %(default)g)",
    )
    add_compute_options(parser)
    group = add_filter_options(parser)
    add_parameters_option(group)
    add_vector_options(parser)
    add_nonfinite_option(add_source_options(parser))
    parser.set_defaults(also=[], all_color=False)


def run(arguments: argparse.Namespace) -> int:
    """Write the page; see `add_parser`."""
    from jaxblur.sequence import has_frame_number

    output: pathlib.Path = arguments.output
    if output.suffix.lower() not in (".html", ".htm"):
        raise CommandError(f"{output}: can write .html only; change the extension.")
    check_parent(output)
    check_outputs([output], arguments.overwrite)
    if has_frame_number(arguments.input):
        raise CommandError(f"{arguments.input}: a page has one frame; give the file of one.")
    name, parameters, settings = complete(arguments, read_fitted(arguments))
    buffers = sources.read(arguments)
    report_ignored(arguments.input, buffers.ignored)
    page = _page(arguments, name, parameters, settings, buffers)
    size = len(page.encode("utf-8")) / 1e6
    if size > arguments.max_megabytes:
        raise CommandError(
            f"{arguments.input}: the page would have {size:.0f} MB, more than --max-megabytes "
            f"{arguments.max_megabytes:g}; allow more, or render a smaller frame."
        )
    with replacing(output) as temporary:
        pathlib.Path(temporary).write_text(page, encoding="utf-8")
    print_line(output)
    return 0


def _page(
    arguments: argparse.Namespace, name: str, parameters: Any, settings: Any, buffers: Any
) -> str:
    """The page of a frame."""
    import dataclasses

    import numpy as np

    start_jax(not arguments.no_compile_cache)
    from jaxblur import exr, metrics, vectors

    info = exr.inspect(arguments.input)
    colors = exr.conversion_of(info, buffers.color_channels[0], arguments.color_space, None)
    color = np.asarray(metrics.rgb(colors.light(buffers.color)), np.float32)
    if arguments.radius == 0:
        fastest = vectors.speed_statistics(buffers.velocity, settings.radius).suggested_radius
        settings = dataclasses.replace(settings, radius=fastest)
        LOG.info("radius: %d px", fastest)
    frame = {"color": color, "depth": buffers.depth, "velocity": buffers.velocity}
    if buffers.path is not None:
        frame["path"] = buffers.path
    truth = None
    if arguments.truth is not None:
        stored, colors = read_truth(arguments, color.shape, None)
        truth = metrics.rgb(colors.light(stored))
    return page_of(
        *(name, parameters, settings, frame, truth),
        title=arguments.input.name,
        shutter=arguments.shutter,
    )


def page_of(
    name: str,
    parameters: Mapping[str, Any],
    settings: Any,
    frame: Mapping[str, Any],
    truth: Any,
    *,
    title: str,
    shutter: float,
) -> str:
    """The page that blurs a frame.

    Args:
        name: of the filter.
        parameters: that differ from its defaults.
        settings: of the filter.
        frame: NumPy arrays by name: color (H, W, 3) as a screen shows it, depth, velocity, and path
            where there is one.
        truth: (H, W, 3) likewise, or None.
        title: of the page.
        shutter: exposure in frames.

    Returns:
        HTML.
    """
    import numpy as np

    from jaxblur.export import build_play, graph_of
    from jaxblur.noise import make_noise

    height, width = frame["depth"].shape
    noise = make_noise("halton", height, width)
    names = [key for key in frame if key != "path" or name == "layered"]
    planes = {key: np.asarray(frame[key], np.float32) for key in names}
    planes |= {"noise_tap": np.asarray(noise.tap), "noise_tile": np.asarray(noise.tile)}
    filter_of = find_filter(name)
    graph = graph_of(
        *(filter_of, filter_of.make_parameters(**parameters), settings),
        channels=3,
        has_path="path" in planes,
    )
    return build_play(graph, planes, truth, title=title, shutter=shutter)
