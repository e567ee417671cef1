"""Compile kernels, keep them between runs, and make them known to XLA."""

import atexit
import ctypes
import functools
import hashlib
import logging
import os
import pathlib
import platform
import shutil
import subprocess
import tempfile
import threading

import jax

from ..._util.cache import cache_folder

LOG = logging.getLogger("jaxblur")
FLAGS = (
    *("-O3", "-std=c++17", "-shared", "-fPIC", "-fwrapv", "-fno-math-errno", "-fno-trapping-math"),
    *("-fno-exceptions", "-fno-rtti", "-Wno-psabi"),
)
# Tried in this order: compilers differ in the flag for "this machine".
MACHINE_FLAGS = (("-march=native",), ("-mcpu=native",), ())

MOST_KERNELS = 300
"""Kernels that are kept, about 30 KB each; the oldest are removed first."""

_ONE_AT_A_TIME = threading.Lock()
_keeps_kernels = True
_said = False
"""Whether this process has said that it compiles."""
_failures: "dict[tuple[str, str], BuildFailed]" = {}
"""Why the compiler refused a program, by compiler and program."""


class BuildFailed(Exception):
    """The compiler refused a kernel."""


@functools.cache
def find_compiler() -> str | None:
    """Path of a C++ compiler, None where there is none or where kernels cannot be loaded."""
    if platform.system() not in ("Linux", "Darwin"):
        return None
    return next(filter(None, map(shutil.which, ("c++", "g++", "clang++"))), None)


@functools.cache
def _machine() -> str:
    """The machine that kernels are compiled for; computers with one home do not share kernels."""
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
        kinds = {line for line in lines if line.startswith(("flags", "Features", "model name"))}
    except OSError:
        kinds = {platform.processor()}
    return "\n".join([platform.machine(), jax.__version__, find_compiler() or "", *sorted(kinds)])


def _folder() -> pathlib.Path:
    """The folder of kernels, readable by this user only; a temporary one if it cannot be used."""
    if not _keeps_kernels:
        return _temporary_folder()
    try:
        folder = cache_folder() / "kernels"
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        if folder.stat().st_uid == os.getuid() and os.access(folder, os.W_OK):
            return folder
    except (OSError, RuntimeError):
        pass
    return _temporary_folder()


def keep_kernels(keep: bool) -> None:
    """Choose whether kernels outlive this process.

    Args:
        keep: if not, this process makes its own kernels anew and removes them when it ends.
    """
    global _keeps_kernels
    _keeps_kernels = keep


@functools.cache
def _temporary_folder() -> pathlib.Path:
    """A folder that is removed when this process ends."""
    folder = tempfile.mkdtemp(prefix="jaxblur_kernels_")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return pathlib.Path(folder)


def _compile(source: str, library: pathlib.Path) -> None:
    """Compile beside the target, then rename: another process never sees half a library.

    Raises:
        BuildFailed: with the compiler's words; a program refused once is refused again.
    """
    compiler = find_compiler() or "c++"
    if (compiler, source) in _failures:
        raise _failures[compiler, source]
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        program = pathlib.Path(folder, "kernel.cc")
        program.write_text(source, encoding="utf-8")
        built = program.with_suffix(".so")
        words = ""
        for machine in MACHINE_FLAGS:
            command = [compiler, *FLAGS, *machine, f"-I{jax.ffi.include_dir()}"]
            command += ["-o", os.fspath(built), os.fspath(program), "-lm", "-lpthread"]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode == 0:
                os.replace(built, library)
                _forget_old(library.parent)
                return
            words = done.stderr
    error = _first_error(words)
    failure = BuildFailed(f"the C++ compiler {compiler} refused a kernel: {error}")
    _failures[compiler, source] = failure
    raise failure


def forget_failures() -> None:
    """Ask the compiler again for programs that it has refused."""
    _failures.clear()


def _first_error(words: str) -> str:
    """The line of a compiler's output that says the error."""
    lines = words.strip().splitlines() or ["it printed nothing"]
    return next((line for line in lines if "error" in line), lines[0])


def _forget_old(folder: pathlib.Path) -> None:
    """Remove the oldest kernels beyond the number kept; a process that has loaded one keeps it."""
    kernels = sorted(folder.glob("*.so"), key=_made, reverse=True)
    for path in kernels[MOST_KERNELS:]:
        path.unlink(missing_ok=True)


def _made(path: pathlib.Path) -> float:
    """When a file was made; long ago if another process has just removed it."""
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return 0


def register(source: str) -> str:
    """Compile a kernel unless a former run has, load it, and register it with XLA.

    Args:
        source: the program, ``@NAME@`` in place of the function's name.

    Returns:
        Name of the target for `jax.ffi.ffi_call`.

    Raises:
        BuildFailed: the compiler refused it, or its output cannot be loaded.
    """
    with _ONE_AT_A_TIME:
        return _register(source)


def _say_once() -> None:
    global _said
    if not _said:
        LOG.info("compiling native code, once for this kind of run")
    _said = True


@functools.cache
def _register(source: str) -> str:
    """Once for each program of this process."""
    key = hashlib.sha256("\n".join([_machine(), *FLAGS, source]).encode()).hexdigest()[:24]
    name = f"jaxblur_sum_{key}"
    library = _folder() / f"{name}.so"
    try:
        if not library.exists():
            _say_once()
            LOG.debug("%s", library)
            _compile(source.replace("@NAME@", name), library)
        function = getattr(ctypes.CDLL(os.fspath(library)), name)
    except (OSError, AttributeError) as error:
        raise BuildFailed(f"{library}: {error}") from error
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(function), platform="cpu")
    return name
