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


_held: list[int] | None = None
"""Signals that arrived while interruptions are held back; None if they are not."""


def _deliver(number: int, _: Any) -> None:
    """Raise KeyboardInterrupt for a signal, now or at the end of `held_back`."""
    if _held is None:
        raise KeyboardInterrupt
    _held.append(number)


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Delay an interruption to the end of the block; one during an import can crash the modules.

    Raises:
        KeyboardInterrupt: there was one.
    """
    global _held
    if threading.current_thread() is not threading.main_thread() or _held is not None:
        yield
        return
    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    _held = came = []
    if usual:
        signal.signal(signal.SIGINT, _deliver)
    try:
        yield
    finally:
        if usual:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        _held = None
    if came:
        raise KeyboardInterrupt


@contextlib.contextmanager
def with_termination() -> Iterator[list[int]]:
    """Handle SIGTERM, with which farms end a job, like Ctrl-C.

    Works where Ctrl-C does not: background jobs of a shell script inherit SIGINT as ignored.

    Yields:
        A list that is not empty once the signal has arrived.
    """
    came: list[int] = []
    usual = signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if not usual or threading.current_thread() is not threading.main_thread():
        yield came
        return

    def interrupt(number: int, frame: Any) -> None:
        came.append(number)
        _deliver(number, frame)

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
        return
    # Unlike `_thread.interrupt_main` a signal also ends a wait of the main thread.
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    signal.pthread_kill(main, signal.SIGTERM if ignored else signal.SIGINT)
