"""``jaxblur bench``."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import jaxblur
from jaxblur import bench, exr
from jaxblur.cli.commands.bench import OTHERS
from tests.command_line import refused, run
from tests.helpers import random_frame

pytestmark = pytest.mark.slow

SHAPE = (24, 32)
SMALL = ("--scene", "crossing", "--size", "64x36", "--truth-samples", "4", "--samples", "5,9")
METHOD = ("--methods", "pixel_velocity,unblurred", "--repeats", "3")


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Results of the command on a small scene."""
    path = tmp_path_factory.mktemp("bench") / "results.csv"
    outcome = run("bench", *SMALL, *METHOD, "-o", path, "--table", path.with_suffix(".md"))
    assert outcome.status == 0, outcome.err
    assert outcome.out == path.with_suffix(".md").read_text(encoding="utf-8")
    assert "| crossing 64x36 | front of |" in outcome.out
    return path


def test_the_command_measures_and_goes_on_where_it_stopped(measured):
    rows = bench.read_rows(measured)
    assert [r["samples"] for r in rows] == ["5", "9", ""]
    before = measured.read_bytes()
    bench.write_rows(measured, rows[:1])
    outcome = run("bench", *SMALL, *METHOD, "-o", measured)
    assert outcome.status == 0 and "N=5" not in outcome.err and "N=9" in outcome.err
    assert [r.identity for r in bench.read_rows(measured)] == [r.identity for r in rows]
    measured.write_bytes(before)
    assert run("bench", *SMALL, *METHOD, "-o", measured).err == ""


def test_the_guard_fails_where_a_case_became_slower(measured, tmp_path):
    quicker, now = tmp_path / "old.csv", tmp_path / "now.csv"
    # Without the noise of this machine, which can be larger than any difference.
    rows = [
        dataclasses.replace(row, figures=dataclasses.replace(row.figures, ms_iqr=0.0))
        for row in bench.read_rows(measured)
    ]
    bench.write_rows(now, rows)
    ms: Any = rows[1].figures.ms
    figures = dataclasses.replace(rows[1].figures, ms=ms / 100)
    bench.write_rows(quicker, [rows[0], dataclasses.replace(rows[1], figures=figures)])
    guard = ("bench", "--compare", quicker, "--repeats", "3", "-o")
    # Measures the scene of the older file again: what its file holds already.
    outcome = run(*guard, now)
    assert outcome.status == 1, outcome.out
    verdicts = [line.split()[-1] for line in outcome.out.splitlines()[-2:]]
    assert verdicts == ["same", "slower"]
    same = run("bench", *SMALL, *METHOD, "-o", now, "--compare", quicker, "--tolerance", "1e5")
    assert same.status == 0 and same.out.splitlines()[-1].split()[-1] == "same"


def test_the_command_takes_frames_with_their_truth(tmp_path):
    frame = random_frame(SHAPE, sky=0.0)
    blurred = jaxblur.pixel_velocity(frame, None, settings=jaxblur.Settings(samples=5, radius=40))
    exr.write_frame(tmp_path / "frame.exr", frame, shutter=0.5)
    exr.write_image(tmp_path / "truth.exr", np.asarray(blurred))
    options = ("--samples", "5", "--methods", "pixel_velocity", "--repeats", "3")
    path = tmp_path / "out.csv"
    files = (tmp_path / "frame.exr", "--truth", tmp_path / "truth.exr")
    outcome = run("bench", *files, *options, "-o", path)
    assert outcome.status == 0, outcome.err
    (result,) = bench.read_rows(path)
    assert result["scene"] == "frame.exr" and str(tmp_path) not in path.read_text(encoding="utf-8")
    # Stored as half: 11 bits.
    psnr: Any = result.figures.psnr
    assert psnr > 60
    # What the older file holds of the frame, not the whole grid.
    guard = ("bench", "--compare", path, "-o", tmp_path / "now.csv", "--repeats", "3")
    outcome = run(*guard, *files, "--tolerance", "1e5")
    assert outcome.status == 0, outcome.err
    assert outcome.out.splitlines()[-1].split()[-1] == "same"
    (again,) = bench.read_rows(tmp_path / "now.csv")
    assert again.identity == result.identity
    message = refused(*guard, *files, "--samples", "9")
    assert "out.csv: holds no requested case of frame.exr" in message


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-o", "x.csv"), "give frames, --scene NAME, or --compare OLD.csv"),
        (("--scene", "crossing", "-o", "x.txt"), "x.txt: results are CSV"),
        (("--scene", "crossed", "-o", "x.csv"), "no scene 'crossed' (did you mean crossing?)"),
        (("--scene", "crossing", "-o", "x.csv", "--methods", "gertin"), "did you mean guertin2014"),
        (("--scene", "crossing", "-o", "x.csv", "--truth", "t.exr"), "--truth: 1 for 0 frames"),
        (("--compare", "x.csv", "-o", "x.csv"), "would be compared with itself"),
        (("--scene", "crossing", "-o", "no/x.csv"), "no folder no"),
    ],
)
def test_mistakes_are_told(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert message in refused("bench", *arguments)


def test_the_command_knows_every_method_that_is_no_filter():
    assert OTHERS == (bench.UNBLURRED, *bench.RENDERERS)
