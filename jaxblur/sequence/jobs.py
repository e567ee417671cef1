"""The action for each frame, chosen before any work from the files on disk."""

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
"""Header attribute: size and modification time of every input, from `input_state`; those of the
frames before and after are inputs too."""
MEAN_SPEED = "jaxblur:mean_speed"
"""Header attribute: mean half-spread of the frame's vectors in pixels, for `find_cuts`."""

REMEDY = "--overwrite replaces such files"


@dataclasses.dataclass(frozen=True)
class Job:
    """One frame.

    Attributes:
        frame: its number.
        inputs: input files by role.
        outputs: files to write.
        action: ``blur`` the frame; ``pass`` it through unblurred; ``keep`` outputs
            that equal those of this run; ``missing`` inputs; ``refuse`` to replace existing files.
        reason: reason for the action, in words.
        marks: attributes for the header of the outputs.
        mean_speed: mean speed stored in outputs that are kept, or None.
        neighbors: input files by role of the frames before and after, by number.
    """

    frame: int
    inputs: Mapping[str, pathlib.Path]
    outputs: tuple[pathlib.Path, ...]
    action: Action
    reason: str
    marks: Mapping[str, str]
    mean_speed: float | None = None
    neighbors: Mapping[int, Mapping[str, pathlib.Path]] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Plan:
    """All frames of a run.

    Attributes:
        jobs: jobs in the order of the requested frames.
    """

    jobs: tuple[Job, ...]

    def with_action(self, *actions: Action) -> list[Job]:
        """Return the jobs that have one of the actions."""
        return [job for job in self.jobs if job.action in actions]

    def needs_overwrite(self) -> bool:
        """Whether there are files now that a run without ``overwrite`` would refuse to replace."""
        return any(_refusal(job, _headers_of(job)) for job in self.with_action("blur", "pass"))


