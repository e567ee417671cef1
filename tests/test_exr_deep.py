"""Deep files as a few layers."""

import numpy as np
import OpenImageIO as oiio
import pytest

import jaxblur
from jaxblur import exr
from jaxblur.exr import deep
from tests.command_line import run

SIZE = (48, 72)
CHANNELS = ("R", "G", "B", "A", "Z", "velocity.X", "velocity.Y")
SETTINGS = jaxblur.Settings(samples=66, radius=24, fetch="bilinear", noise="none")


def write_deep(path, samples, size=SIZE, names=CHANNELS, in_order=False, tile=0):
    """Write deep samples: for each, the mask (H, W) of where it is, and (H, W, channels)."""
    spec = oiio.ImageSpec(size[1], size[0], len(names), "float")
    spec.channelnames = names
    spec.deep = True
    spec.tile_width = spec.tile_height = tile
    data = oiio.DeepData()
    data.init(size[0] * size[1], len(names), oiio.TypeDesc("float"), names)
    counts = np.sum([mask for mask, _ in samples], axis=0).reshape(-1)
    for pixel, count in enumerate(counts):
        data.set_samples(pixel, int(count))
    filled = np.zeros(size[0] * size[1], int)
    for mask, values in samples:
        flat = values.reshape(-1, len(names))
        for pixel in np.flatnonzero(mask):
            for channel, value in enumerate(flat[pixel]):
                data.set_deep_value(int(pixel), channel, int(filled[pixel]), float(value))
            filled[pixel] += 1
    for pixel in range(size[0] * size[1] if in_order else 0):
        data.sort(pixel)
    output = oiio.ImageOutput.create(str(path))
    assert output is not None, oiio.geterror()
    assert output.open(str(path), spec), output.geterror()
    assert output.write_deep_image(data), output.geterror()
    assert output.close()
    return path


