"""The shutter of ``jaxblur blur``: position, times, curve, readout, in files and sequences."""

import tomllib

import numpy as np
import pytest

import jaxblur
from jaxblur import exr
from jaxblur.cli import shutter
from tests.command_line import refused, run
from tests.exr_files import write_single
from tests.helpers import slow

FEW = ("--samples", "9", "--radius", "16")
SETTINGS = jaxblur.Settings(samples=9, radius=16, fetch="bilinear")
SIZE = (20, 36)


def write_frame(path, time=0):
    """A square that moves to the right by 8 pixels a frame over a wall that is at rest."""
    row, column = np.indices(SIZE).astype(np.float32)
    square = (np.abs(column - 14 - 8 * time) < 4) & (np.abs(row - 10) < 6)
    channels = {name: np.where(square, 0.9, 0.2 + 0.01 * row) for name in "RGB"}
    channels |= {"Z": np.where(square, 1.0, 9.0)}
    channels |= {"velocity.X": np.where(square, 8.0, 0.0), "velocity.Y": np.zeros(SIZE)}
    write_single(path, {name: channel.astype(np.float32) for name, channel in channels.items()})
    return path


def blurred(tmp_path, *options):
    """The result of the options, and the settings that the file names."""
    frame, output = write_frame(tmp_path / "in.exr"), tmp_path / "out.exr"
    outcome = run("blur", frame, "-o", output, "--overwrite", *FEW, *options)
    assert outcome.status == 0, outcome.err
    notes = exr.inspect(output).parts[0].attributes["jaxblur:settings"]
    return exr.read_image(output), tomllib.loads(notes)


def in_python(tmp_path, exposure, length):
    frame = jaxblur.read_frame(write_frame(tmp_path / "in.exr"), shutter=length)
    parameters = jaxblur.LayeredParameters()
    return np.asarray(jaxblur.layered(frame, parameters, settings=SETTINGS, exposure=exposure))


def curve_file(tmp_path, text):
    (tmp_path / "curve.csv").write_text(text)
    return tmp_path / "curve.csv"


SHUTTER = jaxblur.Shutter
TRIANGLE = np.array([0, 1, 0], np.float32)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "exposure", "notes"),
    [
        (
            ("--shutter-position", "start"),
            SHUTTER(0.0, 2.0),
            {"shutter": 0.5, "shutter_open": 0, "shutter_close": 0.5, "shutter_curve": "box"},
        ),
        slow(
            ("--shutter-position", "end", "--shutter", "90deg"),
            SHUTTER(-2.0, 0.0),
            {"shutter": 0.25, "shutter_open": -0.25, "shutter_close": 0},
        ),
        (
            ("--shutter-open=-90deg", "--shutter-close", "0.5", "--shutter-curve", "triangle"),
            SHUTTER(-2 / 3, 4 / 3, TRIANGLE),
            {"shutter": 0.75, "shutter_open": -0.25, "shutter_curve": "triangle"},
        ),
        slow(
            ("--readout=-1/60s", "--fps", "30"),
            SHUTTER(readout=-2.0),
            {"readout": -0.5, "shutter_curve": "box"},
        ),
    ],
)
def test_options_are_the_shutter_of_python(tmp_path, options, exposure, notes):
    image, settings = blurred(tmp_path, *options)
    expected = in_python(tmp_path, exposure, settings["shutter"])
    np.testing.assert_allclose(image, expected, atol=1e-5)
    assert notes.items() <= settings.items()
    nominal, _ = blurred(tmp_path, "--shutter", f"{settings['shutter']}")
    assert np.abs(image - nominal).max() > 0.02


