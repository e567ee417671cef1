"""``jaxblur info``: what a file holds, and how fast things move in it."""

import argparse
import dataclasses
import json
import logging
import os
import pathlib
import re
from collections.abc import Sequence
from typing import Any

from jaxblur.filters.registry import filter_info

from .. import isolation, view_files
from ..arguments import (
    add_command,
    channel_names,
    describe_presets,
    file_path,
    in_option_names,
    positive_integer,
)
from ..console import print_line, print_table
from ..errors import FAILED, is_foreseeable, message_of
from ..filtering import DEFAULT_FILTER
from ..sequence import frames_on_disk
from ..sources import add_channel_options, add_vector_options
from .info_mattes import names_of, print_names

LOG = logging.getLogger("jaxblur")


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(commands, "info", "List what a file holds and how fast it moves.", run)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.more_help = describe_presets
    parser.add_argument(
        "files",
        type=file_path,
        nargs="+",
        metavar="file",
        help="image file, or name.####.exr, or name.%%V.exr with a file for each view; a file with "
        "the same channels and sizes as the one before takes one line",
    )
    parser.add_argument(
        "--views",
        type=channel_names,
        metavar="NAME[,NAME]",
        help="the views that %%V stands for (default left,right)",
    )
    parser.add_argument("--json", action="store_true", help="print a JSON object for each file")
    parser.add_argument(
        "--radius",
        type=positive_integer,
        default=filter_info(DEFAULT_FILTER).settings.radius,
        metavar="PX",
        help="count the vectors beyond it (default %(default)s, the longest half-spread that "
        f"{DEFAULT_FILTER} takes by default)",
    )
    add_vector_options(parser)
    group = parser.add_argument_group("where color and depth are, as in `jaxblur blur`")
    add_channel_options(group)
    isolation.add_options(parser, memory=4096, seconds=120)


def run(arguments: argparse.Namespace) -> int:
    """List files, one after the other; see `add_parser`."""
    files = arguments.files
    if not isolation.in_child:
        # A child gets the file of one view and frame.
        files = _files(view_files.files_of(files, arguments.views))
    if len(files) == 1:
        return _list(_about(arguments, files[0]), _Before())
    status, before = 0, _Before()
    for file in files:
        try:
            if _list(_about(arguments, file), before):
                status = FAILED
        except Exception as error:
            if not is_foreseeable(error):
                raise
            LOG.error("%s", in_option_names(message_of(error), vars(arguments)))
            status = FAILED
    return status


def _files(given: Sequence[pathlib.Path]) -> list[pathlib.Path]:
    """The files that are named, those of a sequence in the order of their frames."""
    from jaxblur.sequence import has_frame_number, parse_names

    files = []
    for path in given:
        if path.exists() or not has_frame_number(path):
            files.append(path)
            continue
        names = parse_names(path)
        files += [names.path(frame) for frame in frames_on_disk(names)]
    return files


def _about(arguments: argparse.Namespace, file: pathlib.Path) -> argparse.Namespace:
    """The arguments of a command for one of the files."""
    named = {str(path) for path in arguments.files}
    options = [text for text in arguments.argv if text not in named and text != "--"]
    own = {"file": file, "argv": [*options, "--", str(file)]}
    return argparse.Namespace(**vars(arguments) | own)


@dataclasses.dataclass
class _Before:
    """What was printed before a file, of several.

    Attributes:
        path: of the last file that was listed in full.
        kind: what it held, for comparison.
        is_line: whether the last listing was one line.
        is_first: whether nothing was printed.
    """

    path: str = ""
    kind: Any = None
    is_line: bool = False
    is_first: bool = True


def _list(arguments: argparse.Namespace, before: _Before) -> int:
    """List one file: in one line if it holds the same as the last one that was listed in full."""
    from jaxblur import exr

    if arguments.isolate and not isolation.in_child:
        _separate(arguments, before, as_line=False)
        return isolation.run(arguments)
    info = exr.inspect(arguments.file)
    if isolation.declares_too_much(info) and not isolation.in_child and os.name != "nt":
        _separate(arguments, before, as_line=False)
        return isolation.run(arguments)
    bad = {name: count for name, count in exr.count_not_finite(info.path).items() if count}
    motion = _motion(info, arguments)
    picture = _picture(info, arguments, motion.get("channels", ()))
    shown_as, mattes = _shown_as(info, picture), names_of(info)
    if arguments.json:
        listing: dict[str, Any] = {"path": info.path, "views": list(exr.views_of(info))}
        listing["parts"] = [_as_json(part) for part in info.parts]
        if shown_as:
            listing["shown_as"] = shown_as
        if mattes:
            listing["cryptomatte"] = mattes
        print(json.dumps(listing | {"not_finite": bad} | picture | {"motion": motion}, indent=2))
        return 0
    kind = _kind(info, picture, motion, shown_as)
    _separate(arguments, before, as_line=kind == before.kind)
    if kind == before.kind:
        _print_as_line(info.path, before.path, motion, bad)
        return 0
    before.path, before.kind = info.path, kind
    print_line(info.path)
    _print_parts(info)
    _print_not_finite(bad)
    print_line()
    if views := exr.views_of(info):
        print_line(
            f"views: {', '.join(views)}; `jaxblur blur` and `post` process all of them, other "
            f"commands {views[0]}; --layer NAME chooses one"
        )
    for what, found in picture.items():
        channels = ", ".join(found["channels"]) or f"none ({found['reason']})"
        print_line(f"{what}: {channels}{_borrowed(info, arguments, found['channels'])}")
    if shown_as:
        print_line(f"colors of previews: {shown_as}")
    _print_motion(motion)
    _explain_radius(motion, arguments.radius)
    print_names(mattes, every=bool(arguments.verbose))
    return 0


