"""Progress of a sequence: a bar with rate and time left, or, without a terminal, a line a frame."""

import contextlib
import logging
import sys
import threading
from collections.abc import Iterator
from typing import Any

LOG = logging.getLogger("jaxblur")

_HERE = threading.local()


@contextlib.contextmanager
def about_frame(frame: int) -> Iterator[None]:
    """Mark the log records of this thread as being about a frame, for `FrameMessages`."""
    _HERE.frame = frame
    try:
        yield
    finally:
        del _HERE.frame


class FrameMessages(logging.Filter):
    """Passes a message that repeats for every frame once, and names the frame in warnings."""

    def __init__(self) -> None:
        super().__init__()
        self._said: set[str] = set()

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to pass a record; warnings get the frame's number."""
        frame = getattr(_HERE, "frame", None)
        if frame is None or record.levelno == logging.DEBUG:
            return True
        text = record.getMessage()
        if record.levelno >= logging.WARNING:
            record.msg, record.args = f"frame {frame}: {text}", ()
            return True
        if text in self._said:
            return False
        self._said.add(text)
        return True


@contextlib.contextmanager
def frame_messages() -> Iterator[None]:
    """Filter log records by `FrameMessages`."""
    messages = FrameMessages()
    LOG.addFilter(messages)
    try:
        yield
    finally:
        LOG.removeFilter(messages)


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
        LOG.info("%s [%d/%d, %d%%]", text, count, total, 100 * count // total)

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
