"""``jaxblur vectors``: find the convention of motion vectors from two frames."""

import argparse
import dataclasses
import json
import os
import shlex
from collections.abc import Sequence
from typing import Any

from ..arguments import (
    CommandError,
    add_command,
    channel_names,
    file_path,
    positive_integer,
    preset_name,
)
from ..console import print_line, print_table
from ..shutter import add_exposure, add_fps
from ..sources import add_depth_kind, add_max_displace
from . import vectors_conform, vectors_draw


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "vectors",
        "Rank sign, unit and span of motion vectors by warping the next frame back, test them, or "
        "draw them.",
        run,
    )
    parser.epilog = (
        "Exit status 1: inconclusive; no candidate brings the frames together, or several do so "
        "equally well. Units: px is pixels, uv fractions of the picture, ndc -1 to 1 over it, "
        "displace -1 to 1 over --max-displace. The span is the time in frames that vectors cover."
    )
    parser.add_argument("file", type=file_path, help="frame with motion vectors")
    parser.instead_of_more = _next_as_option
    # `run` demands it: the parser would, before it names a second file without the option.
    parser.add_argument(
        "--next", type=file_path, metavar="FILE", help="the following frame (required to rank)"
    )
    parser.add_argument(
        "--draw",
        type=file_path,
        metavar="OUT.png",
        help="draw instead, over the picture, how far points move while the shutter is open for "
        "--shutter (needs matplotlib)",
    )
    parser.add_argument(
        "--preset",
        type=preset_name,
        metavar="NAME",
        help="with --draw: convention of the vectors (default auto: by channel names)",
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="with --draw: replace an existing picture"
    )
    parser.add_argument(
        "--conform",
        type=preset_name,
        metavar="PRESET",
        help="test instead, rule by rule, whether the vectors keep this convention (auto: the one "
        "that their names say)",
    )
    parser.add_argument(
        "--previous",
        type=file_path,
        metavar="FILE",
        help="with --conform: the frame before, for vectors that lead there",
    )
    parser.add_argument(
        "--velocity-channels",
        type=channel_names,
        metavar="X,Y[,X,Y]",
        help="names of the vector channels, where they are not recognized",
    )
    parser.add_argument("--layer", metavar="NAME", help="view layer, view or part to look in")
    add_depth_kind(parser, "with --conform or --draw: kind of the depth: ")
    parser.add_argument(
        "--depth-channel", metavar="NAME", help="with --conform or --draw: channel of the depth"
    )
    add_exposure(
        parser, "--shutter", "exposure that the vectors might span, or to draw", default=0.5
    )
    add_fps(parser)
    add_max_displace(parser)
    parser.add_argument(
        "--top",
        type=positive_integer,
        default=8,
        metavar="N",
        help="candidates to list (default %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print JSON, all candidates")


def run(arguments: argparse.Namespace) -> int:
    """Rank the conventions of one pair of frames, test one, or draw; see `add_parser`."""
    vectors_draw.check(arguments)
    if arguments.draw is not None:
        return vectors_draw.run(arguments)
    if arguments.conform is not None:
        _check_beside(arguments, "next", "follows")
        _check_beside(arguments, "previous", "comes before")
        return vectors_conform.run(arguments)
    if arguments.previous is not None:
        raise CommandError("--previous: is for --conform PRESET.")
    for name in ("depth", "depth_channel"):
        if getattr(arguments, name) != arguments.option_defaults[name]:
            option = f"--{name.replace('_', '-')}"
            raise CommandError(f"{option}: is for --conform PRESET and --draw OUT.png.")
    ranking = _rank(arguments)
    explained = ranking.is_explained
    undecided = ranking.undecided
    if arguments.json:
        print(json.dumps(dataclasses.asdict(ranking) | {"undecided": undecided}, indent=2))
    else:
        _print_ranking(ranking, arguments.top, explained, arguments.max_displace)
        if explained and not undecided and ranking.candidates[0].presets:
            if both := _both_sides(arguments, ranking.candidates[0]):
                print_line(both)
            print_line(f"to blur: {_command(arguments, ranking.candidates[0])}")
    return 0 if explained and not undecided else 1


def _next_as_option(given: Sequence[str], left: Sequence[str]) -> str:
    """How to give the following frame."""
    return f"`jaxblur vectors` takes one frame, and the following one as --next {left[-1]}"


def _check_beside(arguments: argparse.Namespace, side: str, place: str) -> None:
    """Reject the frame itself in place of one beside it."""
    path = getattr(arguments, side)
    if path is not None and path.exists() and arguments.file.exists():
        if os.path.samefile(path, arguments.file):
            raise CommandError(
                f"--{side}: {path} is the frame itself; give the frame that {place}."
            )


