"""The page of claims: its table is that of its results, and rows are measured as they say."""

import importlib
import json

import jax.numpy as jnp
import numpy as np
import pytest

run = importlib.import_module("experiments.018_claims.run")
claim = importlib.import_module("experiments.018_claims.claim")
costs = importlib.import_module("experiments.018_claims.costs")
tiles = importlib.import_module("experiments.018_claims.tiles")

VERDICTS = (claim.AGREES, claim.DIFFERS, claim.PARTLY, claim.NOT_COMPARABLE)
FOLDER = run.PAGE.parent


def test_the_page_shows_the_results_beside_it():
    page = run.PAGE.read_text(encoding="utf-8")
    rows = run.read_rows(FOLDER)
    assert len(rows) > 30
    assert page == run.with_table(page, run.table(rows))
    assert all(row.verdict.startswith(VERDICTS) for row in rows)


def test_a_page_without_markers_is_refused():
    with pytest.raises(ValueError, match="must hold the markers"):
        run.with_table(f"only {run.START}", "")


def test_the_buffers_of_the_paper_are_counted():
    """720p: 6 bytes in, 6 out, 2 of velocity, 2 of depth, and 2 x 2 for each of 64 x 36 tiles."""
    measured = costs.buffers().measured
    assert measured["published"] == 1280 * 720 * 16 + 64 * 36 * 4


def test_maxima_in_two_passes_are_those_of_one():
    speed = np.random.default_rng(0).random((12, 20), np.float32)
    expected = speed.reshape(3, 4, 5, 4).max(axis=(1, 3))
    for windows in (
        (costs.Window(4, 4),),
        (costs.Window(1, 4), costs.Window(4, 1)),
    ):
        np.testing.assert_array_equal(costs.maxima(jnp.asarray(speed), windows), expected)


def test_rows_of_a_tiny_run():
    """One frame serves them all; what they say is what they measured."""
    extent = claim.Extent(size=(36, 64), truth_samples=4, scenes=("crossing",), rounds=1)
    diagonal = tiles.diagonal_tiles(extent)
    assert f"{diagonal.measured['all']:.2f} dB with all" in diagonal.ours
    assert diagonal.verdict in VERDICTS
    variance = tiles.eight_bit_variance(extent)
    assert 0 <= variance.measured["share"] <= 1
    assert variance.verdict.startswith(VERDICTS)


def test_results_are_written_and_read_back(tmp_path, capsys):
    run.main(["-o", str(tmp_path), "--groups", "elsewhere", "--tiny"])
    rows = json.loads((tmp_path / "elsewhere.json").read_text(encoding="utf-8"))
    assert [row["claim"] for row in rows] == [row.claim for row in run.read_rows(tmp_path)]
    assert run.table(run.read_rows(tmp_path)) in capsys.readouterr().out
    with pytest.raises(SystemExit):
        run.main(["-o", str(tmp_path), "--groups", "elswhere"])
    assert "--groups must be some of" in capsys.readouterr().err


def test_links_of_the_table_lead_somewhere():
    links = [
        part.partition(")")[0]
        for row in run.read_rows(FOLDER)
        for part in f"{row.tested} {row.ours}".split("](")[1:]
    ]
    assert len(links) > 10
    assert [link for link in links if not (FOLDER / link).is_file()] == []
