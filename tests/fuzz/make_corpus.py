"""Write the corpus: small files, valid but strange.

    python -m tests.fuzz.make_corpus [FOLDER]

Files that are there already are written anew; mutants are left alone.
"""

import importlib
import struct
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from tests.exr_files import make_spec, plain_frame, write_parts, write_single

mutations = importlib.import_module("experiments.008_hard_cases.mutations")

CORPUS = Path(__file__).with_name("corpus")
SHAPE = (7, 10)
ATTRIBUTES = {
    "timecode": ("timecode", struct.pack("<II", 0x01020304, 0)),
    "keycode": ("keycode", struct.pack("<7i", 1, 2, 3, 4, 5, 6, 7)),
    "rational": ("rational", struct.pack("<iI", -1, 0)),
    "chromaticities": ("chromaticities", struct.pack("<8f", *[0.3] * 8)),
    "preview": ("preview", struct.pack("<II", 1, 1) + b"\1\2\3\4"),
    "views": ("stringvector", struct.pack("<i", 4) + b"left" + struct.pack("<i", 0)),
    "matrix": ("m44f", struct.pack("<16f", *[float("nan")] * 16)),
    "matrix33": ("m33d", struct.pack("<9d", *range(9))),
    "points": ("floatvector", struct.pack("<3f", 1, float("inf"), -0.0)),
    "box": ("box2f", struct.pack("<4f", 1, 1, -1, -1)),
    "vector": ("v3d", struct.pack("<3d", 1e308, -1e308, 0)),
    "unknown": ("someTypeOfARenderer", bytes(range(256))),
    "empty": ("string", b""),
    "nothing": ("anotherType", b""),
    "n" * 31: ("string", b"a long name"),
    "long": ("string", b"x" * 3000),
    "text": ("string", b"\xff\xfe\x1b[31m\r\n\t<b>\x00end"),
    "jaxblur:filter": ("string", b"guertin2014"),
    "jaxblur:settings": ("string", b"samples = ]["),
    "multiView": ("stringvector", b""),
    "worldToCamera": ("m44f", struct.pack("<16f", *[0.0] * 16)),
    "framesPerSecond": ("rational", struct.pack("<iI", 24, 0)),
    "pixelAspectRatio2": ("float", struct.pack("<f", float("nan"))),
}


def frame(shape=SHAPE):
    """Color, depth and vectors that compress well."""
    return {name: np.round(4 * values) / 4 for name, values in plain_frame(shape).items()}