def _separate(arguments: argparse.Namespace, before: _Before, as_line: bool) -> None:
    """Print an empty line between listings, but not between those of one line."""
    if not (before.is_first or arguments.json or (as_line and before.is_line)):
        print_line()
    before.is_first, before.is_line = False, as_line


def _kind(info: Any, picture: dict[str, Any], motion: dict[str, Any], shown_as: str) -> Any:
    """What frames of one shot have in common: everything that is printed but for the numbers."""
    parts = [dataclasses.replace(part, attributes={}) for part in info.parts]
    meaning = {name: value for name, value in motion.items() if name != "speeds"}
    return parts, picture, meaning, shown_as


def _print_as_line(path: str, model: str, motion: dict[str, Any], bad: dict[str, int]) -> None:
    """Print how a file differs from another one with the same channels."""
    words = [f"{path}: as {os.path.basename(model)}"]
    if speeds := motion.get("speeds"):
        fast = speeds["percentiles"]
        words.append(
            f"half-spread median {fast[50.0]:.2f}, max {fast[100.0]:.2f} px, "
            f"{100 * speeds['zero_share']:.2f} % zero, "
            f"{100 * speeds['beyond_share']:.2f} % beyond {speeds['radius']:g} px"
        )
    if bad:
        counts = ", ".join(f"{name} ({count} pixels)" for name, count in bad.items())
        words.append(f"NaN or infinity in {counts}")
    print_line("; ".join(words))


def _shown_as(info: Any, picture: dict[str, Any]) -> str:
    """How previews convert the colors, or why they cannot; nothing without colors."""
    from jaxblur import exr

    if not picture["color"]["channels"]:
        return ""
    try:
        return exr.conversion_of(info, picture["color"]["channels"][0]).words
    except ValueError as error:
        return f"unknown ({error})"


def _borrowed(info: Any, arguments: argparse.Namespace, channels: Sequence[str]) -> str:
    from jaxblur import exr

    words = exr.borrowed_from(info, arguments.layer, channels) if channels else ""
    return f" ({words})" if words else ""


def _explain_radius(motion: dict[str, Any], radius: int) -> None:
    """Say why vectors are compared with this length."""
    usual = filter_info(DEFAULT_FILTER).settings.radius
    if motion.get("speeds") and radius == usual:
        print_line(
            f"{DEFAULT_FILTER}, the default filter, shortens half-spreads beyond its default "
            f"--radius, {radius} px; --radius PX counts beyond another length"
        )


def _picture(info: Any, arguments: argparse.Namespace, vectors: Sequence[str]) -> dict[str, Any]:
    """The channels that `blur` would read as color and as depth, or the reason for none."""
    from jaxblur import exr

    found, prefix = {}, ""
    try:
        group = exr.choose_color(info, arguments.layer, arguments.color_channels)
        found["color"], prefix = {"channels": list(group.channels)}, group.prefix
    except exr.JaxblurIOError as error:
        if arguments.color_channels:
            raise
        found["color"] = {"channels": [], "reason": _advice(error.reason, arguments)}
    try:
        depth = exr.choose_depth(info, arguments.layer, arguments.depth_channel, prefix, vectors)
        found["depth"] = {"channels": [depth]}
    except exr.JaxblurIOError as error:
        if arguments.depth_channel:
            raise
        found["depth"] = {"channels": [], "reason": _advice(error.reason, arguments)}
    return found


