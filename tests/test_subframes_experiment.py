"""Experiment 022: the error falls with the number of sub-frames, most with layered."""

import importlib

import pytest

run = importlib.import_module("experiments.022_subframes.run")


def test_filters_are_tried_with_fewer_subframes_than_the_mean():
    assert list(run.methods(run.MOST)) == list(run.METHODS)
    assert list(run.methods(run.MOST + 1)) == ["mean of the renders"]


@pytest.mark.slow
def test_the_error_falls_with_the_number_of_subframes(monkeypatch):
    monkeypatch.setattr(run, "SIZE", (36, 64))
    monkeypatch.setattr(run, "TRUTH_SAMPLES", 64)
    monkeypatch.setattr(run, "COUNTS", (1, 2, 16))
    rows, shown = run.errors(["crossing"])
    found = {(method, count): float(psnr) for method, count, psnr, _ in run.table(rows)}
    assert found["layered", 2] > found["layered", 1] + 3
    assert found["layered", 2] > found["mean of the renders", 2] + 3
    assert found["mean of the renders", 16] > found["mean of the renders", 2] + 8
    assert ("layered", 16) not in found and (run.FLOOR, "") in found
    assert len(shown["output"]) == len(shown["error"]) == 2
