"""Exposures in frames, degrees and seconds, and vectors that move nothing."""

import numpy as np
import pytest

from jaxblur import exr
from tests.command_line import refused, run
from tests.exr_files import CAR, plain_frame, write_single

FAST = ("--filter", "pixel_velocity")


def blurred(tmp_path, *options):
    output = tmp_path / "out.exr"
    outcome = run("blur", CAR, "-o", output, "--overwrite", *FAST, *options)
    assert outcome.status == 0, outcome.err
    return exr.read_image(output), exr.inspect(output).parts[0].attributes["jaxblur:settings"]


@pytest.mark.parametrize(
    ("options", "frames"),
    [
        (("--shutter", "172.8deg"), 0.48),
        (("--shutter", "1/48s", "--fps", "24"), 0.5),
        (("--shutter", "0.02s", "--fps", "25"), 0.5),
        (("--shutter", "3frames"), 3.0),
        (("--shutter", "2"), 2.0),
        (("--shutter", "1/2"), 0.5),
    ],
)
def test_every_form_is_the_same_exposure(tmp_path, options, frames):
    image, settings = blurred(tmp_path, *options)
    assert f"shutter = {frames}" in settings
    expected, _ = blurred(tmp_path, "--shutter", f"{frames}frames")
    np.testing.assert_array_equal(image, expected)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--shutter", "180"), "180deg is a shutter angle, 0.5 frames; pass 180frames"),
        (("--shutter", "1/48s"), "--shutter: 0.0208333 s is how many frames? Pass --fps"),
        (("--shutter", "1/48"), "1/48s with --fps is a shutter speed in seconds; pass 0.0208 if"),
        (("--shutter", "1/0s"), "expected an exposure"),
        (("--shutter", "nan"), "expected an exposure"),
        (("--shutter", "half"), "expected an exposure"),
        (("--shutter", "5weeks"), "expected an exposure"),
        (("--shutter", "0.5", "--fps", "24"), "--fps: is for exposures in seconds"),
        (("--file-shutter", "360"), "360deg is a shutter angle"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path, options, words):
    assert words in refused("blur", CAR, "-o", tmp_path / "out.exr", *options)
    assert words in refused("info", CAR, *options)


def frame_with_vectors(tmp_path, scale):
    channels = plain_frame((16, 16))
    for axis in "XY":
        channels[f"velocity.{axis}"] = np.full((16, 16), scale, np.float32)
    return write_single(tmp_path / "in.exr", channels)


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        (0.0, "all vectors are zero; check that the pass was rendered."),
        (0.01, "such values can be fractions of the frame: try --preset uv, ndc or unity"),
        (1.3, "the longest half-spread is 0.46 px: check --preset and --shutter"),
    ],
)
def test_vectors_that_move_nothing_are_told(tmp_path, scale, words):
    frame = frame_with_vectors(tmp_path, scale)
    command = ("blur", frame, "-o", tmp_path / "out.exr", *FAST)
    assert words in refused(*command, "--require-motion")
    assert not (tmp_path / "out.exr").exists()
    outcome = run(*command)
    assert outcome.status == 0
    assert f"warning: {frame}: nothing moves, so nothing is blurred; " in outcome.err
    assert words in outcome.err


@pytest.mark.parametrize(
    ("scale", "more", "words"),
    [
        (0.0, (), "all vectors are zero; check that the pass was rendered."),
        (4.0, ("--shutter", "0"), "the exposure is 0; check --shutter"),
        (4.0, (), None),
    ],
)
def test_a_dry_run_tells_that_nothing_moves(tmp_path, scale, more, words):
    frame = frame_with_vectors(tmp_path, scale)
    planned = run("blur", frame, "-o", tmp_path / "out.exr", *FAST, *more, "--dry-run")
    assert planned.status == 0 and "write" in planned.out
    frame = frame.rename(tmp_path / "in.0007.exr")
    names = (tmp_path / "in.####.exr", "-o", tmp_path / "out.####.exr")
    sequence = run("blur", *names, *FAST, *more, "--dry-run")
    assert sequence.status == 0 and "1 blur" in sequence.out
    for outcome in (planned, sequence):
        assert ("nothing moves, so nothing is blurred" in outcome.err) == (words is not None)
        assert words is None or words in outcome.err
    frame.write_bytes(frame.read_bytes()[:400])
    damaged = run("blur", *names, *FAST, *more, "--dry-run")
    assert damaged.status == 0 and "1 blur" in damaged.out
    assert not list(tmp_path.glob("out*"))


def test_motion_is_not_told(tmp_path):
    frame = frame_with_vectors(tmp_path, 4.0)
    outcome = run("blur", frame, "-o", tmp_path / "out.exr", *FAST, "--require-motion")
    assert outcome.status == 0 and "nothing moves" not in outcome.err
    closed = run("blur", frame, "-o", tmp_path / "2.exr", *FAST, "--shutter", "0")
    assert closed.status == 0 and "nothing moves" not in closed.err


def test_motion_cannot_be_required_of_a_closed_shutter(tmp_path):
    out = tmp_path / "out.exr"
    words = refused("blur", CAR, "-o", out, "--shutter", "0", "--require-motion")
    assert "--require-motion: at --shutter 0 nothing moves" in words and not out.exists()
    names = CAR.parent / "cube_over_crates_frame_####.exr", tmp_path / "out.####.exr"
    words = refused("blur", names[0], "-o", names[1], "--shutter", "0deg", "--require-motion")
    assert "--require-motion" in words and not list(tmp_path.iterdir())
