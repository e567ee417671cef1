"""Writing images: contents kept from the model file, and files that are complete or absent."""

import contextlib
import dataclasses
import os
import re
import shutil
import stat
from typing import Any, Literal

import numpy as np
import OpenImageIO as oiio
import pytest

import jaxblur
from jaxblur import exr
from jaxblur.exr import listing, output, write_like
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


def files(folder):
    return sorted(path.name for path in folder.iterdir())


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
    assert files(tmp_path) == ["out.exr"]


@pytest.mark.parametrize("step", ["open", "write_image", "close"])
def test_a_failing_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, step):
    path = tmp_path / "out.exr"
    exr.write_image(path, np.ones((2, 2, 3)))
    before = path.read_bytes()

    class Failing:
        def __init__(self, output):
            self.output = output

        def __getattr__(self, name):
            if name == step:
                return lambda *_: False
            return getattr(self.output, name)

    create = oiio.ImageOutput.create
    outputs = type("Outputs", (), {"create": staticmethod(lambda p: Failing(create(p)))})
    monkeypatch.setattr(output.oiio, "ImageOutput", outputs)
    with pytest.raises(exr.JaxblurIOError, match=r"out.exr: cannot be written"):
        exr.write_image(path, np.zeros((2, 2, 3)))
    assert path.read_bytes() == before
    assert files(tmp_path) == ["out.exr"]


def test_a_failing_sync_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "out.exr"
    exr.write_image(path, np.ones((2, 2, 3)))
    before = path.read_bytes()

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(exr.JaxblurIOError, match="cannot be written: No space left on device"):
        exr.write_image(path, np.zeros((2, 2, 3)))
    assert path.read_bytes() == before
    assert files(tmp_path) == ["out.exr"]


def test_a_damaged_model_leaves_nothing_behind(tmp_path):
    whole = CUBE.read_bytes()
    cut = tmp_path / "cut.exr"
    cut.write_bytes(whole[: int(0.9 * len(whole))])
    image = exr.read_image(cut)
    with pytest.raises(exr.JaxblurIOError, match=r"cut.exr cannot be copied"):
        exr.write_image(tmp_path / "out.exr", image, like=cut)
    assert files(tmp_path) == ["cut.exr"]


def test_inputs_are_never_overwritten(tmp_path):
    source = write_single(tmp_path / "in.exr", plain_frame())
    (tmp_path / "alias.exr").symlink_to(source)
    before = source.read_bytes()
    for name in ("in.exr", "alias.exr", "../" + tmp_path.name + "/in.exr"):
        with pytest.raises(exr.JaxblurIOError, match="is an input too; write to another file"):
            exr.write_image(tmp_path / name, np.ones((4, 6, 3)), like=source)
    exr.refuse_overwrite(tmp_path / "new.exr", source)
    assert source.read_bytes() == before


def test_refusals(tmp_path):
    source = write_single(tmp_path / "in.exr", plain_frame())
    good = np.ones((4, 6, 3), np.float32)
    bad = good.copy()
    bad[1, 1, 1] = np.nan
    (tmp_path / "folder.exr").mkdir()
    io_errors: list[tuple[str, np.ndarray, dict[str, Any], str]] = [
        ("out.exr", bad, {}, "1 values of the image are NaN or infinite; nothing was written"),
        ("out.gif", good, {}, "can write .exr, .png, .tif, .tiff, .jpg, .jpeg only"),
        ("missing/out.exr", good, {}, "cannot be written: No such file or directory"),
        ("folder.exr", good, {}, "is a folder"),
        ("out.exr", good[:3], {"like": source}, "image has 6x3 pixels and 3 channels, but .* 6x4"),
        ("out.exr", np.ones((4, 6, 4)), {"like": source}, "4 channels, but .* and R, G, B"),
        ("out.exr", good, {"like": tmp_path / "no.exr"}, "no.exr: no such file"),
    ]
    for name, image, options, message in io_errors:
        with pytest.raises(exr.JaxblurIOError, match=message):
            exr.write_image(tmp_path / name, image, **options)
    with pytest.raises(ValueError, match="`extra` must be keep or drop"):
        exr.write_image(tmp_path / "a.exr", good, extra="all")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="`image` must have shape"):
        exr.write_image(tmp_path / "a.exr", good[..., 0])
    with pytest.raises(ValueError, match="`channels` must be arrays of one"):
        exr.write_channels(tmp_path / "a.exr", {"R": good[..., 0], "G": good[:2, :, 0]})
    assert files(tmp_path) == ["folder.exr", "in.exr"]