def smooth():
    """A larger frame whose channels are ramps."""
    y, x = np.mgrid[:16, :24].astype(np.float32)
    return {name: 1 + (k * x + y) // 8 for k, name in enumerate(plain_frame((1, 1)))}


def with_attributes(data: bytes, attributes) -> bytes:
    """Add attributes to the last header."""
    end = max(a.value + a.size for a in mutations.attributes(data))
    added = b"".join(
        name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
        for name, (kind, value) in attributes.items()
    )
    # The table of offsets counts from the start of the file.
    shift = len(added)
    count, *_ = chunk_count(data)
    table = [value + shift for value in struct.unpack_from(f"<{count}Q", data, end + 1)]
    rest = data[end + 1 + 8 * count :]
    return data[:end] + added + b"\0" + struct.pack(f"<{count}Q", *table) + rest


def chunk_count(data: bytes) -> tuple[int, int]:
    """Chunks of a file of one part, and the position of their offsets."""
    end = max(a.value + a.size for a in mutations.attributes(data)) + 1
    (first,) = struct.unpack_from("<Q", data, end)
    return (first - end) // 8, end


def write_levels(path: Path) -> None:
    """A file of tiles with smaller levels."""
    channels = frame((16, 16))
    output = oiio.ImageOutput.create(str(path))
    assert output is not None
    for level in range(5):
        size = 16 >> level
        spec = make_spec({name: values[:size, :size] for name, values in channels.items()})
        spec.tile_width = spec.tile_height = 8
        spec.attribute("textureformat", "Plain Texture")
        spec.attribute("openexr:levelmode", 1)
        assert output.open(str(path), spec, "AppendMIPLevel" if level else "Create"), (
            output.geterror()
        )
        pixels = np.stack([v[:size, :size] for v in channels.values()], axis=-1)
        assert output.write_image(np.ascontiguousarray(pixels)), output.geterror()
    assert output.close()


def write_tiles(path: Path, compression="zip", origin=(0, 0)) -> None:
    spec = make_spec(frame(), origin=origin, compression=compression)
    spec.tile_width = spec.tile_height = 4
    output = oiio.ImageOutput.create(str(path))
    assert output is not None and output.open(str(path), spec)
    assert output.write_image(np.stack(list(frame().values()), axis=-1)) and output.close()


def write_deep(path: Path, samples=(0, 1, 3), tile=0) -> None:
    spec = make_spec(frame(), compression="zips")
    spec.deep, spec.tile_width, spec.tile_height = True, tile, tile
    deep = oiio.DeepData()
    deep.init(spec)
    for pixel in range(SHAPE[0] * SHAPE[1]):
        deep.set_samples(pixel, samples[pixel % len(samples)])
        for sample in range(deep.samples(pixel)):
            for channel in range(spec.nchannels):
                deep.set_deep_value(pixel, channel, sample, 0.5 * sample)
    output = oiio.ImageOutput.create(str(path))
    assert output is not None and output.open(str(path), spec)
    assert output.write_deep_image(deep) and output.close()


def part(names, name, shape=SHAPE, **options):
    channels = {key: frame(shape)[key] for key in names}
    return make_spec(channels, name=name, **options), channels


def write_corpus(folder: Path) -> None:
    """Write all files of the corpus but the mutants."""
    folder.mkdir(exist_ok=True)
    plain, kinds = frame(), ["half", "half", "half", "float", "float", "float"]
    for scheme in mutations.COMPRESSIONS:
        # Large and smooth enough that every scheme stores less than the plain values.
        write_single(folder / f"scheme_{scheme}.exr", smooth(), kinds, compression=scheme)
    write_single(folder / "half.exr", plain, "half")
    write_single(folder / "mixed.exr", plain, kinds)
    write_single(folder / "whole_numbers.exr", plain | {"id": 7 * plain["R"]}, [*kinds, "uint"])
    write_tiles(folder / "tiles.exr")
    write_tiles(folder / "tiles_b44_window.exr", "b44", (-3, 5))
    write_levels(folder / "levels.exr")
    write_deep(folder / "deep.exr")
    write_deep(folder / "deep_empty.exr", (0,))
    write_deep(folder / "deep_tiles.exr", tile=4)

    write_single(folder / "window_negative.exr", plain, origin=(-5, -7), display=(0, 0, 10, 7))
    write_single(folder / "window_inside.exr", plain, origin=(90, 50), display=(0, 0, 1920, 1080))
    write_single(folder / "window_far.exr", plain, origin=(-(2**20), 2**20))
    for shape in ((1, 1), (1, 33), (40, 1)):
        write_single(folder / f"size_{shape[1]}x{shape[0]}.exr", frame(shape))

    write_parts(
        folder / "parts.exr", [part("RGB", "color"), part("Z", "z"), part(list(plain)[4:], "v")]
    )
    write_parts(
        folder / "parts_of_other_windows.exr",
        [
            part("RGB", "color", display=(0, 0, 10, 7)),
            part("Z", "z", (3, 4), display=(0, 0, 10, 7)),
            part(list(plain)[4:], "v", origin=(1, 1), display=(0, 0, 10, 7)),
        ],
    )
    write_parts(folder / "parts_many.exr", [part("R", f"p{k}", (2, 2)) for k in range(20)])

    write_single(folder / "attributes.exr", plain)
    data = (folder / "attributes.exr").read_bytes()
    (folder / "attributes.exr").write_bytes(with_attributes(data, ATTRIBUTES))

    rgb = {name: plain[name] for name in "RGB"}
    value = plain["R"]
    write_single(folder / "no_vectors.exr", rgb)
    write_single(folder / "only_vectors.exr", {k: plain[k] for k in ("velocity.X", "velocity.Y")})
    write_single(folder / "channels_many.exr", plain | {f"aov{k:02}.x": value for k in range(60)})
    strange = ("..", " ", ".R", "R.", "a/b.X", "\u202e.Z", "%s.Y", "<i>.A", "x" * 200, "[31m")
    write_single(folder / "channels_strange.exr", plain | dict.fromkeys(strange, value))
    vector = {"Vector.X": value, "Vector.Y": value, "Vector.Z": -value, "Vector.W": -value}
    layer = {f"ViewLayer.{name}": v for name, v in vector.items()}
    layer |= {f"ViewLayer.Combined.{name}": value for name in "RGBA"} | {
        "ViewLayer.Depth.Z": plain["Z"]
    }
    write_single(folder / "blender.exr", layer)
    nuke = {f"{side}.{axis}": value for side in ("forward", "backward") for axis in "uv"}
    write_single(folder / "nuke.exr", rgb | nuke | {"depth.Z": plain["Z"]})
    write_single(folder / "arnold.exr", rgb | {"motionvector.X": value, "motionvector.Y": value})
    two = {f"{eye}.{name}": v for eye in ("left", "right") for name, v in plain.items()}
    write_single(folder / "two_eyes.exr", two)

    write_single(folder / "values_not_finite.exr", plain | {"R": value + np.float32("inf")})
    write_single(folder / "values_nan.exr", plain | {"velocity.X": value * np.float32("nan")})
    write_single(folder / "values_huge.exr", plain | {"velocity.Y": value * np.float32(1e38)})
    write_single(folder / "values_still.exr", plain | {f"velocity.{a}": 0 * value for a in "XY"})
    write_single(folder / "values_negative_depth.exr", plain | {"Z": -plain["Z"]})

    def changed(name: str, source: str, attribute: bytes, value: bytes) -> None:
        data = bytearray((folder / source).read_bytes())
        (found,) = [a for a in mutations.attributes(bytes(data)) if a.name == attribute]
        data[found.value : found.value + len(value)] = value
        (folder / name).write_bytes(data)

    changed("order_decreasing.exr", "scheme_none.exr", b"lineOrder", b"\1")
    changed("order_impossible.exr", "scheme_none.exr", b"lineOrder", b"\x7f")
    changed("aspect_zero.exr", "scheme_zip.exr", b"pixelAspectRatio", struct.pack("<f", 0))
    nowhere = struct.pack("<4i", 5, 5, 4, 4)
    changed("display_empty.exr", "scheme_zip.exr", b"displayWindow", nowhere)
    # Rows and columns of one channel in two: its data are half as large as the file's.
    data = bytearray((folder / "scheme_none.exr").read_bytes())
    at = data.index(b"R\0", data.index(b"chlist")) + 2
    struct.pack_into("<2i", data, at + 8, 2, 1)
    (folder / "subsampled.exr").write_bytes(data)


if __name__ == "__main__":
    write_corpus(Path(sys.argv[1]) if len(sys.argv) > 1 else CORPUS)
