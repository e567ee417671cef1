"""What ``--scale-motion`` selects: things, identifiers, mattes, maps."""

import argparse
import logging
import math
import pathlib
from typing import Any, NamedTuple

from jaxblur._util.text import nearest

from .arguments import CommandError, from_zero
from .windows import in_window

LOG = logging.getLogger("jaxblur")

KINDS = ("crypto", "id", "matte", "map")
FORMS = "0.5, crypto:NAME=0.5, id:CHANNEL:VALUE=0.5, matte:CHANNEL=0.5 or map:CHANNEL"
LISTED = 12
"""Names or values that a message lists."""


class Scale(NamedTuple):
    """One ``--scale-motion``.

    Attributes:
        kind: one of `KINDS`, or "" for everything.
        name: of a thing or a channel.
        value: of an identifier, in its channel.
        factor: 1 changes nothing; None for a map.
        text: as given.
    """

    kind: str
    name: str
    value: float | None
    factor: float | None
    text: str


def select(
    source: pathlib.Path, scale: Scale, frame: pathlib.Path, windows: Any
) -> tuple[Any, bool]:
    """What one ``--scale-motion`` does to a frame.

    Args:
        source: file with the mattes; outside of their data window nothing is selected.
        scale: the option.
        frame: file of the frame.
        windows: `jaxblur.exr.Windows` of the frame.

    Returns:
        A factor, or (H, W) one for each pixel; and whether it is for any pixel. If not, a warning
        says what there is.

    Raises:
        CommandError: there is no such channel, it holds NaN or infinity, or it is of another
            picture.
        JaxblurIOError: there is no such Cryptomatte, or no such name in it.
    """
    if not scale.kind:
        return scale.factor, True
    from jaxblur import exr

    info = exr.inspect(source)
    if scale.kind != "crypto" and scale.name not in info.channel_names:
        names = ", ".join(info.channel_names)
        raise CommandError(
            f"--scale-motion {scale.text}: {source} has no channel "
            f"{scale.name}{nearest(scale.name, info.channel_names)}; it holds {names}."
        )
    factors, selects = _factors(source, scale)
    channel = scale.name
    if scale.kind == "crypto":
        channel = exr.cryptomatte_layers(source)[0].channels[0]
    what = f"the matte of --scale-motion {scale.text}"
    return in_window(factors, source, channel, frame, windows, what=what, outside=1), selects


def _factors(source: pathlib.Path, scale: Scale) -> tuple[Any, bool]:
    """A factor for each pixel of the file with the mattes, and whether it is for any pixel."""
    import numpy as np

    from jaxblur import exr

    if scale.kind == "crypto":
        share = exr.read_cryptomatte(source, scale.name)
    else:
        share = exr.read_values(source, scale.name)
    if not np.isfinite(share).all():
        raise CommandError(f"--scale-motion {scale.text}: NaN or infinity in {source}; repair it.")
    if scale.kind == "map":
        return share, True
    values = share
    if scale.kind == "id":
        # Float channels hold the nearest float.
        value = scale.value if share.dtype.kind == "u" else np.float32(scale.value or 0)
        share = values == value
    if not (selects := bool(share.any())):
        there = "it is 0 everywhere"
        if scale.kind == "id":
            there = "there are " + _in_words([f"{float(one):.9g}" for one in np.unique(values)])
        elif scale.kind == "crypto":
            there = f"there are {_in_words(exr.names_in(source))}"
        LOG.warning("%s: no pixel has %s; %s.", source, scale.text.rpartition("=")[0], there)
    # Parsing gives every other kind a factor.
    return 1 + share * np.float32((scale.factor or 0.0) - 1), selects


def _in_words(names: list[str]) -> str:
    if not names:
        return "nothing"
    more = len(names) - LISTED
    return ", ".join(names[:LISTED]) + (f" and {more} more" if more > 0 else "")


def parse_scale(text: str) -> Scale:
    """Parse ``--scale-motion``.

    Raises:
        ArgumentTypeError: it is none of `FORMS`.
    """
    kind, colon, rest = text.partition(":")
    if not colon:
        return Scale("", "", None, _factor(text, text), text)
    if kind not in KINDS:
        raise argparse.ArgumentTypeError(f"expected {FORMS}, got {text!r}{nearest(kind, KINDS)}")
    if kind == "map":
        if not rest or "=" in rest:
            raise argparse.ArgumentTypeError(
                f"expected map:CHANNEL, whose values are factors, got {text!r}"
            )
        return Scale(kind, rest, None, None, text)
    name, equals, number = rest.rpartition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"expected {FORMS}, got {text!r}")
    factor, value = _factor(number, text), None
    if kind == "id":
        name, _, written = name.rpartition(":")
        try:
            value = float(written)
        except ValueError:
            value = math.nan
        if not name or not math.isfinite(value):
            raise argparse.ArgumentTypeError(f"expected id:CHANNEL:VALUE=FACTOR, got {text!r}")
    return Scale(kind, name, value, factor, text)


def _factor(written: str, text: str) -> float:
    try:
        return from_zero(written)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(
            f"expected {FORMS}, with a factor from 0, got {text!r}"
        ) from error
