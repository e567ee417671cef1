"""Exposures on the command line: ``0.5`` frames, ``180deg``, ``1/48s`` with ``--fps 24``.

And the shutter of ``jaxblur blur``: where the exposure lies, its curve, and its rolling.
"""

import argparse
import logging
import math
import pathlib
import re
from typing import Any, NamedTuple

from jaxblur._util.small_files import read_text

from .arguments import CommandError, did_you_mean, positive_number

LOG = logging.getLogger("jaxblur")
LONGEST = 2.0
"""Frames above which a number without a unit is taken for a mistake."""
SPEED = 24
"""Divisor from which a fraction without a unit is taken for a shutter speed in seconds."""
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
        help=f"{help}, {FORMS}" + ("" if default is None else f" (default {default})"),
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
    if unit == "" and float(found["divisor"] or 1) >= SPEED:
        raise argparse.ArgumentTypeError(
            f"{text} of a frame is a short exposure; {text}s with --fps is a shutter speed in "
            f"seconds; pass {value:.3g} if you mean frames"
        )
    if unit == "" and abs(value) > LONGEST:
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


DEFAULT = 0.5
"""Frames, the exposure of ``--shutter``."""
POSITIONS = ("start", "center", "end")
"""Where the time of the frame lies in the exposure, as `jaxblur.shutter.POSITIONS`."""
CURVES = ("box", "trapezoid", "triangle", "gaussian")
"""As `jaxblur.shutter.CURVES`."""
LARGEST = 1e30
"""Numbers of a curve are below it, so that sums of them are finite in single precision."""
MOST_POINTS = 10_000
"""Lines of the file of a curve."""
POINTS = 257
"""Points to which a curve is brought whose times are not evenly spaced."""
OPTIONS = ("shutter_position", "shutter_open", "shutter_close", "shutter_curve", "readout")


class Exposure(NamedTuple):
    """A shutter that is no centered box, in frames from the time of the frame.

    Attributes:
        open: when it opens.
        close: when it closes.
        readout: from the exposure of the top edge to that of the bottom edge.
        curve: name of the curve, or of its file.
        points: transmission at evenly spaced times, of a curve from a file; empty for a name.
    """

    open: float
    close: float
    readout: float
    curve: str
    points: tuple[float, ...] = ()

    @property
    def reach(self) -> float:
        """The longest time from the frame at which light comes in, in half exposures."""
        farthest = max(abs(self.open), abs(self.close)) + abs(self.readout) / 2
        return farthest / ((self.close - self.open) / 2)

    def shutter(self) -> Any:
        """The `jaxblur.Shutter` of a frame that was read for an exposure of the same length."""
        import numpy as np

        from jaxblur.shutter import Shutter

        return Shutter.from_frames(
            self.open,
            self.close,
            exposure=self.close - self.open,
            curve=np.array(self.points, np.float32) if self.points else self.curve,
            readout=self.readout,
        )

    def notes(self) -> dict[str, Any]:
        """What is written into a file, by name."""
        times = {name: round(getattr(self, name), 9) for name in ("open", "close", "readout")}
        named = {("" if name == "readout" else "shutter_") + name: t for name, t in times.items()}
        named["shutter_curve"] = self.curve
        return named | ({"shutter_points": list(self.points)} if self.points else {})


