"""Which frames a run has, and what is to be done with each: all checks before any work."""

import argparse
import contextlib
import dataclasses
import hashlib
import logging
import os
import pathlib
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import jaxblur

from .. import outputs, stack, strength, view_files, views
from ..arguments import CommandError
from ..choice import Choice
from ..filtering import takes_neighbors
from ..shutter import OPTIONS
from .recognition import settle_convention

LOG = logging.getLogger("jaxblur")

# Options that do not change the pixels of an output: places, messages, workers. The file of
# parameters counts by its contents.
NOT_A_CHOICE = frozenset(
    {
        *("command", "run", "option_defaults", "verbose", "quiet", "input", "inputs", "output"),
        *("frames", "cut", "parameters"),
        *("overwrite", "skip_existing", "dry_run", "json", "png", "scheduler", "workers"),
        *("truth", "truth_layer", "in_truth", "result"),
        *("velocity_from", "depth_from", "no_compile_cache"),
        # A file of cameras counts by its contents.
        *("matte_from", "left_input", "camera"),
        # The quality counts by its samples.
        *("quality", "allow_resize", "argv", "isolate", "memory", "time_limit", "threads", "fps"),
        "require_motion",
        # Cryptomattes count by whether they are blurred.
        "cryptomatte",
        # Neighbors count by whether they are used; the others are for single frames.
        *("neighbors", "before", "after", "subframes"),
        # The exposure counts by its times and its points.
        *("exposure", *OPTIONS),
        # Layers count by `stack`, which has a record of each; their files are inputs.
        *("layers", "holdout", "still"),
    }
)


def make_plan(arguments: argparse.Namespace, asked: Choice) -> tuple[Any, Any]:
    """Plan what is to be done with each frame, and settle what its vectors mean.

    Args:
        arguments: of the command; ``--preset auto`` may change, see `settle_convention`.
        asked: filter, parameters and settings from the options.

    Returns:
        A `jaxblur.sequence.Plan`, and the names of the input, a `jaxblur.sequence.FrameNames`.

    Raises:
        CommandError: an option is wrong, or there is no frame.
    """
    from jaxblur.sequence import parse_names, plan_jobs

    if arguments.workers and arguments.scheduler != "local":
        raise CommandError("--workers: is for --scheduler local.")
    for name in ("before", "after", "subframes"):
        if getattr(arguments, name):
            also = "" if name == "subframes" else ", which finds its neighbors by itself"
            raise CommandError(f"--{name}: is for a single frame, not for a sequence{also}.")
    sources = names_of(arguments, roles(arguments))
    outputs.check_output(arguments)
    frames = arguments.frames or _frames_of_all(arguments, sources)
    check_truth(arguments, frames)
    if arguments.result is not None and arguments.output.suffix.lower() != ".exr":
        raise CommandError(
            f"--result: the frames of a sequence are read back from {arguments.output}, and "
            "pictures do not hold what was scored; write .exr, with --png for a .png beside each."
        )
    _check_cuts(arguments, frames, sources["input"])
    names = parse_names(_placed(arguments, arguments.output))
    targets = outputs.files_of(arguments, names, _views(arguments, sources, frames))
    settle_convention(arguments, sources)
    neighbors = _uses_neighbors(arguments, asked)
    choices = _choices(arguments, asked) | ({"neighbors": True} if neighbors else {})
    choices |= {"cryptomatte": True} if arguments.cryptomatte else {}
    plan = plan_jobs(
        frames,
        sources,
        targets,
        choices,
        overwrite=arguments.overwrite,
        cuts=arguments.cut,
        neighbors=neighbors,
    )
    return plan, sources["input"]


def _frames_of_all(arguments: argparse.Namespace, sources: Mapping[str, Any]) -> list[int]:
    """The frames of the input; those that only other layers have give a warning."""
    from jaxblur.sequence import FrameNames, frame_ranges

    own = sources["input"]
    frames = frames_on_disk(own)
    for layer in dict.fromkeys(sources[role] for role in stack.roles(arguments)):
        if isinstance(layer, FrameNames) and (more := {*layer.frames_on_disk()} - {*frames}):
            LOG.warning(
                "%s: frames that it lacks are left out: %s, which %s has.",
                own.pattern,
                frame_ranges(more),
                layer.pattern,
            )
    return frames


