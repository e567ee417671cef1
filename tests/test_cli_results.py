"""``blur --result`` leaves what ``report`` reads."""

import shutil
from pathlib import Path

import numpy as np

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


def test_a_frame_without_a_truth_becomes_a_page_with_its_motion_and_time(tmp_path):
    folder, page = tmp_path / "result", tmp_path / "page.html"
    command = ("blur", FRAME, "-o", tmp_path / "out.exr", "--result", folder, *OPTIONS)
    outcome = run(*command)
    assert outcome.status == 0 and "PSNR" not in outcome.out
    (shot,) = read_result(folder).shots
    sharp, blurred = shot.pictures
    assert shot.truth is None and (sharp.scores, blurred.scores) == ({}, {})
    assert sharp.milliseconds is None and (blurred.milliseconds or 0) > 0
    expected = exr.read_buffers(FRAME, shutter=0.5).velocity
    np.testing.assert_allclose(np.asarray(shot.velocity), expected, rtol=1e-3, atol=1e-4)
    assert set(shot.hashes) == {FRAME.name}
    assert run("report", folder, "-o", page).status == 0
    assert f"<title>{FRAME.name} blurred</title>" in page.read_text(encoding="utf-8")


def test_a_view_of_a_result_without_a_truth_is_that_of_its_pictures(tmp_path):
    view = "ACES 2.0 - SDR 100 nits (Rec.709)"
    command = ("blur", FRAME, "-o", tmp_path / "out.exr", "--result", tmp_path / "r", *OPTIONS)
    assert run(*command, "--view", view).status == 0
    result = read_result(tmp_path / "r")
    assert result.settings["view"] == view
    assert np.asarray(result.shots[0].pictures[0].image).max() <= 1.001


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
    assert all((shot.pictures[1].milliseconds or 0) > 0 for shot in written.shots)
    again = run(*command)
    assert again.status == 0 and "2 kept" in again.out, "a result changes no output"
    kept = read_result(tmp_path / "result").shots
    assert [shot.name for shot in kept] == ["frame 1", "frame 2"]
    assert [shot.pictures[1].milliseconds for shot in kept] == [None, None], "not blurred now"


def test_a_result_that_cannot_be_is_refused_before_any_work(tmp_path):
    (tmp_path / "file").write_text("")
    output = tmp_path / "out.exr"
    line = refused("blur", FRAME, "-o", output, "--result", tmp_path / "file" / "result")
    assert "is not a folder" in line and not output.exists()
