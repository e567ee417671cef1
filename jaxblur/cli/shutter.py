"""Exposures on the command line: ``0.5`` frames, ``180deg``, ``1/48s`` with ``--fps 24``."""

import argparse
import math
import re
from typing import Any

from .arguments import CommandError, positive_number

LONGEST = 2.0
"""Frames above which a number without a unit is taken for a mistake."""
FORMS = "such as 0.5 (frames), 180deg, or 1/48s with --fps"
_FORM = re.compile(
    r"(?P<number>[-+]?[0-9.]+(?:e[-+]?[0-9]+)?)(?:/(?P<divisor>[0-9.]+))? *(?P<unit>[a-z]*)"
)


class Seconds(float):
    """An exposure in seconds, which becomes one in frames once ``--fps`` is known."""


def add_exposure(parser: Any, option: str, help: str, default: float | None = None) -> None:
    """Add an option that takes an exposure.

    Args:
        parser: or a group of one.
        option: such as ``--shutter``.
        help: its text, to which the forms are added.
        default: exposure in frames.
    """
    parser.add_argument(
        option,
        type=exposure,
        default=default,
        metavar="S",
        help=f"{help}, {FORMS}" + ("" if default is None else " (default %(default)s)"),
    )


def add_fps(parser: Any) -> None:
    """Add ``--fps``."""
    parser.add_argument(
        "--fps",
        type=positive_number,
        metavar="N",
        help="frames per second, for exposures in seconds",
    )


def exposure(text: str) -> float:
    """Parse an exposure: frames, or `Seconds`.

    Raises:
        ArgumentTypeError: it is something else, or a number without a unit that is not meant as
            frames.
    """
    found = _FORM.fullmatch(text.strip().lower())
    try:
        if found is None:
            raise ValueError
        value = float(found["number"]) / float(found["divisor"] or 1)
    except (ValueError, ZeroDivisionError):
        raise argparse.ArgumentTypeError(f"expected an exposure {FORMS}, got {text!r}") from None
    unit = found["unit"]
    if not math.isfinite(value) or unit not in ("", "deg", "s", "frames"):
        raise argparse.ArgumentTypeError(f"expected an exposure {FORMS}, got {text!r}")
    if unit == "deg":
        return value / 360
    if unit == "s":
        return Seconds(value)
    if unit == "" and value > LONGEST:
        raise argparse.ArgumentTypeError(
            f"{text} frames is a long exposure; {text}deg is a shutter angle, {value / 360:.3g} "
            f"frames; pass {text}frames if you mean it"
        )
    return value


def resolve(arguments: argparse.Namespace) -> None:
    """Turn exposures in seconds into frames, in place.

    Raises:
        CommandError: there is one, and no ``--fps``; or ``--fps`` without one.
    """
    fps = getattr(arguments, "fps", None)
    given = [name for name, value in vars(arguments).items() if isinstance(value, Seconds)]
    for name in given:
        seconds = getattr(arguments, name)
        if fps is None:
            option = f"--{name.replace('_', '-')}"
            raise CommandError(f"{option}: {seconds:g} s is how many frames? Pass --fps.")
        setattr(arguments, name, float(seconds) * fps)
    if fps is not None and not given:
        raise CommandError("--fps: is for exposures in seconds, such as --shutter 1/48s.")