def _check_cuts(arguments: argparse.Namespace, frames: Sequence[int], names: Any) -> None:
    """Reject cuts at frames that are neither of this run nor on disk.

    Cuts at other frames of the sequence matter too: no frame beside one sees it.
    """
    unknown = {*arguments.cut} - {*frames}
    unknown = unknown - {*names.frames_on_disk()} if unknown else unknown
    if unknown:
        raise CommandError(f"--cut: {names.pattern} has no frame {min(unknown)}.")


def check_truth(arguments: argparse.Namespace, frames: Sequence[int]) -> None:
    """Reject one truth for many frames.

    Args:
        arguments: of the command.
        frames: numbers of the frames.

    Raises:
        CommandError: it is so.
    """
    from jaxblur.sequence import has_frame_number

    if arguments.truth is not None and len(frames) > 1 and not has_frame_number(arguments.truth):
        raise CommandError(
            f"--truth: {arguments.truth} is one file for {len(frames)} frames; write it as "
            "truth.####.exr."
        )


def refuse(plan: Any, names: Any) -> None:
    """Stop before any work if an output must not be replaced, or if there is no input.

    Args:
        plan: a `jaxblur.sequence.Plan`.
        names: of the input.

    Raises:
        CommandError: it is so.
    """
    missing = plan.with_action("missing")
    refuse_existing(plan.jobs)
    if len(missing) == len(plan.jobs):
        hint = "" if missing[0].inputs["input"].is_file() else hint_of(names)
        raise CommandError(f"{missing[0].reason}, nor any other frame asked for{hint}.")


def refuse_existing(jobs: Sequence[Any]) -> None:
    """Stop before any work if an output must not be replaced.

    Args:
        jobs: of `jaxblur.sequence`.

    Raises:
        CommandError: it is so.
    """
    refused = [job for job in jobs if job.action == "refuse"]
    if refused:
        more = f" (and {len(refused) - 1} more)" if len(refused) > 1 else ""
        raise CommandError(f"{refused[0].reason}{more}.")


def roles(arguments: argparse.Namespace) -> tuple[str, ...]:
    """The roles of all files of a frame."""
    left = ["left_input"] if "left_input" in arguments else []
    own = ("velocity_from", "depth_from", "matte_from", *view_files.truths_of(arguments))
    return (*stack.roles(arguments), *left, *own)


def at_job(
    arguments: argparse.Namespace, job: Any, number: int | None = None
) -> argparse.Namespace:
    """The arguments for the frame of a job, or for one of its neighbors.

    Args:
        arguments: of the command.
        job: of the frame.
        number: of a neighbor, if it is for that.
    """
    inputs = job.neighbors.get(number, job.inputs)
    here: dict[str, Any] = {role: inputs.get(role) for role in roles(arguments)}
    if arguments.seed == "frame":
        here["seed"] = job.frame
    return argparse.Namespace(**vars(arguments) | here)


def names_of(arguments: argparse.Namespace, roles: Sequence[str]) -> dict[str, Any]:
    """Names of the inputs of a sequence.

    Args:
        arguments: of the command.
        roles: of the inputs, ``input`` among them.

    Returns:
        A `jaxblur.sequence.FrameNames` by role, or the path of a file that serves all frames.
    """
    from jaxblur.sequence import has_frame_number, parse_names

    given = {role: getattr(arguments, role) for role in roles}
    return {
        role: parse_names(_placed(arguments, path))
        if has_frame_number(path) or role == "input"
        else _placed(arguments, path)
        for role, path in given.items()
        if path is not None
    }


def _placed(arguments: argparse.Namespace, path: pathlib.Path) -> pathlib.Path:
    """The path of a file for workers, which may stand in another folder."""
    scheduler = getattr(arguments, "scheduler", None)
    return pathlib.Path(os.path.abspath(path)) if scheduler else path


def _views(
    arguments: argparse.Namespace, sources: Mapping[str, Any], frames: Sequence[int]
) -> list[str]:
    """The views after which pictures are named: those of the first frame that can be read."""
    from jaxblur.exr import JaxblurIOError
    from jaxblur.sequence import at_frame

    for frame in frames if outputs.pictures_of(arguments, arguments.output) else ():
        here = {"input": at_frame(sources, frame)["input"]}
        # A frame that cannot be read is reported when it is its turn.
        with contextlib.suppress(JaxblurIOError):
            return views.names_of(argparse.Namespace(**vars(arguments) | here))
    return []


