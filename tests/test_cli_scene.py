"""``jaxblur scene`` and ``jaxblur demo``: frames with their truth."""

import numpy as np
import pytest

import jaxblur
from jaxblur import exr, scenes
from jaxblur.cli.commands import demo
from tests.command_line import refused, run

SIZE = (72, 128)
SMALL = ("--size", "128x72")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two frames of the pan with truth and object numbers."""
    folder = tmp_path_factory.mktemp("scene") / "new" / "folder"
    outcome = run(
        *("scene", "uniform_pan", "-o", folder, "--frames", "1-3x2", "--ids", *SMALL),
        *("--truth", "--truth-samples", "16"),
    )
    assert outcome.status == 0, outcome.err
    assert outcome.out.split() == [str(folder / f"uniform_pan.000{k}.exr") for k in (1, 3)]
    first, *lines = outcome.err.splitlines()
    assert first == "jaxblur: uniform_pan at 128x72; the first frame compiles the scene"
    assert lines[0] == "jaxblur: rendering"
    # A stage that takes long says so in between.
    stages = [line for line in lines[1:] if not line.startswith("jaxblur: rendering:")]
    for k in (1, 3):
        truth, sharp, done, *stages = stages
        assert truth == f"jaxblur: frame {k}: truth, the mean of 16 images"
        assert sharp == f"jaxblur: frame {k}: sharp"
        assert done.startswith(f"jaxblur: frame {k} ok ")
    assert stages == []
    return folder


def test_scene_writes_frames_truth_and_ids_and_nothing_else(folder):
    names = sorted(path.name for path in folder.iterdir())
    kinds = ("", "_id", "_truth")
    assert names == sorted(f"uniform_pan{kind}.000{k}.exr" for kind in kinds for k in (1, 3))


def test_scene_frames_read_back_as_the_renderer_made_them(folder):
    frame = jaxblur.read_frame(folder / "uniform_pan.0003.exr", shutter=0.5)
    made = scenes.render(scenes.SCENES["uniform_pan"](), 3.0, 0.5, SIZE, path=True)
    assert frame.path is not None and made.path is not None
    np.testing.assert_allclose(frame.velocity, made.velocity, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(frame.path, made.path, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(frame.depth, made.depth, rtol=1e-6)
    # Color is stored as half: 11 bits.
    np.testing.assert_allclose(frame.color, made.color, rtol=2**-11)
    truth = scenes.accumulate(scenes.SCENES["uniform_pan"](), 3.0, 0.5, 16, SIZE)
    stored = exr.read_image(folder / "uniform_pan_truth.0003.exr")
    np.testing.assert_allclose(stored, truth, rtol=2**-11)
    ids = exr.read_channels(folder / "uniform_pan_id.0003.exr", ["id"])[..., 0]
    np.testing.assert_array_equal(ids, scenes.object_ids(scenes.SCENES["uniform_pan"](), 3.0, SIZE))


@pytest.mark.slow
def test_blur_takes_scene_frames_and_comes_near_their_truth(folder, tmp_path):
    outcome = run(
        *("blur", folder / "uniform_pan.0001.exr", "-o", tmp_path / "out.exr"),
        *("--truth", folder / "uniform_pan_truth.0001.exr", "--samples", "15", "--radius", "auto"),
    )
    assert "vectors: jaxblur: found velocity.previous.X" in outcome.err
    sharp, blurred = (float(row.split()[1]) for row in outcome.out.splitlines()[2:])
    assert blurred > sharp + 5


def test_scene_keeps_existing_files(folder):
    target = folder / "uniform_pan.0001.exr"
    before = target.read_bytes()
    message = refused("scene", "uniform_pan", "-o", folder, "--frames", "0-1", *SMALL)
    assert "uniform_pan.0001.exr: exists; pass --overwrite" in message
    assert target.read_bytes() == before
    assert not (folder / "uniform_pan.0000.exr").exists(), "refused before any work"


def test_unknown_scenes_are_refused_with_a_suggestion(tmp_path):
    message = refused("scene", "gaers", "-o", tmp_path / "out")
    assert "did you mean gears" in message and "uniform_pan" in message
    assert "did you mean smoke" in refused("scene", "smok", "-o", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_what_ends_before_a_frame_is_rendered_leaves_no_folder(tmp_path, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(scenes, "render", stop)
    outcome = run("scene", "gears", "-o", tmp_path / "a" / "b", *SMALL)
    assert outcome.status == 130 and list(tmp_path.iterdir()) == []


def test_the_list_shows_every_scene_with_a_line_about_it():
    outcome = run("scene", "--list")
    assert outcome.status == 0
    rows = dict(line.split(maxsplit=1) for line in outcome.out.splitlines()[1:])
    assert list(rows) == [*scenes.SCENES, "smoke"]
    assert all(len(text) > 10 for text in rows.values())


@pytest.mark.slow
def test_smoke_comes_with_layers_that_can_be_blurred(tmp_path):
    given = ("scene", "smoke", "-o", tmp_path, "--size", "36x24")
    outcome = run(*given, "--truth", "--truth-samples", "2")
    assert outcome.status == 0, outcome.err
    for stage in ("truth, the mean of 2 images", "layers", "flat frame"):
        assert f"frame 0: {stage}" in outcome.err
    kinds = ("", "_layer1", "_layer2", "_layer3", "_layer4", "_truth")
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"smoke{k}.0000.exr" for k in kinds]
    flat = jaxblur.read_frame(tmp_path / "smoke.0000.exr", shutter=0.5)
    layers = [
        jaxblur.read_frame(tmp_path / f"smoke_layer{k}.0000.exr", shutter=0.5) for k in (1, 2, 3, 4)
    ]
    assert [np.shape(frame.color)[-1] for frame in (flat, *layers)] == [3, 4, 4, 4, 4]
    color, through = np.zeros((24, 36, 3)), 1.0
    for layer in layers:
        rgba = np.asarray(layer.color)
        color, through = color + through * rgba[..., :3], through * (1 - rgba[..., 3:])
    assert np.sqrt(np.mean((color - np.asarray(flat.color)) ** 2)) < 0.02


def test_options_that_smoke_or_other_scenes_lack_are_refused(tmp_path):
    assert "--ids: smoke has no" in refused("scene", "smoke", "-o", tmp_path, "--ids")
    assert "1 or even" in refused("scene", "smoke", "-o", tmp_path, "--layers", "3")
    assert "only smoke has layers" in refused("scene", "gears", "-o", tmp_path, "--layers", "2")


@pytest.mark.slow
def test_demo_writes_pictures_and_scores_that_improve(tmp_path, monkeypatch):
    monkeypatch.setattr(demo, "TRUTH_SAMPLES", 16)
    folder = tmp_path / "demo"
    given = ("demo", "-o", folder, "--scene", "uniform_pan", *SMALL)
    outcome = run(*given)
    assert outcome.status == 0, outcome.err
    names = sorted(path.name for path in folder.iterdir())
    kinds = ("blurred", "sharp", "truth")
    files = [f"{kind}.{end}" for kind in kinds for end in ("exr", "png")]
    assert names == sorted([*files, "play.html", "report.html", "result"])
    for name in (*files, "play.html", "report.html"):
        assert name in outcome.out
    rows = [line.split() for line in outcome.out.splitlines()]
    scores = {row[0]: float(row[1]) for row in rows if row[0] in ("sharp", "layered")}
    assert scores["layered"] > scores["sharp"] + 5
    assert exr.inspect(folder / "blurred.exr").parts[0].attributes["jaxblur:filter"]
    assert "sharp.exr: exists; pass --overwrite" in refused(*given)
    assert run(*given, "--overwrite").status == 0


def test_demo_leaves_files_of_the_user_alone(tmp_path):
    mine = tmp_path / "truth.png"
    mine.write_text("mine")
    assert "truth.png: exists; pass --overwrite" in refused("demo", "-o", tmp_path, *SMALL)
    assert mine.read_text() == "mine" and list(tmp_path.iterdir()) == [mine]
