"""Memory that the command line frees stays with its process."""

import platform
import subprocess
import sys

import pytest

from jaxblur.cli import compute

FAULTS = """
import resource, sys
import numpy as np
from jaxblur.cli import compute

if sys.argv[1] == "kept":
    compute._keep_freed_memory()
for _ in range(3):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.full(1 << 26, 1, np.uint8)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(way):
    command = [sys.executable, "-c", FAULTS, way]
    return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="needs the GNU C library")
def test_a_block_that_was_freed_is_not_fetched_page_by_page_again():
    assert faults("kept") < 10
    assert faults("given back") > 10


def test_another_c_library_goes_without(monkeypatch):
    asked = []

    def without_option(name):
        asked.append(name)
        return object()

    monkeypatch.setattr(compute.ctypes, "CDLL", without_option)
    compute._keep_freed_memory.__wrapped__()
    assert asked == [None]
