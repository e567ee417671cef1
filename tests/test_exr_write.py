"""Writing images: what is taken over from the file given as ``like``, and how values are stored."""

import os
import stat

import numpy as np
import OpenImageIO as oiio
import pytest

import jaxblur
from jaxblur import exr
from jaxblur.exr.header import relabel_as_uint
from jaxblur.exr.notes import described
from tests.exr_files import (
    CAR,
    CUBE,
    make_spec,
    plain_frame,
    read_raw,
    read_stored,
    write_parts,
    write_single,
)


def any_bits(shape, dtype, seed):
    """Make values of arbitrary bits, among them NaN payloads, denormals and infinities."""
    unsigned = {"float16": np.uint16, "float32": np.uint32}[dtype]
    generator = np.random.default_rng(seed)
    return generator.integers(0, np.iinfo(unsigned).max, shape, unsigned).view(dtype)


def assert_same_bits(first, second):
    assert first.dtype == second.dtype
    np.testing.assert_array_equal(
        np.ascontiguousarray(first).view(np.uint8), np.ascontiguousarray(second).view(np.uint8)
    )


def test_color_is_replaced_and_everything_else_is_copied(tmp_path):
    image = exr.read_image(CUBE) * np.float32(0.5)
    exr.write_image(tmp_path / "out.exr", image, like=CUBE, attributes={"jaxblur:version": "9.9"})
    np.testing.assert_allclose(exr.read_image(tmp_path / "out.exr"), image, rtol=1e-3)
    for part in range(5):
        before, pixels = read_raw(CUBE, part)
        after, written = read_raw(tmp_path / "out.exr", part)
        assert before.channelnames == after.channelnames and str(before.format) == str(after.format)
        assert before.get_string_attribute("name") == after.get_string_attribute("name")
        if part:
            assert_same_bits(pixels, written)
    first = exr.inspect(tmp_path / "out.exr").parts[0].attributes
    assert first["jaxblur:version"] == "9.9"
    kept = {"Frame": "11", "Camera": "Cam", "colorInteropID": "lin_rec709_scene"}
    assert kept.items() <= first.items()


def test_mixed_types_of_one_part_keep_their_bits(tmp_path):
    shape = (9, 7)
    generator = np.random.default_rng(2)
    color = {c: generator.random(shape, np.float32) for c in "RGBA"}
    spec = make_spec(
        {**color, "Z": color["R"], "crypto00.R": color["R"], "mask": color["R"], "id": color["R"]},
        types=["half"] * 4 + ["float", "float", "half", "float"],
    )
    bits = any_bits(shape, "float32", 3)
    data = {
        **color,
        "Z": color["G"] + 1,
        "crypto00.R": bits,
        "mask": any_bits(shape, "float16", 4).astype(np.float32),
        "id": any_bits(shape, "float32", 5),
    }
    with np.errstate(invalid="ignore"):
        source = write_parts(tmp_path / "in.exr", [(spec, data)])
    relabel_as_uint(str(source), 0, ["id"])
    info = exr.inspect(source)
    assert {c.name: c.type for c in info.channels}["id"] == "uint"

    image = np.full((*shape, 4), 0.25, np.float32)
    with pytest.warns(
        exr.JaxblurIOWarning, match=r"NaN or infinity in .*mask \(\d pixels\), copied"
    ):
        exr.write_image(tmp_path / "out.exr", image, like=source)
    after = exr.inspect(tmp_path / "out.exr")
    assert [(c.name, c.type) for c in after.channels] == [(c.name, c.type) for c in info.channels]
    for name, kind in (("Z", "float"), ("crypto00.R", "float"), ("mask", "half"), ("id", "uint")):
        stored = [read_stored(path, name, kind) for path in (source, tmp_path / "out.exr")]
        assert_same_bits(*stored)
    written = exr.read_channels(tmp_path / "out.exr", ["R", "G", "B", "A"])
    np.testing.assert_array_equal(written, image)


def test_integer_identifiers_are_exact_where_openimageio_alone_rounds_them(tmp_path):
    ids = np.array([[0, 1, 2**24 + 1, 2**31 + 3, 2**32 - 1]], np.uint32)
    plain = {c: np.zeros((1, 5), np.float32) for c in "RGB"} | {"id": ids.view(np.float32)}
    source = write_single(tmp_path / "in.exr", plain, types=["half"] * 3 + ["float"])
    relabel_as_uint(str(source), 0, ["id"])
    exr.write_image(tmp_path / "out.exr", np.ones((1, 5, 3)), like=source)
    np.testing.assert_array_equal(read_stored(tmp_path / "out.exr", "id", "uint"), ids)


