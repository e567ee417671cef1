"""Progress of long commands: bars on a terminal, lines elsewhere.

A sequence shows a bar with rate and time left, or a line a frame. Work in stages, such as a fit,
shows a bar for each stage, or a line as a stage begins and while it goes on.
"""

import contextlib
import logging
import re
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

LOG = logging.getLogger("jaxblur")

SECONDS_BETWEEN_LINES = 10.0
"""For how long work in stages says nothing, at most, where there is no terminal."""

_HERE = threading.local()


@contextlib.contextmanager
def about_frame(frame: int | None) -> Iterator[None]:
    """Mark the log records of this thread as being about a frame, for `messages_once`."""
    _HERE.frame = frame
    try:
        yield
    finally:
        del _HERE.frame


class _Warning(NamedTuple):
    """A warning, the first frame that gave it, and those that gave it later."""

    text: str
    frame: int
    more: set[int]


class _Once(logging.Filter):
    """Passes what repeats once, and names the frame in warnings."""

    def __init__(self) -> None:
        super().__init__()
        self._said: set[str] = set()
        self.warnings: dict[str, _Warning] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to pass a record; warnings get the frame's number."""
        frame, text = getattr(_HERE, "frame", None), record.getMessage()
        if record.levelno == logging.INFO:
            repeats = text in self._said
            self._said.add(text)
            return not repeats
        if frame is None or record.levelno == logging.DEBUG:
            return True
        if record.levelno == logging.WARNING and not LOG.isEnabledFor(logging.DEBUG):
            # The file of a frame, counts and shares differ.
            alike = re.sub(r"\d+", "#", text)
            said = self.warnings.setdefault(alike, _Warning(text, frame, set()))
            if said.frame != frame:
                said.more.add(frame)
                return False
        record.msg, record.args = f"frame {frame}: {text}", ()
        return True


@contextlib.contextmanager
def messages_once() -> Iterator[None]:
    """Pass remarks, and warnings of several frames that are alike but for numbers, once.

    At the end a line says for which other frames a warning is. With ``-v`` all warnings pass.
    """
    from jaxblur.sequence import frame_ranges

    once = _Once()
    LOG.addFilter(once)
    try:
        yield
    finally:
        LOG.removeFilter(once)
        for text, frame, more in once.warnings.values():
            if more:
                LOG.warning(
                    "frame %d and %d more (%s; -v prints each): %s",
                    frame,
                    len(more),
                    frame_ranges(more),
                    text,
                )


@contextlib.contextmanager
def progress(total: int) -> Iterator[Any]:
    """Show progress over a number of frames.

    Args:
        total: number of frames.

    Yields:
        A function of one text, to be called after each frame; a terminal shows a bar instead.
    """
    if sys.stderr.isatty() and LOG.isEnabledFor(logging.INFO):
        with _bar(total) as step:
            yield step
        return
    count = 0

    def line(text: str) -> None:
        nonlocal count
        count += 1
        # Frames are blurred side by side and end in any order: the count is not the frame's number.
        LOG.info("%d of %d done: %s", count, total, text)

    yield line


@contextlib.contextmanager
def _bar(total: int) -> Iterator[Any]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        Task,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text(f"{task.finished_speed or task.speed or 0:.2f} frames/s")

    columns = (
        *(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()),
        *(Rate(), TimeRemainingColumn(), TextColumn("left")),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar, _logging_above():
        task = bar.add_task("frames", total=total)
        yield lambda text: bar.advance(task)


class Stages(Protocol):
    """Shows work that is done in stages."""

    def stage(self, name: str, done: int, total: int) -> None:
        """Show that a stage begins, if its name is another, and how many of its parts are done."""

    def detail(self, text: str) -> None:
        """Show something about the present stage: a line, or the text before its bar."""


@contextlib.contextmanager
def stages() -> Iterator[Stages]:
    """Show work in stages: bars with the time taken on a terminal, lines elsewhere.

    Yields:
        What to call as stages begin and go on. Where lines are printed, a stage that says nothing
        for `SECONDS_BETWEEN_LINES` gives a line by itself.
    """
    if sys.stderr.isatty() and LOG.isEnabledFor(logging.INFO):
        with _bars() as bars:
            yield bars
        return
    lines = _Lines()
    thread = threading.Thread(target=lines.keep_talking, daemon=True)
    thread.start()
    try:
        yield lines
    finally:
        lines.ended.set()
        thread.join()


class _Lines:
    """Stages as lines of the log."""

    def __init__(self) -> None:
        self.ended = threading.Event()
        self._name, self._parts = "starting", ""
        self._began = self._said = time.monotonic()

    def stage(self, name: str, done: int, total: int) -> None:
        self._parts = f" {done} of {total}" if total > 1 else ""
        if name != self._name:
            self._name, self._began = name, time.monotonic()
            self._say(name)
        elif self._idle() > SECONDS_BETWEEN_LINES:
            self._say(f"{name}:{self._parts}")

    def detail(self, text: str) -> None:
        self._say(text)

    def keep_talking(self) -> None:
        """Say from time to time, until the end, what is going on."""
        while not self.ended.wait(SECONDS_BETWEEN_LINES / 10):
            if self._idle() > SECONDS_BETWEEN_LINES:
                seconds = time.monotonic() - self._began
                self._say(f"{self._name}:{self._parts}, {seconds:.0f} s so far")

    def _idle(self) -> float:
        return time.monotonic() - self._said

    def _say(self, text: str) -> None:
        self._said = time.monotonic()
        LOG.info("%s", text.replace(":,", ":"))


@contextlib.contextmanager
def _bars() -> Iterator[Stages]:
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
    )

    class Bars:
        def __init__(self, bar: Progress):
            self._bar, self._task = bar, bar.add_task("starting", total=None)
            self._name = "starting"

        def stage(self, name: str, done: int, total: int) -> None:
            if name != self._name:
                self._close()
                self._name = name
                self._task = self._bar.add_task(name, total=total if total > 1 else None)
            if done:
                self._bar.update(self._task, completed=done, total=total)

        def detail(self, text: str) -> None:
            self._bar.update(self._task, description=f"{self._name}: {escape(text)}")

        def _close(self) -> None:
            """A stage may end before all of its parts are done."""
            done = self._bar.tasks[-1].completed
            self._bar.update(self._task, total=done or 1, completed=done or 1)
            self._bar.stop_task(self._task)

    columns = (
        *(SpinnerColumn(finished_text="+"), TextColumn("{task.description}")),
        *(BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar, _logging_above():
        yield Bars(bar)


@contextlib.contextmanager
def _logging_above() -> Iterator[None]:
    """Send the log to rich's replacement of stderr, which prints above the bar."""
    handlers = [h for h in LOG.handlers if isinstance(h, logging.StreamHandler)]
    before = [handler.setStream(sys.stderr) for handler in handlers]
    try:
        yield
    finally:
        for handler, stream in zip(handlers, before, strict=True):
            if stream is not None:
                handler.setStream(stream)