@pytest.mark.parametrize(
    ("text", "points"),
    [
        ("0\n1\n0\n", [0, 1, 0]),
        ("\ufefftransmission\n0\n\n0.5  # half\n1\n", [0, 0.5, 1]),
        ("time, weight\n0, 0\n0.5, 1\n1, 0\n", [0, 1, 0]),
        ("10;0\n20;3\n30;1", [0, 3, 1]),
        ("0\t2\n1\t2\n", [2, 2]),
    ],
)
def test_a_curve_from_a_file(tmp_path, text, points):
    path = curve_file(tmp_path, text)
    image, settings = blurred(tmp_path, "--shutter-curve", path)
    assert settings["shutter_points"] == points
    assert settings["shutter_curve"] == "curve.csv"
    expected = in_python(tmp_path, SHUTTER(curve=np.array(points, np.float32)), 0.5)
    np.testing.assert_allclose(image, expected, atol=1e-5)


def test_times_that_are_not_even_are_sampled(tmp_path):
    path = curve_file(tmp_path, "0 0\n1 1\n4 0\n")
    _, settings = blurred(tmp_path, "--shutter-curve", path)
    points = settings["shutter_points"]
    assert len(points) == 257
    np.testing.assert_allclose([points[k] for k in (0, 32, 64, 160, 256)], [0, 0.5, 1, 0.5, 0])


@pytest.mark.parametrize(
    "options",
    [
        ("--shutter-open=-0.125", "--shutter-close", "0.125"),
        ("--shutter", "0.25", "--shutter-position", "center", "--shutter-curve", "box"),
        ("--shutter", "0.25", "--readout", "0"),
    ],
)
def test_a_centered_box_is_the_length_alone(tmp_path, options):
    expected, _ = blurred(tmp_path, "--shutter", "0.25")
    image, settings = blurred(tmp_path, *options)
    np.testing.assert_array_equal(image, expected)
    assert settings["shutter"] == 0.25 and "shutter_open" not in settings
    # So every filter has it.
    blurred(tmp_path, *options, "--filter", "guertin2014")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--shutter-open", "0"), "--shutter-open: needs --shutter-close too"),
        (("--shutter-close", "0"), "--shutter-close: needs --shutter-open too"),
        (
            ("--shutter-open", "0", "--shutter-close", "1", "--shutter", "1"),
            "--shutter-open and --shutter-close say together when light comes in; leave --shutter ",
        ),
        (
            ("--shutter-open", "0", "--shutter-close", "1", "--shutter-position", "end"),
            "--shutter-position: --shutter-open and --shutter-close say",
        ),
        (("--shutter-open=-0.25", "--shutter", "0.5"), "leave --shutter out"),
        (("--shutter-open", "0.5", "--shutter-close", "0.5"), "--shutter-close: must be after"),
        (("--shutter-open", "-180", "--shutter-close", "0"), "-180deg is a shutter angle"),
        (("--shutter-curve", "triangel"), "no curve (did you mean triangle?) and no file"),
        (("--shutter", "0", "--readout", "1"), "--readout: --shutter 0 blurs nothing"),
        (
            ("--readout", "0.2", "--filter", "guertin2014"),
            "--readout: guertin2014 knows only a box centered on the frame",
        ),
        (("--shutter-position", "end", "--filter", "mcguire2012"), "or pass --filter layered"),
        (("--shutter-position", "end", "--plan", "auto"), "--shutter-position: --plan may"),
        (
            ("--shutter-curve", "triangle", "--subframes", "sub.####.exr"),
            "--shutter-curve: sub-frames are equal parts",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path, options, words):
    frame = write_frame(tmp_path / "in.exr")
    assert words in refused("blur", frame, "-o", tmp_path / "out.exr", *options)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1\nmany\n", "line 2 holds something else than numbers"),
        ("0.2x\n1\n0\n", "line 1 holds something else than numbers"),
        ("time, 1e-\n0, 1\n1, 1\n", "line 1 holds something else than numbers"),
        ("1\n", "a curve has 2 to 10000 points, one in each line; got 1"),
        ("a b\n", "got 0, since line 1 (a b) is taken as the names of the columns"),
        ("", "got 0"),
        ("0\n-1\n", "must not be negative"),
        ("0\n0\n", "not 0 everywhere"),
        ("0,1\n2\n", "line 2: expected a finite number"),
        ("0,1,2\n", "line 1: expected a finite number"),
        ("0\nnan\n", "line 2: expected a finite number"),
        ("0\n1e308\n1e308\n", "line 2: expected a finite number"),
        ("-1e308 0\n1e308 1\n", "line 1: expected a finite number"),
        ("0,1\n0,2\n", "times must increase"),
        ("1\n" * 10001, "got 10001"),
    ],
)
def test_a_file_that_holds_no_curve_is_refused(tmp_path, text, words):
    path = curve_file(tmp_path, text)
    frame = write_frame(tmp_path / "in.exr")
    message = refused("blur", frame, "-o", tmp_path / "out.exr", "--shutter-curve", path)
    assert words in message and "curve.csv" in message


