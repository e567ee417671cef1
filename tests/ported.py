"""Runs printed filters, for tests."""

import ctypes
import pathlib
import shutil
import subprocess

import numpy as np
import pytest

FLAGS = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]


def run_c(graph, text, folder, planes, parameters=None):
    """Compile a filter that was printed as C, and run it on planes by name."""
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        pytest.skip("needs a C compiler: apt install gcc")
    name = f"jaxblur_{graph.filter.name}"
    folder = pathlib.Path(folder)
    (folder / f"{name}.h").write_text(text.header)
    (folder / f"{name}.c").write_text(text.source)
    library = folder / f"{name}.so"
    arguments = [compiler, *FLAGS, "-o", library, folder / f"{name}.c", "-lm"]
    subprocess.run(arguments, check=True, cwd=folder)
    loaded = ctypes.CDLL(str(library))
    height, width = planes["color"].shape[:2]
    scratch_bytes = getattr(loaded, f"{name}_scratch_bytes")
    scratch_bytes.restype = ctypes.c_size_t
    # Rubbish in the working memory must not matter.
    scratch = np.full(scratch_bytes(width, height) + 4, 0x7F, np.uint8)
    out = np.full((height, width, graph.channels), np.nan, np.float32)
    values = None
    if parameters is not None:
        values = (ctypes.c_float * len(parameters))(*parameters)
    given = [np.ascontiguousarray(planes[buffer.name], np.float32) for buffer in graph.inputs]
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (*given, out, scratch)]
    assert getattr(loaded, name)(values, width, height, *pointers) == 0
    return out
