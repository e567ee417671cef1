"""Processes of ``jaxblur blur`` that are killed: nothing is lost, nothing is done twice."""

import contextlib
import importlib
import os
import re
import subprocess
import sys
import time

import pytest

from tests.command_line import run

pytestmark = pytest.mark.slow

kills = importlib.import_module("experiments.009_throughput.kills")

FEW = ("--filter", "guertin2014", "--samples", "3", "--radius", "8")
SLOW = """
import os, time
rename = os.replace
renamed = []

def rename_slowly(*paths, **options):
    time.sleep(0.1)
    frame = "out." in str(paths[1])
    while frame and len(renamed) > 2 and os.path.exists(os.environ.get("STOP", "")):
        time.sleep(0.01)
    rename(*paths, **options)
    renamed.extend(paths[1:] * frame)

os.replace = rename_slowly
"""


@pytest.fixture(autouse=True)
def slow_writes(tmp_path, monkeypatch):
    """Processes that a test starts write slowly, so that they can be caught at it."""
    folder = tmp_path / "slow"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(SLOW)
    paths = [str(folder), os.environ.get("PYTHONPATH")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))


def undisturbed_and_again(path, count, size):
    """Frames that are blurred, a second folder, and the command that would fill that one too."""
    pattern = kills.make_frames(path, count, size)
    outputs = path / "undisturbed", path / "disturbed"
    commands = []
    for output in outputs:
        output.mkdir()
        commands.append(("blur", str(pattern), "-o", str(output / "out.####.exr"), *FEW))
    assert run(*commands[0]).status == 0
    return outputs, [sys.executable, "-m", "jaxblur", *commands[1]]


def test_killed_at_random_and_started_again_it_is_as_if_undisturbed(tmp_path):
    outputs, again = undisturbed_and_again(tmp_path, 40, (60, 80))
    seen = kills.run_with_kills(again, outputs[1], 2, seed=1)
    assert 0 < seen[-1] < 40, "it was killed while it worked"
    assert kills.differences(*outputs) == []
    assert len(list(outputs[1].iterdir())) == 40


def test_what_a_farm_ends_leaves_whole_frames_only(tmp_path):
    outputs, again = undisturbed_and_again(tmp_path, 20, (60, 80))
    # After three frames the process waits with the others until it has its signal.
    (stop := tmp_path / "stop").touch()
    environment = os.environ | {"STOP": str(stop)}
    with subprocess.Popen(again, stderr=subprocess.PIPE, text=True, env=environment) as process:
        while process.poll() is None and not list(outputs[1].glob("out.*")):
            time.sleep(0.001)
        process.terminate()
        time.sleep(0.5)
        stop.unlink()
        _, lines = process.communicate(timeout=300)
    assert process.returncode == 143 and "interrupted" in lines.splitlines()[-1], lines
    left = sorted(outputs[1].iterdir())
    assert 0 < len(left) < 20, "it was ended while it worked"
    for path in left:
        assert path.read_bytes() == (outputs[0] / path.name).read_bytes()
    assert subprocess.run(again, check=False, capture_output=True).returncode == 0
    assert kills.differences(*outputs) == []


def dask_workers(psutil, process):
    """Those children of a process that Dask spawned; what they start looks alike for a moment."""
    found = []
    for child in psutil.Process(process).children():
        # A compiler may have come and gone.
        with contextlib.suppress(psutil.NoSuchProcess):
            if "spawn_main" in " ".join(child.cmdline()):
                found.append(child)
    return found


def test_a_worker_that_dies_loses_nothing_and_doubles_nothing(tmp_path):
    psutil = pytest.importorskip("psutil", reason="comes with Dask")
    outputs, again = undisturbed_and_again(tmp_path, 60, (120, 160))
    local = [*again, "--scheduler", "local"]
    with subprocess.Popen(local, stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None and not list(outputs[1].glob("out.*")):
            time.sleep(0.001)
        workers = dask_workers(psutil, process.pid)
        workers[0].kill()
        before = len(list(outputs[1].glob("out.*")))
        _, lines = process.communicate(timeout=300)
    assert len(workers) == 2 and before < 60
    assert process.returncode == 0, lines
    done = re.findall(r"frame (\d+) ok", lines)
    assert sorted(map(int, done)) == list(range(1, 61))
    assert lines.count("color: R, G, B") == 1, "what every frame says is said once"
    assert kills.differences(*outputs) == []
