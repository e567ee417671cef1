"""What is to be done with each frame, decided by what is on the disk before any work."""

import dataclasses
import hashlib
import json
import os
import pathlib
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal

from jaxblur import exr

from .names import FrameNames, at_frame

Action = Literal["blur", "pass", "keep", "missing", "refuse"]

DIGEST = "jaxblur:digest"
"""Header attribute: `digest` of all choices that made the file."""
INPUT_STATE = "jaxblur:input_state"
"""Header attribute: size and time of change of every input, as `input_state` gives it."""
MEAN_SPEED = "jaxblur:mean_speed"
"""Header attribute: mean half-spread of the frame's vectors in pixels, for `find_cuts`."""

REMEDY = "--overwrite replaces such files"


@dataclasses.dataclass(frozen=True)
class Job:
    """One frame.

    Attributes:
        frame: its number.
        inputs: files that it is made from, by what they are for.
        outputs: files to write.
        action: ``blur`` it, ``pass`` it through unblurred, ``keep`` outputs that are as this run
            would make them; inputs are ``missing``; ``refuse`` to replace what is there.
        reason: why, in words.
        marks: what to write into the header of the outputs.
        mean_speed: as found in outputs that are kept, or None.
    """

    frame: int
    inputs: Mapping[str, pathlib.Path]
    outputs: tuple[pathlib.Path, ...]
    action: Action
    reason: str
    marks: Mapping[str, str]
    mean_speed: float | None = None


@dataclasses.dataclass(frozen=True)
class Plan:
    """All frames of a run.

    Attributes:
        jobs: in the order of the frames asked for.
    """

    jobs: tuple[Job, ...]

    def with_action(self, *actions: Action) -> list[Job]:
        """The jobs with one of some actions."""
        return [job for job in self.jobs if job.action in actions]


def digest(choices: Mapping[str, Any]) -> str:
    """Digest choices, so that files made by the same ones can be told.

    Args:
        choices: what determines an output besides the input; values that JSON or ``str`` can
            spell out.

    Returns:
        32 hexadecimal digits, the same for equal choices in any order.
    """
    text = json.dumps(choices, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def input_state(inputs: Mapping[str, pathlib.Path]) -> str:
    """Spell out size and time of change of files, which change when they are written again.

    Args:
        inputs: existing files.

    Returns:
        ``role size nanoseconds`` for each, separated by commas.

    Raises:
        OSError: a file is missing.
    """
    states = {role: os.stat(path) for role, path in sorted(inputs.items())}
    return ", ".join(f"{role} {s.st_size} {s.st_mtime_ns}" for role, s in states.items())


def plan_jobs(
    frames: Sequence[int],
    sources: Mapping[str, FrameNames | pathlib.Path],
    outputs: Sequence[FrameNames],
    choices: Mapping[str, Any],
    *,
    overwrite: bool = False,
    cuts: Collection[int] = (),
) -> Plan:
    """Decide what becomes of each frame; only headers are read.

    Args:
        frames: numbers of the frames.
        sources: where the inputs are, by what they are for: sequences, or single files.
        outputs: names of the files to write, one or several a frame.
        choices: what determines an output besides its inputs, see `digest`.
        overwrite: replace outputs, whatever they are.
        cuts: frames to pass through unblurred.

    Returns:
        The plan. Outputs are kept if they were made by the same choices from inputs that have
        not changed since; made again if the inputs have changed; anything else in the place of
        an output is refused.

    Raises:
        JaxblurIOError: an output is one of the inputs.
    """
    return Plan(
        tuple(
            _plan_job(frame, sources, outputs, {**choices, "pass": frame in cuts}, overwrite)
            for frame in frames
        )
    )


def _plan_job(
    frame: int,
    sources: Mapping[str, FrameNames | pathlib.Path],
    outputs: Sequence[FrameNames],
    choices: Mapping[str, Any],
    overwrite: bool,
) -> Job:
    inputs = at_frame(sources, frame)
    files = tuple(names.path(frame) for names in outputs)
    for file in files:
        exr.refuse_overwrite(file, *inputs.values())
    missing = [str(path) for path in inputs.values() if not path.is_file()]
    if missing:
        return Job(frame, inputs, files, "missing", f"{missing[0]}: no such file", {})
    # Taken before the file is read: an input that changes meanwhile is found out by the next run.
    marks = {DIGEST: digest(choices), INPUT_STATE: _state_of(inputs)}
    job = Job(frame, inputs, files, "pass" if choices["pass"] else "blur", "new", marks)
    present = [file for file in files if os.path.lexists(file)]
    if not present:
        return job
    if overwrite:
        return dataclasses.replace(job, reason=f"replaces {present[0].name}")
    return _compare(job, present)


def _state_of(inputs: Mapping[str, pathlib.Path]) -> str:
    """The truth is no input: it changes scores, not pixels."""
    return input_state({role: path for role, path in inputs.items() if role != "truth"})


def _compare(job: Job, present: Sequence[pathlib.Path]) -> Job:
    """Hold the outputs that are there against what this run would write."""
    found = {file: _marks_in(file) for file in present}
    for file, marks in found.items():
        if marks.get(DIGEST) != job.marks[DIGEST]:
            how = "with other parameters" if DIGEST in marks else "by something else"
            return dataclasses.replace(
                job, action="refuse", reason=f"{file} was made {how}; {REMEDY}"
            )
    if any(marks.get(INPUT_STATE) != job.marks[INPUT_STATE] for marks in found.values()):
        return dataclasses.replace(job, reason="the input has changed since")
    if len(present) < len(job.outputs):
        return dataclasses.replace(job, reason="a file is missing")
    speed = next(iter(found.values())).get(MEAN_SPEED)
    return dataclasses.replace(
        job,
        action="keep",
        reason="done before",
        mean_speed=None if speed is None else float(speed),
    )


def _marks_in(path: pathlib.Path) -> dict[str, Any]:
    """The attributes of a file; none if it is not an image."""
    try:
        parts = exr.inspect(path).parts
    except exr.JaxblurIOError:
        return {}
    return {name: value for part in parts for name, value in part.attributes.items()}
