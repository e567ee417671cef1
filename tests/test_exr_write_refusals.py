"""Writing images: what is refused, reported or dropped, and failures that leave nothing behind."""

import contextlib
import dataclasses
import os
import pathlib
import re
import shutil
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import OpenImageIO as oiio
import pytest

from jaxblur import exr
from jaxblur.exr import listing, output, write_like
from tests.exr_files import (
    CUBE,
    make_spec,
    plain_frame,
    write_parts,
    write_single,
)


def files(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def writers(monkeypatch):
    """Replaces a method of the writers of OpenImageIO by a function of writer and file."""

    def replace(step, function):
        class Replaced:
            def __init__(self, path):
                self.path, self.output = path, create(path)

            def __getattr__(self, name):
                if name == step:
                    return lambda *_: function(self.output, self.path)
                return getattr(self.output, name)

        create = oiio.ImageOutput.create
        monkeypatch.setattr(output.oiio, "ImageOutput", SimpleNamespace(create=Replaced))

    return replace


@pytest.mark.parametrize("step", ["open", "write_image", "close"])
def test_a_failing_write_leaves_the_old_file_and_nothing_else(tmp_path, writers, step):
    path = tmp_path / "out.exr"
    exr.write_image(path, np.ones((2, 2, 3)))
    before = path.read_bytes()
    writers(step, lambda *_: False)
    with pytest.raises(exr.JaxblurIOError, match=r"out.exr: cannot be written"):
        exr.write_image(path, np.zeros((2, 2, 3)))
    assert path.read_bytes() == before
    assert files(tmp_path) == ["out.exr"]


@pytest.mark.parametrize("kind", ["exr", "png", "tif"])
def test_a_full_disk_is_told_in_one_way(tmp_path, monkeypatch, writers, kind):
    free = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: free)
    writers("write_image", lambda *_: False)
    message = r"the disk is full: it needs up to \d{6} bytes, and 1\d{3} are free; free some space"
    with pytest.raises(exr.JaxblurIOError, match=message):
        exr.write_image(tmp_path / f"out.{kind}", np.ones((2, 2, 3)))
    assert files(tmp_path) == []


def test_a_png_that_lost_bytes_in_its_middle_is_rejected(tmp_path, writers):
    """As when the disk is full for a moment: the writer goes on, and reports success."""

    def lossy(output, path):
        assert output.close()
        file = pathlib.Path(path)
        data = file.read_bytes()
        file.write_bytes(data[:2000] + data[3000:])
        return True

    writers("close", lossy)
    image = np.random.default_rng(0).random((40, 60, 3), np.float32)
    with pytest.raises(exr.JaxblurIOError, match=r"bytes are missing; is the disk full, or a"):
        exr.write_image(tmp_path / "out.png", image)
    assert files(tmp_path) == []


def test_a_failing_sync_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "out.exr"
    exr.write_image(path, np.ones((2, 2, 3)))
    before = path.read_bytes()

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(exr.JaxblurIOError, match="written, the disk is full; free some space"):
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
    with pytest.raises(
        exr.JaxblurIOError, match=r"needs up to 180072 bytes, and 1000 are free; free"
    ):
        exr.write_image(tmp_path / "a.jpg", np.ones((4, 6, 3)))
    assert files(tmp_path) == ["a.png"]
    monkeypatch.undo()
    for count in (59_980, 59_990):
        text = {"jaxblur:x": "z" * count}
        fits = count == 59_980
        with contextlib.nullcontext() if fits else pytest.raises(exr.JaxblurIOError, match="holds"):
            exr.write_image(tmp_path / "a.jpg", np.ones((4, 6, 3)), attributes=text)
    assert len(str(exr.inspect(tmp_path / "a.jpg").parts[0].attributes["jaxblur:x"])) == 59_980


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
        ("zero", "written as 0 (depth as infinity)", 0),
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
