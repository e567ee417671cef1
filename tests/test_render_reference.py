"""The parts of the Blender script that need no Blender: its command line and its outputs."""

import argparse
import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

pytestmark = pytest.mark.slow

SCRIPT = Path(__file__).parents[1] / "experiments" / "blender" / "render_reference.py"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("render_reference", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("text", "frames"),
    [("7", [7]), ("10-12", [10, 11, 12]), ("3, 1-2,2", [3, 1, 2]), ("-2--1", [-2, -1])],
)
def test_frames_are_listed_once_and_in_order(script, text, frames):
    assert script.parse_frames(text) == frames


@pytest.mark.parametrize("text", ["", "1-", "a", "1,,2", "1.5"])
def test_unreadable_frames_are_refused(script, text):
    with pytest.raises(argparse.ArgumentTypeError, match="expected frames"):
        script.parse_frames(text)


def test_a_backward_range_is_refused(script):
    with pytest.raises(argparse.ArgumentTypeError, match=r"12-10.*backwards"):
        script.parse_frames("12-10")


def test_arguments_follow_the_double_dash_in_blender_only(script):
    blender = ["blender", "-b", "a.blend", "-P", "script.py", "--", "--out", "there"]
    assert script.script_arguments(blender) == ["--out", "there"]
    assert script.script_arguments(["script.py", "a.blend"]) == ["a.blend"]


def test_a_full_command_line_is_read(script, tmp_path):
    blend = tmp_path / "scene.blend"
    blend.touch()
    options = script.parse_arguments(
        f"{blend} --out {tmp_path} --frames 4-5 --size 64x32 --shutter 0.25 --samples 8".split()
    )
    assert (options.blend, options.out, options.frames) == (blend, tmp_path, [4, 5])
    assert (options.size, options.shutter, options.samples) == ((64, 32), 0.25, 8)
    assert options.shutter_curve == "box"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--frames 1", "--out"),
        ("--out there --size 64", "expected WIDTHxHEIGHT"),
        ("--out there --size 0x9", "expected WIDTHxHEIGHT"),
        ("--out there --shutter 0", "above 0 and at most 2"),
        ("--out there --shutter nan", "above 0 and at most 2"),
        ("--out there --samples 0", "at least 1"),
        ("nowhere.blend --out there", "nowhere.blend is not a file"),
        (f"--out {SCRIPT}", "is not a folder"),
    ],
)
def test_wrong_arguments_exit_with_one_reason(script, capsys, arguments, message):
    with pytest.raises(SystemExit, match="2"):
        script.parse_arguments(arguments.split())
    assert message in capsys.readouterr().err


def test_finished_frames_are_not_replaced_unasked(script, tmp_path):
    options = script.parse_arguments(["--out", str(tmp_path)])
    script.refuse_existing(options, [3])
    script.outputs(tmp_path, 3)["truth"].touch()
    with pytest.raises(SystemExit, match=r"truth_0003\.exr exists; add --overwrite"):
        script.refuse_existing(options, [3])
    script.refuse_existing(script.parse_arguments(["--out", str(tmp_path), "--overwrite"]), [3])


def test_an_overlay_puts_dependent_settings_back(script):
    class Image:
        """Like Blender's: a new media type resets the file format."""

        def __init__(self):
            self._media, self.file_format = "IMAGE", "PNG"

        @property
        def media(self):
            return self._media

        @media.setter
        def media(self, value):
            self._media = value
            self.file_format = "MULTILAYER" if value == "MULTI" else "JPEG"

    image = Image()
    with script.Overlay() as overlay:
        overlay.set(image, media="MULTI", file_format="MULTILAYER")
        overlay.set(image, file_format="MULTILAYER")
        with script.Overlay() as inner:
            inner.set(image, media="MULTI")
        assert (image.media, image.file_format) == ("MULTI", "MULTILAYER")
    assert (image.media, image.file_format) == ("IMAGE", "PNG")


def test_an_overlay_remembers_copies_of_vectors(script):
    class Point:
        def __init__(self):
            self._location = [0.0, 0.2]

        __hash__ = object.__hash__

        @property
        def location(self):
            return self._location

        @location.setter
        def location(self, value):
            self._location[:] = value

    point = Point()
    with script.Overlay() as overlay:
        overlay.set(point, location=(0.0, 1.0))
        assert point.location == [0.0, 1.0]
    assert point.location == [0.0, 0.2]
