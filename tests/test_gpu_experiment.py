"""Experiment 011, on the CPU: what it refuses, and that what was measured is kept."""

import csv
import importlib
import subprocess
import sys
import types

import numpy as np
import pytest

run = importlib.import_module("experiments.011_gpu.run")


def test_it_stops_without_a_gpu():
    with pytest.raises(SystemExit, match="jax sees no GPU: install"):
        run.find_device(allow_cpu=False)
    assert run.find_device(allow_cpu=True).platform == "cpu"


@pytest.mark.parametrize("wrong", ["image", "derivatives", "not finite"])
def test_it_stops_where_values_differ(wrong, monkeypatch, capsys):
    expected = run.Outcome(np.zeros((40, 50, 3)), {"motion": 1.0, "kappa": 0.5})
    image = expected.image.copy()
    image[:3, 0] = {"image": 0.01, "derivatives": 0, "not finite": np.nan}[wrong]
    found = expected._replace(image=image)
    if wrong == "derivatives":
        found = expected._replace(derivatives={"motion": 1.0, "kappa": 0.53})
    device = types.SimpleNamespace(device_kind="a GPU")

    def outcome(where, dtype, program, size):
        return found if where is device and dtype == "float32" else expected

    monkeypatch.setattr(run, "outcome", outcome)
    with pytest.raises(SystemExit, match=r"a GPU differs from the CPU: .*'float32'"):
        run.check(device, ["guertin2014"], (40, 50))
    assert "float64  0  0  0" in capsys.readouterr().out
    monkeypatch.setattr(run, "outcome", lambda *_: expected)
    assert len(run.check(device, ["guertin2014"], (40, 50))) == 4


def test_the_floor_is_the_larger_bound():
    # 40 bytes per pixel, and 110 operations per tap.
    assert run.Floor(1e9, 1e15).milliseconds(1000, 35) == pytest.approx(0.04)
    h100 = run.Floor(3.35e12, 67e12).milliseconds(1280 * 720, 35)
    assert h100 == pytest.approx(0.053, abs=5e-4)


def test_what_was_measured_is_kept(monkeypatch, tmp_path):
    row = tuple(str(k) for k in range(len(run.COLUMNS)))

    def measure(filters, size, batch, extent, floor):
        if batch > 1:
            raise MemoryError("RESOURCE_EXHAUSTED")
        return [row]

    monkeypatch.setattr(run, "check", lambda *_: [("guertin2014", *"12345")])
    monkeypatch.setattr(run, "measure_floor", lambda *_: run.Floor(1e9, 1e12))
    monkeypatch.setattr(run, "measure", measure)
    monkeypatch.setattr("sys.argv", ["run.py", "-o", str(tmp_path), "--allow-cpu", "--quick"])
    with pytest.raises(MemoryError):
        run.main()
    with (tmp_path / "results.csv").open(newline="") as file:
        assert list(csv.reader(file)) == [list(run.COLUMNS), list(row)]
    text = (tmp_path / "results.md").read_text()
    assert "(cpu), jax " in text and f"| {' | '.join(row)} |" in text


@pytest.mark.slow
def test_the_script_runs_as_its_page_says(tmp_path):
    options = ("-o", tmp_path, "--allow-cpu", "--quick", "--filters", "pixel_velocity")
    ran = subprocess.run(
        [sys.executable, "experiments/011_gpu/run.py", *map(str, options)],
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stderr
    with (tmp_path / "results.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    cases = [(row["size"], row["batch"], row["what"]) for row in rows]
    kinds = ("forward", "gradient")
    assert cases == [("320x180", batch, kind) for batch in ("1", "2") for kind in kinds]
    assert all(float(row["ms per frame"]) > 0 for row in rows)
    text = (tmp_path / "results.md").read_text()
    assert text.count("| pixel_velocity |") == 8
