"""Reading frames: channels by name, parts, layers, vectors and depth of other files."""

import subprocess
import sys

import numpy as np
import pytest

from jaxblur import exr
from tests.exr_files import (
    CAR,
    CUBE,
    DATA,
    make_spec,
    plain_frame,
    write_bytes,
    write_parts,
    write_single,
)


def test_a_blender_frame_becomes_a_frame():
    frame = exr.read_frame(CAR, shutter=0.5)
    assert frame.color.shape == (112, 160, 4)
    assert {str(b.dtype) for b in (frame.color, frame.depth, frame.velocity)} == {"float32"}
    assert np.isposinf(frame.depth).sum() == 426, "sky"
    assert np.asarray(frame.depth).min() > 0
    raw = exr.read_channels(CAR, [f"ViewLayer.Vector.{axis}" for axis in "XYZW"])
    expected = 0.125 * np.stack([-raw[..., 0] - raw[..., 2], raw[..., 1] + raw[..., 3]], -1)
    np.testing.assert_allclose(frame.velocity, expected, atol=1e-5)
    assert frame.path is not None
    half = np.asarray(frame.path[..., 1, :] - frame.path[..., 0, :]) / 2
    straight = np.abs(half - frame.velocity).max(-1) < 1e-3
    assert 0.5 < straight.mean() < 1, "all but what turns"
    speed = np.linalg.norm(np.asarray(frame.velocity), axis=-1)
    assert (np.linalg.norm(half, axis=-1) >= speed - 1e-4).all(), "an arc is longer than its chord"


def test_buffers_record_the_decisions():
    buffers = exr.read_buffers(CUBE)
    assert buffers.color_channels == tuple(f"ViewLayer.Combined.{c}" for c in "RGBA")
    assert buffers.depth_channel == "ViewLayer.Depth.Z"
    assert buffers.depth_kind == "z"
    assert buffers.guess.reason.startswith("blender: found ViewLayer.Vector.X")


@pytest.mark.parametrize(
    "prefix", ["ViewLayer.", "View Layer.", "RenderLayer.", "My.Layer.001.", ""]
)
@pytest.mark.parametrize("depth", ["Z", "V"])
def test_single_part_blender_files(tmp_path, prefix, depth):
    plain = plain_frame()
    channels = {f"{prefix}Combined.{c}": plain[c] for c in "RGB"}
    channels[f"{prefix}Depth.{depth}"] = plain["Z"]
    channels |= {
        f"{prefix}Vector.{c}": np.full((4, 6), v, np.float32)
        for c, v in zip("XYZW", (-8, 4, -8, 4), strict=True)
    }
    frame = exr.read_frame(write_single(tmp_path / "a.exr", channels))
    np.testing.assert_array_equal(frame.velocity[0, 0], [2, 1])
    np.testing.assert_array_equal(frame.depth, plain["Z"])
    np.testing.assert_array_equal(frame.color, np.stack([plain[c] for c in "RGB"], -1))


def test_channels_of_named_parts_carry_the_part_name(tmp_path):
    plain = plain_frame()
    color = {c: plain[c] for c in "RGB"}
    forward = {"u": plain["velocity.X"], "v": plain["velocity.Y"]}
    depth = {"Z": plain["Z"]}
    path = write_parts(
        tmp_path / "nuke.exr",
        [
            (make_spec(color, name="rgba"), color),
            (make_spec(forward, name="forward"), forward),
            (make_spec(depth, name="depth"), depth),
        ],
    )
    names = exr.inspect(path).channel_names
    assert names == ("rgba.R", "rgba.G", "rgba.B", "forward.u", "forward.v", "depth.Z")
    buffers = exr.read_buffers(path, depth="z")
    np.testing.assert_array_equal(buffers.velocity[..., 0], plain["velocity.X"] / 4)
    np.testing.assert_array_equal(buffers.velocity[..., 1], -plain["velocity.Y"] / 4)
    with pytest.warns(exr.JaxblurIOWarning, match="depth is read as 1/z, as nuke"):
        inverse = exr.read_buffers(path)
    np.testing.assert_allclose(inverse.depth, 1 / plain["Z"], rtol=1e-6)


