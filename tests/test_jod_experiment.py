"""Experiment 020: clips of a scene are judged, and a fit on JOD descends."""

import importlib
import re

import pytest

run = importlib.import_module("experiments.020_jod.run")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def clip():
    return run.shot("crossing", (36, 64), 2)


def test_a_blurred_clip_is_nearer_to_the_truth_than_a_sharp_one(clip):
    rows = {name: scores for name, _, *scores in run.judge_filters([clip])}
    assert list(rows) == list(run.filters())
    sharp, blurred = (dict(zip(run.SCORES, rows[n], strict=True)) for n in ("unblurred", "layered"))
    assert blurred["JOD"] > sharp["JOD"] + 0.2 and blurred["PSNR"] > sharp["PSNR"] + 3
    assert blurred["FLIP"] < sharp["FLIP"]
    assert all(scores[0] < 10 for scores in rows.values())


def test_the_noise_is_fixed_or_animated(clip):
    labels = [label for label, *_ in run.judge_noise([clip])]
    assert labels == ["none", "ign, fixed", "ign, animated", "halton, fixed", "halton, animated"]


def test_a_fit_on_jod_descends(clip, capsys):
    found = run.fit([clip], "jod", 3)
    losses = [float(text) for text in re.findall(r"step [0-9]: ([0-9.]+)", capsys.readouterr().out)]
    assert len(losses) == 3 and losses[2] < losses[0]
    assert float(found.kappa) != 40 and float(found.gamma) == 1.5
