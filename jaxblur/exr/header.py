"""Change channel types in the header of an EXR file.

OpenImageIO converts through float32 when a part mixes integer channels with others, and 32-bit
identifiers do not survive that. Therefore the bits of such a channel are written as a float
channel, which is exact, and the header is corrected afterwards: both types have four bytes, and the
compression schemes used here do not depend on the type.

Source: OpenEXR file layout, "Header attributes" and "chlist".
"""

import mmap
import struct
from collections.abc import Collection, Iterator

_MAGIC_AND_VERSION = 8
_TYPE_UINT = 0


def relabel_as_uint(path: str, part: int, channel_names: Collection[str]) -> None:
    """Mark float channels of one part as 32-bit unsigned integers, in place.

    Args:
        path: EXR file, complete and closed.
        part: index of the part.
        channel_names: names as stored in the channel list.
    """
    wanted = {name.encode("utf-8", "surrogateescape") for name in channel_names}
    with open(path, "r+b") as file, mmap.mmap(file.fileno(), 0) as data:
        for name, offset in _channel_types(data, part):
            if name in wanted:
                data[offset : offset + 4] = struct.pack("<i", _TYPE_UINT)


def _channel_types(data: mmap.mmap, part: int) -> Iterator[tuple[bytes, int]]:
    """Yield name and offset of the type of each channel of a part."""
    start, end = _channel_list(data, part)
    while data[start] != 0 and start < end:
        name, start = _text(data, start)
        yield name, start
        start += 16


def _channel_list(data: mmap.mmap, part: int) -> tuple[int, int]:
    """Walk the headers, each a list of attributes ended by an empty name."""
    position = _MAGIC_AND_VERSION
    while True:
        name, position = _text(data, position)
        if not name:
            part -= 1
            continue
        _, position = _text(data, position)
        (size,) = struct.unpack_from("<i", data, position)
        position += 4
        if name == b"channels" and part == 0:
            return position, position + size
        position += size


def _text(data: mmap.mmap, start: int) -> tuple[bytes, int]:
    end = data.find(b"\0", start)
    return data[start:end], end + 1
