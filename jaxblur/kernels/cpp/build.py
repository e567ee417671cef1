"""Compile kernels, keep them between runs, and make them known to XLA."""

import atexit
import contextlib
import ctypes
import functools
import hashlib
import json
import logging
import os
import pathlib
import shutil
import subprocess
import tempfile
import threading
import time
from typing import NamedTuple

import jax
import jaxlib.version

from ..._util.cache import (
    BUILDING,
    UnsafeFolderError,
    checksum_file,
    intact_bytes,
    is_intact,
    keep_bytes,
    private_folder,
    trim_cache,
)
from ..._util.compiler import NO_COMPILER, ZIG_CACHES, find_compiler, machine_words, run_command

LOG = logging.getLogger("jaxblur")
FLAGS = (
    *("-O3", "-std=c++17", "-shared", "-fPIC", "-fwrapv", "-fno-math-errno", "-fno-trapping-math"),
    *("-fno-exceptions", "-fno-rtti", "-Wno-psabi"),
)
MORE_FLAGS = "JAXBLUR_KERNEL_FLAGS"
"""Environment variable; its words are added to `FLAGS`: sanitizers, less optimization."""
# Tried in this order: compilers differ in the flag for "this machine".
MACHINE_FLAGS = (("-march=native",), ("-mcpu=native",), ())

TIME_LIMIT = 300
"""Seconds that the compiler has for one program; the largest take about ten."""
LEFT_OVER = 2 * len(MACHINE_FLAGS) * TIME_LIMIT
"""Seconds after which a folder of a compilation belongs to a process that was killed."""

_ONE_AT_A_TIME = threading.Lock()
_keeps_kernels = True
_said = False
"""Whether this process has said that it compiles."""
_failures: "dict[tuple[str, str], BuildFailed]" = {}
"""Why the compiler refused a program, by compiler and program; any program if that is empty."""


class BuildFailed(Exception):
    """The compiler refused a kernel."""


@functools.cache
def _machine() -> str:
    """The machine and the software that kernels are compiled for and by."""
    return "\n".join([jax.__version__, jaxlib.version.__version__, *machine_words(find_compiler())])


def _folder() -> pathlib.Path:
    """The folder of kernels; a temporary one if they are not kept, or others could change it."""
    if not _keeps_kernels:
        return _temporary_folder()
    try:
        return private_folder("kernels")
    except UnsafeFolderError as error:
        _warn_once(str(error))
        return _temporary_folder()


@functools.cache
def _warn_once(reason: str) -> None:
    LOG.warning("native code is not kept between runs: %s", reason)


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


def _flags() -> tuple[str, ...]:
    return (*FLAGS, *os.environ.get(MORE_FLAGS, "").split())


def _compile(source: str, library: pathlib.Path) -> None:
    """Compile in a folder of its own, then rename: no process ever sees half a library.

    Raises:
        BuildFailed: with the compiler's words, or since it took too long; a program refused once is
            refused again, and a compiler that takes too long is not asked again.
        OSError: the disk refused.
    """
    compiler = find_compiler()
    if compiler is None:
        raise BuildFailed(NO_COMPILER)
    name = " ".join(compiler.command)
    for known in ((name, source), (name, "")):
        if known in _failures:
            raise _failures[known]
    _remove_left_over(library.parent)
    with tempfile.TemporaryDirectory(prefix=BUILDING, dir=library.parent) as folder:
        program = pathlib.Path(folder, "kernel.cc")
        program.write_text(source, encoding="utf-8")
        built = program.with_suffix(".so")
        environment = os.environ | dict.fromkeys(ZIG_CACHES, folder)
        words = ""
        for machine in MACHINE_FLAGS:
            command = [*compiler.command, *_flags(), *compiler.flags, *machine]
            command += [f"-I{jax.ffi.include_dir()}", "-o", os.fspath(built), os.fspath(program)]
            try:
                done = run_command([*command, "-lm", "-lpthread"], TIME_LIMIT, environment)
            except subprocess.TimeoutExpired as error:
                failure = BuildFailed(
                    f"the C++ compiler {name} took more than {TIME_LIMIT} s for a kernel"
                )
                _failures[name, ""] = failure
                raise failure from error
            if done.returncode == 0:
                _keep(built, library)
                if _keeps_kernels:
                    trim_cache()
                return
            words = done.stderr
    error = _first_error(words)
    failure = BuildFailed(f"the C++ compiler {name} refused a kernel: {error}")
    _failures[name, source] = failure
    raise failure


