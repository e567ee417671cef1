"""Native kernels compiled with AddressSanitizer and UndefinedBehaviorSanitizer, in child processes.

Kernels read tables at promised places, so that an error in them shows in no result. Here every
array has a block of memory of its own, and a read outside ends the process with a report. Signed
overflow, which kernels define by -fwrapv, is reported too: no index may need it.
"""

import concurrent.futures
import functools
import os
import pathlib
import subprocess
import sys

import pytest

from jaxblur.kernels.cpp import build
from tests.sanitized import CASES

pytestmark = pytest.mark.slow

ROOT = pathlib.Path(__file__).parents[1]
TESTS = {
    "tests/test_kernels_operations.py": "table or neighbors or loop or limit or reads or integers",
    "tests/test_kernels_marks.py": "native",
}
"""Expressions of pytest that choose tests by file: those that read, mark and add most."""
FLAGS = (
    *("-O0", "-g1", "-fno-omit-frame-pointer", "-fno-wrapv", "-DSANITIZED"),
    *("-fsanitize=address,undefined", "-fno-sanitize-recover=undefined"),
)
PROGRAMS = (*CASES, "neighbors")
START = """
import os, runpy, sys
del os.environ["LD_PRELOAD"]
del sys.argv[0]
runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
"""
"""Runs a module as python -m does; compilers that it starts are faster without the libraries."""


@functools.cache
def library(name):
    """Path of a library of the compiler, None if it has none."""
    compiler = build.find_compiler()
    # With the flags of ziglang there are no libraries of sanitizers.
    if sys.platform != "linux" or compiler is None or compiler.flags:
        return None
    command = [*compiler.command, f"-print-file-name={name}"]
    path = subprocess.run(command, capture_output=True, text=True).stdout.strip()
    return path if os.path.isabs(path) else None


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory):
    """Environment of a process whose kernels are checked."""
    if library("libasan.so") is None:
        pytest.skip("needs a C++ compiler with libasan.so (Linux, GCC)")
    folder = tmp_path_factory.mktemp("cache")
    folder.chmod(0o700)
    libraries = filter(None, map(library, ("libasan.so", "libubsan.so", "libstdc++.so")))
    return os.environ | {
        build.MORE_FLAGS: " ".join(FLAGS),
        "LD_PRELOAD": " ".join(libraries),
        # Python never frees some of its memory; no traces of allocations save time.
        "ASAN_OPTIONS": ":".join(
            ("detect_leaks=0", "halt_on_error=1", "malloc_context_size=0", "quarantine_size_mb=16")
        ),
        "UBSAN_OPTIONS": "halt_on_error=1:print_stacktrace=1",
        "XDG_CACHE_HOME": str(folder),
    }


def run(environment, *arguments):
    return subprocess.run(
        [sys.executable, "-c", START, *arguments],
        env=environment,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    )


@pytest.mark.parametrize(
    ("program", "report"),
    [
        ("read-past-the-end", "AddressSanitizer: heap-buffer-overflow"),
        ("overflow", "runtime error: signed integer overflow"),
        ("nothing", None),
    ],
)
def test_a_wrong_kernel_is_reported(sanitized, program, report):
    done = run(sanitized, "tests.sanitized", program)
    assert (done.returncode != 0) == (report is not None), done.stdout
    assert report is None or report in done.stdout


def test_native_code_does_nothing_undefined(sanitized):
    jobs = {name: ("tests.sanitized", name) for name in PROGRAMS}
    pytest_ = ("pytest", "-s", "-q", "-p", "no:cacheprovider")
    jobs |= {file: (*pytest_, file, "-k", which) for file, which in TESTS.items()}
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        done = dict(
            zip(jobs, pool.map(lambda job: run(sanitized, *job), jobs.values()), strict=True)
        )
    wrong = [f"{name}:\n{one.stdout}" for name, one in done.items() if one.returncode]
    assert not wrong, "\n\n".join(wrong)
    assert all("(5, 17)" in done[name].stdout for name in PROGRAMS)
    assert all(" passed" in done[file].stdout for file in TESTS)
