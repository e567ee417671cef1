"""What the README says works as it says."""

from pathlib import Path

import jax
import numpy as np

import jaxblur
from jaxblur import metrics

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_ten_lines_run_and_blur(tmp_path, monkeypatch):
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(README.split("```python\n")[1].split("```")[0], names)
    data = ROOT / "tests" / "data"
    truth = jaxblur.exr.read_image(data / "cube_over_crates_truth_0011.exr")[..., :3]
    written = jaxblur.exr.read_image(tmp_path / "blurred.exr")[..., :3]
    sharp = np.asarray(names["frame"].color)[..., :3]
    assert metrics.compare(written, truth).psnr > metrics.compare(sharp, truth).psnr + 5
    gradient = jax.grad(names["loss"])(names["parameters"])
    assert all(np.isfinite(value) for value in jax.tree.leaves(gradient))


def test_it_names_the_two_commands():
    blocks = README.split("```\n")
    assert any(block.rstrip().endswith(".venv/bin/jaxblur demo") for block in blocks)
    assert any(
        block.rstrip().endswith(".venv/bin/pytest -n 2 --dist worksteal") for block in blocks
    )
