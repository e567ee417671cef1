"""Small EXR files for tests, written with OpenImageIO alone so that they can test jaxblur's I/O."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio

DATA = Path(__file__).parent / "data"
CUBE = DATA / "cube_over_crates_frame_0011.exr"
CUBE_NEXT = DATA / "cube_over_crates_frame_0012.exr"
CAR = DATA / "sky_car_frame_0011.exr"


def make_spec(
    channels, types: str | list[str] = "float", name="", origin=(0, 0), display=None, **attributes
):
    """Make a header for ``{channel: (H, W) array}``; ``types`` is one name or one per channel."""
    height, width = next(iter(channels.values())).shape
    kinds = [types] * len(channels) if isinstance(types, str) else list(types)
    widest = "float" if len(set(kinds)) > 1 else kinds[0]
    spec = oiio.ImageSpec(width, height, len(channels), widest)
    spec.channelnames = tuple(channels)
    if len(set(kinds)) > 1:
        spec.channelformats = [oiio.TypeDesc(kind) for kind in kinds]
    spec.x, spec.y = origin
    x, y, full_width, full_height = display or (*origin, width, height)
    spec.full_x, spec.full_y, spec.full_width, spec.full_height = x, y, full_width, full_height
    spec.attribute("compression", "zip")
    if name:
        spec.attribute("name", name)
    for key, value in attributes.items():
        spec.attribute(key.replace("__", ":"), value)
    return spec


def write_parts(path, parts):
    """Write ``[(spec, {channel: array})]``, one part each."""
    output = oiio.ImageOutput.create(str(path))
    assert output is not None, oiio.geterror()
    specs = [spec for spec, _ in parts]
    assert output.open(str(path), specs[0] if len(specs) == 1 else tuple(specs))
    for index, (spec, channels) in enumerate(parts):
        if index:
            assert output.open(str(path), spec, "AppendSubimage")
        assert output.write_image(np.stack(list(channels.values()), axis=-1)), output.geterror()
    assert output.close(), output.geterror()
    return path


def write_single(path, channels, types: str | list[str] = "float", **options):
    """Write one part from ``{channel: (H, W) array}``."""
    return write_parts(path, [(make_spec(channels, types, **options), channels)])


def read_raw(path, part=0, kind="native"):
    """Read all pixels of a part as stored, with its header."""
    source = oiio.ImageInput.open(str(path))
    assert source is not None and source.seek_subimage(part, 0), oiio.geterror()
    spec = source.spec()
    pixels = source.read_image(part, 0, 0, spec.nchannels, kind)
    source.close()
    return spec, pixels


def read_stored(path, channel, kind):
    """Read one channel of the first part as ``kind``, without conversion if that is its type."""
    source = oiio.ImageInput.open(str(path))
    assert source is not None, oiio.geterror()
    index = source.spec().channelindex(channel)
    pixels = source.read_image(0, 0, index, index + 1, kind)
    source.close()
    assert isinstance(pixels, np.ndarray)
    return pixels[..., 0]


def write_bytes(path, pixels):
    """Write (H, W, C) uint8 values as they are, for example as PNG."""
    height, width, channels = pixels.shape
    output = oiio.ImageOutput.create(str(path))
    assert output is not None, oiio.geterror()
    assert output.open(str(path), oiio.ImageSpec(width, height, channels, "uint8"))
    assert output.write_image(pixels) and output.close(), output.geterror()
    return path


def plain_frame(shape=(4, 6), seed=0):
    """Make color, depth and jaxblur velocity channels of a valid frame."""
    generator = np.random.default_rng(seed)
    channels = {name: generator.random(shape, np.float32) for name in "RGB"}
    channels["Z"] = generator.uniform(1, 9, shape).astype(np.float32)
    for axis in "XY":
        channels[f"velocity.{axis}"] = generator.normal(size=shape).astype(np.float32)
    return channels
