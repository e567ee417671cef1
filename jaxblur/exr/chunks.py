"""Copy parts of an EXR file as they are stored, without decoding them.

A file of several parts holds its headers, then for each part a table of the places of its chunks,
then the chunks: some rows or a tile each, compressed, with the number of their part in front. Where
the headers agree in what chunks depend on, the chunks of one file are those of another.

Source: OpenEXR file layout, "Multi-part files", "Offset tables" and "Chunk layout".
"""

import itertools
import os
import struct
from collections.abc import Iterator, Mapping
from typing import Any, BinaryIO, NamedTuple

_MAGIC = 20000630
_MULTI_PART = 0x1000
_DEEP = 0x800
_LARGEST_HEADERS = 64_000_000
"""Bytes; manifests of Cryptomattes may take some millions."""
_STORAGE = (b"channels", b"compression", b"dataWindow", b"tiles", b"type", b"chunkCount")
"""Attributes that say how pixels are stored."""
_FRONT = {b"scanlineimage": 4 + 4, b"tiledimage": 4 + 4 * 4}
"""Bytes of a chunk before the number of its bytes: its part, and the first row or the tile."""


class _Part(NamedTuple):
    """Storage of a part.

    Attributes:
        storage: attributes that say how pixels are stored.
        table: position of the table of its chunks.
        chunks: number of chunks.
        front: bytes before the size of a chunk.
    """

    storage: Mapping[bytes, bytes]
    table: int
    chunks: int
    front: int


def alike(source: str, output: str, parts: Mapping[int, int]) -> dict[int, int]:
    """The parts of a file whose chunks may stand in another file.

    Args:
        source: EXR file.
        output: EXR file, whose headers are complete.
        parts: numbers of the parts in ``output`` by those in ``source``.

    Returns:
        Those of ``parts`` that both files store in the same way, and of which ``source`` holds all
        chunks; none if one is no file of several parts, or if chunks overlap: a small file could
        ask for copies without end.
    """
    try:
        with open(source, "rb") as file, open(output, "rb") as other:
            theirs, ours = _parts(file), _parts(other)
            size = os.fstat(file.fileno()).st_size
            places = {
                old: found
                for old, new in parts.items()
                if theirs[old].storage == ours[new].storage
                and (found := _places(file, theirs, old, size))
            }
    except (ValueError, LookupError, struct.error):
        return {}
    every = sorted(place for found in places.values() for place in found)
    if any(end > begin for (_, end), (begin, _) in itertools.pairwise(every)):
        return {}
    return {old: parts[old] for old in places}


def copy_chunks(source: str, output: str, parts: Mapping[int, int]) -> None:
    """Append the chunks of some parts to a file that lacks them.

    Args:
        source: EXR file.
        output: EXR file with the headers of all parts, for whose parts `alike` is true.
        parts: numbers of the parts in ``output`` by those in ``source``.

    Raises:
        OSError: the disk is full.
    """
    with open(source, "rb") as file, open(output, "r+b") as other:
        theirs, ours = _parts(file), _parts(other)
        for old, new in parts.items():
            other.seek(0, os.SEEK_END)
            table = bytearray()
            for offset, size in _chunks(file, theirs[old]):
                file.seek(offset + 4)
                table += struct.pack("<Q", other.tell())
                other.write(struct.pack("<i", new))
                other.write(file.read(size - 4))
            other.seek(ours[new].table)
            other.write(table)


def _places(
    file: BinaryIO, parts: list[_Part], number: int, length: int
) -> list[tuple[int, int]] | None:
    """Begin and end of each chunk of a part; None if one lies outside or is of another part."""
    first = parts[-1].table + 8 * parts[-1].chunks
    found = []
    try:
        for offset, size in _chunks(file, parts[number]):
            file.seek(offset)
            (named,) = struct.unpack("<i", file.read(4))
            if named != number or offset < first or size < 0 or offset + size > length:
                return None
            found.append((offset, offset + size))
    except (ValueError, struct.error):
        return None
    return found


def _chunks(file: BinaryIO, part: _Part) -> Iterator[tuple[int, int]]:
    """Position and size of each chunk of a part, with what stands in front of its pixels."""
    file.seek(part.table)
    table = file.read(8 * part.chunks)
    for (offset,) in struct.iter_unpack("<Q", table):
        if offset > 1 << 62:
            raise ValueError("a chunk beyond the end")
        file.seek(offset + part.front)
        (size,) = struct.unpack("<i", file.read(4))
        yield offset, part.front + 4 + size


def _parts(file: BinaryIO) -> list[_Part]:
    """The parts of a file of several; ValueError for other files."""
    file.seek(0)
    magic, version = struct.unpack("<iI", file.read(8))
    if magic != _MAGIC or not version & _MULTI_PART or version & _DEEP:
        raise ValueError("not several flat parts")
    data = file.read(_LARGEST_HEADERS)
    position, headers = 0, []
    while True:
        header, position = _header(data, position)
        if not header:
            break
        headers.append(header)
    parts, position = [], position + 8
    for header in headers:
        (count,) = struct.unpack("<i", header[b"chunkCount"])
        if not 0 < count < 1 << 28 or header[b"type"] not in _FRONT:
            raise ValueError("no such part")
        parts.append(_Part(header, position, count, _FRONT[header[b"type"]]))
        position += 8 * count
    return parts


def _header(data: bytes, position: int) -> tuple[dict[bytes, bytes], int]:
    """The attributes of a header that say how pixels are stored, and where the next one begins."""
    found: dict[bytes, Any] = {}
    while True:
        name, position = _text(data, position)
        if not name:
            return found, position
        _, position = _text(data, position)
        (size,) = struct.unpack_from("<i", data, position)
        position += 4
        if size < 0:
            raise ValueError("an attribute of negative size")
        if name in _STORAGE:
            found[name] = data[position : position + size].removesuffix(b"\0" * (name == b"type"))
        position += size


def _text(data: bytes, start: int) -> tuple[bytes, int]:
    end = data.find(b"\0", start)
    if end < 0:
        raise ValueError("the header does not end")
    return data[start:end], end + 1
