"""``jaxblur blur`` on sequences whose vectors no name identifies: measured on their frames."""

import re
import sys

import numpy as np
import pytest

from jaxblur import exr
from tests.command_line import refused, run
from tests.exr_files import write_single

SHAPE = (48, 64)
MOTION = (5.0, -3.0)
"""Pixels per frame, x right, y down."""
FEW = ("--filter", "guertin2014", "--samples", "3", "--radius", "8")


def write_shot(folder, names, encode, frames=(11, 12, 13), moving=True, depth="Z"):
    """Write frames of a smooth texture that moves as a whole; ``encode`` makes raw vectors."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    (folder / "out").mkdir()
    for frame in frames:
        shift = np.array(MOTION) * (frame if moving else 0)
        u, v = x - shift[0], y - shift[1]
        waves = [
            np.sin(u / 3.1 + v / 7.3),
            np.sin(u / 5.7 - v / 4.1),
            np.cos(u / 9.1) * np.sin(v / 3),
        ]
        channels = {name: 0.5 + 0.4 * wave for name, wave in zip("RGB", waves, strict=True)}
        channels[depth] = np.ones(SHAPE)
        for name, value in zip(names, encode(*MOTION), strict=True):
            channels[name] = np.full(SHAPE, value)
        single = {name: values.astype(np.float32) for name, values in channels.items()}
        write_single(folder / f"in.{frame}.exr", single)
    return ("blur", folder / "in.##.exr", "-o", folder / "out/a.##.exr", *FEW)


def settings(folder):
    return exr.inspect(folder / "out/a.11.exr").parts[0].attributes["jaxblur:settings"]


def said(outcome):
    lines = [line for line in outcome.err.splitlines() if "brings frame 12 onto 11" in line]
    assert len(lines) == 1, outcome.err
    return lines[0]


def fractions(x, y):
    return x / SHAPE[1], -y / SHAPE[0]


def test_fractions_under_the_name_of_pixels_are_recognized(tmp_path):
    command = write_shot(tmp_path, ("MotionVectors.R", "MotionVectors.G"), fractions)
    outcome = run(*command)
    assert outcome.status == 0, outcome.err
    assert (
        "vectors: unity for MotionVectors.R, MotionVectors.G (their names alone say redshift)"
        in said(outcome)
    )
    assert 'preset = "unity"' in settings(tmp_path)
    velocity = exr.read_buffers(tmp_path / "in.11.exr", "unity", 1.0).velocity
    np.testing.assert_allclose(velocity[0, 0], np.array(MOTION) / 2, rtol=1e-5)
    assert "3 kept" in run(*command).out
    assert "other parameters" in refused(*command, "--preset", "redshift")


def test_a_name_is_confirmed(tmp_path):
    command = write_shot(tmp_path, ("MotionVectors.R", "MotionVectors.G"), lambda x, y: (x, -y))
    outcome = run(*command)
    assert outcome.status == 0 and "redshift by name, and by measurement" in said(outcome)
    assert 'preset = "redshift"' in settings(tmp_path)


def test_vectors_over_the_shutter_need_no_option(tmp_path):
    names = ("motionvector.X", "motionvector.Y")
    command = write_shot(tmp_path, names, lambda x, y: (x / 2, -y / 2))
    outcome = run(*command)
    assert outcome.status == 0 and "arnold by name, and by measurement" in said(outcome)
    assert outcome.err.count("vectors: --file-shutter 0.5 (measured)") == 1
    found = settings(tmp_path)
    assert "file_shutter = 0.5" in found and "max_displace" not in found
    assert 'velocity_channels = "motionvector.X, motionvector.Y"' in found
    assert 'depth_channel = "Z"' in found
    written = exr.read_image(tmp_path / "out/a.11.exr")
    run(*command, "--preset", "arnold", "--file-shutter", "0.5", "--overwrite")
    np.testing.assert_array_equal(exr.read_image(tmp_path / "out/a.11.exr"), written)


@pytest.mark.parametrize("span", [0.25, 0.5, 0.4])
def test_the_span_of_the_file_is_measured_for_any_shutter(tmp_path, span):
    names = ("motionvector.X", "motionvector.Y")
    command = (*write_shot(tmp_path, names, lambda x, y: (x * span, -y * span)), "--dry-run")
    measured = re.compile(r"--file-shutter (\S+) \(measured\)")
    for shutter in ("0.75", "1"):
        outcome = run(*command, "--shutter", shutter)
        assert outcome.status == 0, outcome.err
        assert float(measured.findall(outcome.err)[0]) == pytest.approx(span, rel=0.05)


def test_a_wrong_span_is_named_and_used(tmp_path):
    names = ("motionvector.X", "motionvector.Y")
    command = write_shot(tmp_path, names, lambda x, y: (x / 2, -y / 2))
    outcome = run(*command, "--file-shutter", "0.25")
    assert outcome.status == 0
    assert "--file-shutter 0.25 is used as given, but they fit --file-shutter 0.5" in said(outcome)
    assert "file_shutter = 0.25" in settings(tmp_path)
    assert "3 kept" in run(*command, "--file-shutter", "0.25").out
    assert "other parameters" in refused(*command, "--file-shutter", "0.5")


def test_another_length_of_a_full_vector_is_noticed(tmp_path):
    names = ("velocity.R", "velocity.G")
    command = write_shot(tmp_path, names, lambda x, y: (0.5 + x / 64, 0.5 - y / 64))
    command = (*command, "--preset", "vray", "--depth", "z")
    assert run(*command, "--max-displace", "32").status == 0
    assert "max_displace = 32" in settings(tmp_path)
    assert "3 kept" in run(*command, "--max-displace", "32").out
    assert "other parameters" in refused(*command, "--max-displace", "64")


@pytest.mark.parametrize(
    ("names", "given"),
    [(("flow.u", "flow.v"), ()), (("odd.1", "odd.2"), ("--velocity-channels", "odd.1,odd.2"))],
)
def test_channels_that_identify_nothing_are_measured(tmp_path, names, given):
    command = write_shot(tmp_path, names, lambda x, y: (x, y))
    outcome = run(*command, *given)
    assert outcome.status == 0, outcome.err
    assert f"vectors: pixel for {', '.join(names)}: it brings" in said(outcome)


def test_chunks_of_a_sequence_agree(tmp_path):
    command = write_shot(tmp_path, ("MotionVectors.R", "MotionVectors.G"), fractions)
    assert "brings frame 12 onto 11" in run(*command, "--frames", "13").err
    assert "2 written, 1 kept" in run(*command).out


def test_frames_that_do_not_decide_leave_what_names_say_and_a_hint(tmp_path):
    names = ("MotionVectors.R", "MotionVectors.G")
    command = write_shot(tmp_path, names, fractions, moving=False)
    outcome = run(*command, "--max-displace", "32", "--file-shutter", "0.25")
    assert outcome.status == 0
    assert "does not show between frames 11 and 12; check it with: jaxblur vectors" in outcome.err
    assert "--max-displace 32 --shutter 0.25" in outcome.err
    assert 'preset = "redshift"' in settings(tmp_path)


def test_depth_is_read_as_the_names_say(tmp_path):
    names = ("forward.u", "forward.v")
    command = write_shot(tmp_path, names, fractions, depth="depth.Z")
    outcome = run(*command)
    assert outcome.status == 0 and "their names alone say nuke" in said(outcome)
    assert 'depth = "1/z"' in settings(tmp_path)


def test_verified_names_are_not_measured(tmp_path):
    command = write_shot(tmp_path, ("velocity.X", "velocity.Y"), lambda x, y: (x, y))
    assert "brings frame" not in run(*command).err


BLENDER = ("Vector.X", "Vector.Y", "Vector.Z", "Vector.W")


@pytest.mark.parametrize(
    ("names", "encode", "given", "words"),
    [
        (("mv.R", "mv.G"), lambda x, y: (x, y), ("uv",), "--preset uv is used as given, but they "),
        (("mv.R", "mv.G"), lambda x, y: (x, y), ("pixel",), None),
        (("mv.R", "mv.G"), fractions, ("pixel",), "but they fit --preset unity: it brings"),
        (("mv.R", "mv.G"), fractions, ("unity",), None),
        (BLENDER, lambda x, y: (-x, y, -x, y), ("blender",), None),
        (
            BLENDER,
            lambda x, y: (x, -y, x, -y),
            ("blender",),
            "but they fit --preset fusion --velocity-channels Vector.X,Vector.Y: it brings",
        ),
        (
            ("motionvector.X", "motionvector.Y"),
            lambda x, y: (x / 2, -y / 2),
            ("arnold", "--file-shutter", "0.5"),
            None,
        ),
        (
            ("motionvector.X", "motionvector.Y"),
            lambda x, y: (x / 2, -y / 2),
            ("arnold", "--file-shutter", "0.2"),
            "--file-shutter 0.2 is used as given, but they fit --file-shutter 0.5: at that",
        ),
    ],
)
def test_a_given_convention_is_used_and_a_better_one_named(tmp_path, names, encode, given, words):
    command = write_shot(tmp_path, names, encode)
    outcome = run(*command, "--preset", *given)
    assert outcome.status == 0
    assert f'preset = "{given[0]}"' in settings(tmp_path)
    if words is None:
        assert "brings" not in outcome.err
    else:
        assert words in said(outcome) and "warning: vectors: " in said(outcome)


def test_a_given_convention_is_compared_where_motion_leaves_signs_open(tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "MOTION", (5.0, 0.0))
    command = write_shot(tmp_path, ("mv.R", "mv.G"), lambda x, y: (x, y))
    line = said(run(*command, "--preset", "uv"))
    assert "but they fit another convention, see `jaxblur vectors " in line


def test_a_given_convention_that_frames_neither_confirm_nor_contradict(tmp_path):
    still = write_shot(tmp_path, ("mv.R", "mv.G"), lambda x, y: (x, y), moving=False)
    outcome = run(*still, "--preset", "uv")
    assert outcome.status == 0 and "brings" not in outcome.err
    assert "check it with" not in outcome.err