def test_a_jpeg_that_the_disk_may_not_hold_is_not_begun(tmp_path, monkeypatch):
    # libjpeg would end the process.
    free = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: free)
    exr.write_image(tmp_path / "a.png", np.ones((4, 6, 3)))
    with pytest.raises(exr.JaxblurIOError, match=r"needs up to 180072 bytes, .* has 1000; free"):
        exr.write_image(tmp_path / "a.jpg", np.ones((4, 6, 3)))
    assert files(tmp_path) == ["a.png"]
    monkeypatch.undo()
    for count in (59_980, 59_990):
        text = {"jaxblur:x": "z" * count}
        fits = count == 59_980
        with contextlib.nullcontext() if fits else pytest.raises(exr.JaxblurIOError, match="holds"):
            exr.write_image(tmp_path / "a.jpg", np.ones((4, 6, 3)), attributes=text)
    assert len(str(exr.inspect(tmp_path / "a.jpg").parts[0].attributes["jaxblur:x"])) == 59_980


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


def test_a_png_cannot_be_the_model(tmp_path):
    exr.write_image(tmp_path / "a.png", np.ones((4, 6, 3)))
    with pytest.raises(exr.JaxblurIOError, match=r"a.png: `like` must be an .exr file"):
        exr.write_image(tmp_path / "out.exr", np.ones((4, 6, 3)), like=tmp_path / "a.png")
    assert files(tmp_path) == ["a.png"]


@pytest.mark.parametrize("parts", [1, 2])
def test_nan_in_channels_that_are_copied_is_reported_and_set_to_zero_on_request(tmp_path, parts):
    channels = plain_frame()
    channels["velocity.X"][1, 2] = np.nan
    channels["velocity.Y"][0, 0] = -np.inf
    channels["Z"][3, 3] = np.inf
    channels["Z"][2, 1] = np.nan
    color = {name: channels.pop(name) for name in "RGB"}
    source = tmp_path / "in.exr"
    if parts == 1:
        write_single(source, color | channels)
    else:
        specs = [make_spec(color, name="rgb"), make_spec(channels, name="data")]
        write_parts(source, [(specs[0], color), (specs[1], channels)])
    prefix = "" if parts == 1 else "data."
    names = ", ".join(f"{prefix}{name} (1 pixels)" for name in ("Z", "velocity.X", "velocity.Y"))
    image = np.full((4, 6, 3), 0.5, np.float32)
    policies: tuple[tuple[Literal["keep", "zero"], str, float], ...] = (
        ("keep", "copied as they are", np.nan),
        ("zero", "set to 0 (depth to infinity)", 0),
    )
    for policy, words, value in policies:
        out = tmp_path / f"{policy}.exr"
        # A part of its own is kept as it is stored, without a look at it.
        looks = parts == 1 or policy == "zero"
        report = pytest.warns(exr.JaxblurIOWarning, match=re.escape(f"{names}, {words}"))
        with report if looks else contextlib.nullcontext():
            exr.write_image(out, image, like=source, nonfinite=policy)
        stored = exr.read_channels(out, [f"{prefix}velocity.X", f"{prefix}Z"])
        np.testing.assert_equal(stored[1, 2, 0], np.float32(value))
        assert np.isposinf(stored[3, 3, 1]), "the sky stays"
        np.testing.assert_equal(stored[2, 1, 1], np.float32(np.inf if policy == "zero" else np.nan))
        good = np.isfinite(channels["velocity.X"])
        np.testing.assert_array_equal(stored[..., 0][good], channels["velocity.X"][good])


