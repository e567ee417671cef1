"""Experiment 001 as a test: it runs on a made-up folder, and its figures hold on the renders."""

import csv
import importlib.util
import json
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import exr, metrics
from jaxblur.filters import FILTERS

pytestmark = pytest.mark.slow

SCRIPT = Path(__file__).parents[1] / "experiments" / "001_published_filters" / "run.py"


@pytest.fixture(scope="module")
def experiment():
    spec = importlib.util.spec_from_file_location("published_filters", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def panned(tmp_path):
    """A folder with one scene: a panned texture, and its box blur over the path as the truth."""
    color = np.random.default_rng(0).random((24, 40, 3)).astype(np.float32)
    color = (color + np.roll(color, 1, 1) + np.roll(color, 2, 1)) / 3
    velocity = jnp.zeros((24, 40, 2)).at[..., 0].set(3.0)
    frame = jaxblur.Frame(jnp.asarray(color), jnp.ones((24, 40)), velocity)
    scene = tmp_path / "data" / "pan"
    scene.mkdir(parents=True)
    exr.write_frame(scene / "frame_0007.exr", frame, shutter=0.5)
    truth = np.mean([np.roll(color, step, 1) for step in range(-3, 4)], axis=0)
    exr.write_image(scene / "truth_0007.exr", truth)
    (scene / "camera.json").write_text(json.dumps({"shutter": 0.5}))
    return tmp_path / "data"


def test_the_experiment_writes_its_tables_and_pictures(
    experiment, panned, tmp_path, monkeypatch, capsys
):
    out = tmp_path / "out"
    monkeypatch.setattr(sys, "argv", f"run.py --reference-data {panned} -o {out}".split())
    experiment.main()
    with (out / "results.csv").open(newline="") as file:
        rows = {(row["method"], row["area"]): row for row in csv.DictReader(file)}
    sharp, blurred = (
        float(rows[name, "whole"]["psnr"]) for name in ("unblurred", "pixel_velocity")
    )
    assert blurred > sharp + 6
    assert f"| pan 7 | pixel_velocity | {blurred:.2f} / " in capsys.readouterr().out
    rows = 1 + len(FILTERS)
    size = (rows * 24 + (rows - 1) * 4, 4 * 40 + 3 * 4, 3)
    assert exr.read_image(out / "pan_7.png").shape == size
    assert (out / "overview.png").is_file()


def test_the_experiment_names_what_is_missing(experiment, panned):
    with pytest.raises(SystemExit, match=r"truth_0008\.exr"):
        list(experiment.find_shots(panned, 8, None))
    (panned / "pan" / "camera.json").unlink()
    with pytest.raises(SystemExit, match=r"camera\.json is missing; give --shutter"):
        list(experiment.find_shots(panned, None, None))
    assert len(list(experiment.find_shots(panned, None, 0.5))) == 1


# PSNR in dB of a plain reading of the papers: mcguire2012 with 35 taps and radius 40, guertin2014.
PLAIN_READING = {
    "cube_over_crates": (36, 37),
    "falling_cubes": (29, 31.6),
    "flagpole": (33, 34.4),
}


@pytest.mark.parametrize("scene", PLAIN_READING)
def test_a_plain_reading_of_the_papers_is_reached(experiment, reference_data, scene):
    shot = experiment.read_shot(reference_data / scene / "truth_0011.exr", 0.5)
    methods = experiment.methods()
    measured = [
        float(
            metrics.psnr(metrics.display(methods[name](shot.centers)), metrics.display(shot.truth))
        )
        for name in ("mcguire2012, 35 taps", "guertin2014")
    ]
    # The figures are given to the decibel and its half; a flipped axis costs 3 dB or more.
    np.testing.assert_allclose(measured, PLAIN_READING[scene], atol=0.5)
