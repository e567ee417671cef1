"""Reading frames: channels by name, conversions, and one clear error for every bad input."""

import re
import struct
import subprocess
import sys
import tracemalloc
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

from jaxblur import exr
from jaxblur.nonfinite import Ignored
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


def test_buffers_say_what_was_decided():
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


def test_a_depth_channel_called_plain_z_is_a_distance_beside_nuke_vectors_too(tmp_path):
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


def test_a_layer_settles_which_view_is_read(tmp_path):
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


def test_data_windows_of_files_that_go_together_must_agree(tmp_path):
    plain = plain_frame()
    color = write_single(tmp_path / "color.exr", plain, origin=(-1, 0))
    moved = write_single(tmp_path / "moved.exr", {"Z": plain["Z"]}, origin=(1, 0))
    with pytest.raises(exr.JaxblurIOError, match=r"6x4 at \(1, 0\), but .* has 6x4 at \(-1, 0\)"):
        exr.read_frame(color, depth_from=moved)
    same = write_single(tmp_path / "same.exr", {"Z": plain["Z"]}, origin=(-1, 0))
    np.testing.assert_array_equal(exr.read_frame(color, depth_from=same).depth, plain["Z"])


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


def test_flat_depth_asks_for_no_depth_channel(tmp_path):
    channels = plain_frame()
    del channels["Z"]
    path = write_single(tmp_path / "a.exr", channels)
    assert np.all(exr.read_buffers(path, depth="flat").depth == 1)
    with pytest.raises(exr.JaxblurIOError, match=r"no depth channel among R, G.*depth='flat'"):
        exr.read_frame(path)


@pytest.mark.parametrize(
    ("kind", "stored", "distance"),
    [
        ("z", [2, 1e9, 1e10, np.inf, 0], [2, *[np.inf] * 4]),
        ("-z", [-2, -1e10, -np.inf, 0], [2, *[np.inf] * 3]),
        ("1/z", [0.5, 0, 4], [2, np.inf, 0.25]),
        ("normalized-near1", [1, 0.25, 0], [1, 1.75, np.inf]),
    ],
)
def test_depth_becomes_a_positive_distance(tmp_path, kind, stored, distance):
    channels = plain_frame((1, len(stored)))
    channels["Z"][0] = stored
    path = write_single(tmp_path / "a.exr", channels)
    np.testing.assert_array_equal(exr.read_buffers(path, depth=kind).depth[0], distance)


@pytest.mark.parametrize(
    ("kind", "value", "message"),
    [
        ("z", -3, "Z: 1 of 24 pixels are negative .first at row 1, column 2.; pass depth='-z'"),
        ("-z", 3, "negative .*pass depth='z'"),
        ("1/z", -1, "Z: 1 of 24 pixels are negative"),
        ("1/z", 1e10, "1e9 or more .*pass depth='z'"),
        ("normalized-near1", 1.5, "above 1 .*pass depth='z'"),
    ],
)
def test_depth_of_another_kind_is_refused(tmp_path, kind, value, message):
    channels = plain_frame()
    channels["Z"] = np.full((4, 6), -0.5 if kind == "-z" else 0.5, np.float32)
    channels["Z"][1, 2] = value
    path = write_single(tmp_path / "a.exr", channels)
    with pytest.raises(exr.JaxblurIOError, match=message):
        exr.read_buffers(path, depth=kind)


