"""Data windows: what one file stores, put into the data window of another one.

A window is ``(x, y, width, height)`` in pixels of the display window, as `jaxblur.exr.Part` has it.
Renders that are cropped to what they show have another one in every frame.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxblur._util.errors import JaxblurIOWarning, PathLike

from .choose import component_of

if TYPE_CHECKING:
    from jaxtyping import Bool
    from numpy.typing import ArrayLike

    from .listing import FileInfo
    from .ranks import Ranks
    from .read import Buffers

Window = tuple[int, int, int, int]


class Windows(NamedTuple):
    """The windows of a picture.

    Attributes:
        data: of the pixels that its file holds.
        display: of the full picture.
    """

    data: Window
    display: Window

    @property
    def origin(self) -> tuple[int, int]:
        """(x, y) of the first pixel in the full picture."""
        return self.data[0] - self.display[0], self.data[1] - self.display[1]


def window_words(window: Window) -> str:
    """Format a window, such as ``6x4 at (-1, 0)``."""
    x, y, width, height = window
    return f"{width}x{height} at ({x}, {y})"


def windows_of(info: FileInfo, channel: str) -> Windows:
    """The windows of a channel.

    Args:
        info: listing of a file.
        channel: full name.
    """
    part = info.parts[info.channel(channel).part]
    return Windows(part.data_window, part.display_window)


def overlap(first: Window, second: Window) -> Window:
    """The pixels that two windows have in common; width or height is 0 if there are none."""
    left, top = max(first[0], second[0]), max(first[1], second[1])
    right = min(first[0] + first[2], second[0] + second[2])
    bottom = min(first[1] + first[3], second[1] + second[3])
    return left, top, max(right - left, 0), max(bottom - top, 0)


def union(first: Window, second: Window) -> Window:
    """The smallest window that holds two."""
    left, top = min(first[0], second[0]), min(first[1], second[1])
    right = max(first[0] + first[2], second[0] + second[2])
    bottom = max(first[1] + first[3], second[1] + second[3])
    return left, top, right - left, bottom - top


def put_into(
    image: np.ndarray, window: Window, wanted: Window, outside: ArrayLike = 0
) -> np.ndarray:
    """Put an image into another data window.

    Args:
        image: (H, W, ...) pixels of a data window.
        window: it.
        wanted: the other one.
        outside: values of pixels that the image does not hold.

    Returns:
        (height, width, ...) pixels of the other one; the same array if the windows are the same.
    """
    if window == wanted:
        return image
    x, y, width, height = overlap(window, wanted)
    placed = np.full((wanted[3], wanted[2], *image.shape[2:]), outside, image.dtype)
    if width and height:
        rows, columns = y - window[1], x - window[0]
        part = image[rows : rows + height, columns : columns + width]
        rows, columns = y - wanted[1], x - wanted[0]
        placed[rows : rows + height, columns : columns + width] = part
    return placed


def is_element(color: np.ndarray, channels: Sequence[str]) -> bool:
    """Whether a picture is an element, so that pixels which it does not hold are transparent.

    Renderers and compositing cut away what is transparent. A picture without alpha, or with an
    alpha of 1 everywhere, may be a region of a larger one.

    Args:
        color: (H, W, C).
        channels: full names of its channels.
    """
    alpha = _alpha_of(color, channels)
    return alpha is not None and bool((alpha < 1).any())


def _alpha_of(color: np.ndarray, channels: Sequence[str]) -> np.ndarray | None:
    found = [k for k, name in enumerate(channels) if component_of(name) == "A"]
    return color[..., found[0]] if found else None


def known_in(buffers: Buffers, wanted: Window) -> Bool[np.ndarray, "height width"]:
    """Which pixels of a data window a frame knows.

    Args:
        buffers: the frame.
        wanted: the data window.

    Returns:
        (H, W) True for pixels that it holds and does not mask, and for those of the display window
        that it does not hold if it is an element.
    """
    window, display = buffers.windows
    held = np.ones(buffers.depth.shape, bool) if buffers.valid is None else buffers.valid
    outside: ArrayLike = False
    if is_element(buffers.color, buffers.color_channels):
        outside = put_into(np.ones((display[3], display[2]), bool), display, wanted)
    return put_into(held, window, wanted, outside)


def common_window(first: Buffers, second: Buffers) -> Window:
    """A data window of which two frames know everything but what they mask.

    Args:
        first: a frame.
        second: one of the same display window.

    Returns:
        Theirs, if it is the same; what both hold; or if both are elements what either holds of the
        display window. Width or height is 0 if there is nothing.
    """
    here, there = first.windows.data, second.windows.data
    if here == there:
        return here
    if all(is_element(each.color, each.color_channels) for each in (first, second)):
        return overlap(union(here, there), first.windows.display)
    return overlap(here, there)


def buffers_in(buffers: Buffers, wanted: Window) -> Buffers:
    """Put a frame into another data window.

    Args:
        buffers: the frame.
        wanted: the other data window.

    Returns:
        The frame there, with ``decoded`` as it is; the same buffers if the windows are the same.
        Pixels that it does not hold are 0, at rest and sky, and those that it does not know are
        masked, see `known_in`.
    """
    window = buffers.windows.data
    if window == wanted:
        return buffers
    placed = {
        name: None if image is None else put_into(image, window, wanted)
        for name in ("color", "velocity", "path", "pass_colors", "guide")
        for image in [getattr(buffers, name)]
    }
    known = known_in(buffers, wanted)
    return dataclasses.replace(
        buffers,
        **placed,
        depth=put_into(buffers.depth, window, wanted, np.inf),
        valid=None if known.all() else known,
        windows=buffers.windows._replace(data=wanted),
    )


def blur_window(buffers: Buffers, reach: float = 1, spread: float = 0) -> Window:
    """A data window that holds the blur of an element, as far as the display window goes.

    Args:
        buffers: a frame.
        reach: longest time from the frame at which light comes in, half exposures.
        spread: radius of the largest disc by which a lens blurs it, pixels.

    Returns:
        Its data window, larger at those edges within the display window over which something that
        is seen goes: by its way beyond them, and a pixel without anything. That of other pictures
        as it is.
    """
    x, y, width, height = buffers.windows.data
    left, top, right, bottom = (
        min(math.ceil(way) + 1, room) if way > 0 else 0
        for way, room in _beyond(buffers, reach, spread)
    )
    return x - left, y - top, width + left + right, height + top + bottom


def _beyond(buffers: Buffers, reach: float, spread: float) -> list[tuple[float, int]]:
    """How far an element goes over the left, top, right and bottom edge, and its room there."""
    (x, y, width, height), (left, top, full_width, full_height) = buffers.windows
    room = x - left, y - top, left + full_width - x - width, top + full_height - y - height
    alpha = _alpha_of(buffers.color, buffers.color_channels)
    if max(room) <= 0 or alpha is None or not (alpha < 1).any():
        return [(0, 0)] * 4
    row, column = np.nonzero(alpha > 0)
    motion = np.abs(buffers.velocity[row, column])
    if buffers.path is not None:
        motion = np.abs(buffers.path[row, column]).max(axis=1)
    across, down = np.moveaxis(reach * motion + spread, -1, 0)
    ways = (across - column, down - row, across - (width - 1 - column), down - (height - 1 - row))
    return [
        (float(way.max(initial=0)) if most > 0 else 0, most)
        for way, most in zip(ways, room, strict=True)
    ]


def warn_cropped(path: PathLike, buffers: Buffers) -> None:
    """Warn of an element that is cropped so closely that its blur does not fit in its data window.

    Args:
        path: its file.
        buffers: it.
    """
    beyond = zip(("left", "top", "right", "bottom"), _beyond(buffers, 1, 0), strict=True)
    if lost := [side for side, (way, _) in beyond if way > 0.5]:
        warnings.warn(
            f"{path}: color moves out of the data window, {window_words(buffers.windows.data)}, "
            f"across its edges ({', '.join(lost)}), and its blur is cut off there; give it the "
            "full window first: oiiotool IN --croptofull -o OUT.",
            JaxblurIOWarning,
            stacklevel=3,
        )


def ranks_in(ranks: Ranks, window: Window, wanted: Window) -> Ranks:
    """Put the coverages of a Cryptomatte layer into another data window.

    Args:
        ranks: them.
        window: their data window.
        wanted: the other one, outside of which nothing is kept.
    """
    rows, columns = np.divmod(ranks.pixels, window[2])
    rows, columns = rows + (window[1] - wanted[1]), columns + (window[0] - wanted[0])
    kept = (rows >= 0) & (rows < wanted[3]) & (columns >= 0) & (columns < wanted[2])
    pixels = (rows * wanted[2] + columns)[kept].astype(ranks.pixels.dtype)
    return ranks._replace(
        size=(wanted[3], wanted[2]),
        pixels=pixels,
        identifiers=ranks.identifiers[kept],
        coverages=ranks.coverages[kept],
    )
