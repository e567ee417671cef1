"""``jaxblur blur`` of several files into a folder."""

import pytest

from jaxblur import exr
from tests.command_line import refused, run
from tests.exr_files import plain_frame, write_single

FEW = ("--filter", "guertin2014", "--samples", "3", "--radius", "4")


@pytest.fixture
def frames(tmp_path):
    """Two frames and a damaged one between them."""
    files = [write_single(tmp_path / name, plain_frame()) for name in ("a.exr", "b.exr", "c.exr")]
    files[1].write_bytes(b"no picture")
    (tmp_path / "out").mkdir()
    return files


def test_each_becomes_a_file_of_its_name_and_a_bad_one_is_told(frames, tmp_path):
    outcome = run("blur", *frames, "-o", tmp_path / "out", *FEW, "--png")
    assert outcome.status == 1
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["a.exr", "a.png", "c.exr", "c.png"]
    assert "b.exr: cannot be opened" in outcome.err and "1 of 3 frames are not done" in outcome.err
    alone = tmp_path / "alone.exr"
    assert run("blur", frames[2], "-o", alone, *FEW).status == 0
    assert exr.read_image(alone).tolist() == exr.read_image(tmp_path / "out/c.exr").tolist()


def test_one_frame_goes_into_a_folder_too(frames, tmp_path):
    outcome = run("blur", frames[0], "-o", tmp_path / "out", *FEW)
    assert outcome.out.strip() == str(tmp_path / "out/a.exr")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("x/a.exr",), "out/a.exr: 2 inputs have that name"),
        (("in.####.exr",), "in.####.exr: is a pattern, and there are 4 inputs"),
        (("in.%V.exr",), "in.%V.exr: is a pattern, and there are 4 inputs"),
        (("--before", "z.exr"), "--before: is for one frame, and there are 3"),
        (("--frames", "1-2"), "--frames: is for a sequence; name the frames"),
        (("--cut", "1"), "--cut: is for sequences"),
        (("-o", "."), "is an input too"),
    ],
)
def test_what_several_frames_cannot_have(frames, tmp_path, monkeypatch, change, message):
    monkeypatch.chdir(tmp_path)
    given = ("a.exr", "b.exr", "c.exr", *change)
    assert message in refused("blur", *given, *(() if "-o" in change else ("-o", "out")), *FEW)
    assert not any((tmp_path / "out").iterdir())


def test_outputs_that_exist_stop_it_before_any_work(frames, tmp_path):
    (tmp_path / "out/c.exr").write_text("mine")
    assert "out/c.exr: exists; pass --overwrite" in refused(
        "blur", *frames, "-o", tmp_path / "out", *FEW
    )
    assert not (tmp_path / "out/a.exr").exists()
