"""``jaxblur blur``: sharp frames in, blurred frames out."""

import argparse
from collections.abc import Sequence
from typing import Any

from .. import isolation, mattes, outputs, posts, results, sequence, several, strength, views
from ..arguments import (
    CommandError,
    add_command,
    add_compute_options,
    describe_presets,
    file_path,
    positive_number,
)
from ..choice import Choice
from ..colors import add_color_options, check_colors
from ..compute import add_threads_option, limited_threads
from ..filtering import (
    CHOICES,
    add_filter_options,
    add_nonfinite_option,
    add_parameters_option,
    add_quality_option,
    add_seed_option,
    complete,
    describe_filters,
    read_fitted,
    require_lens,
    require_shutter,
)
from ..loading import add_motion_option, check_motion
from ..scores import add_truth_options
from ..shutter import add_shutter_options, option_of, settle
from ..single import blur_single
from ..sources import add_pass_options, add_source_options, add_vector_options


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands, "blur", "Blur a frame, or a sequence of frames, along motion vectors.", run
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.more_help = lambda: f"{describe_filters()}\n\n{describe_presets()}"
    parser.instead_of_more = _together
    parser.add_argument(
        "inputs",
        type=file_path,
        nargs="+",
        metavar="input",
        help="frame with color, depth and vectors, or frames: name.####.exr, name.%%04d.exr; "
        "name.%%V.####.exr has a file for each view; several files, or one, become files of their "
        "names where OUT is a folder",
    )
    outputs.add_output_option(parser)
    existing = parser.add_mutually_exclusive_group()
    existing.add_argument("--overwrite", action="store_true", help="replace existing outputs")
    sequence.add_options(parser, existing)
    outputs.add_png_option(parser)
    parser.add_argument(
        "--drop-extra", action="store_true", help="write the color alone, not the other channels"
    )
    add_pass_options(parser)
    mattes.add_option(parser)
    add_truth_options(parser)
    results.add_option(parser)
    _add_neighbor_options(parser)
    add_color_options(parser, "pictures, scores and --result")
    add_compute_options(parser)
    add_threads_option(parser)
    group = add_filter_options(parser)
    add_quality_option(group)
    add_seed_option(group)
    add_parameters_option(group)
    _add_plan_options(parser)
    add_vector_options(parser)
    add_shutter_options(parser)
    add_motion_option(parser)
    views.add_options(parser)
    strength.add_options(parser)
    posts.add_options(parser, "--then", through=True)
    add_nonfinite_option(add_source_options(parser))
    isolation.add_options(parser, memory=16384, seconds=24 * 3600)


def _add_neighbor_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "more renders, for a single frame (a sequence uses its frames by itself)"
    )
    for side in ("before", "after"):
        group.add_argument(
            f"--{side}",
            type=file_path,
            metavar="FILE",
            help=f"the frame {side}, which shows some of what the frame hides; read by the same "
            "options",
        )
    group.add_argument(
        "--subframes",
        type=file_path,
        metavar="NAMES",
        help="sub.####.exr: K sharp renders at the centers of K equal parts of the exposure, each "
        "blurred over its part, and their mean; the frame gives the other channels",
    )


def _together(given: Sequence[str], left: Sequence[str]) -> str:
    """How to give frames that options separate."""
    return "give all frames one after the other, and the options before or behind them"


def _add_plan_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("plan")
    group.add_argument(
        "--plan",
        choices=("auto", "perceptual"),
        help="choose filter, settings and parameters by statistics of the frame, of a sequence for "
        "each frame anew; -v says why: auto by PSNR, perceptual by what viewers of clips see "
        "(JOD); replaces all filter options, which are rejected beside it",
    )
    group.add_argument(
        "--tolerance",
        type=positive_number,
        metavar="LOSS",
        help="with --plan: what may be lost against the full filter, auto in dB of PSNR (0.5 "
        "without --budget), perceptual in JOD (without it what viewers did not tell apart)",
    )
    group.add_argument(
        "--budget", type=positive_number, metavar="MS", help="with --plan: time for the filter"
    )


def run(arguments: argparse.Namespace) -> int:
    """Blur one frame, several, or a sequence; see `add_parser`."""
    places = several.places_of(arguments)
    arguments.input, arguments.output = places[0]
    if arguments.isolate and not isolation.in_child:
        return isolation.run(arguments)
    settle(arguments)
    _check_plan(arguments)
    check_motion(arguments)
    check_colors(arguments)
    views.check(arguments)
    strength.check(arguments)
    mattes.check(arguments)
    posts.check(arguments)
    results.check(arguments)
    asked = Choice(*complete(arguments, read_fitted(arguments)))
    views.check_samples(arguments, asked)
    if arguments.exposure is not None:
        require_shutter(asked.name, option_of(arguments))
    if posts.looks_through(arguments) and not arguments.plan:
        require_lens(asked.name, "--focus")
    with limited_threads(arguments.threads):
        if sequence.is_asked_for(arguments):
            return sequence.blur_sequence(arguments, asked)
        sequence.refuse_options(arguments)
        if len(places) > 1:
            return several.blur_several(arguments, asked, places)
        return blur_single(arguments, asked)


def _check_plan(arguments: argparse.Namespace) -> None:
    numbers = "samples", "quality", "radius", "spacing", "temperature"
    names = ("filter", *numbers, "param", "parameters", *CHOICES)
    excluded = names if arguments.plan else ("tolerance", "budget")
    if arguments.plan and arguments.exposure is not None:
        raise CommandError(
            f"{option_of(arguments)}: --plan may choose a filter that takes no shutter; leave out "
            "one of the two."
        )
    if arguments.plan and posts.looks_through(arguments):
        raise CommandError(
            "--focus: --plan may choose a filter that takes no lens; leave out one of the two, or "
            "add --then defocus."
        )
    for name in excluded:
        # A radius of 0 stands for auto, and is given too.
        if getattr(arguments, name) not in (None, []):
            option = f"--{name.replace('_', '-')}"
            reason = "--plan chooses that" if arguments.plan else "only --plan takes it"
            raise CommandError(f"{option}: {reason}; leave out one of the two.")