def _advice(reason: str, arguments: argparse.Namespace) -> str:
    """A reason in the names of options, with a note of those that only `blur` has."""
    of_blur = dict.fromkeys(("velocity_from", "depth_from", "depth"))
    words = in_option_names(reason, vars(arguments) | of_blur)
    flags = [f"--{name.replace('_', '-')}" for name in of_blur]
    used = [flag for flag in flags if re.search(rf"{flag}(?![\w-])", words)]
    note = f" ({' and '.join(used)}: of `jaxblur blur`)" if used else ""
    return words.removesuffix(".") + note + "."


def _motion(info: Any, arguments: argparse.Namespace) -> dict[str, Any]:
    """Recognize the vectors and measure them; ``preset`` is None where there are none."""
    from jaxblur import exr

    try:
        guess = exr.choose_vectors(
            info, arguments.preset, arguments.layer, arguments.velocity_channels
        )
    except exr.JaxblurIOError as error:
        if arguments.preset != "auto" or arguments.velocity_channels:
            raise
        return {"preset": None, "reason": _advice(error.reason, arguments)}
    reason = guess.reason + _borrowed(info, arguments, guess.channels)
    found = {"preset": guess.preset.name, "channels": guess.channels, "reason": reason}
    if why := _not_measured(info, guess, arguments):
        return found | {"speeds": None, "not_measured": why}
    speeds = exr.measure_speeds(
        info.path,
        guess,
        arguments.shutter,
        arguments.radius,
        file_shutter=arguments.file_shutter,
        max_displace=arguments.max_displace,
        layer=arguments.layer,
    )
    return found | {"shutter": arguments.shutter, "speeds": dataclasses.asdict(speeds)}


def _not_measured(info: Any, guess: Any, arguments: argparse.Namespace) -> str:
    """Why speeds cannot be measured, empty if they can."""
    if info.parts[info.channel(guess.channels[0]).part].deep:
        return "deep pixels; `jaxblur layers` blurs them"
    if guess.preset.span == "shutter" and arguments.file_shutter is None:
        return "this preset needs --file-shutter"
    if guess.preset.scale == "max-displace" and arguments.max_displace is None:
        return "this preset needs --max-displace"
    return ""


def _as_json(part: Any) -> dict[str, Any]:
    attributes = {
        name: value
        for name, value in part.attributes.items()
        if isinstance(value, str | int | float)
    }
    channels = {channel.name: channel.type for channel in part.channels}
    return dataclasses.asdict(part) | {"channels": channels, "attributes": attributes}


def _print_parts(info: Any) -> None:
    print_table(
        (">part", "name", "data window", "display window", "compression"),
        [
            (
                index,
                part.name or "-",
                _window(part.data_window),
                _window(part.display_window),
                _storage(part),
            )
            for index, part in enumerate(info.parts)
        ],
    )
    print_line()
    print_table(
        (">part", "channel", "type"),
        [(channel.part, channel.name, channel.type) for channel in info.channels],
    )
    notes = {
        (name, str(value))
        for part in info.parts
        for name, value in part.attributes.items()
        if name.startswith("jaxblur:")
    }
    if notes:
        print_line()
        print_table(("attribute", "value"), sorted(notes))


def _print_not_finite(bad: dict[str, int]) -> None:
    if bad:
        print_line()
        print_table(("channel", ">pixels with NaN or infinity"), list(bad.items()))
        print_line(
            "`jaxblur blur` rejects frames with NaN or infinity in channels that it reads; "
            "--nonfinite ignore takes them"
        )


def _storage(part: Any) -> str:
    levels = (", deep" if part.deep else "") + (
        f", {part.levels} levels" if part.levels > 1 else ""
    )
    return part.compression + levels


def _window(window: tuple[int, int, int, int]) -> str:
    x, y, width, height = window
    return f"{width}x{height} at {x},{y}"


def _print_motion(motion: dict[str, Any]) -> None:
    if motion["preset"] is None:
        print_line(f"motion vectors: none ({motion['reason']})")
        return
    print_line(f"motion vectors: {motion['reason']}")
    speeds = motion["speeds"]
    if speeds is None:
        print_line(f"speeds not measured: {motion['not_measured']}")
        return
    shutter = motion["shutter"]
    print_line(
        f"half-spread (half of the path during the exposure), pixels, at --shutter {shutter:g}:"
    )
    percentiles = speeds["percentiles"]
    headings = [">median" if p == 50 else ">max" if p == 100 else f">{p:g} %" for p in percentiles]
    print_table(headings, [[f"{speed:.2f}" for speed in percentiles.values()]])
    print_line()
    print_table(
        (">zero", ">non-finite", f">beyond {speeds['radius']:g} px", ">suggested radius"),
        [
            (
                f"{100 * speeds['zero_share']:.2f} %",
                f"{100 * speeds['non_finite_share']:.2f} %",
                f"{100 * speeds['beyond_share']:.2f} %",
                f"{speeds['suggested_radius']} px",
            )
        ],
    )
