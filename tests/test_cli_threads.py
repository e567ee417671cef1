"""``jaxblur blur --threads``."""

import os
from concurrent.futures import ThreadPoolExecutor

import OpenImageIO as oiio
import pytest

from jaxblur.cli.compute import limited_threads
from tests.command_line import refused, spawn
from tests.exr_files import CUBE

pytestmark = pytest.mark.skipif(
    not hasattr(os, "sched_setaffinity") or len(os.sched_getaffinity(0)) < 2,
    reason="needs Linux and two cores",
)


def cores():
    return len(os.sched_getaffinity(0))


def test_threads_that_run_and_that_start_are_limited():
    usual, threads = cores(), oiio.get_int_attribute("threads")
    with ThreadPoolExecutor(1) as old:
        assert old.submit(cores).result() == usual
        with limited_threads(1):
            with ThreadPoolExecutor(1) as new:
                assert [pool.submit(cores).result() for pool in (old, new)] == [1, 1]
            assert oiio.get_int_attribute("threads") == 1
        assert old.submit(cores).result() == cores() == usual
    assert oiio.get_int_attribute("threads") == threads
    with limited_threads(None):
        assert cores() == usual


def test_the_command_uses_one_core(tmp_path):
    code = (
        "import os, sys; from jaxblur.cli import main; from jaxblur.cli.commands import blur\n"
        "run = blur.blur_single\n"
        "def counted(*given):\n"
        "    status = run(*given)\n"
        "    threads = os.listdir('/proc/self/task')\n"
        "    print(len(threads), max(len(os.sched_getaffinity(int(t))) for t in threads))\n"
        "    return status\n"
        "blur.blur_single = counted; sys.exit(main(sys.argv[1:]))"
    )
    options = ("--threads", "1", "--samples", "5", "--radius", "20", "--no-compile-cache")
    simple = ("--filter", "pixel_velocity")
    outcome = spawn("blur", CUBE, "-o", tmp_path / "o.exr", *options, *simple, code=code)
    assert outcome.returncode == 0, outcome.stderr
    count, most = map(int, outcome.stdout.split()[-2:])
    assert count > 1 and most == 1


def test_refusals(tmp_path):
    assert "--threads" in refused("blur", CUBE, "-o", tmp_path / "o.exr", "--threads", "0")
