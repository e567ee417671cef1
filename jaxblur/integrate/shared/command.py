"""The command ``jaxblur blur`` in processes of its own: arguments, progress, errors."""

from __future__ import annotations

import dataclasses
import json
import os
import pathlib
import queue
import re
import shlex
import shutil
import subprocess
import threading
import time
from collections.abc import Sequence

from .frames import Frames, ranges

FILTERS = ("layered", "guertin2014", "mcguire2012", "pixel_velocity")
POSITIONS = ("start", "center", "end")
RUN_CODE = ("--filter", "--scheduler")
"""Options that load Python of a file, or of another machine."""
SECONDS_TO_END = 10.0
"""For how long a cancelled command may finish the frames that it is at."""

_DONE = re.compile(r"jaxblur: (\d+) of (\d+) done")
_SAID = re.compile(r"jaxblur: (warning|error): (.*)")


@dataclasses.dataclass(frozen=True)
class Options:
    """How to blur.

    Attributes:
        shutter: exposure in frames.
        position: where the time of the frame lies in the exposure, one of `POSITIONS`.
        filter: one of `FILTERS`.
        samples: for each pixel.
        overwrite: whether results may be replaced.
        more: further options, as on a command line.
    """

    shutter: float = 0.5
    position: str = "center"
    filter: str = "layered"
    samples: int = 35
    overwrite: bool = True
    more: str = ""


def find_executable(chosen: str) -> str:
    """Find the command.

    Args:
        chosen: path or name of it by the user, or "": then that of the installation that wrote this
            extension, or else the one on the PATH.

    Returns:
        Its path.

    Raises:
        ValueError: there is none.
    """
    recorded = pathlib.Path(__file__).with_name("installation.json")
    names = [chosen] if chosen else [json.loads(recorded.read_text())["executable"], "jaxblur"]
    for name in names:
        if found := shutil.which(os.path.expanduser(name)):
            return found
    raise ValueError(
        f"{names[0]}: no such command. Install jaxblur (pip install jaxblur), and give the path of "
        "its command."
    )


def blur_command(executable: str, sharp: Frames, blurred: Frames, options: Options) -> list[str]:
    """The command line that blurs frames.

    Args:
        executable: path of the command.
        sharp: files to read.
        blurred: files to write.
        options: how.

    Returns:
        Program and arguments.

    Raises:
        ValueError: a quotation mark in the further options is not closed, or one of them runs code.
    """
    command = [executable, "blur", sharp.names, "-o", blurred.names]
    command += [f"--shutter={options.shutter:g}frames", f"--filter={options.filter}"]
    command += [f"--samples={options.samples}"]
    if options.position != "center":
        # Not always: only filters that take a shutter accept it.
        command.append(f"--shutter-position={options.position}")
    if sharp.digits:
        command.append(f"--frames={ranges(sharp.numbers)}")
    if options.overwrite:
        command.append("--overwrite")
    try:
        more = shlex.split(options.more)
    except ValueError as error:
        raise ValueError(f"further options {options.more!r}: {error}.") from error
    for text in more:
        name = text.partition("=")[0]
        # The command takes beginnings of options too.
        if name[:2] == "--" and name != "--" and any(each.startswith(name) for each in RUN_CODE):
            raise ValueError(
                f"further options: {name} can run code, and scenes come from others; choose the "
                "filter in its own field, and use such options on the command line."
            )
    return command + more


class Job:
    """Commands that run one after the other while the host goes on; ask `poll` again and again.

    Attributes:
        done: frames that are done.
        total: frames of all commands.
        warnings: what the commands warned of, each once.
        errors: why a command failed; empty if all is well so far.
        cancelled: whether `cancel` was called.
    """

    def __init__(self, commands: Sequence[Sequence[str]], counts: Sequence[int]):
        """Start the first of the commands.

        Args:
            commands: program and arguments of each.
            counts: how many frames each of them blurs.
        """
        self.done, self.total = 0, sum(counts)
        self.warnings: list[str] = []
        self.errors: list[str] = []
        self.cancelled = False
        self._waiting = list(zip(commands, counts, strict=True))
        self._finished = 0
        self._kill_at = 0.0
        self._process: subprocess.Popen[str] | None = None
        self._last = ""
        self._start()

    def poll(self) -> bool:
        """Take up what the command has said, and start the next one where it has ended.

        Returns:
            Whether there is still something to wait for.
        """
        while self._process is not None:
            try:
                line = self._lines.get_nowait()
            except queue.Empty:
                if self.cancelled and time.monotonic() > self._kill_at:
                    self._process.kill()
                return True
            if line is None:
                self._end()
            else:
                self._hear(line)
        return False

    def wait(self) -> None:
        """Wait for all commands."""
        while self.poll():
            time.sleep(0.05)

    def cancel(self) -> None:
        """End the command; files that it has written are whole, and poll on until it has ended."""
        self.cancelled = True
        self._waiting.clear()
        self._kill_at = time.monotonic() + SECONDS_TO_END
        if self._process is not None:
            self._process.terminate()

    def _start(self) -> None:
        command, self._count = self._waiting.pop(0)
        # Those of the host's own Python would lead that of the command astray.
        hidden = ("PYTHONHOME", "PYTHONPATH")
        environment = {name: value for name, value in os.environ.items() if name not in hidden}
        try:
            self._process = subprocess.Popen(
                list(command),
                env={**environment, "PYTHONIOENCODING": "utf-8"},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                encoding="utf-8",
                errors="replace",
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except OSError as error:
            self.errors.append(f"{command[0]}: cannot be started: {error.strerror}.")
            self._waiting.clear()
            return
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        threading.Thread(target=self._read, args=(self._process, self._lines), daemon=True).start()

    @staticmethod
    def _read(process: subprocess.Popen[str], lines: queue.SimpleQueue[str | None]) -> None:
        assert process.stderr is not None
        for line in process.stderr:
            lines.put(line.strip())
        lines.put(None)

    def _hear(self, line: str) -> None:
        self._last = line or self._last
        if done := _DONE.match(line):
            self.done = self._finished + int(done[1])
        elif said := _SAID.match(line):
            texts = self.warnings if said[1] == "warning" else self.errors
            if said[2] not in texts:
                texts.append(said[2])

    def _end(self) -> None:
        assert self._process is not None and self._process.stderr is not None
        status = self._process.wait()
        self._process.stderr.close()
        self._process = None
        self._finished += self._count
        if status == 0 and not self.cancelled:
            self.done = self._finished
            if self._waiting:
                self._start()
            return
        self._waiting.clear()
        if self.cancelled:
            # A canceled command reports that it was interrupted, which is no error.
            self.errors.clear()
        elif not self.errors:
            self.errors.append(f"jaxblur ended with status {status}: {self._last or 'no message'}")
