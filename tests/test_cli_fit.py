"""``jaxblur fit``, and ``jaxblur blur --parameters`` with what it wrote."""

import pathlib
import re
import tomllib

import numpy as np
import pytest

import jaxblur
from jaxblur import exr
from jaxblur.cli.arguments import CommandError
from jaxblur.cli.commands.fit import held_out
from jaxblur.fitting import STAGES
from tests.command_line import refused, run, spawn
from tests.exr_files import CAR, CUBE, DATA, plain_frame, write_single

pytestmark = pytest.mark.slow

SMALL = ("--crop", "48x32+60+40", "--samples", "5", "--radius", "20", "--steps", "3")


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A fit of a small part of one frame, with another held out."""
    out = tmp_path_factory.mktemp("fit") / "fitted.toml"
    outcome = run(
        *("fit", CAR, CUBE, "--truth", DATA / "cube_over_crates_truth_0011.exr"),
        *(DATA / "sky_car_truth_0011.exr", "--holdout", "sky_car*", "-o", out),
        *("--free", "kappa,depth_sharpness", "--param", "gamma=2", *SMALL),
    )
    assert outcome.status == 0, outcome
    return out, outcome


def test_it_fits_reports_and_writes(fitted):
    out, outcome = fitted
    result = jaxblur.FitResult.load(out)
    assert result.steps == 3 and result.free == ("kappa", "depth_sharpness")
    assert [(d.name.rpartition("/")[2], d.part) for d in result.data] == [
        (CUBE.name, "train"),
        (CAR.name, "held-out"),
    ]
    assert result.settings["samples"] == 5 and result.notes["preset"] == "blender"
    assert result.parameters["gamma"] == 2 and result.published["gamma"] == 1.5
    assert result.history["loss"][-1] < result.history["loss"][0]
    assert f"{out}\n" in outcome.out
    for words in ("held-out", "default", "± standard error", "held"):
        assert words in outcome.out
    stages = [name for name in STAGES if name != "Newton steps"]
    assert f"starting; stages: {', '.join(STAGES)}\n" in outcome.err
    said = [outcome.err.index(f"jaxblur: {stage}\n") for stage in stages]
    assert said == sorted(said), "each stage is announced as it begins"
    assert all(outcome.err.count(f"jaxblur: {stage}\n") == 1 for stage in stages)
    assert result.sensitivity is not None
    rows = {line.split()[0]: line for line in outcome.out.splitlines() if line}
    for name in result.free:
        assert ("not determined" in rows[name]) == (name in result.sensitivity.undetermined)
    for warning in result.warnings:
        assert f"warning: {warning}" in outcome.err
    for step in (1, 2, 3):
        assert f"step {step}/3 loss" in outcome.err
    assert "minimized: mse error expected over the random outcomes" in outcome.err
    assert [entry.name for entry in out.parent.iterdir()] == ["fitted.toml"], "no state is left"


def test_blur_uses_filter_parameters_and_settings_and_options_override(fitted, tmp_path):
    result = jaxblur.FitResult.load(fitted[0])
    first, second = tmp_path / "first.exr", tmp_path / "second.exr"
    assert run("blur", CAR, "-o", first, "--parameters", fitted[0]).status == 0
    expected = jaxblur.guertin2014(
        jaxblur.read_frame(CAR), result.filter_parameters, settings=result.filter_settings
    )
    half = np.asarray(expected).astype(np.float16).astype(np.float32)
    np.testing.assert_array_equal(exr.read_image(first), half)

    overrides = ("--param", "kappa=5", "--samples", "7")
    outcome = run("blur", CAR, "-o", second, "--parameters", fitted[0], *overrides)
    assert outcome.status == 0
    attributes = exr.inspect(second).parts[0].attributes
    parameters = tomllib.loads(attributes["jaxblur:parameters"])
    assert parameters == result.parameters | {"kappa": 5}
    settings = tomllib.loads(attributes["jaxblur:settings"])
    assert (settings["samples"], settings["radius"]) == (7, 20)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('filter = "guertin2014"', 'filter = "box"', "'filter' must be one of guertin2014"),
        ("schema = 1", "schema = 9", "must be 1, got 9"),
        ("gamma = 2.0", "gamma = -2.0", "'parameters.gamma' must be above 0 px, got -2"),
        ("steps = 3", "steps = 3\nstep = 4", "unknown key 'step'"),
        ("radius = 20", "radius = 20\nradios = 3", "unknown key 'settings.radios'"),
        ("radius = 20", "radius = -1", "bad.toml: 'radius' must be at least 1, got -1"),
    ],
)
def test_blur_refuses_a_bad_parameter_file(fitted, tmp_path, old, new, match):
    path = tmp_path / "bad.toml"
    text = fitted[0].read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    error = refused("blur", CAR, "-o", tmp_path / "o.exr", "--parameters", path)
    assert match in error and "bad.toml" in error


def test_blur_refuses_the_parameters_of_another_filter(fitted, tmp_path):
    given = ("--parameters", fitted[0], "--filter", "mcguire2012")
    error = refused("blur", CAR, "-o", tmp_path / "o.exr", *given)
    assert "holds parameters of guertin2014; leave out --filter mcguire2012" in error


TRUTH = DATA / "sky_car_truth_0011.exr"


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ((CAR, CUBE, "--truth", TRUTH), "--truth: 1 files for 2 frames"),
        ((CAR, CAR, "--truth", TRUTH, TRUTH), "is given twice"),
        ((CAR, "--truth", TRUTH, "--velocity-from", "a", "b"), "--velocity-from: 2 files for 1"),
        ((CAR, "--truth", TRUTH, "--depth-from", "{nr}.exr"), "--depth-from: '{nr}.exr' does not"),
        ((CAR, "--truth", "{name}.exr"), "'{name}.exr' does not apply to"),
        ((CAR, "--truth", "none_{number}.exr"), "none_0011.exr"),
        ((CAR, "--truth", TRUTH, "--holdout", "truck*"), "--holdout: no frame matches 'truck*'"),
        (
            (CAR, "--truth", TRUTH, "--holdout", "sky*"),
            "--holdout: no frame is left to fit, 'sky*' matches every frame; hold out fewer of "
            f"{CAR}.",
        ),
        ((CAR, "--truth", TRUTH, "--patience", "-1"), "expected a whole number from 0, got '-1'"),
        ((CAR, "--truth", TRUTH, "--prior=-1"), "--prior: expected a number from 0, got '-1'"),
        ((CAR, "--truth", TRUTH, "--free", "eta,phi"), "must not hold both eta and phi"),
        ((CAR, "--truth", TRUTH, "--free", "speed"), "has no parameter 'speed'"),
        ((CAR, "--truth", TRUTH, "--crop", "9x9"), "expected WxH+X+Y"),
        ((CAR, "--truth", TRUTH, "--crop", "9000x9+0+0"), "--crop: reaches beyond"),
        ((CAR, "--truth", TRUTH, "--free", "kapa"), "no parameter 'kapa' (did you mean kappa?)"),
        ((CAR, "--truth", TRUTH, "--param", "tau=2"), "tau must be 0 to 1 tiles, got 2"),
        ((CAR, "--truth", TRUTH, "--steps", "0"), "expected a whole number from 1"),
    ],
)
def test_mistakes_are_one_line(tmp_path, arguments, match):
    out = tmp_path / "fitted.toml"
    assert match in refused("fit", *arguments, "-o", out)
    assert not list(tmp_path.iterdir())


SHOTS = [
    pathlib.Path(name)
    for name in ("shots/car/f_0011.exr", "shots/rolling_ball/f_0011.exr", "shots/gears/f_0012.exr")
]


@pytest.mark.parametrize(
    ("patterns", "found"),
    [
        (["*rolling*"], [1]),
        (["shots/rolling_ball/*"], [1]),
        (["rolling_ball/f_0011.exr"], [1]),
        (["shots/car/f_0011.exr"], [0]),
        (["f_0012*"], [2]),
        (["*_0011.exr"], [0, 1]),
        (["*car*", "*gears*"], [0, 2]),
        (["shots/[cg]*"], [0, 2]),
    ],
)
def test_hold_out_patterns_match_as_in_a_shell(patterns, found):
    assert held_out(SHOTS, patterns) == found


def test_a_pattern_that_matches_nothing_or_everything_lists_the_frames():
    listing = ", ".join(map(str, SHOTS))
    with pytest.raises(CommandError, match=re.escape("'*truck*'; * stands for any characters. T")):
        held_out(SHOTS, ["*truck*"])
    for patterns in (["*.exr"], ["*car*", "*rolling*", "*gears*"]):
        with pytest.raises(CommandError, match=f"no frame is left to fit, .* fewer of {listing}"):
            held_out(SHOTS, patterns)


def test_outputs_are_checked_first(tmp_path):
    given = ("fit", CAR, "--truth", TRUTH, "-o")
    assert "can write .toml only" in refused(*given, tmp_path / "fitted.json")
    assert "create it first" in refused(*given, tmp_path / "missing" / "fitted.toml")
    (tmp_path / "fitted.toml").touch()
    assert "pass --overwrite to replace it" in refused(*given, tmp_path / "fitted.toml")


def test_a_truth_of_another_size_is_refused(tmp_path):
    frame = write_single(tmp_path / "frame.exr", plain_frame((12, 16)))
    error = refused("fit", frame, "--truth", TRUTH, "-o", tmp_path / "fitted.toml")
    assert "the truth has" in error and f"but {frame} has 16x12" in error


def test_mistakes_are_found_without_jax(tmp_path):
    code = (
        "import sys; from jaxblur.cli import main; "
        f"status = main(['fit', {str(CAR)!r}, '--truth', 'a', 'b', '-o', 'x.toml']); "
        "print(status, 'jax' in sys.modules)"
    )
    assert spawn(code=code).stdout.split() == ["2", "False"]


def test_ctrl_c_saves_and_resume_goes_on(tmp_path, monkeypatch):
    from jaxblur.fitting import descent

    out, state = tmp_path / "fitted.toml", tmp_path / "fitted.state.npz"
    command = ("fit", CAR, "--truth", TRUTH, "-o", out, "--free", "kappa", *SMALL, "--resume")
    take = descent._take_step

    def interrupted(task, reached, step, update):
        if step == 2:
            raise KeyboardInterrupt
        return take(task, reached, step, update)

    monkeypatch.setattr(descent, "_take_step", interrupted)
    outcome = run(*command)
    assert outcome.status == 130 and "stopped after 2 steps; --resume continues from" in outcome.err
    assert state.exists() and not out.exists()
    monkeypatch.undo()
    line = refused(*command[:-1])
    assert "pass --resume to continue from it, or --overwrite to start anew" in line
    assert "number of steps or seed differ" in refused(*command, "--steps", "4")
    outcome = run(*command)
    assert outcome.status == 0 and "step 3/3" in outcome.err and "step 2/3" not in outcome.err
    assert out.exists() and not state.exists()


def test_ctrl_c_before_the_first_step_leaves_nothing(tmp_path, monkeypatch):
    from jaxblur.fitting import optimization

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(optimization, "scan_start", interrupted)
    out = tmp_path / "fitted.toml"
    outcome = run("fit", CAR, "--truth", TRUTH, "-o", out, "--free", "kappa", *SMALL)
    assert outcome.status == 130
    assert outcome.err.endswith(
        "error: interrupted before the first step; there is nothing to continue from\n"
    )
    assert "starting; stages: compiling, scanning for a start" in outcome.err
    assert not list(tmp_path.iterdir())


@pytest.fixture
def fitted_frames(tmp_path, monkeypatch):
    """A function that gives the frames that a command would fit to."""

    class Stop(Exception):
        pass

    frames = []

    def fit(name, pairs, **options):
        frames[:] = [frame for frame, _ in pairs]
        raise Stop

    def frames_of(*command):
        with pytest.raises(Stop):
            run("fit", *command, "-o", tmp_path / "f.toml", "--filter", "layered")
        return frames

    monkeypatch.setattr("jaxblur.fitting.fit", fit)
    return frames_of


@pytest.mark.parametrize("crop", [(), ("--crop", "40x30+8+4")])
def test_paths_are_followed_where_they_are_followed_by_blur(fitted_frames, crop):
    (frame,) = fitted_frames(CAR, "--truth", TRUTH, *crop)
    path = exr.read_buffers(CAR).path
    assert path is not None
    expected = path[4:34, 8:48] if crop else path
    np.testing.assert_array_equal(frame.path, expected)


def test_color_vectors_and_depth_may_be_in_files_of_their_own(fitted_frames, tmp_path):
    wanted = {}
    for number in (1, 2):
        channels = plain_frame((12, 16), seed=number)
        color = {
            f"{layer}.{c}": channels[c] / k for k, layer in enumerate(("a", "b"), 1) for c in "RGB"
        }
        velocity = {name: channels[name] for name in ("velocity.X", "velocity.Y")}
        write_single(tmp_path / f"color_{number}.exr", color)
        write_single(tmp_path / f"vectors_{number}.exr", velocity)
        write_single(
            tmp_path / f"depth_{number}.exr", {"far": channels["Z"], "near": channels["R"]}
        )
        write_single(tmp_path / f"truth_{number}.exr", {c: channels[c] for c in "RGB"})
        wanted[number] = channels
    frames = fitted_frames(
        *(tmp_path / "color_2.exr", tmp_path / "color_1.exr"),
        *("--truth", "{folder}/truth_{number}.exr", "--color-channels", "b.R,b.G,b.B"),
        *("--velocity-from", "{folder}/vectors_{number}.exr", "--shutter", "0.5"),
        *("--depth-from", tmp_path / "depth_1.exr", tmp_path / "depth_2.exr"),
        *("--depth-channel", "far"),
    )
    for frame, channels in zip(frames, (wanted[1], wanted[2]), strict=True):
        np.testing.assert_array_equal(frame.color[..., 1], channels["G"] / 2)
        np.testing.assert_array_equal(frame.depth, channels["Z"])
        scale = frame.velocity[..., 0] / channels["velocity.X"]
        assert np.ptp(scale) < 1e-6 and scale[0, 0] > 0