def test_a_depth_channel_called_z_is_a_distance_with_nuke_vectors_too(tmp_path):
    plain = plain_frame()
    channels = {name: plain[name] for name in ("R", "G", "B", "Z")}
    channels |= {"forward.u": plain["velocity.X"], "forward.v": plain["velocity.Y"]}
    buffers = exr.read_buffers(write_single(tmp_path / "a.exr", channels))
    assert (buffers.guess.preset.name, buffers.depth_kind) == ("nuke", "z")
    np.testing.assert_array_equal(buffers.depth, plain["Z"])


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_any_usual_number_of_color_channels(tmp_path, count):
    names = {1: "Y", 2: "YA", 3: "RGB", 4: "RGBA"}[count]
    plain = plain_frame()
    color = {name: np.full((4, 6), i + 1, np.float32) for i, name in enumerate(names)}
    data = {name: plain[name] for name in ("Z", "velocity.X", "velocity.Y")}
    frame = exr.read_frame(write_single(tmp_path / "a.exr", color | data))
    np.testing.assert_array_equal(frame.color[0, 0], np.arange(count) + 1)


def test_given_channels_are_read_in_the_given_order(tmp_path):
    channels = plain_frame() | {f"band{i}": np.full((4, 6), i, np.float32) for i in range(6)}
    path = write_single(tmp_path / "a.exr", channels)
    frame = exr.read_frame(
        path,
        preset="fusion",
        color_channels=["band5", "band0", "band3", "band4", "band1"],
        velocity_channels=["G", "B"],
        depth_channel="R",
    )
    np.testing.assert_array_equal(frame.color[0, 0], [5, 0, 3, 4, 1])
    np.testing.assert_array_equal(frame.velocity[..., 0], channels["G"] / 4)
    np.testing.assert_array_equal(frame.velocity[..., 1], -channels["B"] / 4)
    np.testing.assert_array_equal(frame.depth, channels["R"])


def test_a_layer_selects_the_view(tmp_path):
    channels = {
        f"{view}.{name}": values + offset
        for view, offset in (("left", 0), ("right", 10))
        for name, values in plain_frame().items()
    }
    path = write_single(tmp_path / "stereo.exr", channels)
    with pytest.raises(exr.JaxblurIOError, match=r"several layers of color: left.R.*`layer`"):
        exr.read_frame(path)
    frame = exr.read_frame(path, layer="right")
    np.testing.assert_array_equal(frame.color[..., 0], channels["right.R"])
    np.testing.assert_array_equal(frame.velocity[..., 1], channels["right.velocity.Y"] / 4)
    with pytest.raises(exr.JaxblurIOError, match="no layer 'center'; the file holds left"):
        exr.read_frame(path, layer="center")


def test_vectors_and_depth_from_other_files(tmp_path):
    plain = plain_frame()
    color = write_single(tmp_path / "color.exr", {c: plain[c] for c in "RGB"})
    motion = write_single(
        tmp_path / "motion.exr", {"R": plain["velocity.X"], "G": plain["velocity.Y"]}
    )
    depth = write_single(tmp_path / "depth.exr", {"Z": plain["Z"]})
    frame = exr.read_frame(color, "pixel", velocity_from=motion, depth_from=depth)
    np.testing.assert_array_equal(frame.velocity[..., 1], plain["velocity.Y"] / 4)
    np.testing.assert_array_equal(frame.depth, plain["Z"])
    small = write_single(tmp_path / "small.exr", {"Z": plain["Z"][:3]})
    with pytest.raises(
        exr.JaxblurIOError,
        match=r"small.exr: Z: pixels 6x3 at \(0, 0\), but the color of .*color.exr has 6x4",
    ):
        exr.read_frame(color, "pixel", velocity_from=motion, depth_from=small)


