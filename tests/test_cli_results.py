"""``blur --result`` leaves what ``report`` reads."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from jaxblur import exr
from jaxblur.report import read_result

from .command_line import refused, run

DATA = Path(__file__).parent / "data"
FRAME = DATA / "cube_over_crates_frame_0011.exr"
TRUTH = DATA / "cube_over_crates_truth_0011.exr"
OPTIONS = ("--filter", "pixel_velocity", "--samples", 5, "--radius", "auto")


def test_a_frame_with_its_truth_becomes_a_page(tmp_path):
    folder, page = tmp_path / "result", tmp_path / "page.html"
    outcome = run(
        *("blur", FRAME, "-o", tmp_path / "out.exr", "--truth", TRUTH, "--result", folder),
        *OPTIONS,
    )
    assert outcome.status == 0, outcome.err
    (shot,) = read_result(folder).shots
    sharp, blurred = shot.pictures
    assert (sharp.method, blurred.method) == ("input", "pixel_velocity")
    np.testing.assert_array_equal(blurred.image, exr.read_image(tmp_path / "out.exr")[..., :3])
    assert f"{blurred.scores['psnr']:.2f}" in outcome.out
    assert (blurred.settings["samples"], blurred.settings["radius"]) == (5, 20)
    assert set(shot.hashes) == {FRAME.name, TRUTH.name}
    assert run("report", folder, "-o", page).status == 0
    assert FRAME.name in page.read_text(encoding="utf-8")


def test_a_sequence_becomes_a_shot_for_each_frame(tmp_path):
    for number in (1, 2):
        shutil.copy(FRAME, tmp_path / f"in.{number:04d}.exr")
        shutil.copy(TRUTH, tmp_path / f"truth.{number:04d}.exr")
    command = (
        *("blur", tmp_path / "in.####.exr", "-o", tmp_path / "out.####.exr", *OPTIONS),
        *("--truth", tmp_path / "truth.####.exr", "--result", tmp_path / "result"),
    )
    made = run(*command)
    assert made.status == 0 and made.err.count("color: ") == 1, "not once more for the result"
    assert "mean   pixel_velocity" in made.out
    written = read_result(tmp_path / "result")
    assert [shot.name for shot in written.shots] == ["frame 1", "frame 2"]
    assert written.shots[1].pictures[1].settings["radius"] == 20
    again = run(*command)
    assert again.status == 0 and "2 kept" in again.out, "a result changes no output"
    assert [shot.name for shot in read_result(tmp_path / "result").shots] == ["frame 1", "frame 2"]


@pytest.mark.parametrize(
    ("folder", "more", "message"),
    [
        ("result", (), "--result: needs --truth"),
        ("file/result", ("--truth", TRUTH), "is not a folder"),
    ],
)
def test_a_result_that_cannot_be_is_refused_before_any_work(tmp_path, folder, more, message):
    (tmp_path / "file").write_text("")
    output = tmp_path / "out.exr"
    line = refused("blur", FRAME, "-o", output, "--result", tmp_path / folder, *more)
    assert message in line and not output.exists()