def _keep(built: pathlib.Path, library: pathlib.Path) -> None:
    """Move a library to its place, with its checksum beside it; both are whole on disk first."""
    checksum = built.with_suffix(".sha256")
    checksum.write_text(hashlib.sha256(built.read_bytes()).hexdigest())
    for path in (built, checksum):
        # The linker's file has the permissions that the umask leaves.
        path.chmod(0o700)
        with path.open("rb") as file:
            os.fsync(file.fileno())
    os.replace(checksum, checksum_file(library))
    os.replace(built, library)


def _remove_left_over(folder: pathlib.Path) -> None:
    """Remove the folders of compilations whose processes were killed."""
    for path in folder.glob(f"{BUILDING}*"):
        if time.time() - _made(path) > LEFT_OVER and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)


def _made(path: pathlib.Path) -> float:
    """When a folder was made; just now if another process has just removed it."""
    try:
        return path.lstat().st_mtime
    except FileNotFoundError:
        return time.time()


def forget_failures() -> None:
    """Ask the compiler again for programs that it has refused."""
    _failures.clear()


def _first_error(words: str) -> str:
    """The line of a compiler's output that says the error."""
    lines = words.strip().splitlines() or ["it printed nothing"]
    return next((line for line in lines if "error" in line), lines[0])


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
    key = hashlib.sha256("\n".join([_machine(), *_flags(), source]).encode()).hexdigest()[:24]
    name = f"jaxblur_sum_{key}"
    library = _folder() / f"{name}.so"
    try:
        if not is_intact(library):
            _say_once()
            LOG.debug("%s", library)
            _compile(source.replace("@NAME@", name), library)
        _load(name, library)
    except (OSError, AttributeError) as error:
        raise BuildFailed(f"{library}: {error}") from error
    return name


_loaded: set[str] = set()
"""Names that XLA knows; it accepts a name once in a process."""


def _load(name: str, library: pathlib.Path) -> None:
    """Make a kernel known to XLA.

    Raises:
        OSError: the library cannot be loaded.
        AttributeError: it holds another function.
    """
    if name not in _loaded:
        function = getattr(ctypes.CDLL(os.fspath(library)), name)
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(function), platform="cpu")
        _loaded.add(name)


class Known(NamedTuple):
    """A kernel that is registered.

    Attributes:
        target: its name for `jax.ffi.ffi_call`.
        planes: number of results of a pixel.
        is_image: whether they are the channels of one image, or a plane each.
    """

    target: str
    planes: int
    is_image: bool


@functools.cache
def _engine() -> str | None:
    """A checksum of the code that prints kernels; None where it is not in files."""
    digest = hashlib.sha256()
    try:
        for path in sorted(pathlib.Path(__file__).parents[1].rglob("*")):
            if path.suffix in (".py", ".cc", ".h"):
                digest.update(path.read_bytes())
    except OSError:
        return None
    return digest.hexdigest()


def _record_of(key: str) -> pathlib.Path | None:
    """The file that says which library holds the kernel of a key."""
    engine = _engine()
    if engine is None:
        return None
    words = "\n".join([_machine(), *_flags(), engine, key])
    return _folder() / f"jaxblur_{hashlib.sha256(words.encode()).hexdigest()[:24]}.json"


def find_known(key: str | None) -> Known | None:
    """A kernel that this run or a former one has printed and compiled, registered.

    Args:
        key: see `jaxblur.kernels.keys`.

    Returns:
        The kernel; None where there is none, or its library is not as it was compiled.
    """
    record = None if key is None else _record_of(key)
    if record is None:
        return None
    with _ONE_AT_A_TIME:
        try:
            if (words := intact_bytes(record)) is None:
                return None
            known = Known(*json.loads(words))
            library = record.with_name(f"{known.target}.so")
            if known.target not in _loaded:
                if not is_intact(library):
                    return None
                _load(known.target, library)
        except (OSError, ValueError, TypeError, AttributeError):
            return None
    return known


def keep_known(key: str | None, known: Known) -> None:
    """Keep under a key which library holds a kernel.

    Args:
        key: see `jaxblur.kernels.keys`.
        known: the kernel.
    """
    record = None if key is None else _record_of(key)
    if record is None:
        return
    # What cannot be written is printed again in the next run.
    with contextlib.suppress(OSError):
        keep_bytes(record, json.dumps(known).encode())