def digest(choices: Mapping[str, Any]) -> str:
    """Hash choices, so that files made with equal choices can be recognized.

    Args:
        choices: everything but the inputs that determines an output; values that JSON or ``str``
            can represent.

    Returns:
        32 hexadecimal digits, the same for equal choices in any order.
    """
    text = json.dumps(choices, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def input_state(inputs: Mapping[str, pathlib.Path]) -> str:
    """Describe files by size and modification time, which change when they are written again.

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
    neighbors: bool = False,
) -> Plan:
    """Choose the action for each frame; only headers are read.

    Args:
        frames: numbers of the frames.
        sources: names of the inputs by role: sequences, or single files. The roles ``truth`` and
            ``truth:VIEW`` are for what changes scores and no pixels.
        outputs: names of the files to write, one or several per frame.
        choices: everything but the inputs that determines an output; see `digest`.
        overwrite: replace existing files at the outputs, whatever they are.
        cuts: frames to pass through unblurred.
        neighbors: whether the frames before and after are inputs of a frame, where their files
            exist. Frames of `cuts` neither have neighbors nor are any.

    Returns:
        The plan. Outputs are kept if they were made with the same choices from inputs that have not
        changed since, and made again if the inputs have changed or an output is damaged. Any
        other existing file at an output is refused.

    Raises:
        JaxblurIOError: an output is one of the inputs.
    """
    return Plan(
        tuple(
            plan_frame(
                frame,
                at_frame(sources, frame),
                [names.path(frame) for names in outputs],
                {**choices, "pass": frame in cuts},
                overwrite=overwrite,
                neighbors=_neighbors_of(frame, sources, cuts) if neighbors else {},
            )
            for frame in frames
        )
    )


def plan_frame(
    frame: int,
    inputs: Mapping[str, pathlib.Path],
    files: Sequence[pathlib.Path],
    choices: Mapping[str, Any],
    *,
    overwrite: bool,
    neighbors: Mapping[int, Mapping[str, pathlib.Path]],
) -> Job:
    """Choose the action for one frame.

    Args:
        frame: its number.
        inputs: input files by role.
        files: to write.
        choices: as of `plan_jobs`; with a true ``pass`` the frame is passed through.
        overwrite: as of `plan_jobs`.
        neighbors: input files by role of the frames before and after, by number.

    Raises:
        JaxblurIOError: an output is one of the inputs.
    """
    for file in files:
        exr.refuse_overwrite(file, *inputs.values(), *_files_of(neighbors, frame).values())
    missing = [str(path) for path in inputs.values() if not path.is_file()]
    if missing:
        return Job(frame, inputs, tuple(files), "missing", f"{missing[0]}: no such file", {})
    # Recorded before the file is read, so that the next run notices an input that changes
    # meanwhile.
    state = _state_of({**inputs, **_files_of(neighbors, frame)})
    marks = {DIGEST: digest(choices), INPUT_STATE: state}
    action: Action = "pass" if choices.get("pass") else "blur"
    job = Job(frame, inputs, tuple(files), action, "new", marks, neighbors=neighbors)
    present = [file for file in files if os.path.lexists(file)]
    if not present:
        return job
    if overwrite:
        return dataclasses.replace(job, reason=f"replaces {present[0].name}")
    return _compare(job)


def _neighbors_of(
    frame: int, sources: Mapping[str, FrameNames | pathlib.Path], cuts: Collection[int]
) -> dict[int, dict[str, pathlib.Path]]:
    """Return the inputs of the frames before and after a frame, if all of them exist."""
    names = {role: name for role, name in sources.items() if not _is_truth(role)}
    found = {} if frame in cuts else {n: at_frame(names, n) for n in (frame - 1, frame + 1)}
    return {
        number: inputs
        for number, inputs in found.items()
        if number not in cuts and all(path.is_file() for path in inputs.values())
    }


def _files_of(
    neighbors: Mapping[int, Mapping[str, pathlib.Path]], frame: int
) -> dict[str, pathlib.Path]:
    """Return the files of the neighbors of a frame by role, such as ``before_input``."""
    return {
        f"{'before' if number < frame else 'after'}_{role}": path
        for number, inputs in neighbors.items()
        for role, path in inputs.items()
    }


def _state_of(inputs: Mapping[str, pathlib.Path]) -> str:
    """Describe all inputs except the truth, which affects scores but not pixels."""
    return input_state({role: path for role, path in inputs.items() if not _is_truth(role)})


def _is_truth(role: str) -> bool:
    """Whether a role is that of a truth; see `plan_jobs`."""
    return role.partition(":")[0] == "truth"


def _compare(job: Job) -> Job:
    """Compare existing outputs with those that this run would write."""
    found = _headers_of(job)
    if refusal := _refusal(job, found):
        return dataclasses.replace(job, action="refuse", reason=refusal)
    if any(marks.get(INPUT_STATE) != job.marks[INPUT_STATE] for marks in found.values()):
        return dataclasses.replace(job, reason="the input has changed since")
    if len(found) < len(job.outputs):
        return dataclasses.replace(job, reason="a file is missing")
    if not all(map(exr.is_complete, found)):
        return dataclasses.replace(job, reason="a file is damaged")
    speed = _number(next(iter(found.values())).get(MEAN_SPEED))
    return dataclasses.replace(job, action="keep", reason="done before", mean_speed=speed)


def _headers_of(job: Job) -> dict[pathlib.Path, dict[str, Any]]:
    """The attributes of the outputs that exist."""
    return {file: _marks_in(file) for file in job.outputs if os.path.lexists(file)}


def _refusal(job: Job, found: Mapping[pathlib.Path, Mapping[str, Any]]) -> str:
    """The reason not to replace one of the existing outputs; empty if there is none."""
    for file, marks in found.items():
        if marks.get(DIGEST) != job.marks[DIGEST]:
            how = "with other parameters" if DIGEST in marks else "by something else"
            return f"{file} was made {how}; {REMEDY}"
    return ""


def _number(attribute: Any) -> float | None:
    """A number that was stored as text; None for anything else."""
    try:
        return float(attribute)
    except (TypeError, ValueError):
        return None


def _marks_in(path: pathlib.Path) -> dict[str, Any]:
    """Return the attributes of a file; none if it is not an image."""
    try:
        parts = exr.inspect(path).parts
    except exr.JaxblurIOError:
        return {}
    return {name: value for part in parts for name, value in part.attributes.items()}
