"""Commands in a process of their own: limits of memory and time, crashes."""

import subprocess
import sys

import numpy as np
import OpenImageIO as oiio
import pytest

from jaxblur import exr
from jaxblur.cli import isolation
from jaxblur.cli.errors import message_of
from tests.command_line import refused, run, spawn
from tests.exr_files import CAR, plain_frame, read_raw, write_single


@pytest.fixture(scope="module")
def bomb(tmp_path_factory):
    """A file of 0.4 MB that declares 640 MB of pixels."""
    path = str(tmp_path_factory.mktemp("bomb") / "bomb.exr")
    spec = oiio.ImageSpec(8000, 8000, 5, "half")
    spec.channelnames = ("R", "G", "B", "velocity.X", "velocity.Y")
    spec.attribute("compression", "zip")
    output = oiio.ImageOutput.create(path)
    rows = np.zeros((500, 8000, 5), np.float16)
    assert output is not None and output.open(path, spec)
    for row in range(0, 8000, 500):
        assert output.write_scanlines(row, row + 500, 0, rows)
    assert output.close()
    return path


@pytest.mark.slow
def test_the_output_is_that_of_the_command(tmp_path):
    assert spawn("info", CAR, "--isolate").stdout == run("info", CAR).out
    commands = [
        ("blur", CAR, "-o", tmp_path / name, "--filter", "pixel_velocity", "--no-compile-cache")
        for name in ("plain.exr", "isolated.exr")
    ]
    assert spawn(*commands[0]).returncode == spawn(*commands[1], "--isolate").returncode == 0
    plain, isolated = (read_raw(tmp_path / name)[1] for name in ("plain.exr", "isolated.exr"))
    np.testing.assert_array_equal(plain, isolated)


def test_errors_and_statuses_are_those_of_the_command(tmp_path):
    missing = spawn("info", tmp_path / "missing.exr", "--isolate")
    assert missing.returncode == 2
    assert missing.stderr.splitlines() == [
        f"jaxblur: error: {tmp_path / 'missing.exr'}: no such file."
    ]


def test_modules_do_not_come_from_the_working_folder(tmp_path):
    (tmp_path / "resource.py").write_text("print('foreign code')")
    code = "import sys; sys.path.remove(''); from jaxblur.cli import main; sys.exit(main())"
    result = spawn("info", CAR, "--isolate", code=code, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "foreign code" not in result.stdout


@pytest.mark.slow
def test_a_file_that_declares_much_is_listed_within_limits(bomb):
    info = exr.inspect(bomb)
    assert isolation.declares_too_much(info)
    assert not isolation.declares_too_much(exr.inspect(CAR))
    code = (
        "import resource, sys; from jaxblur.cli import main; status = main();"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss); sys.exit(status)"
    )
    result = spawn("info", bomb, code=code)
    assert result.returncode == 0, result.stderr
    assert "8000x8000" in result.stdout and "suggested radius" in result.stdout
    # Four bytes a pixel, 256 MB, and blocks of rows: 496 MB measured.
    assert int(result.stdout.splitlines()[-1]) < 700_000


@pytest.mark.slow
def test_limits_end_the_command_with_a_clear_error(bomb):
    result = spawn("info", bomb, "--time-limit", 1)
    assert result.returncode == 2
    assert f"{bomb}: took more than 1 s of processor time" in result.stderr
    result = spawn("info", bomb, "--memory", 400)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1 and f"error: {bomb}: " in result.stderr


def test_memory_that_the_decoder_lacks_is_called_that():
    """What OpenImageIO says at the limit is the name of a C++ exception."""
    error = exr.JaxblurIOError("a.exr", "part 0: cannot be read: std::bad_alloc")
    assert "out of memory; with --isolate, a larger --memory" in message_of(error)


def test_a_crash_names_the_file(tmp_path):
    path = write_single(tmp_path / "frame.exr", plain_frame((4, 5)))
    code = (
        "import os, signal, sys; from jaxblur.cli import isolation, main;"
        "crash = 'import os; os.kill(os.getpid(), 11)';"
        "isolation.CHILD = crash; sys.exit(main())"
    )
    result = spawn("info", path, "--isolate", code=code)
    assert result.returncode == 2
    assert f"error: {path}: reading it crashed (SIGSEGV)" in result.stderr


def test_a_killed_command_takes_its_child_with_it():
    code = (
        "import sys; from jaxblur.cli import isolation, main;"
        "waiting = 'import time; print(\"waiting\", flush=True); time.sleep(60)';"
        "isolation.CHILD = isolation.CHILD.replace('sys.exit(main(argv))', waiting);"
        "sys.exit(main())"
    )
    command = [sys.executable, "-c", code, "info", str(CAR), "--isolate"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "waiting\n"
        process.kill()
        # The pipe ends when the child, which has it too, is gone.
        process.communicate(timeout=30)


def test_too_little_memory_is_a_wrong_argument():
    assert "expected at least 256 MB" in refused("info", CAR, "--isolate", "--memory", "20")


def test_several_files_are_isolated_each_by_itself(tmp_path):
    missing = tmp_path / "missing.exr"
    outcome = spawn("info", missing, CAR, "--isolate", "--radius", "7")
    assert outcome.returncode == 1
    assert outcome.stdout.strip() == run("info", CAR, "--radius", "7").out.strip()
    assert outcome.stderr == f"jaxblur: error: {missing}: no such file.\n"
