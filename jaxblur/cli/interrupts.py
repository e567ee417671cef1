"""Ctrl-C and SIGTERM end a command cleanly at any time."""

import _thread
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any

_SOON = 0.01
"""Seconds after which an interruption is repeated."""


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Delay an interruption to the end of the block; one during an import can crash the modules.

    Raises:
        KeyboardInterrupt: there was one.
    """
    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not usual or threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if came:
        raise KeyboardInterrupt


@contextlib.contextmanager
def with_termination() -> Iterator[list[int]]:
    """Handle SIGTERM, with which farms end a job, like Ctrl-C.

    Yields:
        A list that is not empty once the signal has arrived.
    """
    came: list[int] = []
    usual = signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if not usual or threading.current_thread() is not threading.main_thread():
        yield came
        return

    def interrupt(number: int, _: Any) -> None:
        came.append(number)
        signal.raise_signal(signal.SIGINT)

    signal.signal(signal.SIGTERM, interrupt)
    try:
        yield came
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextlib.contextmanager
def never_lost() -> Iterator[None]:
    """Repeat an interruption that arrived where exceptions are lost, as in callbacks of jax."""
    report = sys.unraisablehook

    def hook(unraisable: Any) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            threading.Timer(_SOON, _interrupt).start()
        else:
            report(unraisable)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = report


def _interrupt() -> None:
    """Interrupt the main thread, from another one."""
    main = threading.main_thread().ident
    if os.name == "nt" or main is None:
        _thread.interrupt_main()
    else:
        # Unlike `_thread.interrupt_main` it also ends a wait of the main thread.
        signal.pthread_kill(main, signal.SIGINT)
