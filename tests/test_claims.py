"""The page of claims: its table is that of its results, and rows are measured as they say."""

import importlib
import re

import jax.numpy as jnp
import numpy as np
import pytest

run = importlib.import_module("experiments.018_claims.run")
claim = importlib.import_module("experiments.018_claims.claim")
costs = importlib.import_module("experiments.018_claims.costs")
samples = importlib.import_module("experiments.018_claims.samples")
tiles = importlib.import_module("experiments.018_claims.tiles")

elsewhere = importlib.import_module("experiments.018_claims.elsewhere")

VERDICTS = (claim.AGREES, claim.DIFFERS, claim.PARTLY, claim.NOT_COMPARABLE)
RESULTS = run.FOLDER / "results.json"
EXTENT = claim.Extent(size=(36, 64), truth_samples=4, scenes=("crossing",), rounds=1)


def test_the_page_shows_the_results_beside_it():
    page = (run.FOLDER / "README.md").read_text(encoding="utf-8")
    rows = run.read_rows(RESULTS)
    assert len(rows) > 20
    assert page == run.with_table(page, run.table(rows))
    assert all(row.verdict.startswith(VERDICTS) for row in [*rows.values(), *elsewhere.ROWS])


TEXTS = (".md", ".csv")
DERIVED = {"0.37", "2.4"}
"""Differences of two numbers of the page."""


@pytest.mark.parametrize("row", elsewhere.ROWS, ids=lambda row: row.claim)
def test_numbers_of_other_experiments_are_those_of_their_pages(row):
    folders = [run.FOLDER / link for link in re.findall(r"\]\(([^)#]+)", row.tested + row.ours)]
    pages = [page for link in folders for page in link.parent.glob("*") if page.suffix in TEXTS]
    assert pages
    text = " ".join(page.read_text(encoding="utf-8") for page in pages)
    for number in re.findall(r"(?<![\w.])\d+\.\d+", row.ours):
        assert number in text or number in DERIVED


def test_a_page_without_markers_is_refused():
    with pytest.raises(ValueError, match="must hold the markers"):
        run.with_table(f"only {run.START}", "")


def test_the_buffers_of_the_paper_are_counted():
    """720p: 6 bytes in, 6 out, 2 of velocity, 2 of depth, and 2 x 2 for each of 64 x 36 tiles."""
    measured = costs.buffers(EXTENT).measured
    assert measured["published"] == 1280 * 720 * 16 + 64 * 36 * 4


def test_maxima_in_two_passes_are_those_of_one():
    speed = np.random.default_rng(0).random((12, 20), np.float32)
    expected = speed.reshape(3, 4, 5, 4).max(axis=(1, 3))
    for windows in (
        (costs.Window(4, 4),),
        (costs.Window(1, 4), costs.Window(4, 1)),
    ):
        np.testing.assert_array_equal(costs.maxima(jnp.asarray(speed), windows), expected)


@pytest.mark.slow
def test_rows_say_what_they_measured():
    diagonal = tiles.diagonal_tiles(EXTENT)
    assert f"{diagonal.measured['all']:.2f} dB with all" in diagonal.ours
    assert diagonal.verdict == claim.AGREES
    variance = tiles.eight_bit_variance(EXTENT)
    assert 0 <= variance.measured["share"] <= 1
    assert variance.verdict.startswith(VERDICTS)


@pytest.mark.slow
def test_the_noise_of_more_samples_is_less():
    row = samples.fewest_samples(EXTENT)
    assert row.measured[5] > row.measured[15] > row.measured[35] > 0
    assert row.measured["power"] < -0.3


def test_results_are_written_and_kept(tmp_path, capsys):
    page = tmp_path / "README.md"
    with pytest.raises(SystemExit):
        run.main(["-o", str(tmp_path), "--claims", "buffers"])
    assert "README.md is missing" in capsys.readouterr().err
    page.write_text(f"{run.START}{run.END}", encoding="utf-8")
    run.write_rows(tmp_path / "results.json", {"growth": costs.buffers(EXTENT)})
    run.main(["-o", str(tmp_path), "--claims", "buffers", "--tiny"])
    rows = run.read_rows(tmp_path / "results.json")
    assert list(rows) == ["growth", "buffers"]
    assert run.table(rows) in page.read_text(encoding="utf-8")
    with pytest.raises(SystemExit):
        run.main(["-o", str(tmp_path), "--claims", "bufers"])
    assert "--claims must be some of" in capsys.readouterr().err


def test_links_of_the_table_lead_somewhere():
    links = re.findall(r"\]\(([^)#]+)", run.table(run.read_rows(RESULTS)))
    assert len(links) > 10
    assert [link for link in links if not (run.FOLDER / link).is_file()] == []
