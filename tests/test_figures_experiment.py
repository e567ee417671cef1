"""The figures that explain the filters are drawn, and show the owners that `layered` reads."""

import importlib

import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from tests.exr_files import CUBE, write_single
from tests.page_files import stored

run = importlib.import_module("experiments.021_figures.run")

pytestmark = pytest.mark.slow

SIZE = (16, 40)
BLOCK = np.s_[4:12, 10:20]


def test_owners_are_where_the_motion_leads_from():
    """A block before a wall, 6 px to the right until the shutter closes."""
    depth, velocity = np.full(SIZE, 9.0, np.float32), np.zeros((*SIZE, 2), np.float32)
    depth[BLOCK], velocity[BLOCK] = 2.0, (6.0, 0.0)
    frame = jaxblur.Frame(jnp.ones((*SIZE, 3)), jnp.asarray(depth), jnp.asarray(velocity))
    right, down, drawn = map(np.asarray, run.owner_offsets(frame))
    assert len(right) == 12
    for k, moved in ((0, -6), (-1, 6)):
        there = np.zeros(SIZE, bool)
        there[BLOCK[0], 10 + moved : 20 + moved] = True
        np.testing.assert_array_equal(drawn[k], there)
        assert set(right[k][there]) == {moved} and set(down[k][there]) == {0}


def test_figures_are_written(tmp_path, monkeypatch):
    """Without weights and slices, which compile for long and call what other tests run."""
    monkeypatch.setattr(run, "FRAME", write_single(tmp_path / "frame.exr", stored(CUBE)))
    for name in ("weights", "slices"):
        monkeypatch.setattr(run, name, lambda *_: run.show.new_figure(1, 1))
    run.main(["-o", str(tmp_path)])
    names = {path.stem for path in tmp_path.glob("*.png")}
    assert names == {"tiles", "directions", "weights", "owners", "slices"}
    assert (tmp_path / "owners.png").stat().st_size > 5000


def test_the_page_shows_them_all():
    page = (run.REPOSITORY / "docs/explanation/how-filters-work.md").read_text(encoding="utf-8")
    stored_figures = sorted((run.REPOSITORY / "experiments/021_figures").glob("*.png"))
    assert len(stored_figures) == 5
    assert all(f"021_figures/{path.name})" in page for path in stored_figures)
    assert sum(path.stat().st_size for path in stored_figures) < 600_000
