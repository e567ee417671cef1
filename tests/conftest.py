"""Options, shared fixtures, and run-time type checks of the kernels."""

import atexit
import gc
import importlib.util
import mmap
import os
import shutil
import signal
import sys
import tempfile
from pathlib import Path

import jax
import jaxlib
import pytest
from jaxtyping import install_import_hook

# Installed before any import of these modules, so that beartype checks the array annotations.
install_import_hook(
    [
        "jaxblur.filters",
        "jaxblur.metrics",
        "jaxblur.noise",
        "jaxblur.safe_math",
    ],
    "beartype.beartype",
)

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # In the background of a script Ctrl-C is ignored, by this process and by those that it starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)

# JAX makes millions of objects while it traces, and few of them are garbage: with the threshold of
# Python, 700, the search for garbage takes a seventh of the processor time of such a test.
gc.set_threshold(100_000)


def quick_xla() -> str:
    """Flags with which XLA compiles two to five times as fast, and what it makes runs slower."""
    flags = ["--xla_backend_optimization_level=0"]
    library = Path(jaxlib.__file__).with_name("libjax_common.so")
    values = {"xla_cpu_use_fusion_emitters": "false", "xla_cpu_parallel_codegen_split_count": "1"}
    # XLA ends the process at a flag that it does not know.
    with library.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as text:
        flags += [f"--{k}={v}" for k, v in values.items() if text.find(k.encode()) >= 0]
    return " ".join(flags)


if "XLA_FLAGS" not in os.environ:
    # Tests compile far longer than they run. `XLA_FLAGS= JAXBLUR_KERNEL_FLAGS= PJRT_NPROC= pytest`
    # runs as for users; tests/test_xla_defaults.py does so for filters and native code.
    os.environ["XLA_FLAGS"] = quick_xla()

# GCC takes half of the time at this level, and kernels run nearly as fast.
os.environ.setdefault("JAXBLUR_KERNEL_FLAGS", "-Og")

# pytest -n runs a process on each core; more threads would wait for each other. The slow test above
# has several.
os.environ.setdefault("PJRT_NPROC", "1")

COMPILED = "JAX_COMPILATION_CACHE_DIR"
if COMPILED not in os.environ:
    # Programs that several tests compile are compiled once; the processes that pytest and tests
    # start inherit the folder. Set the variable to keep compiled programs between runs.
    folder = tempfile.mkdtemp(prefix="jaxblur_tests_")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ |= {
        COMPILED: folder,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def pytest_addoption(parser):
    parser.addoption(
        "--reference-data",
        type=Path,
        metavar="DIR",
        help="folder of scenes rendered with true motion blur, given with an equals sign; "
        "without it their tests skip",
    )
    parser.addoption(
        "--bpy-python",
        type=Path,
        metavar="PATH",
        help="Python of an environment with the wheel bpy, given with an equals sign; without it "
        "this Python is taken if it has bpy, and the tests in Blender skip if not",
    )


def pytest_configure(config):
    folder = config.getoption("--reference-data")
    if folder is not None and not folder.is_dir():
        raise pytest.UsageError(f"--reference-data: {folder} is not a folder")


@pytest.fixture(scope="session")
def reference_data(request) -> Path:
    """The folder of rendered scenes, one sub-folder each; skips the test where not given."""
    folder = request.config.getoption("--reference-data")
    if folder is None:
        pytest.skip("needs rendered scenes: pass --reference-data=DIR")
    return folder


@pytest.fixture(scope="session")
def bpy_python(request) -> Path:
    """The Python of an environment with bpy; skips the test where there is none."""
    python = request.config.getoption("--bpy-python")
    if python is None:
        if importlib.util.find_spec("bpy") is None:
            pytest.skip("needs Blender as a module: pass --bpy-python=PATH")
        python = Path(sys.executable)
    return python


@pytest.fixture(scope="module", autouse=True)
def forget_compiled_programs():
    """Each compiled program holds memory maps, and the kernel allows 65,530 to a process."""
    yield
    jax.clear_caches()
