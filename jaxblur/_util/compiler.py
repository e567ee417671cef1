"""The C++ compiler: which one, how it is run, and the machine that it compiles for."""

import contextlib
import functools
import importlib.util
import os
import pathlib
import platform
import shutil
import signal
import subprocess
from collections.abc import Mapping, Sequence
from typing import NamedTuple

NO_COMPILER = 'there is no C++ compiler (remedy: pip install "jaxblur[compiler]")'
ZIG_CACHES = ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR")
"""Variables that name the folders where ziglang keeps parts of what it links: the folder of the
compilation, so that a kernel is made of nothing that others could have written."""


class Compiler(NamedTuple):
    """A C++ compiler.

    Attributes:
        command: starts it.
        flags: that it needs beside `FLAGS`.
        version: a command that prints its version.
    """

    command: tuple[str, ...]
    flags: tuple[str, ...]
    version: tuple[str, ...]


def loads_kernels() -> bool:
    """Whether native code can be loaded on this system."""
    return platform.system() in ("Linux", "Darwin")


@functools.cache
def find_compiler() -> Compiler | None:
    """The C++ compiler; None where there is none, or where kernels cannot be loaded.

    It is the first of ``c++``, ``g++`` and ``clang++`` on ``PATH``, else that of the package
    ziglang.
    """
    if not loads_kernels():
        return None
    found = next(filter(None, map(shutil.which, ("c++", "g++", "clang++"))), None)
    if found is not None:
        return Compiler((found,), (), (found, "--version"))
    package = importlib.util.find_spec("ziglang")
    zig = shutil.which("zig", path=os.path.dirname((package and package.origin) or ""))
    if zig is None:
        return None
    # Without these flags it first compiles its C++ library and run-time library, for minutes, and
    # links them into each kernel, which needs neither.
    return Compiler((zig, "c++"), ("-nostdlib", "-lc", "-s"), (zig, "version"))


def machine_words(compiler: Compiler | None) -> list[str]:
    """The machine that code is compiled for, and the compiler.

    Computers that share a home folder, and versions of compilers, do not share compiled code.
    """
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
        kinds = {line for line in lines if line.startswith(("flags", "Features", "model name"))}
    except OSError:
        kinds = {
            platform.processor(),
            *words_of("sysctl", "machdep.cpu.brand_string", "hw.optional"),
        }
    words = [platform.machine(), *sorted(kinds)]
    if compiler is not None:
        words += [*compiler.command, *compiler.flags, *words_of(*compiler.version)]
    return words


def words_of(*command: str) -> list[str]:
    """The lines that a command prints; none if it fails or takes long."""
    try:
        done = run_command(command, limit=10)
    except (OSError, subprocess.SubprocessError):
        return []
    return done.stdout.splitlines()


def run_command(
    command: Sequence[str], limit: float, environment: Mapping[str, str] | None = None
) -> "subprocess.CompletedProcess[str]":
    """Run a command; one that exceeds its time is ended together with the processes it started.

    Args:
        command: it.
        limit: seconds.
        environment: variables; those of this process if None.

    Raises:
        subprocess.TimeoutExpired: it took more than ``limit`` seconds.
    """
    with subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        errors="replace",
        env=environment,
        start_new_session=True,
    ) as process:
        try:
            out, errors = process.communicate(timeout=limit)
        except BaseException:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            raise
    return subprocess.CompletedProcess(command, process.returncode, out, errors)