def add_shutter_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the shutter of ``blur``, for `settle`; ``--shutter`` is there already."""
    parser.set_defaults(shutter=None, exposure=None)
    group = parser.add_argument_group(
        "shutter, for filters that take one, as layered does (default: a box centered on the frame)"
    )
    group.add_argument(
        "--shutter-position",
        choices=POSITIONS,
        help="the exposure starts at the time of the frame, has it in the center, or ends there",
    )
    for side, verb in (("open", "opens"), ("close", "closes")):
        group.add_argument(
            f"--shutter-{side}",
            type=exposure,
            metavar="T",
            help=f"when the shutter {verb}, from the time of the frame, such as --shutter-{side}="
            f"{'-90deg' if side == 'open' else '0.25'}; both in place of --shutter",
        )
    group.add_argument(
        "--shutter-curve",
        metavar="NAME|FILE",
        help=f"transmission over the exposure: {', '.join(CURVES)}, or a text file with a number "
        "in each line, evenly spaced from opening to closing, or with a time and a number",
    )
    group.add_argument(
        "--readout",
        type=exposure,
        metavar="T",
        help="rolling shutter: from the exposure of the top edge of the image to that of the "
        "bottom edge; negative rolls upward, as --readout=-0.3",
    )


def settle(arguments: argparse.Namespace) -> None:
    """Find the exposure: ``shutter``, its length, and ``exposure``, None for a centered box.

    Args:
        arguments: of ``blur``, changed in place.

    Raises:
        CommandError: options exclude each other, or a curve is none.
    """
    open, close = arguments.shutter_open, arguments.shutter_close
    if open is not None or close is not None:
        for name in ("shutter", "shutter_position"):
            if getattr(arguments, name) is not None:
                raise CommandError(
                    f"--{name.replace('_', '-')}: --shutter-open and --shutter-close say together "
                    f"when light comes in; leave --{name.replace('_', '-')} out."
                )
        if open is None or close is None:
            given, missing = ("close", "open") if open is None else ("open", "close")
            raise CommandError(f"--shutter-{given}: needs --shutter-{missing} too.")
        if not close > open:
            raise CommandError(
                f"--shutter-close: must be after --shutter-open, got {open:g} to {close:g} frames."
            )
    else:
        shutter = DEFAULT if arguments.shutter is None else arguments.shutter
        open = -POSITIONS.index(arguments.shutter_position or "center") / 2 * shutter
        close = open + shutter
    points = _points(arguments.shutter_curve)
    curve = pathlib.Path(arguments.shutter_curve).name if points else arguments.shutter_curve
    arguments.shutter = close - open
    reach = max(abs(open), abs(close)) + abs(arguments.readout or 0) / 2
    if reach > 1 + 1e-9:
        LOG.warning(
            "the exposure reaches %.3g frames from the frame, and vectors one: beyond, motion is "
            "continued as it is at the frame.",
            reach,
        )
    plain = abs(open + close) <= 1e-9 * abs(close - open) and curve in (None, "box")
    # A negative length is refused where vectors are read.
    if (plain and not arguments.readout) or arguments.shutter < 0:
        return
    if arguments.shutter == 0:
        given = next(name for name in OPTIONS if getattr(arguments, name) is not None)
        raise CommandError(
            f"--{given.replace('_', '-')}: --shutter 0 blurs nothing; leave out one of the two."
        )
    arguments.exposure = Exposure(open, close, arguments.readout or 0.0, curve or "box", points)


def reach_of(arguments: argparse.Namespace) -> float:
    """The longest time from the frame at which light comes in, in half exposures."""
    exposure = getattr(arguments, "exposure", None)
    return 1.0 if exposure is None else exposure.reach


def option_of(arguments: argparse.Namespace) -> str:
    """An option that asks for a shutter that is no centered box, for messages."""
    given = [name for name in reversed(OPTIONS) if getattr(arguments, name, None) is not None]
    return f"--{given[0].replace('_', '-')}"


def _points(curve: str | None) -> tuple[float, ...]:
    """The curve of a file; empty for a name.

    Raises:
        CommandError: there is neither such a curve nor such a file, or it holds no curve.
    """
    if curve is None or curve in CURVES:
        return ()
    path = pathlib.Path(curve)
    if not path.is_file():
        raise CommandError(
            f"--shutter-curve: {curve!r} is no curve{did_you_mean(curve, CURVES)} and no file; "
            f"there are {', '.join(CURVES)}."
        )
    rows = _rows(path)
    values = [row[-1] for row in rows]
    if min(values) < 0 or max(values) == 0:
        raise CommandError(f"{path}: transmission must not be negative, and not 0 everywhere.")
    if len(rows[0]) == 1:
        return tuple(values)
    return _evenly(path, [row[0] for row in rows], values)


def _rows(path: pathlib.Path) -> list[list[float]]:
    """The numbers of a file, one or two in each line."""
    text = read_text(path, "give a file with a number in each line.")
    lines = [
        (number, words)
        for number, line in enumerate(text.splitlines(), start=1)
        if (words := re.split(r"[,;\s]+", line.partition("#")[0].strip(" \t,;"))) != [""]
    ]
    rows: list[list[float]] = []
    heading = ""
    for position, (number, words) in enumerate(lines):
        try:
            row = [float(word) for word in words]
        except ValueError:
            if position == 0 and all(re.fullmatch(r"[A-Za-z_]\w*", word) for word in words):
                heading = f"line {number} ({' '.join(words)}) is taken as the names of the columns"
                continue
            raise CommandError(
                f"{path}: line {number} holds something else than numbers."
            ) from None
        is_like_others = len(row) <= 2 and (not rows or len(row) == len(rows[0]))
        # NaN is not below either.
        if not (is_like_others and all(abs(value) < LARGEST for value in row)):
            raise CommandError(
                f"{path}: line {number}: expected a finite number, or a time and a number, as in "
                f"the other lines, of less than {LARGEST:g}."
            )
        rows.append(row)
    if not 2 <= len(rows) <= MOST_POINTS:
        raise CommandError(
            f"{path}: a curve has 2 to {MOST_POINTS} points, one in each line; got {len(rows)}"
            f"{heading and f', since {heading}'}."
        )
    return rows


def _evenly(path: pathlib.Path, times: list[float], values: list[float]) -> tuple[float, ...]:
    """The curve at evenly spaced times; the first is the opening, the last the closing."""
    import numpy as np

    steps = np.diff(times)
    if not np.all(steps > 0):
        raise CommandError(f"{path}: times must increase from line to line.")
    if np.all(np.abs(steps - steps.mean()) <= 1e-3 * steps.mean()):
        return tuple(values)
    even = np.linspace(times[0], times[-1], POINTS)
    return tuple(np.interp(even, times, values).tolist())
