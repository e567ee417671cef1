"""``jaxblur layers``: layers of a frame in, one blurred frame out."""

import argparse
from typing import Any

from .. import isolation, layer_reading, outputs, sequence, stack, strength
from ..arguments import (
    CommandError,
    add_command,
    add_compute_options,
    describe_presets,
    positive_integer,
)
from ..choice import Choice
from ..colors import add_color_options, check_colors
from ..compute import add_threads_option, limited_threads
from ..filtering import (
    add_filter_options,
    add_nonfinite_option,
    add_quality_option,
    add_seed_option,
    complete,
    describe_filters,
)
from ..loading import add_motion_option, check_motion
from ..scores import add_truth_options
from ..shutter import add_shutter_options, settle
from ..single import blur_single
from ..sources import add_depth_options, add_pass_options, add_vector_options

FILTER = "layered"
EXPLANATION = """\
Each layer is FILE, or FILE:LAYER for a part, a view layer or a layer by name: hero.exr
shot.exr:street. Names of a sequence, hero.####.exr, give a layer for each frame; a file without a
frame number is the same in all frames. Every layer has color with alpha, depth and vectors; the
last of several may be without alpha, and is opaque then, as a clean plate is. Deep files become
several layers. The result is the color of all of them, over nothing, with the metadata of the
front one. Options are those of `jaxblur blur`, but for those of other filters, plans and fitted
parameters, defocus and antialiasing, views, color and vectors of other names or files for one
layer, Cryptomattes, --subframes and --result: `jaxblur layers --focus 4` says what to do instead.
"""
_REMEDIES = {
    "layers are blurred by layered alone, with its --param and --samples; leave it out": (
        *("--filter", "--plan", "--tolerance", "--budget", "--parameters", "--temperature"),
        *("--tile-choice", "--directions", "--direction-weights", "--diagonal-tiles"),
        *("--dominant", "--split"),
    ),
    "layers are blurred by motion alone; afterwards run `jaxblur post OUT.exr -o FINAL.exr "
    "--do defocus --focus DEPTH --depth-from FILE`": (
        *("--focus", "--lens", "--lens-samples", "--f-number", "--focal-length", "--sensor"),
        "--unit",
    ),
    "afterwards run `jaxblur post OUT.exr -o FINAL.exr --do NAME`": ("--then",),
    "the layer of a file is named with it, as FILE:LAYER": ("--layer", "--color-channels"),
    "vectors and depth of a layer are in its own file; copy them into it": (
        *("--velocity-from", "--depth-from"),
    ),
    "the output is the color of all layers, without other channels; leave it out": (
        *("--drop-extra", "--cryptomatte", "--no-cryptomatte"),
    ),
    "layers have no views but those of files with %V, left and right; run it for each view": (
        *("--views", "--view-samples", "--disparity"),
    ),
    "`jaxblur layers` makes no results for `jaxblur report`; --truth prints scores": ("--result",),
    "`jaxblur layers` takes one render of a frame; leave it out": ("--subframes",),
}
ELSEWHERE = {option: why for why, options in _REMEDIES.items() for option in options}
"""Options of ``jaxblur blur`` that layers have not, and what to do instead."""


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands, "layers", "Blur layers together, front to back, into one frame.", run
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.elsewhere = ELSEWHERE
    parser.more_help = lambda: f"{EXPLANATION}\n{describe_filters(FILTER)}\n\n{describe_presets()}"
    parser.add_argument(
        "layers",
        type=stack.layer_name,
        nargs="+",
        metavar="FILE[:LAYER]",
        help="from the front to the back; see below",
    )
    outputs.add_output_option(parser)
    existing = parser.add_mutually_exclusive_group()
    existing.add_argument("--overwrite", action="store_true", help="replace existing outputs")
    sequence.add_options(parser, existing)
    outputs.add_png_option(parser)
    add_pass_options(parser)
    add_truth_options(parser)
    _add_stack_options(parser)
    add_color_options(parser)
    add_compute_options(parser)
    add_threads_option(parser)
    group = add_filter_options(parser, FILTER, alone=True)
    add_quality_option(group)
    add_seed_option(group)
    add_vector_options(parser, layer=False)
    add_shutter_options(parser)
    add_motion_option(parser)
    strength.add_options(parser)
    add_nonfinite_option(add_depth_options(parser))
    isolation.add_options(parser, memory=16384, seconds=24 * 3600)
    # What `blur` has besides.
    nothing = ("velocity_from", "depth_from", "color_channels", "layer", "subframes", "result")
    nothing += ("views", "view_samples", "disparity")
    more = ("plan", "tolerance", "budget", "parameters", "cryptomatte")
    parser.set_defaults(**dict.fromkeys((*nothing, *more)), drop_extra=True, stack=(), posts=())


def _add_stack_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("layers")
    group.add_argument(
        "--holdout",
        action="append",
        default=[],
        metavar="NAME|N",
        help="this layer hides what is behind it and is not seen, so that the result is "
        "transparent there; repeat for several",
    )
    group.add_argument(
        "--still",
        action="append",
        default=[],
        metavar="NAME|N",
        help="nothing moves in this layer, which needs neither vectors nor depth; repeat for "
        "several",
    )
    group.add_argument(
        "--deep-layers",
        type=positive_integer,
        metavar="K",
        help="most layers that a deep file is flattened into, divided where things pass each other "
        f"(default {layer_reading.DEEP_LAYERS})",
    )
    for side in ("before", "after"):
        group.add_argument(
            f"--{side}",
            type=stack.layer_name,
            nargs="+",
            metavar="FILE",
            help=f"the files of the frame {side}, one for each layer, which show some of what the "
            "layers hide; for a single frame (a sequence uses its frames by itself)",
        )


def run(arguments: argparse.Namespace) -> int:
    """Blur the layers of one frame, or of a sequence; see `add_parser`."""
    if arguments.isolate and not isolation.in_child:
        arguments.input = arguments.layers[0].path
        return isolation.run(arguments)
    settle(arguments)
    arguments.stack = stack.places_of(arguments)
    arguments.layer = next(p.layer for p in arguments.stack if p.role == "input")
    _check(arguments)
    check_motion(arguments)
    check_colors(arguments)
    strength.check(arguments)
    asked = Choice(*complete(arguments))
    from jaxblur.exr import JaxblurIOError

    with limited_threads(arguments.threads):
        if sequence.is_asked_for(arguments):
            return sequence.blur_sequence(arguments, asked)
        sequence.refuse_options(arguments)
        try:
            return blur_single(arguments, asked)
        except JaxblurIOError as error:
            raise layer_reading.with_remedies(error) from error


def _check(arguments: argparse.Namespace) -> None:
    """Reject what layers do not have, before any work."""
    for side in ("before", "after"):
        given = getattr(arguments, side)
        if given is not None and len(given) != len(arguments.stack):
            raise CommandError(
                f"--{side}: needs one file for each layer, {len(arguments.stack)}, in their "
                f"order; got {len(given)}."
            )
    names = [(name.path.resolve(), name.layer) for name in arguments.layers]
    for number, name in enumerate(names, 1):
        if number > (first := names.index(name) + 1):
            raise CommandError(
                f"{arguments.layers[number - 1].text}: layer {number} is layer {first} again; "
                "leave it out, or name another layer of the file as FILE:LAYER."
            )
    if all(place.holdout for place in arguments.stack):
        raise CommandError("--holdout: nothing is left to be seen; leave it out for one layer.")