def test_an_existing_file_stays_if_it_must_not_be_replaced(tmp_path):
    path = tmp_path / "out.exr"
    exr.write_image(path, np.zeros((2, 3, 3), np.float32))
    before = path.read_bytes()
    with pytest.raises(exr.JaxblurIOError, match=r"out.exr: exists; pass overwrite=True"):
        exr.write_image(path, np.ones((2, 3, 3), np.float32), overwrite=False)
    assert path.read_bytes() == before
    exr.write_image(path, np.ones((2, 3, 3), np.float32))
    assert (exr.read_image(path) == 1).all()


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


def test_compression_that_the_library_cannot_write_is_reported(tmp_path, monkeypatch):
    source = write_single(tmp_path / "in.exr", plain_frame(), compression="piz")
    writer = write_like.writer

    def without_piz(path, temporary, specs, finish=None):
        others = [oiio.ImageSpec(spec) for spec in specs]
        for spec in others:
            spec.attribute("compression", "zips")
        return writer(path, temporary, others, finish)

    monkeypatch.setattr(write_like, "writer", without_piz)
    with pytest.warns(exr.JaxblurIOWarning, match=r"in.exr: part 0 is stored with zips, .* piz"):
        exr.write_image(tmp_path / "out.exr", np.ones((4, 6, 3)), like=source)


def test_a_deep_part_beside_the_picture_is_dropped_or_refused(tmp_path, monkeypatch):
    frame = plain_frame()
    smoke = {"smoke.A": frame["R"], "smoke.Z": frame["Z"]}
    parts = [(make_spec(frame, name="rgb"), frame), (make_spec(smoke, name="smoke"), smoke)]
    source, describe = write_parts(tmp_path / "in.exr", parts), listing.describe

    def with_a_deep_part(*arguments):
        # OpenImageIO cannot write such a file for this test.
        info = describe(*arguments)
        flat, deep = info.parts
        return dataclasses.replace(info, parts=(flat, dataclasses.replace(deep, deep=True)))

    monkeypatch.setattr(write_like, "describe", with_a_deep_part)
    with pytest.raises(exr.JaxblurIOError, match=r"part 1 of .*in.exr is deep.*extra='drop'"):
        exr.write_image(tmp_path / "out.exr", np.ones((4, 6, 3)), like=source)
    exr.write_image(tmp_path / "out.exr", np.ones((4, 6, 3)), like=source, extra="drop")
    assert exr.inspect(tmp_path / "out.exr").channel_names == ("R", "G", "B")


def test_parts_of_one_name_are_refused_by_that_name(tmp_path):
    frame = plain_frame()
    data = {"other.A": frame["R"]}
    parts = [(make_spec(frame, name="one"), frame), (make_spec(data, name="two"), data)]
    source = write_parts(tmp_path / "in.exr", parts)
    source.write_bytes(source.read_bytes().replace(b"\3\0\0\0two", b"\3\0\0\0one"))
    assert [part.name for part in exr.inspect(source).parts] == ["one", "one"]
    words = r"2 parts of .*in.exr are named 'one'.*extra='drop'"
    with pytest.raises(exr.JaxblurIOError, match=words):
        exr.write_image(tmp_path / "out.exr", np.ones((4, 6, 3)), like=source)
    assert not (tmp_path / "out.exr").exists()
    exr.write_image(tmp_path / "out.exr", np.ones((4, 6, 3)), like=source, extra="drop")
    assert len(exr.inspect(tmp_path / "out.exr").parts) == 1


def test_an_image_that_overflowed_names_the_file_that_it_was_made_from(tmp_path):
    source = write_single(tmp_path / "in.exr", plain_frame())
    image = np.full((4, 6, 3), np.inf)
    with pytest.raises(exr.JaxblurIOError, match=r"72 values of the image.*in.exr, is the color"):
        exr.write_image(tmp_path / "out.exr", image, like=source)