def disc(center, radius, speed, color, alpha, depth, time=0.0):
    """A translucent disc at a time in half exposures; shutter 0.5, so vectors are 4 times that."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    x, y = columns - speed[0] * time, rows - speed[1] * time
    cover = alpha * np.clip(radius + 0.5 - np.hypot(x - center[0], y - center[1]), 0, 1)
    texture = 0.7 + 0.3 * np.sin(x * 0.4) * np.cos(y * 0.3)
    image = np.empty((*SIZE, 7))
    image[..., :3] = (cover * texture)[..., None] * color
    image[..., 3:5] = np.stack([cover, np.full(SIZE, depth)], axis=-1)
    image[..., 5:] = 4 * np.array(speed)
    return cover > 0, image


DISCS = (
    ((28, 24), 13, (7.0, 0.0), (0.9, 0.5, 0.2), 0.6, 2.0),
    ((40, 24), 15, (-4.0, 3.0), (0.2, 0.4, 0.9), 0.5, 5.0),
)


def over(images):
    result, through = np.zeros((*SIZE, 4)), np.ones((*SIZE, 1))
    for image in images:
        result += through * image[..., :4]
        through = through * (1 - image[..., 3:4])
    return result


def truth():
    times = np.linspace(-1, 1, 201)[:-1] + 1 / 200
    return np.mean([over([disc(*d, time=t)[1] for d in DISCS]) for t in times], axis=0)


@pytest.fixture
def discs(tmp_path):
    """Two discs; samples are stored with the far one first."""
    return write_deep(tmp_path / "discs.exr", [disc(*DISCS[1]), disc(*DISCS[0])])


def test_each_thing_becomes_a_layer(discs):
    front, back = exr.read_deep_layers(discs, 2)
    for buffers, parts in zip((front, back), DISCS, strict=True):
        mask, image = disc(*parts)
        np.testing.assert_allclose(buffers.color, image[..., :4], atol=1e-6)
        np.testing.assert_array_equal(np.isfinite(buffers.depth), mask)
        np.testing.assert_allclose(buffers.depth[mask], parts[-1], rtol=1e-5)
        np.testing.assert_allclose(buffers.velocity[mask], np.tile(parts[2], (mask.sum(), 1)))
        assert not buffers.velocity[~mask].any()
    assert front.color_channels == ("R", "G", "B", "A") and front.depth_channel == "Z"


@pytest.mark.parametrize("layers", [1, 2, 3, 5])
def test_layers_composite_back_to_the_flat_image(tmp_path, layers):
    generator, samples = np.random.default_rng(3), []
    for _ in range(6):
        image = generator.random((8, 9, 7))
        image[..., 3] = np.where(generator.random((8, 9)) < 0.1, 1, image[..., 3])
        image[..., :3] *= image[..., 3:4]
        image[..., 4] = generator.uniform(1, 9, (8, 9))
        samples.append((generator.random((8, 9)) < 0.6, image))
    path = write_deep(tmp_path / "random.exr", samples, (8, 9), in_order=True)
    found = exr.read_deep_layers(path, layers)
    assert len(found) == layers
    result, through = np.zeros((8, 9, 4)), np.ones((8, 9, 1))
    for buffers in found:
        result += through * buffers.color
        through = through * (1 - buffers.color[..., 3:])
    np.testing.assert_allclose(result, read_flat(path), atol=1e-6)


def read_flat(path):
    """The flat image as OpenImageIO composites it, in the order of the file."""
    flat = oiio.ImageBufAlgo.flatten(oiio.ImageBuf(str(path)))
    return np.asarray(flat.get_pixels("float"))[..., :4]


def test_depth_and_velocity_are_means_by_contribution(tmp_path):
    near, far = np.zeros((2, 1, 1, 7))
    near[..., 3:], far[..., 3:] = (0.5, 2.0, 8.0, 0.0), (0.5, 4.0, 0.0, 4.0)
    mask = np.ones((1, 1), bool)
    path = write_deep(tmp_path / "pixel.exr", [(mask, far), (mask, near)], (1, 1))
    (buffers,) = exr.read_deep_layers(path, 1)
    # The near one contributes a half, the far one a quarter; a velocity is a quarter of a vector.
    np.testing.assert_allclose(buffers.velocity[0, 0], [2 * 2 / 3, 1 / 3], rtol=1e-6)
    np.testing.assert_allclose(1 / buffers.depth[0, 0], (2 / 2 + 1 / 4) / 3, rtol=1e-6)


def test_what_an_opaque_sample_hides_is_kept_behind_it(tmp_path):
    mask, front = disc(*DISCS[0][:4], 1.0, 2.0)
    wall = np.broadcast_to(np.array([0.1, 0.2, 0.3, 1.0, 9.0, 0.0, 0.0]), (*SIZE, 7))
    path = write_deep(tmp_path / "wall.exr", [(mask, front), (np.ones(SIZE, bool), wall)])
    _, back = exr.read_deep_layers(path, 2)
    np.testing.assert_allclose(back.color, wall[..., :4], atol=1e-6)


def psnr(image, target):
    return -10 * np.log10(np.mean((np.asarray(image) - target)[8:-8, 8:-8] ** 2))


@pytest.mark.slow
def test_two_layers_blur_better_than_the_flat_image(discs):
    target = truth()
    layers = [buffers.frame() for buffers in exr.read_deep_layers(discs, 2)]
    deep = psnr(jaxblur.blur_layers(layers, settings=SETTINGS), target)
    (flat,) = exr.read_deep_layers(discs, 1)
    parameters = jaxblur.LayeredParameters()
    flat = psnr(jaxblur.layered(flat.frame(), parameters, settings=SETTINGS), target)
    print(f"deep {deep:.2f} flat {flat:.2f}")
    assert deep > 45 and deep > flat + 10


def test_one_depth_is_one_layer(tmp_path):
    path = write_deep(tmp_path / "one.exr", [disc(*DISCS[0])])
    assert len(exr.read_deep_layers(path, 4)) == 1


def test_tiles_hold_the_same_layers_as_lines(tmp_path, discs):
    tiled = write_deep(tmp_path / "tiled.exr", [disc(*DISCS[1]), disc(*DISCS[0])], tile=32)
    for found, expected in zip(
        exr.read_deep_layers(tiled, 2), exr.read_deep_layers(discs, 2), strict=True
    ):
        np.testing.assert_array_equal(found.color, expected.color)
        np.testing.assert_array_equal(found.velocity, expected.velocity)


def test_a_bad_sample_ends_the_reading(tmp_path, monkeypatch):
    """A small file can hold millions of samples, which take memory before they are refused."""
    mask, image = disc(*DISCS[0])
    image[24, 28, 4] = -1
    path = write_deep(tmp_path / "negative.exr", [(mask, image)])
    read, rows_of = [], deep._read_rows
    monkeypatch.setattr(deep, "_read_rows", lambda *of: read.append(of[-1][-1]) or rows_of(*of))
    with pytest.raises(exr.JaxblurIOError, match="negative"):
        exr.read_deep_layers(path, 2)
    assert 24 < read[-1] <= 24 + deep.BAND


def test_refusals(tmp_path, discs):
    mask, image = disc(*DISCS[0])
    no_alpha = write_deep(
        tmp_path / "rgb.exr", [(mask, np.delete(image, 3, axis=-1))], names=(*"RGB", *CHANNELS[4:])
    )
    with pytest.raises(exr.JaxblurIOError, match=r"rgb.exr: R, G, B: no alpha"):
        exr.read_deep_layers(no_alpha, 2)
    image[20, 28, 0] = np.nan
    broken = write_deep(tmp_path / "nan.exr", [(mask, image)])
    with pytest.raises(exr.JaxblurIOError, match=r"R: deep samples are NaN .* row 20, column 28"):
        exr.read_deep_layers(broken, 2)
    with pytest.raises(exr.JaxblurIOError, match="deep samples need depth"):
        exr.read_deep_layers(discs, 2, depth="flat")
    with pytest.raises(ValueError, match="`layers` must be at least 1"):
        exr.read_deep_layers(discs, 0)
    with pytest.raises(ValueError, match="`also` is not for deep files"):
        exr.read_deep_layers(discs, 2, also="all")
    frame = tmp_path / "frame.exr"
    exr.write_channels(frame, dict(zip(CHANNELS, np.moveaxis(image, -1, 0), strict=True)))
    with pytest.raises(exr.JaxblurIOError, match=r"frame.exr: .*not deep"):
        exr.read_deep_layers(frame, 2)


def test_a_deep_file_is_listed_without_speeds(discs):
    outcome = run("info", discs)
    assert outcome.status == 0 and "zips, deep" in outcome.out
    assert "speeds not measured: deep pixels; `jaxblur layers` blurs them" in outcome.out
