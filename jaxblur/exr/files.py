"""Open image files, list their contents, read channels; every failure is a `JaxblurIOError`."""

import contextlib
import dataclasses
import math
import os
import pathlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import OpenImageIO as oiio
from jaxtyping import Float

from jaxblur._util.errors import JaxblurIOError, PathLike

EXTENSIONS = (".exr", ".png", ".tif", ".tiff", ".hdr")
IMAGE_SIZE_LIMIT_MB = 4096
# Deflate cannot expand by more, the other schemes here by even less; this exposes crafted headers.
LARGEST_EXPANSION = {
    "none": 1,
    **dict.fromkeys(("rle", "zips", "zip", "pxr24", "piz", "b44", "b44a"), 2000),
}
# Constant pictures shrink to 1 in 21,500 with dwab.
UNKNOWN_EXPANSION = 200_000


BLOCK = 4_000_000
"""Values that are read at once where a file is only looked through."""


class JaxblurIOWarning(UserWarning):
    """Something in a file is suspicious or was changed, but the work went on."""


@dataclasses.dataclass(frozen=True)
class Channel:
    """One channel of one part.

    Attributes:
        name: full name with the part's name before it where the file is multi-part and the
            channel name does not repeat it.
        type: "half", "float", "uint", "uint8", ...
        part: index of the part.
        index: index of the channel in its part.
    """

    name: str
    type: str
    part: int
    index: int


@dataclasses.dataclass(frozen=True)
class Part:
    """One part (sub-image) of a file.

    Attributes:
        name: part name, empty if it has none.
        channels: its channels in reading order.
        data_window: (x, y, width, height) of the stored pixels; the origin may be negative.
        display_window: (x, y, width, height) of the full picture.
        compression: scheme as the file names it, "none" if it names none.
        deep: whether pixels hold several samples each.
        levels: number of resolutions: 1, or more if mip-mapped; pixels are those of the first.
        attributes: metadata, values as OpenImageIO gives them; bytes of unknown types as a tuple.
    """

    name: str
    channels: tuple[Channel, ...]
    data_window: tuple[int, int, int, int]
    display_window: tuple[int, int, int, int]
    compression: str
    deep: bool
    levels: int
    attributes: dict[str, Any]


