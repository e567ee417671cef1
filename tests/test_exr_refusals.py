"""Files and arguments that are rejected: one clear error each, before memory is allocated."""

import re
import struct
import tracemalloc
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

from jaxblur import exr
from tests.command_line import refused
from tests.exr_files import CUBE, plain_frame, write_single
from tests.fuzz.make_corpus import CORPUS


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


def test_errors_for_missing_preset_arguments_name_the_file(tmp_path):
    path = write_single(tmp_path / "a.exr", plain_frame())
    for preset, message in (("arnold", "`file_shutter`"), ("vray", "`max_displace`")):
        with pytest.raises(exr.JaxblurIOError, match=f"a.exr: .*{message}"):
            exr.read_frame(path, preset, velocity_channels=["R", "G"])


def test_paths_that_are_not_images(tmp_path):
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


def test_a_huge_header_does_not_exhaust_memory(tmp_path):
    path = write_single(tmp_path / "a.exr", plain_frame())
    window = np.array([0, 0, 5, 3], "<i4").tobytes()
    huge = np.array([0, 0, 900_000, 900_000], "<i4").tobytes()
    path.write_bytes(path.read_bytes().replace(window, huge))
    with pytest.raises(exr.JaxblurIOError, match=r"a.exr: "):
        exr.read_frame(path)


def test_a_header_that_claims_more_than_the_file_can_hold_is_rejected_before_allocation(tmp_path):
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


@pytest.mark.parametrize("name", ["deep", "deep_empty", "deep_tiles"])
@pytest.mark.parametrize("extra", ["keep", "drop"])
def test_nothing_deep_is_written(tmp_path, name, extra):
    # OpenImageIO would store it with zips, whatever compression it is asked for.
    model = CORPUS / f"{name}.exr"
    part = exr.inspect(model).parts[0]
    assert part.deep
    image = np.zeros((part.data_window[3], part.data_window[2], 3), np.float32)
    with pytest.raises(exr.JaxblurIOError, match="deep"):
        exr.write_image(tmp_path / "out.exr", image, like=model, extra=extra)
    assert not list(tmp_path.iterdir())
    for command in ("blur", "blur --drop-extra"):
        words = refused(*command.split(), model, "-o", tmp_path / "out.exr")
        assert "deep pixels; flatten the image first" in words
