"""The notebooks run from start to end, and each is the same as text and as notebook."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

jupytext = pytest.importorskip("jupytext", reason="needs jaxblur[notebook]")
nbformat = pytest.importorskip("nbformat", reason="needs jaxblur[notebook]")
pytest.importorskip("ipykernel", reason="needs jaxblur[notebook]")

FOLDER = Path(__file__).parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
LARGEST = 0.5e6
"""Bytes of a notebook with its pictures, which are kept so that it can be read without a kernel."""

PICTURES = {"01": 3, "02": 3, "03": 3, "04": 2, "05": 2, "06": 4, "07": 4}
"""How many figures each shows, at least."""

RUN = """
import sys, nbformat
from nbclient import NotebookClient
notebook = nbformat.read(sys.argv[1], as_version=4)
folder = {"metadata": {"path": sys.argv[2]}}
NotebookClient(notebook, timeout=120, kernel_name="python3", resources=folder).execute()
nbformat.write(notebook, sys.argv[3])
"""


def cells(notebook):
    return [(cell.cell_type, cell.source) for cell in notebook.cells]


def test_there_are_seven_and_each_is_paired():
    assert [path.stem[:2] for path in NOTEBOOKS] == list(PICTURES)
    assert [path.stem for path in sorted(FOLDER.glob("*.py"))] == [p.stem for p in NOTEBOOKS]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_text_and_notebook_agree_and_are_small(path):
    notebook, text = nbformat.read(path, as_version=4), jupytext.read(path.with_suffix(".py"))
    assert cells(notebook) == cells(text), f"run jupytext --sync {path.name}"
    assert path.stat().st_size < LARGEST
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert outputs and not [
        o for o in outputs if o.output_type == "error" or o.get("name") == "stderr"
    ]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs_in_a_fresh_kernel(path, tmp_path):
    executed = tmp_path / "executed.ipynb"
    environment = os.environ | {"IPYTHONDIR": str(tmp_path), "PYTHONPATH": str(FOLDER.parent)}
    done = subprocess.run(
        [sys.executable, "-c", RUN, path, FOLDER, executed],
        env=environment,
        capture_output=True,
        text=True,
        timeout=180,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    outputs = [o for c in nbformat.read(executed, 4).cells for o in c.get("outputs", [])]
    told = [o.text for o in outputs if o.get("name") == "stderr"]
    assert told == [], "a notebook must not warn"
    pictures = [o for o in outputs if any(k.startswith("image/") for k in o.get("data", {}))]
    assert len(pictures) >= PICTURES[path.stem[:2]]
    if path.stem.startswith("02"):
        widgets = [o for o in outputs if "widget-view" in " ".join(o.get("data", {}))]
        assert widgets, "with a live kernel there are sliders"


def test_they_call_the_package_only():
    for path in FOLDER.glob("*.py"):
        imported = set(re.findall(r"^(?:from|import) (\w+)", path.read_text("utf-8"), re.MULTILINE))
        known = {"dataclasses", "jax", "jaxblur", "numpy", "optax", "pathlib", "tempfile", "time"}
        # That of the photograph is matplotlib's.
        known |= {"matplotlib"} if path.stem.startswith("07") else set()
        assert imported <= known, path.name