def test_windows_timecode_and_metadata_survive(tmp_path):
    channels = plain_frame((8, 10))
    spec = make_spec(
        channels, origin=(-3, -2), display=(0, 0, 4, 5), studio__artist="somebody", studio__shot=17
    )
    spec.attribute("PixelAspectRatio", 1.5)
    spec.attribute("smpte:TimeCode", oiio.TypeTimeCode, (0x01020304, 7))
    spec.attribute("worldToCamera", oiio.TypeMatrix, tuple(float(i) for i in range(16)))
    source = write_parts(tmp_path / "in.exr", [(spec, channels)])
    exr.write_image(tmp_path / "out.exr", exr.read_image(source) + 1, like=source)
    before, after = (exr.inspect(p).parts[0] for p in (source, tmp_path / "out.exr"))
    assert after.data_window == before.data_window == (-3, -2, 10, 8)
    assert after.display_window == before.display_window == (0, 0, 4, 5)
    names = ("studio:artist", "studio:shot", "PixelAspectRatio", "smpte:TimeCode", "worldToCamera")
    assert all(name in before.attributes for name in names)
    for name in names:
        np.testing.assert_array_equal(after.attributes[name], before.attributes[name])
    pair = zip(exr.read_image(tmp_path / "out.exr"), exr.read_image(source) + 1, strict=True)
    for row, expected in pair:
        np.testing.assert_array_equal(row, expected)


def test_names_and_values_in_a_local_encoding_survive(tmp_path):
    channels = plain_frame() | {"extra": plain_frame()["R"], "ident": plain_frame()["R"]}
    source = write_single(tmp_path / "in.exr", channels, madeby="xxxxxxxx")
    data = source.read_bytes().replace(b"xxxxxxxx", b"xxx\xe9xxxx")
    source.write_bytes(data.replace(b"extra", b"extr\xe9").replace(b"ident", b"id\xe9nt"))
    relabel_as_uint(str(source), 0, ["id\udce9nt"])
    exr.write_image(tmp_path / "out.exr", np.ones((4, 6, 3)), like=source)
    for path in (source, tmp_path / "out.exr"):
        info = exr.inspect(path)
        assert {"extr\\xe9", "id\\xe9nt"} < set(info.channel_names)
        assert info.channel("id\\xe9nt").type == "uint"
        assert info.parts[0].attributes["madeby"] == "xxx\\xe9xxxx"
    written = exr.read_channels(tmp_path / "out.exr", ["extr\\xe9"])
    np.testing.assert_array_equal(written[..., 0], channels["extra"])


@pytest.mark.parametrize(
    ("given", "written"),
    [("none", "none"), ("rle", "rle"), ("piz", "piz"), ("zips", "zips"), ("dwaa:45", "zip")],
)
def test_compression_is_kept_where_it_is_lossless(tmp_path, given, written):
    source = write_single(tmp_path / "in.exr", plain_frame(), compression=given)
    exr.write_image(tmp_path / "out.exr", np.ones((4, 6, 3)), like=source)
    assert exr.inspect(tmp_path / "out.exr").parts[0].compression == written


def test_extra_channels_are_dropped_on_request(tmp_path):
    image = exr.read_image(CUBE)
    exr.write_image(tmp_path / "out.exr", image, like=CUBE, extra="drop")
    info = exr.inspect(tmp_path / "out.exr")
    assert info.channel_names == tuple(f"ViewLayer.Combined.{c}" for c in "RGBA")
    assert info.parts[0].attributes["Software"] == "Blender 5.0.1"
    np.testing.assert_array_equal(exr.read_image(tmp_path / "out.exr"), image)


def test_the_type_of_the_color_can_be_chosen(tmp_path):
    image = np.full((112, 160, 4), 1 / 3, np.float32)
    exr.write_image(tmp_path / "out.exr", image, like=CUBE, dtype="float")
    info = exr.inspect(tmp_path / "out.exr")
    assert {c.type for c in info.parts[0].channels} == {"float"}
    np.testing.assert_array_equal(exr.read_image(tmp_path / "out.exr"), image)


def test_values_beyond_half_are_clamped_and_counted(tmp_path):
    image = np.zeros((2, 3, 3), np.float32)
    image[0, 0], image[1, 1, 0] = 1e6, -70000
    with pytest.warns(exr.JaxblurIOWarning, match="4 values beyond 65504 were clamped"):
        exr.write_image(tmp_path / "out.exr", image)
    written = exr.read_image(tmp_path / "out.exr")
    assert written[0, 0].tolist() == [65504] * 3 and written[1, 1, 0] == -65504
    exr.write_image(tmp_path / "float.exr", image, dtype="float")
    np.testing.assert_array_equal(exr.read_image(tmp_path / "float.exr"), image)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7])
def test_images_without_a_model(tmp_path, count):
    image = np.random.default_rng(0).random((3, 5, count)).astype(np.float16).astype(np.float32)
    exr.write_image(tmp_path / "out.exr", image)
    names = {1: "Y", 2: "YA", 3: "RGB", 4: "RGBA"}.get(count)
    names = list(names) if names else [f"channel{i}" for i in range(count)]
    assert sorted(exr.inspect(tmp_path / "out.exr").channel_names) == sorted(names)
    np.testing.assert_array_equal(exr.read_channels(tmp_path / "out.exr", names), image)


