"""``jaxblur export``: a filter as source text for other hosts."""

import argparse
import logging
import pathlib
from typing import Any

from ..arguments import CommandError, add_command, add_compute_options, check_folder, file_path
from ..compute import start_jax
from ..console import print_line
from ..filtering import (
    add_filter_options,
    add_parameters_option,
    complete,
    describe_filters,
    find_filter,
    read_fitted,
)

LOG = logging.getLogger("jaxblur")


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands, "export", "Write a filter as C, WGSL, GLSL or HLSL, with a test frame.", run
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.more_help = describe_filters
    parser.add_argument(
        "--language",
        choices=("c", "wgsl", "glsl", "hlsl"),
        required=True,
        help="C99; WGSL (WebGPU); GLSL ES 3.00 fragment shaders (WebGL 2); HLSL compute "
        "shaders (Unity, Unreal)",
    )
    parser.add_argument(
        "-o", "--output", type=file_path, required=True, metavar="DIR", help="a new folder"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier export")
    parser.add_argument(
        "--channels",
        type=int,
        choices=(1, 2, 3, 4),
        default=4,
        help="of color (default %(default)s)",
    )
    parser.add_argument("--path", action="store_true", help="frames have curved paths (layered)")
    add_compute_options(parser)
    group = add_filter_options(parser)
    add_parameters_option(group)


def run(arguments: argparse.Namespace) -> int:
    """Write the folder; see `add_parser`."""
    if arguments.radius == 0:
        raise CommandError("--radius auto: is that of a frame, and here is none; give pixels.")
    name, parameters, settings = complete(arguments, read_fitted(arguments))
    folder: pathlib.Path = arguments.output
    check_folder(folder)
    start_jax(not arguments.no_compile_cache)
    from jaxblur.export import check_empty, graph_of, write_package

    check_empty(folder, arguments.overwrite)
    info = find_filter(name)
    values = info.make_parameters(**parameters)
    graph = graph_of(info, values, settings, channels=arguments.channels, has_path=arguments.path)
    if arguments.path and not any(buffer.name == "path" for buffer in graph.inputs):
        raise CommandError(f"--path: {name} does not read curved paths; leave it out.")
    for file in write_package(graph, arguments.language, folder, overwrite=arguments.overwrite):
        print_line(file)
    return 0