@pytest.mark.parametrize("name", ["G", "velocity.Y"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_non_finite_values_are_refused_or_left_out(tmp_path, name, value):
    channels = plain_frame()
    channels[name][2, 3] = channels[name][3, 0] = value
    path = write_single(tmp_path / "a.exr", channels)
    message = rf"a.exr: {name}: 2 of 24 pixels are NaN or infinite \(first at row 2, column 3\)"
    with pytest.raises(exr.JaxblurIOError, match=message):
        exr.read_frame(path)
    with pytest.warns(exr.JaxblurIOWarning, match="2 pixels with NaN or infinity in .* ignored"):
        buffers = exr.read_buffers(path, nonfinite="ignore")
    assert np.isfinite(buffers.color).all() and np.isfinite(buffers.velocity).all()
    if name == "G":
        assert buffers.ignored == Ignored(color=2)
        assert buffers.valid is not None and np.argwhere(~buffers.valid).tolist() == [
            [2, 3],
            [3, 0],
        ]
    else:
        assert buffers.ignored == Ignored(velocity=2) and buffers.valid is None
        assert (buffers.velocity[2, 3] == 0).all()
    kept = exr.read_buffers(path, nonfinite="keep")
    kept_target = kept.color[..., 1] if name == "G" else kept.velocity[..., 1]
    assert (~np.isfinite(kept_target)).sum() == 2


def test_unknown_vectors_rest_whatever_value_stands_for_rest(tmp_path):
    channels = {name: plain_frame()[name] for name in "RGBZ"}
    channels |= {f"Velocity.{c}": np.full((4, 6), 0.75, np.float32) for c in "RG"}
    channels["Velocity.R"][1, 1] = np.nan
    path = write_single(tmp_path / "a.exr", channels)
    with pytest.warns(exr.JaxblurIOWarning):
        frame = exr.read_frame(path, max_displace=8, depth="z", nonfinite="ignore")
    velocity = np.asarray(frame.velocity)
    assert (velocity[1, 1] == 0).all()
    assert (np.delete(velocity.reshape(-1, 2), 7, axis=0) != 0).all()


def test_unknown_depth_is_refused_or_sky(tmp_path):
    channels = plain_frame()
    channels["Z"][1, 2] = np.nan
    path = write_single(tmp_path / "a.exr", channels)
    with pytest.raises(exr.JaxblurIOError, match=r"a.exr: Z: 1 of 24 pixels are NaN"):
        exr.read_frame(path)
    with pytest.warns(exr.JaxblurIOWarning, match="1 pixels with NaN in Z"):
        buffers = exr.read_buffers(path, nonfinite="ignore")
    assert np.isposinf(buffers.depth[1, 2]) and buffers.ignored == Ignored(depth=1)


def test_impossible_speeds_are_refused(tmp_path):
    channels = plain_frame()
    channels["velocity.X"][0, 5] = 1e20
    path = write_single(tmp_path / "a.exr", channels)
    message = r"velocity.X, velocity.Y: 1 of 24 pixels are faster .*check the preset \(jaxblur\)"
    with pytest.raises(exr.JaxblurIOError, match=message):
        exr.read_frame(path)


@pytest.mark.parametrize(
    ("compression", "types", "lossy"),
    [
        ("pxr24", "float", ["velocity.X", "velocity.Y", "Z"]),
        ("pxr24", "half", []),
        ("b44", "half", ["velocity.X", "velocity.Y", "Z"]),
        ("b44", "float", []),
        ("dwaa", "float", ["velocity.Y"]),
        ("zip", "float", []),
    ],
)
def test_lossy_compression_of_vectors_is_reported_where_it_loses(
    tmp_path, recwarn, compression, types, lossy
):
    plain = plain_frame((64, 64))
    if types == "half":
        plain = {name: v.astype(np.float16).astype(np.float32) for name, v in plain.items()}
    path = write_single(tmp_path / "a.exr", plain, types, compression=compression)
    data = ["velocity.X", "velocity.Y", "Z"]
    stored = exr.read_channels(path, data)
    changed = [name for i, name in enumerate(data) if (stored[..., i] != plain[name]).any()]
    assert changed == lossy
    exr.read_buffers(path)
    reported = [str(warning.message) for warning in recwarn]
    assert [text.split(": ")[1].split(" is ")[0] for text in reported] == lossy
    assert all(f"lossy compression ({compression})" in text for text in reported)


def test_missing_and_ambiguous_channels_are_named(tmp_path):
    plain = plain_frame()
    path = write_single(tmp_path / "a.exr", {c: plain[c] for c in "RGBZ"})
    with pytest.raises(exr.JaxblurIOError, match=r"no motion vectors recognized among R, G, B, Z"):
        exr.read_frame(path)
    with pytest.raises(exr.JaxblurIOError, match="no channels of preset `nuke`"):
        exr.read_frame(path, preset="nuke")
    with pytest.raises(exr.JaxblurIOError, match=r"no channel called mv.X; the file holds R, G"):
        exr.read_frame(path, preset="pixel", velocity_channels=["mv.X", "mv.Y"])
    only_z = write_single(tmp_path / "z.exr", {"Z": plain["Z"]})
    with pytest.raises(exr.JaxblurIOError, match=r"no color \(R, G, B or Y\) among Z"):
        exr.read_image(only_z)
    both = plain | {"Depth.Z": plain["Z"], "crypto.Depth.Z": plain["Z"]}
    with pytest.raises(
        exr.JaxblurIOError, match=r"several depth channels: Depth.Z, crypto.Depth.Z"
    ):
        exr.read_frame(write_single(tmp_path / "two.exr", both))


def test_axes_of_other_data_are_not_depth(tmp_path):
    plain = plain_frame()
    channels = {name: values for name, values in plain.items() if name != "Z"}
    channels |= {f"normals.{axis}": plain["Z"] for axis in "XYZ"}
    with pytest.raises(exr.JaxblurIOError, match="no depth channel"):
        exr.read_frame(write_single(tmp_path / "a.exr", channels))


def test_wrong_arguments_are_refused_before_the_file_is_opened():
    refusals: tuple[tuple[dict[str, Any], str], ...] = (
        ({"preset": "maya"}, "`preset` must be auto or one of"),
        ({"shutter": -1}, "`shutter` must be"),
        ({"depth": "w"}, "`depth` must be auto or one of z, -z"),
        ({"nonfinite": "zero"}, "`nonfinite` must be error or ignore or keep"),
    )
    for options, message in refusals:
        with pytest.raises(ValueError, match=message):
            exr.read_buffers("nowhere.exr", **options)
    with pytest.raises(TypeError, match="unexpected keyword"):
        exr.read_frame(CUBE, velocity="x")  # pyright: ignore[reportCallIssue]


def test_presets_that_need_more_say_so_with_the_file(tmp_path):
    path = write_single(tmp_path / "a.exr", plain_frame())
    for preset, message in (("arnold", "`file_shutter`"), ("vray", "`max_displace`")):
        with pytest.raises(exr.JaxblurIOError, match=f"a.exr: .*{message}"):
            exr.read_frame(path, preset, velocity_channels=["R", "G"])


def test_paths_that_are_no_images(tmp_path):
    (tmp_path / "text.exr").write_text("not an image")
    (tmp_path / "empty.exr").write_bytes(b"")
    (tmp_path / "scene.blend").write_bytes(b"BLENDER")
    (tmp_path / "png.exr").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(64))
    for name, message in (
        ("nowhere.exr", "no such file"),
        ("", "is not a file"),
        ("text.exr", "cannot be opened: .*no EXR file at all; copy or render it again .*OpenEXR"),
        ("png.exr", "cannot be opened: .*not an OpenEXR file"),
        ("empty.exr", "is empty"),
        ("scene.blend", "is not one of .exr, .png"),
    ):
        with pytest.raises(exr.JaxblurIOError, match=message) as caught:
            exr.inspect(tmp_path / name)
        assert caught.value.path == str(tmp_path / name)
        assert str(caught.value) == f"{caught.value.path}: {caught.value.reason}"
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.97])
def test_truncated_files_are_refused(tmp_path, share):
    whole = CUBE.read_bytes()
    path = tmp_path / "cut.exr"
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(exr.JaxblurIOError, match=re.escape("cut.exr: ")):
        exr.read_channels(path, exr.inspect(CUBE).channel_names)


