"""Read channels of image files by name, whole or in blocks of rows, as they are stored."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxblur._util.errors import JaxblurIOError, PathLike

from .listing import Channel, FileInfo, Part, describe
from .opening import open_input, pending_message

if TYPE_CHECKING:
    from jaxtyping import Float

# Deflate cannot expand by more, the other schemes here by even less; this exposes crafted headers.
LARGEST_EXPANSION = {
    "none": 1,
    **dict.fromkeys(("rle", "zips", "zip", "pxr24", "piz", "b44", "b44a"), 2000),
}

# Constant pictures shrink to 1 in 21,500 with dwab.
UNKNOWN_EXPANSION = 200_000

BLOCK = 4_000_000
"""Values that are read at once where a file is only looked through."""


def read_channels(path: PathLike, names: Sequence[str]) -> Float[np.ndarray, "height width names"]:
    """Read channels by full name.

    Args:
        path: an image file.
        names: full names, as `inspect` lists them; they may lie in different parts.

    Returns:
        (H, W, number of names) float32, values as stored (integer files: 0..1).

    Raises:
        JaxblurIOError: a channel is missing, parts differ in window, or pixels are damaged.
    """
    with open_input(path) as source:
        info = describe(source, path)
        return read_named(source, info, names)


def read_together(
    requests: Sequence[tuple[FileInfo, Sequence[str]]],
) -> tuple[list[Float[np.ndarray, "height width names"]], np.ndarray | None]:
    """Read several groups of channels, of one file or of several, each part once.

    Compressed pixels hold all channels of some rows, so that one read of a part takes as long as
    one of a single channel of it.

    Args:
        requests: listing of a file and full names, for each group.

    Returns:
        For each group (H, W, number of names) float32, as `read_channels` gives it. And (H, W,
        number of channels) float32 the whole part in which the first group lies, if all of it was
        read, and more than that group; else None. Nothing else shares its memory.

    Raises:
        JaxblurIOError: as by `read_channels`.
    """
    results: dict[int, np.ndarray] = {}
    whole = None
    for path in dict.fromkeys(info.path for info, _ in requests):
        own = [index for index, (info, _) in enumerate(requests) if info.path == path]
        info = requests[own[0]][0]
        groups = {index: [info.channel(name) for name in requests[index][1]] for index in own}
        with open_input(path) as source:
            read = {}
            for part in sorted({c.part for channels in groups.values() for c in channels}):
                used = {c for channels in groups.values() for c in channels if c.part == part}
                read[part] = _read_part(source, info, sorted(used, key=lambda c: c.index))
        for index, channels in groups.items():
            _common_window(info, channels)
            results[index] = _gathered(read, channels)
        if 0 in groups:
            first = groups[0][0].part
            more = len(info.parts[first].channels) > len(groups[0])
            if more and len(read[first].indices) == len(info.parts[first].channels):
                whole = read[first].pixels
    return [results[index] for index in range(len(requests))], whole


class _Read(NamedTuple):
    """Channels of a part.

    Attributes:
        indices: their numbers, in order.
        pixels: (H, W, number of channels) float32.
    """

    indices: Sequence[int]
    pixels: np.ndarray


def _read_part(source: Any, info: FileInfo, channels: Sequence[Channel]) -> _Read:
    """Read channels of one part, in their order, decoding it once."""
    part, begin, end = channels[0].part, channels[0].index, channels[-1].index + 1
    if end - begin <= 2 * len(channels):
        return _Read(range(begin, end), read_span(source, info, part, begin, end, "float"))
    # Wide gaps would take much memory.
    pixels = np.concatenate(list(read_blocks(source, info, channels)))
    return _Read([channel.index for channel in channels], pixels)


def _gathered(read: Mapping[int, _Read], channels: Sequence[Channel]) -> np.ndarray:
    """Channels out of those of parts, in memory of their own."""
    planes = [read[c.part].pixels[..., read[c.part].indices.index(c.index)] for c in channels]
    return np.stack(planes, axis=-1)


def read_values(path: PathLike, name: str) -> np.ndarray:
    """Read a channel by full name, whole numbers as they are.

    Args:
        path: an image file.
        name: full name, as `inspect` lists it.

    Returns:
        (H, W): uint32 if the channel is of 32-bit integers, else float32 as by `read_channels`.

    Raises:
        JaxblurIOError: as by `read_channels`.
    """
    with open_input(path) as source:
        info = describe(source, path)
        channel = info.channel(name)
        if channel.type != "uint":
            return read_named(source, info, [name])[..., 0]
        span = channel.part, channel.index, channel.index + 1
        return np.asarray(read_span(source, info, *span, "uint"))[..., 0]


def read_named(
    source: Any, info: FileInfo, names: Sequence[str]
) -> Float[np.ndarray, "height width names"]:
    """Read channels of an open image by full name, with one read per span of neighboring channels.

    Args:
        source: an open ``ImageInput``.
        info: its listing.
        names: full names.

    Returns:
        (H, W, number of names) float32.

    Raises:
        JaxblurIOError: a channel is missing, parts differ in window, or pixels are damaged.
    """
    channels = [info.channel(name) for name in names]
    _, _, width, height = _common_window(info, channels)
    order = sorted(range(len(names)), key=lambda i: (channels[i].part, channels[i].index))
    runs = list(_runs(order, channels))

    def pixels_of(run: list[int]) -> np.ndarray:
        first, last = channels[run[0]], channels[run[-1]]
        return read_span(source, info, first.part, first.index, last.index + 1, "float")

    if runs == [list(range(len(names)))]:
        return pixels_of(runs[0])
    out = None
    for run in runs:
        # The first read comes before the allocation, because it rejects impossible sizes.
        pixels = pixels_of(run)
        out = np.empty((height, width, len(names)), np.float32) if out is None else out
        for position, target in enumerate(run):
            out[..., target] = pixels[..., position]
    assert out is not None
    return out


def _runs(order: list[int], channels: list[Channel]) -> Iterator[list[int]]:
    """Split positions, sorted by their order in the file, into runs of neighboring channels."""
    run: list[int] = []
    for position in order:
        previous = channels[run[-1]] if run else None
        here = channels[position]
        if previous and (previous.part, previous.index + 1) != (here.part, here.index):
            yield run
            run = []
        run.append(position)
    if run:
        yield run


def read_span(source: Any, info: FileInfo, part: int, begin: int, end: int, kind: str) -> Any:
    """Read neighboring channels of one part.

    Args:
        source: an open ``ImageInput``.
        info: its listing.
        part: index of the part.
        begin: first channel.
        end: one past the last channel.
        kind: OpenImageIO's name of the type to which pixels are converted.

    Returns:
        (H, W, end - begin) array.

    Raises:
        JaxblurIOError: the part is deep, or its pixels cannot be read completely.
    """
    described = info.parts[part]
    names = ", ".join(channel.name for channel in described.channels[begin:end])
    if described.deep:
        raise JaxblurIOError(
            info.path,
            f"{names}: deep pixels; flatten the image first, or blur it by `jaxblur layers`.",
        )
    _check_size(info, described)
    try:
        pixels = source.read_image(part, 0, begin, end, kind)
    except (RuntimeError, ValueError, MemoryError, UnicodeDecodeError) as error:
        raise JaxblurIOError(info.path, f"{names}: cannot be read: {error}") from error
    if pixels is None:
        message = pending_message(source)
        raise JaxblurIOError(
            info.path, f"{names}: truncated or damaged, copy or render it again ({message})."
        )
    return pixels


def read_blocks(
    source: Any, info: FileInfo, channels: Sequence[Channel]
) -> Iterator[Float[np.ndarray, "rows width channels"]]:
    """Read channels of an open image in blocks of rows, from the top.

    Args:
        source: an open ``ImageInput``.
        info: its listing.
        channels: of one data window; they may lie in different parts.

    Yields:
        (rows, W, number of channels) float32, about `BLOCK` values or one row of tiles each.

    Raises:
        JaxblurIOError: a channel is deep, parts differ in window, or the pixels cannot be read
            completely.
    """
    _, top, width, height = _common_window(info, channels)
    parts = sorted({channel.part for channel in channels})
    spans = {}
    for part in parts:
        indices = [channel.index for channel in channels if channel.part == part]
        spans[part] = min(indices), max(indices) + 1
    step = max(1, BLOCK // (width * sum(end - begin for begin, end in spans.values())))
    # Whole rows of tiles, or of the largest chunks of lines, so that nothing is decoded twice.
    unit = math.lcm(*(_rows_of_chunk(source, info, part) for part in parts))
    step = max(1, step // unit) * unit
    for first in range(top, top + height, step):
        last = min(first + step, top + height)
        rows = {part: _read_rows(source, info, part, first, last, *spans[part]) for part in parts}
        yield np.stack([rows[c.part][..., c.index - spans[c.part][0]] for c in channels], axis=-1)


def _common_window(info: FileInfo, channels: Sequence[Channel]) -> tuple[int, int, int, int]:
    windows = {info.parts[channel.part].data_window for channel in channels}
    if len(windows) != 1:
        names = ", ".join(channel.name for channel in channels)
        raise JaxblurIOError(info.path, f"channels {names} have different data windows: {windows}.")
    return windows.pop()


def _rows_of_chunk(source: Any, info: FileInfo, part: int) -> int:
    """Rows of a tile, or at least those of the largest chunk; impossible parts are rejected."""
    described = info.parts[part]
    if described.deep:
        raise JaxblurIOError(info.path, f"part {part}: deep pixels; flatten the image first.")
    _check_size(info, described)
    source.seek_subimage(part, 0)
    return source.spec().tile_height or 256


def _read_rows(
    source: Any, info: FileInfo, part: int, first: int, last: int, begin: int, end: int
) -> np.ndarray:
    left, _, width, _ = info.parts[part].data_window
    source.seek_subimage(part, 0)
    try:
        if source.spec().tile_width:
            box = (left, left + width, first, last, 0, 1)
            rows = source.read_tiles(part, 0, *box, begin, end, "float")
        else:
            rows = source.read_scanlines(part, 0, first, last, 0, begin, end, "float")
    except (RuntimeError, ValueError, MemoryError, UnicodeDecodeError) as error:
        raise JaxblurIOError(info.path, f"part {part}: cannot be read: {error}") from error
    if rows is None:
        raise JaxblurIOError(
            info.path,
            f"part {part}: truncated or damaged, copy or render it again "
            f"({pending_message(source)}).",
        )
    return rows.reshape(-1, width, end - begin)


def _check_size(info: FileInfo, part: Part) -> None:
    """Reject a header that claims more pixels than the file can hold, before allocating."""
    if not info.path.lower().endswith(".exr"):
        return
    *_, width, height = part.data_window
    claimed = width * height * sum(2 if c.type == "half" else 4 for c in part.channels)
    scheme = part.compression.partition(":")[0]
    held = os.path.getsize(info.path) * LARGEST_EXPANSION.get(scheme, UNKNOWN_EXPANSION)
    if claimed > held:
        raise JaxblurIOError(
            info.path,
            f"the header claims {width}x{height} pixels, more than {os.path.getsize(info.path)} "
            f"bytes with {scheme} compression can hold: truncated or damaged, copy or render it "
            "again.",
        )
