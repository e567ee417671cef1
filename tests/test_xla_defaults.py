"""Filters, native code and gradients where XLA compiles as it does for users.

The other tests let it compile fast (tests/conftest.py).
"""

import os
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parents[1]
TESTS = {
    # One frame for each filter in float64, which XLA computes.
    "tests/test_filters.py": "plain_loops and (shape0 or shape60 or shape64) or vmap_equals",
    "tests/test_native.py": "size0 or size4",
    "tests/test_filter_gradients.py": "kink or second_derivatives",
}
"""Expressions of pytest that choose tests by file."""


@pytest.mark.slow
@pytest.mark.parametrize("file", TESTS)
def test_passes_as_xla_compiles_for_users(file):
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", file, "-k", TESTS[file]],
        env=os.environ | {"XLA_FLAGS": ""},
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    )
    assert done.returncode == 0 and " passed" in done.stdout, done.stdout
