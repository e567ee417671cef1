"""Filters, native code and gradients, compiled as for users, on all cores.

The other tests let XLA and the C++ compiler compile fast, and run on one (tests/conftest.py).
"""

import os
import pathlib
import subprocess
import sys

import pytest

from jaxblur.kernels.cpp import build

ROOT = pathlib.Path(__file__).parents[1]
TESTS = {
    # One frame for each filter in float64, which XLA computes.
    "tests/test_filters.py": "plain_loops and (shape0 or shape60 or shape64) or vmap_equals",
    "tests/test_native.py": "size0 or size4",
    "tests/test_filter_gradients.py": "pixel_velocity and kink",
}
"""Expressions of pytest that choose tests by file."""


@pytest.mark.slow
@pytest.mark.parametrize("file", TESTS)
def test_passes_as_for_users(file):
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", file, "-k", TESTS[file]],
        env=os.environ | {"XLA_FLAGS": "", build.MORE_FLAGS: "", "PJRT_NPROC": ""},
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    )
    assert done.returncode == 0 and " passed" in done.stdout, done.stdout
