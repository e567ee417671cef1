"""Load jax, after every check that does not need it, and limit the cores that are used."""

import atexit
import contextlib
import ctypes
import functools
import gc
import logging
import os
from collections.abc import Iterator
from typing import Any

from jaxblur._util.cache import UnsafeFolderError, private_folder, remove_bad_entries, trim_cache

from .arguments import CommandError, positive_integer
from .interrupts import held_back

LOG = logging.getLogger("jaxblur")


@functools.cache
def _spare_the_collector() -> None:
    """Take imported objects out of the garbage collector's rounds, which slow tracing down.

    Runs once in a process. At exit the objects return to the collector; otherwise libraries report
    leaks.
    """
    gc.freeze()
    atexit.register(gc.unfreeze)


_NO_TRIMMING, _NO_MAPPING, _ONE_ARENA = (-1, -1), (-4, 0), (-8, 1)
"""Arguments of mallopt(3): M_TRIM_THRESHOLD, M_MMAP_MAX and M_ARENA_MAX."""


@functools.cache
def _keep_freed_memory() -> None:
    """Let the GNU C library keep memory that is freed, for every thread to take again.

    Every frame of a sequence needs the same amounts. By itself the library gives large blocks back
    to the system and gets them page by page for the next frame, which takes a tenth of the
    processor time; and it keeps other blocks for threads that do not need them any more.
    """
    try:
        set_option = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        # Another C library, or another system.
        return
    for option in (_NO_TRIMMING, _NO_MAPPING, _ONE_ARENA):
        set_option(*option)


def start_jax(compile_cache: bool) -> None:
    """Import jax and let it keep compiled code between runs.

    A cache folder that cannot be used, or that others can change, is a warning: the run is slower,
    not wrong.

    Args:
        compile_cache: keep compiled code in `jaxblur._util.cache.private_folder`.
    """
    # The C++ part of jax logs messages about cached code that a user can do nothing about.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    _keep_freed_memory()
    with held_back():
        import jax

        from jaxblur.kernels.cpp import keep_kernels

    _spare_the_collector()
    keep_kernels(compile_cache)
    if not compile_cache:
        return
    try:
        folder = private_folder()
    except UnsafeFolderError as error:
        keep_kernels(False)
        LOG.warning("no compile cache: %s; pass --no-compile-cache to silence this", error)
        return
    remove_bad_entries()
    trim_cache()
    jax.config.update("jax_compilation_cache_dir", os.fspath(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)


def add_threads_option(parser: Any) -> None:
    """Add the option for the number of cores; `limited_threads` takes it."""
    parser.add_argument(
        "--threads",
        type=positive_integer,
        metavar="N",
        help="processor cores that reading, filter and writing use together (default all; Linux "
        "only)",
    )


@contextlib.contextmanager
def limited_threads(count: int | None) -> Iterator[None]:
    """Keep all threads of this process, and processes that it starts, on some cores.

    Libraries start threads of their own, of which not all heed a setting; the system does.

    Args:
        count: number of cores; None for no limit.

    Raises:
        CommandError: the system cannot do that.
    """
    if count is None:
        yield
        return
    if not hasattr(os, "sched_setaffinity"):
        raise CommandError("--threads: this system has no such limit; leave it out.")
    import OpenImageIO as oiio

    before, threads = os.sched_getaffinity(0), oiio.get_int_attribute("threads")
    _keep_on(set(sorted(before)[:count]))
    oiio.attribute("threads", min(count, threads or count))
    try:
        yield
    finally:
        oiio.attribute("threads", threads)
        _keep_on(before)


def _keep_on(cores: set[int]) -> None:
    """Move every thread of this process; those that they start stay there too."""
    for thread in map(int, os.listdir("/proc/self/task")):
        # It may have ended.
        with contextlib.suppress(ProcessLookupError):
            os.sched_setaffinity(thread, cores)
