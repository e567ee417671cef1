"""``jaxblur info``: what a file holds, and how fast things move in it."""

import argparse
import dataclasses
import json
import os
from collections.abc import Sequence
from typing import Any

from jaxblur.filters.registry import filter_info

from . import isolation
from .arguments import (
    add_command,
    describe_presets,
    file_path,
    in_option_names,
    positive_integer,
)
from .console import print_line, print_table
from .filtering import DEFAULT_FILTER
from .sources import add_vector_options


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(commands, "info", "List what a file holds and how fast it moves.", run)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.more_help = describe_presets
    parser.add_argument("file", type=file_path, help="image file")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--radius",
        type=positive_integer,
        default=filter_info(DEFAULT_FILTER).settings.radius,
        metavar="PX",
        help="count the vectors beyond it (default %(default)s)",
    )
    add_vector_options(parser)
    isolation.add_options(parser, memory=4096, seconds=120)


def run(arguments: argparse.Namespace) -> int:
    """List one file; see `add_parser`."""
    from jaxblur import exr

    if arguments.isolate and not isolation.in_child:
        return isolation.run(arguments)
    info = exr.inspect(arguments.file)
    if isolation.declares_too_much(info) and not isolation.in_child and os.name != "nt":
        return isolation.run(arguments)
    bad = {name: count for name, count in exr.count_not_finite(info.path).items() if count}
    motion = _motion(info, arguments)
    picture = _picture(info, arguments, motion.get("channels", ()))
    if arguments.json:
        listing = {"path": info.path, "parts": [_as_json(part) for part in info.parts]}
        print(json.dumps(listing | {"not_finite": bad} | picture | {"motion": motion}, indent=2))
    else:
        print_line(info.path)
        _print_parts(info)
        _print_not_finite(bad)
        print_line()
        for what, found in picture.items():
            channels = ", ".join(found["channels"]) or f"none ({found['reason']})"
            print_line(f"{what}: {channels}")
        _print_motion(motion)
    return 0


def _picture(info: Any, arguments: argparse.Namespace, vectors: Sequence[str]) -> dict[str, Any]:
    """The channels that `blur` would read as color and as depth, or the reason for none."""
    from jaxblur import exr

    found, prefix = {}, ""
    try:
        group = exr.choose_color(info, arguments.layer)
        found["color"], prefix = {"channels": list(group.channels)}, group.prefix
    except exr.JaxblurIOError as error:
        found["color"] = _nothing(error)
    try:
        depth = exr.choose_depth(info, arguments.layer, None, prefix, vectors)
        found["depth"] = {"channels": [depth]}
    except exr.JaxblurIOError as error:
        found["depth"] = _nothing(error)
    return found


def _nothing(error: Any) -> dict[str, Any]:
    """No channels, and why; in the option names of `blur`."""
    options: dict[str, Any] = dict.fromkeys(
        ("color_channels", "depth_channel", "depth_from", "depth")
    )
    return {"channels": [], "reason": in_option_names(error.reason, options)}


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
        return {"preset": None, "reason": in_option_names(error.reason, vars(arguments))}
    found = {"preset": guess.preset.name, "channels": guess.channels, "reason": guess.reason}
    missing = _missing_option(guess.preset, arguments)
    if missing:
        return found | {"speeds": None, "needs": missing}
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


def _missing_option(preset: Any, arguments: argparse.Namespace) -> str | None:
    if preset.span == "shutter" and arguments.file_shutter is None:
        return "--file-shutter"
    if preset.scale == "max-displace" and arguments.max_displace is None:
        return "--max-displace"
    return None


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
                part.compression + (", deep" if part.deep else ""),
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
        print_line("`jaxblur blur` rejects them in channels that it uses, unless given --nonfinite")


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
        print_line(f"speeds not measured: this preset needs {motion['needs']}")
        return
    print_line(f"half-spread in pixels at shutter {motion['shutter']:g}:")
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