@dataclasses.dataclass(frozen=True)
class FileInfo:
    """Listing of a file.

    Attributes:
        path: the file.
        parts: its parts in order.
    """

    path: str
    parts: tuple[Part, ...]

    @property
    def channels(self) -> tuple[Channel, ...]:
        """All channels of all parts."""
        return tuple(channel for part in self.parts for channel in part.channels)

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Full names of all channels."""
        return tuple(channel.name for channel in self.channels)

    def channel(self, name: str) -> Channel:
        """Find a channel by its full name.

        Args:
            name: full name, as in ``channel_names``.

        Returns:
            The channel.

        Raises:
            JaxblurIOError: no channel or several channels have that name.
        """
        found = [channel for channel in self.channels if channel.name == name]
        if len(found) != 1:
            problem = "no channel" if not found else f"{len(found)} channels"
            names = ", ".join(self.channel_names)
            raise JaxblurIOError(self.path, f"{problem} called {name}; the file holds {names}.")
        return found[0]


@dataclasses.dataclass(frozen=True)
class FileStates:
    """Sizes and modification times of files, to notice that one changed while it was used.

    Attributes:
        states: path, inode, bytes and nanoseconds of each.
    """

    states: tuple[tuple[str, int, int, int], ...]

    @classmethod
    def of(cls, paths: Iterable[PathLike]) -> "FileStates":
        """Record the present states.

        Args:
            paths: the files.

        Raises:
            JaxblurIOError: a file is missing.
        """
        return cls(tuple(_state(path) for path in paths))

    def check(self) -> None:
        """Check that no file has changed since.

        Raises:
            JaxblurIOError: one has; the message names it.
        """
        for state in self.states:
            if _state(state[0]) != state:
                raise JaxblurIOError(
                    state[0], "changed while it was being used; nothing was written, run again."
                )


def _state(path: PathLike) -> tuple[str, int, int, int]:
    try:
        found = os.stat(path)
    except OSError as error:
        raise JaxblurIOError(path, f"{error.strerror}.") from error
    return os.fspath(path), found.st_ino, found.st_size, found.st_mtime_ns


def inspect(path: PathLike) -> FileInfo:
    """List parts, channels, windows, compression and metadata; read no pixels.

    Args:
        path: an EXR, PNG, TIFF or HDR file.

    Returns:
        The listing.

    Raises:
        JaxblurIOError: the file is missing, unreadable, or not of the kind that its extension
            names.
    """
    with open_input(path) as source:
        return describe(source, path)


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
) -> list[Float[np.ndarray, "height width names"]]:
    """Read several groups of channels, of one file or of several, each part once.

    Compressed pixels hold all channels of some rows, so that one read of a part takes as long as
    one of a single channel of it.

    Args:
        requests: listing of a file and full names, for each group.

    Returns:
        For each group (H, W, number of names) float32, as `read_channels` gives it.

    Raises:
        JaxblurIOError: as by `read_channels`.
    """
    results: dict[int, np.ndarray] = {}
    for path in dict.fromkeys(info.path for info, _ in requests):
        own = [index for index, (info, _) in enumerate(requests) if info.path == path]
        info = requests[own[0]][0]
        groups = {index: [info.channel(name) for name in requests[index][1]] for index in own}
        with open_input(path) as source:
            read: dict[int, tuple[int, np.ndarray]] = {}
            for part in sorted({c.part for channels in groups.values() for c in channels}):
                used = {c.index for channels in groups.values() for c in channels if c.part == part}
                begin, end = min(used), max(used) + 1
                # Wide gaps would take more memory than the time is worth.
                if end - begin <= 2 * len(used):
                    read[part] = begin, read_span(source, info, part, begin, end, "float")
            for index, channels in groups.items():
                _common_window(info, channels)
                if all(channel.part in read for channel in channels):
                    results[index] = _gathered(read, channels)
                else:
                    results[index] = read_named(source, info, requests[index][1])
    return [results[index] for index in range(len(requests))]


def _gathered(read: Mapping[int, tuple[int, np.ndarray]], channels: Sequence[Channel]) -> Any:
    """Channels out of pixels of parts, each with the number of its first channel."""
    (begin, pixels), first = read[channels[0].part], channels[0].index
    places = [(channel.part, channel.index) for channel in channels]
    if places == [(channels[0].part, first + k) for k in range(len(channels))]:
        return np.ascontiguousarray(pixels[..., first - begin : first - begin + len(channels)])
    planes = [read[c.part][1][..., c.index - read[c.part][0]] for c in channels]
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


@contextlib.contextmanager
def open_input(path: PathLike) -> Iterator[Any]:
    """Open an image with the reader of its extension and close it afterwards.

    Args:
        path: an image file.

    Yields:
        An ``OpenImageIO.ImageInput``.

    Raises:
        JaxblurIOError: the file is missing, a folder, of another kind, or unreadable; or memory
            ended while it was open.
    """
    check_readable(path)
    # A crafted header may request all memory, and trying the readers of other formats is a needless
    # risk.
    oiio.attribute("limits:imagesize_MB", IMAGE_SIZE_LIMIT_MB)
    oiio.attribute("try_all_readers", 0)
    try:
        source = oiio.ImageInput.open(os.fspath(path))
    except (RuntimeError, UnicodeDecodeError, ValueError) as error:
        raise JaxblurIOError(path, _unopened(path, str(error))) from error
    if source is None:
        raise JaxblurIOError(path, _unopened(path, pending_message()))
    try:
        yield source
    except MemoryError as error:
        raise JaxblurIOError(
            path, f"needs more memory than this process may use ({error}); allow it more."
        ) from error
    finally:
        source.close()
        pending_message(source)


def _unopened(path: PathLike, message: str) -> str:
    kind = pathlib.Path(path).suffix.lower().removeprefix(".").upper()
    return (
        f"cannot be opened: truncated, damaged or no {kind} file at all; copy or render it again "
        f"(the reader says: {message})."
    )


def check_readable(path: PathLike) -> None:
    """Check that a path can be an image before it is passed to a reader.

    Args:
        path: an image file.

    Raises:
        JaxblurIOError: the file is missing, a folder, empty, or has an unsupported extension.
    """
    file = pathlib.Path(path)
    if not file.exists():
        raise JaxblurIOError(path, "no such file.")
    if not file.is_file():
        raise JaxblurIOError(path, "is not a file; give an image, such as an .exr.")
    if file.suffix.lower() not in EXTENSIONS:
        raise JaxblurIOError(path, f"is not one of {', '.join(EXTENSIONS)}; convert it to .exr.")
    if file.stat().st_size == 0:
        raise JaxblurIOError(path, "is empty; write it again.")


def pending_message(source: Any = None) -> str:
    """Fetch and clear OpenImageIO's pending error messages.

    Args:
        source: the reader or writer that failed, if there is one.

    Returns:
        The message on one line; a message that is not text is replaced by a note that says so.
    """
    messages = []
    for get in ([source.geterror] if source is not None else []) + [oiio.geterror]:
        try:
            messages.append(get())
        except (UnicodeDecodeError, RuntimeError):
            messages.append("the reader's message is not text, the file is probably damaged")
    text = "; ".join(dict.fromkeys(_printable(m).strip() for m in messages if m.strip()))
    return " ".join(text.split()) or "no reason given"


def describe(source: Any, path: PathLike) -> FileInfo:
    """List the parts of an open image.

    Args:
        source: an open ``ImageInput``.
        path: its file, for messages.

    Returns:
        The listing.

    Raises:
        JaxblurIOError: a header is damaged.
    """
    parts: list[Part] = []
    try:
        while source.seek_subimage(len(parts), 0):
            parts.append(_describe_part(source.spec(), len(parts)))
    except (UnicodeDecodeError, RuntimeError, ValueError) as error:
        raise JaxblurIOError(path, f"damaged header, copy or render it again ({error}).") from error
    pending_message(source)
    expected = parts[0].attributes.get("oiio:subimages", 1) if parts else 1
    if isinstance(expected, int) and len(parts) < expected:
        raise JaxblurIOError(path, f"only {len(parts)} of {expected} parts are readable.")
    several = len(parts) > 1
    named = tuple(_qualified(part) if several else part for part in parts)
    return FileInfo(os.fspath(path), named)


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


def _describe_part(spec: Any, index: int) -> Part:
    formats = spec.channelformats or [spec.format] * spec.nchannels
    channels = tuple(
        Channel(_printable(name), str(kind), index, position)
        for position, (name, kind) in enumerate(zip(spec.channelnames, formats, strict=True))
    )
    attributes = _attributes(spec)
    return Part(
        name=str(attributes.get("name", "")),
        channels=channels,
        data_window=(spec.x, spec.y, spec.width, spec.height),
        display_window=(spec.full_x, spec.full_y, spec.full_width, spec.full_height),
        compression=str(attributes.get("compression", "none")),
        deep=bool(spec.deep),
        levels=_levels(attributes.get("oiio:miplevels", 1)),
        attributes=attributes,
    )


def _attributes(spec: Any) -> dict[str, Any]:
    return {_printable(a.name): _plain(a.value) for a in spec.extra_attribs}


def _levels(count: Any) -> int:
    return count if isinstance(count, int) and count > 1 else 1


def _plain(value: Any) -> Any:
    """A value that can be compared and hashed; OpenImageIO gives arrays for types unknown to it."""
    if isinstance(value, np.ndarray):
        return tuple(value.ravel().tolist())
    return _printable(value) if isinstance(value, str) else value


def _printable(text: str) -> str:
    """Escape bytes that are not UTF-8, which local encodings leave in names."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def _qualified(part: Part) -> Part:
    def full(name: str) -> str:
        repeated = name == part.name or name.startswith(part.name + ".")
        return name if repeated or not part.name else f"{part.name}.{name}"

    channels = tuple(dataclasses.replace(c, name=full(c.name)) for c in part.channels)
    return dataclasses.replace(part, channels=channels)


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