def _rank(arguments: argparse.Namespace) -> Any:
    import numpy as np

    from jaxblur import exr, vectors

    if arguments.next is None:
        raise CommandError("--next: is missing; give the frame that follows.")
    _check_beside(arguments, "next", "follows")
    info = exr.inspect(arguments.file)
    names = arguments.velocity_channels or _recognized(info, arguments.layer)
    if len(names) % 2:
        raise CommandError(f"--velocity-channels: expected pairs of x and y, got {len(names)}.")
    *_, width, height = info.parts[info.channel(names[0]).part].display_window
    now = exr.read_image(arguments.file, arguments.layer)
    following = exr.read_image(arguments.next, arguments.layer)
    colors = {_color_count(image) for image in (now, following)}
    if now.shape[:2] != following.shape[:2] or len(colors) > 1:
        raise CommandError(
            f"{arguments.next}: {_size(following)}, but {arguments.file} has {_size(now)}; give "
            "two frames of one sequence."
        )
    if np.array_equal(now, following):
        raise CommandError(
            f"{arguments.next}: has the same picture as {arguments.file}, so that nothing moves "
            "from one to the other; give the following frame."
        )
    raw = exr.read_channels(arguments.file, names)
    if now.shape != following.shape:
        # One of the two lacks alpha; the channels of both are compared.
        now, following = (image[..., : min(colors)] for image in (now, following))
    try:
        return vectors.rank_conventions(
            now,
            following,
            raw,
            names,
            shutter=arguments.shutter,
            size=(height, width),
            max_displace=arguments.max_displace,
        )
    except ValueError as error:
        raise CommandError(f"{arguments.file}: {error}") from error


def _recognized(info: Any, layer: str | None) -> list[str]:
    from jaxblur import exr

    try:
        return list(exr.choose_vectors(info, "auto", layer).channels)
    except exr.JaxblurIOError as error:
        if not isinstance(error.__cause__, ValueError):
            # There is no such layer.
            raise
        found = error.reason.partition(";")[0]
        raise CommandError(f"{info.path}: {found}; name them with --velocity-channels.") from error


def _color_count(image: Any) -> int:
    """Number of channels without alpha: gray or RGB."""
    return 1 if image.shape[2] < 3 else 3


def _size(image: Any) -> str:
    height, width, channels = image.shape
    return f"{width}x{height} pixels and {channels} channels"


def _both_sides(arguments: argparse.Namespace, best: Any) -> str:
    """Why two rows name one preset, if it has vectors to both sides; else nothing."""
    from jaxblur import exr

    name = best.presets[0]
    try:
        found = exr.choose_vectors(exr.inspect(arguments.file), name, arguments.layer)
    except exr.JaxblurIOError:
        return ""
    if len(found.layout) < 2 or not set(best.channels) <= set(found.channels):
        return ""
    sides = {-1: "previous", 1: "next"}
    each = " and ".join(
        f"{', '.join(found.channels[2 * index : 2 * index + 2])} to the {sides[pair.time]} frame"
        for index, pair in enumerate(found.layout)
    )
    return f"preset {name} has a row for each of its two vectors: {each}; both are used."


def _command(arguments: argparse.Namespace, best: Any) -> str:
    """The command line that follows from the best candidate."""
    from jaxblur import exr, vectors

    preset = vectors.PRESETS[best.presets[0]]
    words = ["jaxblur", "blur", arguments.file, "-o", "out.exr", "--preset", preset.name]
    try:
        found = exr.choose_vectors(exr.inspect(arguments.file), preset.name, arguments.layer)
        known = set(best.channels) <= set(found.channels)
    except exr.JaxblurIOError:
        known = False
    if not known:
        words += ["--velocity-channels", ",".join(best.channels)]
    if preset.span == "shutter":
        words += ["--file-shutter", f"{arguments.shutter:g}"]
    if preset.scale == "max-displace":
        words += ["--max-displace", f"{arguments.max_displace:g}"]
    if arguments.layer:
        words += ["--layer", arguments.layer]
    return shlex.join(map(str, words))


def _print_ranking(ranking: Any, count: int, explained: bool, max_displace: float | None) -> None:
    best = ranking.candidates[0]
    print_line(f"{100 * ranking.moving_share:.1f} % of the pixels move")
    print_line("Each row is a way to read two channels as the motion to the next frame:")
    print_line("right = sign * (x - offset) and down = sign * (y - offset), in its unit and span.")
    print_table(
        (">", "x, y", ">right", ">down", "unit", ">offset", ">span", ">error", "presets"),
        [
            (
                index,
                ", ".join(candidate.channels),
                f"{candidate.sign_x:+d} x",
                f"{candidate.sign_y:+d} y",
                candidate.unit,
                f"{candidate.offset:g}",
                f"{candidate.span:g}",
                f"{candidate.error:.5f}",
                ", ".join(candidate.presets) or "-",
            )
            for index, candidate in enumerate(ranking.candidates[:count], start=1)
        ],
    )
    print_line(f"error if nothing moved: {ranking.still_error:.5f}")
    if explained and ranking.undecided:
        print_line(
            f"inconclusive: these frames do not determine {' and '.join(ranking.undecided)}; "
            "give two in which things move both across and up or down"
        )
    elif explained:
        print_line(
            f"best: row 1; to the next frame a point moves {best.sign_x:+d} x to the right and "
            f"{best.sign_y:+d} y down, in {best.unit} over {best.span:g} frames; preset "
            f"{' or '.join(best.presets) or 'unknown'}"
        )
        if max_displace and best.unit == "displace" and best.span != 1:
            print_line(
                "vectors of such a length usually cover a frame: "
                f"then a full one is --max-displace {max_displace / best.span:g}"
            )
    else:
        print_line(
            "inconclusive: no candidate brings the frames together; are they consecutive, and are "
            "these the vectors of the first?"
        )