@pytest.mark.parametrize("curved", [False, True])
def test_frames_survive_writing_and_reading(tmp_path, curved):
    frame = exr.read_frame(CAR, shutter=0.5)
    if not curved:
        frame = jaxblur.Frame(frame.color, frame.depth, frame.velocity)
    exr.write_frame(tmp_path / "out.exr", frame, 0.5, attributes={"jaxblur:shutter": 0.5})
    again = exr.read_frame(tmp_path / "out.exr", shutter=0.5)
    np.testing.assert_array_equal(again.color, frame.color)
    np.testing.assert_array_equal(again.depth, frame.depth)
    np.testing.assert_allclose(again.velocity, frame.velocity, atol=1e-5)
    assert (again.path is not None) == curved
    if again.path is not None and frame.path is not None:
        np.testing.assert_allclose(again.path, frame.path, atol=1e-5)
    longer = exr.read_frame(tmp_path / "out.exr", shutter=1.0)
    np.testing.assert_allclose(longer.velocity, 2 * np.asarray(frame.velocity), atol=1e-4)
    with pytest.raises(ValueError, match="`shutter` must be above 0"):
        exr.write_frame(tmp_path / "zero.exr", frame, 0)


def test_the_time_of_writing_is_not_stored(tmp_path):
    """The same input gives the same bytes, whether the model has a date or not."""
    channels = plain_frame()
    exr.write_channels(tmp_path / "undated.exr", channels)
    undated = (tmp_path / "undated.exr").read_bytes()
    assert b"capDate" not in undated
    dated = write_single(tmp_path / "dated.exr", channels).read_bytes()
    stamp = dated[dated.index(b"capDate") :][:40]
    for name in ("undated", "dated"):
        image = exr.read_image(tmp_path / f"{name}.exr")
        exr.write_image(tmp_path / "out.exr", image, like=tmp_path / f"{name}.exr")
        written = (tmp_path / "out.exr").read_bytes()
        assert stamp in written if name == "dated" else b"capDate" not in written
    exr.write_image(tmp_path / "alone.exr", image)
    assert b"capDate" not in (tmp_path / "alone.exr").read_bytes()


def test_permissions_follow_the_umask(tmp_path):
    old = os.umask(0o027)
    try:
        exr.write_image(tmp_path / "out.exr", np.ones((2, 2, 3)))
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "out.exr").stat().st_mode) == 0o640
    assert [path.name for path in tmp_path.iterdir()] == ["out.exr"]


@pytest.mark.parametrize("text", ["a photo", "[1]", "[" * 100_000, '{"R": 1, "jaxblur:x": [2]}'])
def test_descriptions_that_hold_no_metadata_of_jaxblur(text):
    assert described({"ImageDescription": text}) == {}


def test_bits_are_for_pictures(tmp_path):
    with pytest.raises(ValueError, match="`bits` is for pictures; give `dtype`"):
        exr.write_image(tmp_path / "a.exr", np.ones((4, 6, 3)), bits=16)


def test_alpha_stays_in_a_tif_of_floats_alone(tmp_path):
    image = np.random.default_rng(0).random((4, 6, 4), np.float32) * 3 - 1
    exr.write_image(tmp_path / "a.tif", image, attributes={"jaxblur:version": "1"})
    np.testing.assert_array_equal(exr.read_image(tmp_path / "a.tif"), image)
    info = exr.inspect(tmp_path / "a.tif")
    assert info.parts[0].attributes["jaxblur:version"] == "1"
    assert info.channel_names == ("R", "G", "B", "A")
    exr.write_image(tmp_path / "a.tif", image, bits=8)
    assert exr.inspect(tmp_path / "a.tif").channel_names == ("R", "G", "B")


def mip_mapped(path):
    """Write color, depth and vectors of 64x48 pixels with all smaller levels; return them."""
    channels = plain_frame((48, 64))
    spec = make_spec(channels, comment="kept")
    spec.tile_width = spec.tile_height = 16
    picture = oiio.ImageBuf(spec)
    picture.set_pixels(oiio.ROI(0, 64, 0, 48), np.stack(list(channels.values()), axis=-1))
    assert oiio.ImageBufAlgo.make_texture(oiio.MakeTxTexture, picture, str(path))
    return channels


def test_a_mip_mapped_model_gives_its_first_level_without_the_others(tmp_path):
    channels = mip_mapped(tmp_path / "in.exr")
    info = exr.inspect(tmp_path / "in.exr")
    assert info.parts[0].levels == 7
    color = np.stack([channels[name] for name in "RGB"], axis=-1)
    np.testing.assert_array_equal(exr.read_image(tmp_path / "in.exr"), color)
    with pytest.warns(exr.JaxblurIOWarning, match=r"in.exr: its level 0 of 7 is used") as caught:
        exr.write_image(tmp_path / "out.exr", color * 2, like=tmp_path / "in.exr")
    assert len(caught) == 1
    written = exr.inspect(tmp_path / "out.exr").parts[0]
    assert written.levels == 1 and written.attributes["comment"] == "kept"
    assert written.data_window == info.parts[0].data_window
    np.testing.assert_array_equal(exr.read_image(tmp_path / "out.exr"), color * 2)
    kept = exr.read_channels(tmp_path / "out.exr", ["Z", "velocity.X"])
    np.testing.assert_array_equal(kept, np.stack([channels["Z"], channels["velocity.X"]], axis=-1))
