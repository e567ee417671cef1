"""An interrupted sequence says in one line how to go on, and that is true."""

import importlib
import os
import re
import signal
import subprocess
import sys
import time

import pytest

from jaxblur.cli import blurring
from tests.command_line import refused, run

kills = importlib.import_module("experiments.009_throughput.kills")

FEW = ("--filter", "guertin2014", "--samples", "3", "--radius", "8")


@pytest.fixture
def shot(tmp_path):
    """A folder for the outputs of five frames, and the arguments that blur them."""
    pattern, out = kills.make_frames(tmp_path, 5, (12, 16)), tmp_path / "out"
    out.mkdir()
    return out, ("blur", pattern, "-o", out / "out.####.exr", *FEW)


@pytest.fixture
def interrupted(monkeypatch):
    """Interrupts a command in its third frame; returns the last line."""
    blur = blurring.blur

    def run_interrupted(*command):
        count = []

        def interrupt(*arguments):
            count.append(1)
            if len(count) == 3:
                raise KeyboardInterrupt
            return blur(*arguments)

        with monkeypatch.context() as patch:
            patch.setattr(blurring, "blur", interrupt)
            outcome = run(*command)
        assert outcome.status == 130
        return outcome.err.splitlines()[-1]

    return run_interrupted


def test_the_same_command_continues(shot, interrupted):
    out, command = shot
    message = interrupted(*command)
    found = re.search(r"interrupted; (\d) of 5 frames are written; the same command con", message)
    assert found is not None and int(found[1]) == len(list(out.iterdir()))
    assert f"{found[1]} kept" in run(*command).out


def test_with_overwrite_it_depends_on_what_is_left(shot, interrupted):
    _, command = shot
    assert run(*command, "--samples", "5").status == 0
    message = interrupted(*command, "--overwrite")
    assert "of 5 frames are written; the same command starts again, since only --over" in message
    assert "made with other parameters" in refused(*command)
    assert run(*command, "--overwrite").status == 0
    message = interrupted(*command, "--overwrite")
    assert message.endswith("the same command without --overwrite continues from there")
    assert "5 kept" in run(*command).out


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_workers_on_this_machine_end_without_a_word(tmp_path):
    """A terminal sends Ctrl-C to all processes of the command."""
    pytest.importorskip("distributed", reason="comes with Dask")
    pattern, out = kills.make_frames(tmp_path, 300, (60, 80)), tmp_path / "out"
    out.mkdir()
    command = ("blur", pattern, "-o", out / "out.####.exr", *FEW, "--scheduler", "local")
    with subprocess.Popen(
        [sys.executable, "-m", "jaxblur", *command],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        while process.poll() is None and not list(out.glob("out.*")):
            time.sleep(0.005)
        os.killpg(process.pid, signal.SIGINT)
        lines = process.communicate(timeout=60)[1].splitlines()
    assert process.returncode == 130, lines
    assert all(line.startswith("jaxblur: ") for line in lines), lines
    found = re.search(r"error: interrupted; (\d+) of 300 frames are written", lines[-1])
    assert found is not None and int(found[1]) == len(list(out.iterdir())), lines[-1]
