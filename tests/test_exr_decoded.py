"""Pixels of a file are decoded once: for a frame, and for the copy that holds its blur."""

import numpy as np
import pytest

from jaxblur import exr
from jaxblur.exr import channels, convert, write_like
from tests.command_line import run
from tests.exr_files import plain_frame, write_single

SHAPE = (12, 16)
IMAGE = np.random.default_rng(2).random((*SHAPE, 3), np.float32)


@pytest.fixture
def decodings(monkeypatch):
    """Names of the modules that decoded whole parts, in turn."""
    found = []
    for module in (channels, write_like):
        read = module.read_span
        monkeypatch.setattr(
            module, "read_span", lambda *a, m=module, r=read: (found.append(m), r(*a))[1]
        )
    return found


@pytest.fixture
def source(tmp_path):
    """Color, depth, vectors and a further channel in one part."""
    return write_single(tmp_path / "a.exr", plain_frame(SHAPE) | {"mask": IMAGE[..., 0]})


def test_without_being_asked_nothing_is_kept(source):
    assert exr.read_buffers(source).decoded is None


@pytest.mark.parametrize("extra", ["keep", "drop"])
def test_a_part_that_was_read_is_not_decoded_again(tmp_path, source, decodings, extra):
    buffers = exr.read_buffers(source, keep_decoded=True)
    before = np.array(buffers.decoded)
    exr.write_image(tmp_path / "o.exr", IMAGE, source, extra=extra, decoded=buffers.decoded)
    assert decodings == [channels]
    np.testing.assert_array_equal(buffers.decoded, before)
    exr.write_image(tmp_path / "p.exr", IMAGE, source, extra=extra)
    assert (tmp_path / "o.exr").read_bytes() == (tmp_path / "p.exr").read_bytes()


def test_the_command_decodes_a_frame_once(tmp_path, source, decodings):
    assert run("blur", source, "-o", tmp_path / "o.exr", "--filter", "pixel_velocity").status == 0
    assert decodings == [channels]
    exr.write_image(tmp_path / "p.exr", exr.read_image(tmp_path / "o.exr"), source)
    for name in ("mask", "Z", "velocity.X"):
        ours, theirs = (exr.read_channels(tmp_path / p, [name]) for p in ("o.exr", "p.exr"))
        np.testing.assert_array_equal(ours, theirs)


def test_pixels_of_another_file_are_refused(tmp_path, source):
    with pytest.raises(ValueError, match=r"`decoded` must be .*\(12, 16, 7\), got \(12, 16, 3\)"):
        exr.write_image(tmp_path / "o.exr", IMAGE, source, decoded=IMAGE)
    assert not (tmp_path / "o.exr").exists()


def test_channels_far_apart_are_decoded_once_and_little_is_kept(tmp_path, monkeypatch):
    generator = np.random.default_rng(3)
    passes = {f"m{i}.value": generator.random(SHAPE, np.float32) for i in range(30)}
    frame = plain_frame(SHAPE)
    source = write_single(tmp_path / "a.exr", frame | passes)
    names = [channel.name for channel in exr.inspect(source).channels]
    assert names.index("velocity.X") - names.index("R") > 30
    blocks, rows = [], channels._read_rows
    monkeypatch.setattr(
        channels, "_read_rows", lambda *given: (blocks.append(given[2]), rows(*given))[1]
    )
    buffers = exr.read_buffers(source, keep_decoded=True)
    assert blocks == [0] and buffers.decoded is None
    stored = exr.read_channels(source, ["R", "G", "B"])
    np.testing.assert_array_equal(buffers.color, stored)
    np.testing.assert_array_equal(buffers.depth, exr.read_channels(source, ["Z"])[..., 0])
    moved = exr.read_channels(source, ["velocity.X", "velocity.Y"]) * np.float32(0.25)
    np.testing.assert_allclose(buffers.velocity, moved, rtol=1e-6)


@pytest.mark.parametrize("sides", [("",), ("previous.", "next.")])
def test_vectors_that_are_converted_in_blocks_are_the_same(tmp_path, monkeypatch, sides):
    generator = np.random.default_rng(4)
    frame = {k: v for k, v in plain_frame(SHAPE).items() if "velocity" not in k}
    for name in (f"velocity.{side}{axis}" for side in sides for axis in "XY"):
        frame[name] = np.float32(9) * generator.standard_normal(SHAPE, np.float32)
        frame[name][:4] = 0
    source = write_single(tmp_path / "a.exr", frame)
    monkeypatch.setattr(convert, "PIXELS_AT_ONCE", 50)
    few = exr.read_buffers(source)
    monkeypatch.setattr(convert, "PIXELS_AT_ONCE", 10**6)
    every = exr.read_buffers(source)
    np.testing.assert_array_equal(few.velocity, every.velocity)
    assert (few.path is None) == (len(sides) == 1)
    if every.path is not None:
        np.testing.assert_array_equal(few.path, every.path)
