"""Checks of the pixels of a frame: bad ones raise an error, give a warning, or are left out.

Warnings point at the caller of `read_buffers`: it calls the readers of color, vectors and depth,
and these call the checks.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxblur import vectors
from jaxblur._util.errors import JaxblurIOError, JaxblurIOWarning, PathLike
from jaxblur.nonfinite import not_finite

from .listing import Channel, FileInfo

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Squares of much larger displacements overflow single precision; no picture is that large.
SPEED_LIMIT = 1e6

_IGNORE = "repair it, or leave such pixels out with nonfinite='ignore'."


def refuse(
    bad: Bool[np.ndarray, "height width"], path: PathLike, channel: str, what: str, remedy: str
) -> None:
    """Raise an error for bad pixels that states their number and the first one.

    Args:
        bad: (H, W) True for bad pixels.
        path: file, for the message.
        channel: channels, for the message.
        what: the fault, for the message.
        remedy: advice for the message, with its full stop.

    Raises:
        JaxblurIOError: a pixel is bad.
    """
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise JaxblurIOError(
            path,
            f"{channel}: {int(bad.sum())} of {bad.size} pixels are {what} (first at row {row}, "
            f"column {column}); {remedy}",
        )


def refuse_or_zero(
    path: PathLike,
    names: Sequence[str],
    values: Float[np.ndarray, "height width channels"],
    nonfinite: str,
    taken: str = "left out",
) -> tuple[Float[np.ndarray, "height width channels"], Bool[np.ndarray, "height width"]]:
    """Raise an error for NaN and infinity, channel by channel, or set those pixels to 0.

    Args:
        path: file, for messages.
        names: names of the channels.
        values: (H, W, C) as read.
        nonfinite: "error", "ignore" (with a warning) or "keep".
        taken: what becomes of such pixels, for the warning.

    Returns:
        (H, W, C) the values, and (H, W) True where they were set to 0.

    Raises:
        JaxblurIOError: ``nonfinite`` is "error" and a value is NaN or infinite.
    """
    somewhere = not_finite(values)
    if nonfinite == "keep" or not somewhere.any():
        return values, np.zeros_like(somewhere)
    if nonfinite == "error":
        for index, name in enumerate(names):
            refuse(not_finite(values[..., index]), path, name, "NaN or infinite", _IGNORE)
    _warn_ignored(path, names, somewhere, "NaN or infinite", taken)
    return np.where(somewhere[..., None], np.float32(0), values), somewhere


def without_depth(
    path: PathLike, name: str, raw: Float[np.ndarray, "height width"], nonfinite: str
) -> Bool[np.ndarray, "height width"]:
    """Raise an error for NaN and negative infinity in depth, or return where they count as sky.

    Args:
        path: file, for messages.
        name: name of the channel.
        raw: (H, W) depth as read; negated if the file stores negated depth.
        nonfinite: "error", "ignore" (with a warning) or "keep".

    Returns:
        (H, W) True where such values are ignored.

    Raises:
        JaxblurIOError: ``nonfinite`` is "error" and a pixel has such a value.
    """
    bad = np.isnan(raw) | np.isneginf(raw)
    if nonfinite == "error":
        refuse(bad, path, name, "NaN or negative infinity", _IGNORE)
    if bad.any() and nonfinite == "ignore":
        _warn_ignored(path, [name], bad, "NaN or negative infinity", "taken as sky")
    return bad & (nonfinite == "ignore")


def check_speed(
    velocity: Float[np.ndarray, "height width 2"], path: PathLike, guess: vectors.Guess
) -> None:
    """Raise an error for velocities that no picture can have.

    Args:
        velocity: (H, W, 2) half-spread in pixels.
        path: file, for messages.
        guess: convention under which the velocity was read.

    Raises:
        JaxblurIOError: a component exceeds `SPEED_LIMIT` or is NaN.
    """
    # Written with negations, so that NaN from an overflow is caught too. One number for all pixels
    # is found far faster than one for each.
    if not -SPEED_LIMIT <= velocity.min(initial=0) <= velocity.max(initial=0) <= SPEED_LIMIT:
        fast = ~(np.abs(velocity).max(axis=-1) <= SPEED_LIMIT)
        remedy = f"check the preset ({guess.preset.name}) and the file."
        refuse(fast, path, ", ".join(guess.channels), f"faster than {SPEED_LIMIT:.0e} px", remedy)


def warn_lossy(channels: Sequence[tuple[FileInfo, str]]) -> None:
    """Warn once for each file whose compression changes the values of vectors or depth.

    Args:
        channels: listing of the file and full name of each channel.
    """
    found: dict[tuple[str, str], list[str]] = {}
    for info, name in channels:
        channel = info.channel(name)
        if compression := _lossy_compression(info, channel):
            found.setdefault((info.path, compression), []).append(channel.name)
    for (path, compression), names in found.items():
        are, their = ("are", "their") if len(names) > 1 else ("is", "its")
        warnings.warn(
            f"{path}: {', '.join(names)} {are} stored with lossy compression ({compression}), "
            f"{their} values are inexact; write vectors and depth with zip.",
            JaxblurIOWarning,
            stacklevel=5,
        )


def _lossy_compression(info: FileInfo, channel: Channel) -> str:
    """The compression of a channel, if it changes the values; else nothing."""
    compression = info.parts[channel.part].compression.partition(":")[0]
    # DWA treats channels with the names of colors as color and stores all others exactly.
    like_color = channel.name.rpartition(".")[2].upper() in ("R", "G", "B", "Y", "RY", "BY")
    lossy = {
        "pxr24": channel.type == "float",
        "b44": channel.type == "half",
        "b44a": channel.type == "half",
        "dwaa": like_color,
        "dwab": like_color,
    }
    return compression if lossy.get(compression, False) else ""


def _warn_ignored(
    path: PathLike,
    names: Sequence[str],
    bad: Bool[np.ndarray, "height width"],
    what: str,
    taken: str,
) -> None:
    warnings.warn(
        f"{path}: {', '.join(names)}: {int(bad.sum())} of {bad.size} pixels are {what}, and are "
        f"{taken}.",
        JaxblurIOWarning,
        stacklevel=5,
    )