def test_a_binary_file_is_no_curve(tmp_path):
    frame = write_frame(tmp_path / "in.exr")
    assert "is no text in UTF-8" in refused(
        "blur", frame, "-o", tmp_path / "out.exr", "--shutter-curve", frame
    )


def test_names_are_those_of_the_library():
    assert (shutter.CURVES, shutter.POSITIONS) == (
        jaxblur.shutter.CURVES,
        jaxblur.shutter.POSITIONS,
    )


@pytest.mark.slow
def test_the_radius_is_that_of_the_longest_time(tmp_path):
    frame = write_frame(tmp_path / "in.exr")
    options = ("--shutter", "2", "--shutter-position", "start", "-v", "--radius", "auto")
    outcome = run("blur", frame, "-o", tmp_path / "out.exr", *options)
    assert "for half-spreads up to 16.0 px" in outcome.err


@pytest.mark.slow
def test_sequences_respect_the_shutter_and_its_changes(tmp_path):
    for frame in (1, 2):
        write_frame(tmp_path / f"in.{frame:04d}.exr", frame)
    curve = curve_file(tmp_path, "0\n1\n0\n")
    names = (tmp_path / "in.####.exr", "-o", tmp_path / "out.####.exr")
    command = ("blur", *names, *FEW, "--neighbors", "off", "--noise", "none")
    options = ("--shutter-curve", curve, "--readout", "0.25")
    outcome = run(*command, *options)
    assert outcome.status == 0 and "2 written" in outcome.out, outcome
    for frame in (1, 2):
        read = jaxblur.read_frame(tmp_path / f"in.{frame:04d}.exr", shutter=0.5)
        expected = jaxblur.layered(
            *(read, jaxblur.LayeredParameters()),
            settings=jaxblur.Settings(samples=9, radius=16, fetch="bilinear", noise="none"),
            exposure=SHUTTER(curve=TRIANGLE, readout=1.0),
        )
        image = exr.read_image(tmp_path / f"out.{frame:04d}.exr")
        np.testing.assert_allclose(image, expected, atol=1e-5)
    # The same command keeps them, also if the curve has another name; another curve does not.
    same = curve.rename(tmp_path / "curve.csv")
    assert "2 kept" in run(*command, "--shutter-curve", same, "--readout", "90deg").out
    for changed in (
        ("--shutter-curve", same, "--readout", "0.3"),
        ("--shutter-curve", "box", "--readout", "0.25"),
    ):
        outcome = run(*command, *changed)
        assert outcome.status == 2 and "--overwrite" in outcome.err, outcome
    curve_file(tmp_path, "0\n2\n0\n1")
    assert run(*command, *options).status == 2


@pytest.mark.parametrize(
    ("options", "reach"),
    [
        (("--shutter", "720deg"), None),
        (("--shutter", "3frames"), "1.5"),
        slow(("--shutter-open", "0", "--shutter-close", "1.25"), "1.25"),
        slow(("--shutter", "720deg", "--readout", "0.5"), "1.25"),
    ],
)
def test_an_exposure_beyond_the_next_frame_warns(tmp_path, options, reach):
    frame = write_frame(tmp_path / "in.exr")
    error = run("blur", frame, "-o", tmp_path / "out.exr", *options).err
    expected = f"the exposure reaches {reach} frames from the frame, and vectors one"
    assert (expected in error) if reach else "exposure reaches" not in error
