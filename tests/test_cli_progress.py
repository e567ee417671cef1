"""How far a sequence is, on a terminal and elsewhere."""

import contextlib
import logging
import os
import pty
import re
import sys
import time

import pytest

from jaxblur.cli.progress import LOG, about_frame, messages_once, progress, stages


@pytest.fixture(autouse=True)
def handler(monkeypatch):
    """As the command line logs; on whatever stderr the test chooses."""
    monkeypatch.setattr(LOG, "level", logging.INFO)
    monkeypatch.setattr(LOG, "disabled", False)
    monkeypatch.setattr(LOG, "propagate", False)
    LOG.manager._clear_cache()  # pyright: ignore[reportAttributeAccessIssue]
    handler = logging.StreamHandler()
    LOG.addHandler(handler)
    yield handler
    LOG.removeHandler(handler)


def blur_four_frames():
    with messages_once(), progress(4) as tell:
        for frame in range(1, 5):
            with about_frame(frame):
                LOG.info("color: R, G, B")
            time.sleep(0.02)
            tell(f"frame {frame} ok")


def everything(reader):
    """What was written to a pseudo terminal that is closed by now; it comes piece by piece."""
    pieces = []
    with contextlib.suppress(OSError), os.fdopen(reader, "rb", buffering=0) as terminal:
        while piece := terminal.read(100_000):
            pieces.append(piece)
    return b"".join(pieces).decode()


@contextlib.contextmanager
def attached(writer, monkeypatch, handler):
    """Standard error and the log go to a terminal."""
    for name, value in {"TERM": "xterm-256color", "COLUMNS": "100", "LINES": "24"}.items():
        monkeypatch.setenv(name, value)
    with os.fdopen(writer, "w", encoding="utf-8") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        handler.setStream(terminal)
        yield


def test_a_terminal_shows_a_bar_with_rate_and_time_left(monkeypatch, handler):
    reader, writer = pty.openpty()
    with attached(writer, monkeypatch, handler):
        blur_four_frames()
    shown = everything(reader)
    plain = re.sub(r"\x1b\[[?\d;]*[a-zA-Z]", "", shown)
    assert re.search(r"frames ━+ +0/4 0.00 frames/s +-:--:-- left", plain)
    rate = re.search(r"4/4 (\d+\.\d\d) frames/s +0:00:00 left", plain)
    assert rate and 0 < float(rate[1]) < 60, "no more than 50 frames a second"
    assert plain.count("\rcolor: R, G, B") == 1
    assert "frame 1 ok" not in plain


def test_elsewhere_each_frame_is_a_line(monkeypatch, capsys, handler):
    handler.setStream(sys.stderr)
    blur_four_frames()
    assert capsys.readouterr().err.splitlines() == [
        "color: R, G, B",
        *(f"{k} of 4 done: frame {k} ok" for k in range(1, 5)),
    ]


def test_frames_that_end_in_another_order_are_counted_by_how_many_are_done(capsys, handler):
    handler.setStream(sys.stderr)
    with progress(2) as tell:
        tell("frame 2 ok")
        tell("frame 1 ok")
    assert capsys.readouterr().err.splitlines() == [
        "1 of 2 done: frame 2 ok",
        "2 of 2 done: frame 1 ok",
    ]


def test_warnings_of_many_frames_that_are_alike_are_two_lines(monkeypatch, capsys, handler):
    def warn_of_four_frames():
        with messages_once():
            for frame in (1, 2, 3, 5):
                with about_frame(frame):
                    LOG.warning("in.%04d.exr: %d pixels are ignored.", frame, 10 * frame)
                    if frame == 2:
                        LOG.warning("layer 1 is far")
                        LOG.warning("layer 2 is far")
                        LOG.error("damaged")
                    if frame == 3:
                        LOG.error("damaged")
        return capsys.readouterr().err.splitlines()

    handler.setStream(sys.stderr)
    assert warn_of_four_frames() == [
        "frame 1: in.0001.exr: 10 pixels are ignored.",
        *(f"frame 2: {text}" for text in ("layer 1 is far", "layer 2 is far", "damaged")),
        "frame 3: damaged",
        "frame 1 and 3 more (2-3,5; -v prints each): in.0001.exr: 10 pixels are ignored.",
    ]
    monkeypatch.setattr(LOG, "level", logging.DEBUG)
    LOG.manager._clear_cache()  # pyright: ignore[reportAttributeAccessIssue]
    assert sum("pixels" in line for line in warn_of_four_frames()) == 4


def test_stages_are_lines_and_a_long_one_says_that_it_goes_on(monkeypatch, capsys, handler):
    monkeypatch.setattr("jaxblur.cli.progress.SECONDS_BETWEEN_LINES", 0.1)
    handler.setStream(sys.stderr)
    with stages() as shown:
        shown.stage("compiling", 0, 1)
        time.sleep(0.4)
        shown.stage("scoring", 0, 8)
        shown.stage("scoring", 1, 8)
        time.sleep(0.4)
        shown.detail("loss 3")
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "compiling" and lines[1] == "compiling: 0 s so far"
    middle = lines.index("scoring")
    assert lines[middle + 1] == "scoring: 1 of 8, 0 s so far" and lines[-1] == "loss 3"
    assert len(lines) < 12, "not a line for every part"


def test_a_terminal_shows_a_bar_for_each_stage(monkeypatch, handler):
    reader, writer = pty.openpty()
    with attached(writer, monkeypatch, handler):
        with stages() as shown:
            shown.stage("compiling", 0, 1)
            LOG.info("said above")
            shown.stage("compiling", 1, 1)
            shown.stage("descent", 0, 9)
            shown.detail("step 1 [b]")
            shown.stage("descent", 4, 9)
            shown.stage("scoring", 0, 2)
            shown.stage("scoring", 2, 2)
    plain = re.sub(r"\x1b\[[?\d;]*[a-zA-Z]", "", everything(reader))
    assert "said above" in plain
    assert re.search(r"\+ compiling +━+ +1/1 +0:00:00", plain)
    assert re.search(r"\+ descent: step 1 \[b\] ━+ +4/4 +0:00:00", plain), "ended early"
    assert re.search(r"\+ scoring +━+ +2/2 +0:00:00", plain)