def _uses_neighbors(arguments: argparse.Namespace, asked: Choice) -> bool:
    """Whether frames may see their neighbors; a plan may choose a filter that takes them."""
    if arguments.neighbors == "off" or arguments.shutter == 0:
        return False
    if strength.looks_at_neighbors(arguments):
        return True
    return arguments.plan is not None or takes_neighbors(asked.name)


def _choices(arguments: argparse.Namespace, asked: Choice) -> dict[str, Any]:
    """Every choice that determines an output besides its inputs.

    Settings count where they differ from their defaults, as options do.
    """
    given = options_that_count(arguments, roles(arguments))
    if arguments.filter and ":" in arguments.filter:
        given["filter_file"] = _sha256(arguments.filter.rpartition(":")[0])
    if arguments.exposure is not None:
        given["exposure"] = arguments.exposure._asdict()
    if arguments.camera is not None:
        is_file = isinstance(arguments.camera, pathlib.Path)
        given["camera"] = _sha256(str(arguments.camera)) if is_file else arguments.camera
    plain = dataclasses.asdict(type(asked.settings)())
    changed = {k: v for k, v in dataclasses.asdict(asked.settings).items() if v != plain[k]}
    chosen = {"name": asked.name, "parameters": dict(asked.parameters), "settings": changed}
    return given | chosen


def options_that_count(arguments: argparse.Namespace, roles: Collection[str]) -> dict[str, Any]:
    """The options that determine an output besides its inputs, and the version.

    An option counts unless it is named in `NOT_A_CHOICE`, where it differs from its default, so
    that a new one leaves outputs as they are.

    Args:
        arguments: of the command.
        roles: of the files of a frame.
    """
    places, usual = NOT_A_CHOICE | {*roles}, arguments.option_defaults
    given = {
        key: value
        for key, value in vars(arguments).items()
        if key not in places and value != usual.get(key)
    }
    return given | {"version": jaxblur.__version__}


def _sha256(path: str) -> str:
    return hashlib.sha256(pathlib.Path(path).read_bytes()).hexdigest()


def with_all_frames(views: Sequence[argparse.Namespace]) -> Sequence[argparse.Namespace]:
    """Give all views the same frames, so that one that a view lacks is reported.

    Args:
        views: arguments of each view that has files; of one, or of single frames, nothing changes.

    Returns:
        The arguments, with the frames that any of the views has, unless frames are given.

    Raises:
        CommandError: a view has none.
    """
    from jaxblur.sequence import has_frame_number, parse_names

    if len(views) < 2 or views[0].frames or not has_frame_number(views[0].input):
        return views
    found = {n for each in views for n in frames_on_disk(parse_names(each.input))}
    return [argparse.Namespace(**vars(each) | {"frames": sorted(found)}) for each in views]


def frames_on_disk(names: Any) -> list[int]:
    """The frames of a sequence that exist; missing ones between them give a warning.

    Args:
        names: a `jaxblur.sequence.FrameNames`.

    Returns:
        Their numbers, ascending.

    Raises:
        CommandError: there is none.
    """
    from jaxblur.sequence import missing_frames

    frames = names.frames_on_disk()
    if not frames:
        raise CommandError(f"{names.pattern}: no such frames{hint_of(names)}.")
    missing = missing_frames(frames)
    if missing:
        LOG.warning("%s: missing frames: %s.", names.pattern, missing)
    return frames


def hint_of(names: Any) -> str:
    """What files there are instead of missing ones: their frames, or the pattern for them.

    Args:
        names: a `jaxblur.sequence.FrameNames`.

    Returns:
        The end of a sentence; empty where nothing near is there.
    """
    from jaxblur.sequence import frame_ranges

    if there := names.frames_on_disk():
        return f"; there {'are frames' if len(there) > 1 else 'is frame'} {frame_ranges(there)}"
    other = names.other_padding()
    if other is None:
        near = " or ".join(map(repr, names.near_patterns()))
        return f"; near that name there is {near}" if near else ""
    first, *more = other.frames_on_disk()
    found = f"{other.path(first).name}{f' and {len(more)} more' if more else ''}"
    asked = f"{names.digits} digits" if names.digits > 1 else "no padding"
    return f"; {names.pattern} asks for {asked}, and there is {found}: give {other.pattern!r}"
