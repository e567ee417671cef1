"""EXR files of every kind, and seeded ways to damage them."""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio

SHAPE = (20, 28)
COMPRESSIONS = (
    *("none", "rle", "zips", "zip", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab"),
    *("htj2k256", "htj2k32"),
)
EXTREMES = (0, 1, -1, 2, 255, 65535, 2**24, 2**30, 2**31 - 1, -(2**31), -5)
HOSTILE = (
    b"\x1b[31mred",
    b"\x1b]0;title\x07",
    b"<script>alert(1)</script>",
    b"../../../etc/passwd",
    b"a\r\nb",
    b"\xff\xfe\x00",
    b"%s%n{0}",
    "\u202e\u0007\u009b".encode(),
)


class Attribute(NamedTuple):
    """Position of a header attribute in the file.

    Attributes:
        name: name of the attribute.
        kind: its type, such as ``box2i``.
        start: first byte of the name.
        value: first byte of the value.
        size: bytes of the value.
    """

    name: bytes
    kind: bytes
    start: int
    value: int
    size: int


def frame_channels(shape: tuple[int, int] = SHAPE, seed: int = 0) -> dict[str, np.ndarray]:
    """Color, alpha, depth and motion vectors of a valid frame."""
    generator = np.random.default_rng(seed)
    channels = {name: generator.random(shape, np.float32) for name in "RGBA"}
    channels["Z"] = generator.uniform(1, 9, shape).astype(np.float32)
    for axis in "XY":
        channels[f"velocity.{axis}"] = 3 * generator.normal(size=shape).astype(np.float32)
    return channels


def write_corpus(folder: Path) -> list[Path]:
    """Write one file of each kind: compressions, tiles, types, windows, parts, deep.

    Args:
        folder: output folder.

    Returns:
        Paths of the files, all undamaged.
    """
    paths = [_write(folder / f"{name}.exr", compression=name) for name in COMPRESSIONS]
    paths.append(_write(folder / "tiled.exr", tile=8))
    paths.append(_write(folder / "half.exr", kind="half"))
    paths.append(_write(folder / "window.exr", origin=(-3, 5)))
    paths.append(_write_parts(folder / "parts.exr"))
    paths.append(_write_deep(folder / "deep.exr"))
    return paths


def _spec(names: tuple[str, ...], kind: str, compression: str, part: str = "") -> Any:
    height, width = SHAPE
    spec = oiio.ImageSpec(width, height, len(names), kind)
    spec.channelnames = names
    spec.attribute("compression", compression)
    spec.attribute("Software", "fuzz")
    if part:
        spec.attribute("name", part)
    return spec


def _write(
    path: Path,
    compression: str = "zip",
    kind: str = "float",
    tile: int = 0,
    origin: tuple[int, int] = (0, 0),
) -> Path:
    channels = frame_channels()
    spec = _spec(tuple(channels), kind, compression)
    spec.tile_width = spec.tile_height = tile
    spec.x, spec.y = origin
    with _output(path, spec) as output:
        pixels = np.stack(list(channels.values()), axis=-1)
        if tile:
            height, width = SHAPE
            done = output.write_tiles(0, width, 0, height, 0, 1, pixels)
        else:
            done = output.write_image(pixels)
        assert done, output.geterror()
    return path


class _output:
    """Context of an open writer; failures to open or close it are errors."""

    def __init__(self, path: Path, *specs: Any):
        self._output: Any = oiio.ImageOutput.create(str(path))
        first = specs[0] if len(specs) == 1 else tuple(specs)
        assert self._output is not None and self._output.open(str(path), first)

    def __enter__(self) -> Any:
        return self._output

    def __exit__(self, *_: object) -> None:
        assert self._output.close(), self._output.geterror()


def _write_parts(path: Path) -> Path:
    channels = frame_channels()
    parts = [("RGBA", "Combined"), (("Z",), "Depth"), (("velocity.X", "velocity.Y"), "motion")]
    specs = [_spec(tuple(names), "float", "zip", part) for names, part in parts]
    with _output(path, *specs) as output:
        for index, ((names, _), spec) in enumerate(zip(parts, specs, strict=True)):
            if index:
                assert output.open(str(path), spec, "AppendSubimage")
            assert output.write_image(np.stack([channels[name] for name in names], axis=-1))
    return path


def _write_deep(path: Path) -> Path:
    channels = frame_channels()
    names = ("R", "G", "B", "A", "Z")
    spec = _spec(names, "float", "zips")
    spec.deep = True
    deep = oiio.DeepData()
    deep.init(spec)
    for pixel in range(SHAPE[0] * SHAPE[1]):
        deep.set_samples(pixel, 1)
        for index, name in enumerate(names):
            deep.set_deep_value(pixel, index, 0, float(channels[name].flat[pixel]))
    with _output(path, spec) as output:
        assert output.write_deep_image(deep), output.geterror()
    return path


def attributes(data: bytes) -> Iterator[Attribute]:
    """Walk the attributes of all headers.

    Args:
        data: an undamaged EXR.

    Yields:
        Every attribute in order.
    """
    several = struct.unpack_from("<I", data, 4)[0] & 0x1000
    position = 8
    while data[position]:
        while data[position]:
            start = position
            name_end = data.index(0, position)
            kind_end = data.index(0, name_end + 1)
            (size,) = struct.unpack_from("<i", data, kind_end + 1)
            name, kind = data[start:name_end], data[name_end + 1 : kind_end]
            yield Attribute(name, kind, start, kind_end + 5, size)
            position = kind_end + 5 + size
        position += 1
        if not several:
            return


def mutate(data: bytes, generator: np.random.Generator) -> tuple[str, bytes]:
    """Damage a file by one of `MUTATIONS`, chosen at random.

    Args:
        data: an undamaged EXR.
        generator: source of all random choices.

    Returns:
        The name of the mutation and the damaged file.
    """
    name = str(generator.choice(list(MUTATIONS)))
    damaged = bytearray(data)
    changed = MUTATIONS[name](damaged, generator)
    return name, bytes(damaged if changed is None else changed)


def _bit_flips(data: bytearray, generator: np.random.Generator) -> None:
    limit = len(data) if generator.random() < 0.5 else min(len(data), 800)
    for position in generator.integers(limit, size=generator.integers(1, 17)):
        data[position] ^= 1 << generator.integers(8)


def _bytes(data: bytearray, generator: np.random.Generator) -> None:
    limit = len(data) if generator.random() < 0.5 else min(len(data), 800)
    for position in generator.integers(limit, size=generator.integers(1, 17)):
        data[position] = generator.integers(256)


def _truncation(data: bytearray, generator: np.random.Generator) -> bytearray:
    return data[: generator.integers(len(data))]


def _block(data: bytearray, generator: np.random.Generator) -> bytearray:
    """Remove a block, or repeat it."""
    start, length = generator.integers(len(data)), generator.integers(1, 200)
    if generator.random() < 0.5:
        return data[:start] + data[start + length :]
    return data[: start + length] + data[start:]


def _header_number(data: bytearray, generator: np.random.Generator) -> None:
    """Write an extreme number into the value of an attribute."""
    found = [a for a in attributes(bytes(data)) if a.size >= 4]
    chosen = found[generator.integers(len(found))]
    offset = chosen.value + 4 * int(generator.integers(chosen.size // 4))
    struct.pack_into("<i", data, offset, int(generator.choice(EXTREMES)))


def _absurd_size(data: bytearray, generator: np.random.Generator) -> None:
    """Give a window or the tiles an absurd size."""
    found = [a for a in attributes(bytes(data)) if a.kind in (b"box2i", b"tiledesc")]
    chosen = found[generator.integers(len(found))]
    count = 4 if chosen.kind == b"box2i" else 2
    sizes = (10_000, 20_000, 40_000, 100_000, 2**31 - 1, 2**20, 0, -10_000)
    for index in range(count):
        if generator.random() < 0.6:
            value = int(generator.choice(sizes))
            struct.pack_into("<i", data, chosen.value + 4 * index, value)


def _attribute_size(data: bytearray, generator: np.random.Generator) -> None:
    """Change the stored size of an attribute."""
    found = list(attributes(bytes(data)))
    chosen = found[generator.integers(len(found))]
    value = int(generator.choice((*EXTREMES, chosen.size + 1, chosen.size - 1)))
    struct.pack_into("<i", data, chosen.value - 4, value)


def _channels(data: bytearray, generator: np.random.Generator) -> None:
    """Swap two channels whose names have equal length, or change type or sampling of one."""
    lists = [a for a in attributes(bytes(data)) if a.kind == b"chlist"]
    chosen = lists[generator.integers(len(lists))]
    position, entries = chosen.value, []
    while data[position]:
        end = data.index(0, position)
        entries.append((position, end))
        position = end + 17
    first, second = (entries[i] for i in generator.integers(len(entries), size=2))
    if generator.random() < 0.5 and first[1] - first[0] == second[1] - second[0]:
        a, b = slice(*first), slice(*second)
        data[a], data[b] = data[b], data[a]
    else:
        offset = first[1] + 1 + 4 * int(generator.choice((0, 2, 3)))
        struct.pack_into("<i", data, offset, int(generator.choice(EXTREMES)))


def _hostile_text(data: bytearray, generator: np.random.Generator) -> bytearray:
    """Insert text that could control a terminal or a web page into a name or a value."""
    text = HOSTILE[generator.integers(len(HOSTILE))]
    found = list(attributes(bytes(data)))
    if generator.random() < 0.5:
        end = found[-1].value + found[-1].size
        added = b"note" + text.replace(b"\0", b"") + b"\0string\0"
        return data[:end] + added + struct.pack("<i", len(text)) + text + data[end:]
    lists = [a for a in found if a.kind in (b"chlist", b"string")]
    chosen = lists[generator.integers(len(lists))]
    renamed = data[chosen.value : chosen.value + chosen.size]
    if chosen.kind == b"chlist":
        renamed = bytearray(text.replace(b"\0", b"")) + renamed
    else:
        renamed = bytearray(text)
    size = struct.pack("<i", len(renamed))
    return data[: chosen.value - 4] + size + renamed + data[chosen.value + chosen.size :]


def _offsets(data: bytearray, generator: np.random.Generator) -> None:
    """Change entries of the table of pixel offsets."""
    *_, last = attributes(bytes(data))
    start = last.value + last.size + 1
    for _ in range(generator.integers(1, 5)):
        position = start + 8 * generator.integers(4)
        if position + 8 <= len(data):
            value = int(generator.choice((0, 1, 2**40, len(data), len(data) - 1, start, -1)))
            struct.pack_into("<q", data, int(position), value)


def _values(data: bytearray, generator: np.random.Generator) -> None:
    """Overwrite stored bytes with NaN, infinity and huge numbers (pixels if not compressed)."""
    patterns = (0x7FC00000, 0x7F800000, 0xFF800000, 0x7F7FFFFF, 0x00000001, 0x7C007C00, 0xFE00FE00)
    for position in generator.integers(
        len(data) // 2, len(data) - 4, size=generator.integers(1, 9)
    ):
        struct.pack_into("<I", data, int(position), int(generator.choice(patterns)))


MUTATIONS: dict[str, Callable[[bytearray, np.random.Generator], bytearray | None]] = {
    "bit flips": _bit_flips,
    "bytes": _bytes,
    "truncation": _truncation,
    "block": _block,
    "header number": _header_number,
    "absurd size": _absurd_size,
    "attribute size": _attribute_size,
    "channels": _channels,
    "hostile text": _hostile_text,
    "offsets": _offsets,
    "values": _values,
}
