"""The result file: what is written is read, and nothing else is."""

import dataclasses
import math
import os
import re
import subprocess
import sys
import tomllib

import pytest

import jaxblur
from jaxblur.exr import JaxblurIOError
from jaxblur.fitting import FilterChoice, load_choice
from jaxblur.fitting.result import SCHEMA, Data, FitResult, Score, Sensitivity, to_toml

pytestmark = pytest.mark.slow

RESULT = FitResult(
    filter="mcguire2012",
    parameters={"soft_z_extent": 0.25},
    initial={"soft_z_extent": 1.0},
    published={"soft_z_extent": 0.1},
    free=("soft_z_extent",),
    minimized="mse error",
    objective={"loss": "mean", "noise_draws": 2},
    settings=dataclasses.asdict(jaxblur.McGuireSettings()),
    notes={"shutter": 0.5, "preset": "blender"},
    steps=2,
    interrupted=False,
    history={"loss": (0.5, 1e-17), "soft_z_extent": (1.0, 0.25)},
    scores=(
        Score("a", "train", "fitted", "whole", 0.1, 0.2, math.inf, 1.0, 0.0),
        Score("b", "train", "fitted", "whole", 0.3, 0.2, 30.0, 1.0, 0.0),
    ),
    sensitivity=Sensitivity(
        names=("soft_z_extent",),
        standard_error=(math.inf,),
        relative_error=(0.5,),
        correlation=((1.0,),),
        curvature=((-3e-5,),),
        flags=('±50 %: "quoted" \\ back\x7f\n',),
        blocks=3,
    ),
    data=(Data('odd "name" ü \U0001f600.exr', "train", "00ff"),),
    versions={"jax": "0.10.2"},
)


def test_round_trip(tmp_path):
    path = tmp_path / "fitted.toml"
    RESULT.save(path)
    assert FitResult.load(path) == RESULT
    assert tomllib.loads(path.read_text(encoding="utf-8"))["schema"] == SCHEMA
    assert [entry.name for entry in tmp_path.iterdir()] == ["fitted.toml"]


def test_a_result_prints_as_one_short_line():
    assert repr(RESULT) == (
        "<FitResult mcguire2012: soft_z_extent=0.25; fitted soft_z_extent; "
        "loss 0.5 to 1e-17 in 2 steps>"
    )
    more = {"interrupted": True, "warnings": ("a", "b"), "history": {}}
    line = str(dataclasses.replace(RESULT, **more))
    assert line.endswith("fitted soft_z_extent; interrupted; see 2 in .warnings>")


def test_an_interrupted_result_has_neither_scores_nor_sensitivity(tmp_path):
    partial = dataclasses.replace(RESULT, scores=(), sensitivity=None, interrupted=True)
    partial.save(tmp_path / "fitted.toml")
    assert FitResult.load(tmp_path / "fitted.toml") == partial


def test_what_a_filter_takes():
    assert RESULT.filter_parameters == jaxblur.McGuireParameters(soft_z_extent=0.25)
    assert RESULT.filter_settings == jaxblur.McGuireSettings()


def test_mean_scores():
    assert math.isclose(RESULT.mean_score("mse", "train", "fitted"), 0.2)
    assert math.isnan(RESULT.mean_score("mse", "held-out", "fitted"))


def test_a_choice_without_a_fit(tmp_path):
    path = tmp_path / "copied.toml"
    text = 'schema = 1\nfilter = "mcguire2012"\n[parameters]\nsoft_z_extent = 2\n[settings]\n'
    path.write_text(text + "samples = 9\n")
    choice = load_choice(path)
    assert type(choice) is FilterChoice
    assert choice.filter_parameters == jaxblur.McGuireParameters(soft_z_extent=2.0)
    # Settings that are not in the file are those of the filter.
    assert choice.filter_settings == jaxblur.McGuireSettings(samples=9)
    RESULT.save(tmp_path / "fitted.toml")
    assert load_choice(tmp_path / "fitted.toml") == RESULT
    with pytest.raises(ValueError, match=rf"{path}: missing key '\w+'; write the file again"):
        FitResult.load(path)
    path.write_text(text.replace("[settings]", ""))
    with pytest.raises(ValueError, match=rf"{path}: missing key 'settings'"):
        load_choice(path)
    path.write_text(text.replace("[parameters]", "steps = 3\n[parameters]"))
    with pytest.raises(ValueError, match=rf"{path}: missing key"):
        load_choice(path)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("schema = 1", "schema = 2", "'schema' must be 1, got 2"),
        ("schema = 1", "", "'schema' must be 1, got None"),
        ("steps = 2", "steps = 2\nspeed = 3", "unknown key 'speed'"),
        ("blocks = 3", "blocks = 3\nblock = 3", "unknown key 'sensitivity.block'"),
        ("flip = 0.0", "flip = 0.0\nflop = 1.0", r"unknown key 'scores\[0\].flop'"),
        ("steps = 2", "", "missing key 'steps'"),
        ("steps = 2", 'steps = "2"', "'steps' must be int, got '2'"),
        ("interrupted = false", "interrupted = 0", "'interrupted' must be bool, got 0"),
        ("loss = [0.5, 1e-17]", "loss = 0.5", "'history.loss' must be list, got 0.5"),
        ("soft_z_extent = 0.25", "soft_z_extent = true", "'parameters.soft_z_extent' must be"),
        ("steps = 2", "steps = ", "is not TOML"),
        (
            "soft_z_extent = 0.25",
            "soft_z_extend = 0.25",
            r"unknown key 'parameters.soft_z_extend' \(did you mean soft_z_extent\?\); mcguire2012",
        ),
        ("soft_z_extent = 0.25", "soft_z_extent = 0", "'parameters.soft_z_extent' must be above 0"),
    ],
)
def test_a_changed_file_is_refused_by_name_and_key(tmp_path, old, new, match):
    path = tmp_path / "fitted.toml"
    RESULT.save(path)
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ValueError, match=rf"{re.escape(str(path))}: .*{match}"):
        FitResult.load(path)


def test_only_a_file_is_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reasons = {tmp_path: "is a folder", tmp_path / "pipe": "is not a file"}
    for path, reason in (reasons | {tmp_path / "none.toml": "no such file"}).items():
        with pytest.raises(JaxblurIOError, match=f"{path}: {reason}; give a file that"):
            FitResult.load(path)


def test_whole_numbers_are_read_as_floats(tmp_path):
    path = tmp_path / "fitted.toml"
    RESULT.save(path)
    path.write_text(path.read_text(encoding="utf-8").replace("= 0.25", "= 3"), encoding="utf-8")
    value = FitResult.load(path).parameters["soft_z_extent"]
    assert value == 3 and isinstance(value, float)


def test_nested_tables_and_odd_keys():
    table = {"a b": {"x": 1, "deep": [{"y": True}, {"y": False}]}, "top": "t", "empty": []}
    assert tomllib.loads(to_toml(table)) == table


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "fitted.toml"
    path.write_text("old")
    broken = dataclasses.replace(RESULT, minimized="\ud800")
    with pytest.raises(UnicodeEncodeError):
        broken.save(path)
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["fitted.toml"]
    with pytest.raises(JaxblurIOError, match="cannot be written"):
        RESULT.save(tmp_path / "missing" / "fitted.toml")


def test_a_result_is_read_without_jax(tmp_path):
    path = tmp_path / "fitted.toml"
    RESULT.save(path)
    code = (
        "import sys; from jaxblur.fitting import FitResult; "
        f"print(FitResult.load({str(path)!r}).filter, 'jax' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["mcguire2012", "False"]
