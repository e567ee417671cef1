"""Load jax, after every check that does not need it."""

import atexit
import functools
import gc
import logging
import os

from jaxblur._util.cache import UnsafeFolderError, private_folder, remove_bad_entries, trim_cache

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


def start_jax(compile_cache: bool) -> None:
    """Import jax and let it keep compiled code between runs.

    A cache folder that cannot be used, or that others can change, is a warning: the run is slower,
    not wrong.

    Args:
        compile_cache: keep compiled code in `jaxblur._util.cache.private_folder`.
    """
    # The C++ part of jax logs messages about cached code that a user can do nothing about.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
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
