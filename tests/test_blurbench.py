"""BlurBench without Blender: its halves, its files, and the leaderboard."""

import argparse
import ast
import json
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from experiments.blender.blurbench import cases, files, score, split
from jaxblur import exr

SCENES = Path(split.__file__).with_name("scenes")
SIZE = (14, 18)
"""FLIP and SSIM need a little more than 11 pixels."""


def write_scene(folder: Path, seed: int, shutter: float = 0.5) -> cases.Case:
    """A folder as `render` writes it, with random frames that move to the right."""
    generator = np.random.default_rng(seed)
    folder.mkdir(parents=True)
    for number in (10, 11, 12):
        frame = jaxblur.Frame(
            jnp.asarray(generator.random((*SIZE, 3)), jnp.float32),
            jnp.full(SIZE, number, jnp.float32),
            jnp.broadcast_to(jnp.asarray([2.0, 0.0], jnp.float32), (*SIZE, 2)),
        )
        exr.write_frame(folder / f"frame_{number:04d}.exr", frame, shutter)
    for index in range(1, 5):
        exr.write_frame(files.subframe_file(folder, 11, index), frame, shutter)
    truth = generator.random((*SIZE, 3), np.float32)
    exr.write_image(folder / "truth_0011.exr", truth, dtype="float")
    (folder / "camera.json").write_text(json.dumps({"shutter": shutter}), encoding="utf-8")
    return cases.Case(folder)


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> list[cases.Case]:
    """Two scenes of the training half and one of the test half."""
    folder = tmp_path_factory.mktemp("frames")
    names = ("ground_pan", "crowd", "rain_street")
    return [write_scene(folder / name, seed) for seed, name in enumerate(names)]


def test_the_halves_are_those_that_were_fixed_before_rendering():
    training = {scene for scene in split.SCENES if split.half_of(scene) == "training"}
    assert training == {
        "car_behind_fence",
        "defocused_orbit",
        "forward_city",
        "ground_pan",
        "mirror_dance",
        "rain_street",
        "running_figure",
        "spoked_wheels",
    }
    assert len(split.SCENES) == len(set(split.SCENES)) == 16


def test_every_scene_has_a_builder():
    """The builders cannot be imported here, but their names can be read."""
    tree = ast.parse((SCENES / "catalogue.py").read_text(encoding="utf-8"))
    named = {node.attr: node.value for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    builders = {name for name, module in named.items() if ast.unparse(module) != "builder"}
    assert builders - {"__name__"} == set(split.SCENES)
    for name in split.SCENES:
        source = (SCENES / f"{ast.unparse(named[name])}.py").read_text(encoding="utf-8")
        assert f"def {name}() -> Any:" in source


@pytest.mark.parametrize("count", [1, 2, 4])
def test_subframes_lie_in_the_middle_of_equal_parts(count):
    times = files.subframe_times(11, 0.5, count)
    np.testing.assert_allclose(np.mean(times), 11)
    np.testing.assert_allclose(np.diff(times), 0.5 / count)
    assert times[0] - 0.25 / count == 10.75


def test_a_case_gives_neighbors_and_subframes_with_their_own_shutter(three):
    case = three[0]
    assert (float(case.before.depth[0, 0]), float(case.after.depth[0, 0])) == (10, 12)
    np.testing.assert_allclose(case.frame.velocity[..., 0], 2.0)
    assert [float(frame.velocity[0, 0, 0]) for frame in case.subframes] == [0.5] * 4


def test_what_the_folder_lacks_is_none(tmp_path):
    case = write_scene(tmp_path / "gears", 0)
    for path in (*tmp_path.glob("*/frame_001[02].exr"), files.subframe_file(case.folder, 11, 3)):
        path.unlink()
    assert case.before is case.after is case.vector_blur is case.layer("Foreground") is None
    assert case.subframes == ()


def test_an_unfinished_scene_is_left_out(three, tmp_path):
    assert cases.find_cases(three[0].folder.parent) == sorted(three, key=lambda case: case.name)
    (tmp_path / "gears").mkdir()
    with pytest.raises(SystemExit, match="holds no scene"):
        cases.find_cases(tmp_path)


def test_the_leaderboard_has_the_best_method_first_and_no_mean_of_some_scenes(three):
    methods = {
        "gray": lambda case: np.full((*SIZE, 3), 0.5, np.float32),
        "one scene": lambda case: case.truth if case.name == "crowd" else None,
        "truth": lambda case: case.truth,
    }
    scores = score.score(methods, three)
    rows = score.leaderboard(scores, three)
    assert [row[0] for row in rows] == ["truth", "gray", "one scene"]
    assert rows[0][1:] == [np.inf, 0.0, np.inf, 0.0]
    assert rows[2][1:] == ["", "", np.inf, 0.0]
    table = score.by_scene(scores, three, "psnr")
    assert [row[:2] for row in table] == [
        ["ground_pan", "training"],
        ["rain_street", "training"],
        ["mean", "training"],
        ["crowd", "test"],
        ["mean", "test"],
    ]
    assert table[2][2] == pytest.approx((table[0][2] + table[1][2]) / 2)
    assert table[0][3] == "" and table[3][3] == np.inf


def test_the_length_of_blur_is_that_of_the_whole_shutter(three):
    """Two pixels either way make four."""
    name, half, *lengths = score.motion(three[0])
    assert (name, half) == ("ground_pan", "training")
    np.testing.assert_allclose(lengths, 4.0, rtol=1e-6)


def test_alpha_is_not_scored(three):
    color = np.asarray(three[0].truth)
    with_alpha = np.concatenate([color, np.zeros((*SIZE, 1), np.float32)], -1)
    result = score.score({"alpha": lambda case: with_alpha}, three[:1])["alpha"]["ground_pan"]
    assert result is not None and result.flip == 0


def test_the_command_scores_a_function_of_a_file(three, tmp_path, monkeypatch, capsys):
    own = tmp_path / "own.py"
    own.write_text("def mean_of_three(case):\n    return case.before.color\n", encoding="utf-8")
    monkeypatch.setattr(score, "METHODS", {"unblurred": score.METHODS["unblurred"]})
    out, frames = tmp_path / "out", three[0].folder.parent
    command = f"score --frames {frames} -o {out} --half training --method {own}:mean_of_three"
    monkeypatch.setattr(sys, "argv", command.split())
    score.main()
    assert "| mean_of_three |" in capsys.readouterr().out
    written = (out / "psnr.md").read_text(encoding="utf-8")
    assert "ground_pan" in written and "crowd" not in written
    assert sorted(path.name for path in out.iterdir()) == [
        f"{table}.{kind}"
        for table in ("flip", "leaderboard", "motion", "psnr")
        for kind in ("csv", "md")
    ]


@pytest.mark.parametrize("reference", ["missing.py:blur", "blur", __file__, f"{__file__}:missing"])
def test_a_method_that_does_not_exist_is_refused(reference):
    with pytest.raises(argparse.ArgumentTypeError, match=r"expected an existing|has no function"):
        score.load_method(reference)