def test_deep_images_are_refused(tmp_path):
    spec = oiio.ImageSpec(2, 2, 3, "float")
    spec.channelnames = ("A", "Z", "Y")
    spec.deep = True
    data = oiio.DeepData()
    data.init(4, 3, "float", ("A", "Z", "Y"))
    data.set_samples(0, 1)
    output = oiio.ImageOutput.create("deep.exr")
    assert output is not None and output.open(str(tmp_path / "deep.exr"), spec)
    assert output.write_deep_image(data) and output.close()
    with pytest.raises(exr.JaxblurIOError, match="deep pixels; flatten the image first"):
        exr.read_image(tmp_path / "deep.exr")


def test_a_huge_header_does_not_take_the_memory(tmp_path):
    path = write_single(tmp_path / "a.exr", plain_frame())
    window = np.array([0, 0, 5, 3], "<i4").tobytes()
    huge = np.array([0, 0, 900_000, 900_000], "<i4").tobytes()
    path.write_bytes(path.read_bytes().replace(window, huge))
    with pytest.raises(exr.JaxblurIOError, match=r"a.exr: "):
        exr.read_frame(path)


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


def test_a_header_that_claims_more_than_the_file_can_hold_is_told_before_memory_is_taken(tmp_path):
    data = write_single(tmp_path / "a.exr", plain_frame((40, 50))).read_bytes()
    start = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    claimed = struct.pack("<4i", 0, 0, 3_000 - 1, 4_000 - 1)
    (tmp_path / "bomb.exr").write_bytes(data[:start] + claimed + data[start + 16 :])
    tracemalloc.start()
    for read in (exr.read_frame, exr.read_image, lambda path: exr.read_channels(path, ["B", "G"])):
        with pytest.raises(
            exr.JaxblurIOError, match=r"bomb.exr: .*claims 3000x4000 pixels, more than \d+ bytes"
        ):
            read(tmp_path / "bomb.exr")
    assert tracemalloc.get_traced_memory()[1] < 1e7
    tracemalloc.stop()