def test_data_windows_of_color_vectors_and_depth_must_agree(tmp_path):
    plain = plain_frame()
    color = write_single(tmp_path / "color.exr", plain, origin=(-1, 0))
    moved = write_single(tmp_path / "moved.exr", {"Z": plain["Z"]}, origin=(1, 0))
    with pytest.raises(exr.JaxblurIOError, match=r"6x4 at \(1, 0\), but .* has 6x4 at \(-1, 0\)"):
        exr.read_frame(color, depth_from=moved)
    depth = {"Z": plain.pop("Z")}
    window = (0, 0, 6, 4)
    parts = [(make_spec(plain, name="rgb", display=window), plain)]
    parts.append((make_spec(depth, name="depth", origin=(1, 0), display=window), depth))
    path = write_parts(tmp_path / "parts.exr", parts)
    with pytest.raises(exr.JaxblurIOError, match=r"depth.Z: .* \(1, 0\), but the color has 6x4"):
        exr.read_frame(path)
    same = write_single(tmp_path / "same.exr", depth, origin=(-1, 0))
    np.testing.assert_array_equal(exr.read_frame(color, depth_from=same).depth, depth["Z"])


def test_eight_bit_vectors_in_a_png(tmp_path):
    pixels = np.full((4, 6, 3), 127, np.uint8)
    pixels[1, 2] = [254, 0, 0]
    write_bytes(tmp_path / "v.png", pixels)
    color = write_single(tmp_path / "color.exr", plain_frame())
    frame = exr.read_frame(
        color, "rsmb8", velocity_from=tmp_path / "v.png", max_displace=32, shutter=1
    )
    np.testing.assert_allclose(frame.velocity[1, 2], [-16, -16], rtol=1e-5)
    np.testing.assert_allclose(frame.velocity[0, 0], [0, 0], atol=1e-5)


def test_flat_depth_needs_no_depth_channel(tmp_path):
    channels = plain_frame()
    del channels["Z"]
    path = write_single(tmp_path / "a.exr", channels)
    assert np.all(exr.read_buffers(path, depth="flat").depth == 1)
    with pytest.raises(exr.JaxblurIOError, match=r"no depth channel among R, G.*depth='flat'"):
        exr.read_frame(path)


def test_axes_of_other_data_are_not_depth(tmp_path):
    plain = plain_frame()
    channels = {name: values for name, values in plain.items() if name != "Z"}
    channels |= {f"normals.{axis}": plain["Z"] for axis in "XYZ"}
    with pytest.raises(exr.JaxblurIOError, match="no depth channel"):
        exr.read_frame(write_single(tmp_path / "a.exr", channels))


def test_inspect_lists_parts_windows_types_and_metadata():
    info = exr.inspect(CUBE)
    assert [part.name for part in info.parts] == [
        "ViewLayer.Combined",
        "ViewLayer.Depth",
        "ViewLayer.Vector",
        "ViewLayer.Object Index",
        "ViewLayer.Noisy Image",
    ]
    first = info.parts[0]
    assert first.data_window == first.display_window == (0, 0, 160, 112)
    assert {channel.type for channel in first.channels} == {"half"}
    assert first.compression.startswith("zip") and not first.deep
    assert first.attributes["Software"] == "Blender 5.0.1"
    assert info.channel("ViewLayer.Object Index.X").part == 3


def test_images_of_other_formats_are_linear_light(tmp_path):
    pixels = np.zeros((1, 2, 3), np.uint8)
    pixels[0, 1] = [255, 118, 10]
    image = exr.read_image(write_bytes(tmp_path / "a.png", pixels))
    np.testing.assert_allclose(image[0, 1], [1, 0.18116, 0.0030353], rtol=1e-3)
    assert image.dtype == np.float32
    vectors = write_single(tmp_path / "v.exr", plain_frame((1, 2)))
    frame = exr.read_frame(tmp_path / "a.png", velocity_from=vectors, depth_from=vectors)
    np.testing.assert_array_equal(frame.color, image)


def test_the_truth_of_a_frame_is_read_as_an_image():
    truth = exr.read_image(DATA / "cube_over_crates_truth_0011.exr")
    sharp = exr.read_image(CUBE)
    assert truth.shape == sharp.shape == (112, 160, 4)
    assert 0.05 < np.abs(truth - sharp).mean() < 0.5


def test_listing_and_errors_do_not_load_jax():
    script = (
        "import sys\nfrom jaxblur import exr, vectors\n"
        f"buffers = exr.read_buffers({str(CUBE)!r})\n"
        "vectors.speed_statistics(buffers.velocity)\n"
        "assert 'jax' not in sys.modules, 'jax was imported'\n"
        "frame = exr.read_frame(buffers and sys.argv[1])\nassert 'jax' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", script, str(CUBE)], check=True, timeout=120)
