"""``jaxblur blur`` and ``jaxblur layers`` on a single frame."""

import argparse
import dataclasses
import itertools
import logging
import pathlib
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

from . import blurring, mattes, outputs, programs, results, stack, strength, view_files, views
from .arguments import CommandError, check_outputs
from .choice import Choice, choose
from .compute import start_jax
from .console import print_line, print_table
from .filtering import require_neighbors, takes_neighbors
from .loading import Loaded, Source, load, mismatch, placed, read, tell_rest
from .progress import messages_once
from .scores import SCORE_COLUMNS, scores_of, view_rows
from .shutter import option_of

LOG = logging.getLogger("jaxblur")


def blur_single(arguments: argparse.Namespace, asked: Choice) -> int:
    """Blur one frame.

    Args:
        arguments: of the command.
        asked: filter, parameters and settings from the options.

    Returns:
        0.

    Raises:
        CommandError: an option is wrong or an output must not be replaced.
        JaxblurIOError: a file cannot be read or written.
    """
    from jaxblur.sequence import has_frame_number

    arguments.in_sequence = False
    if has_frame_number(arguments.output):
        raise CommandError(
            f"{arguments.output}: has a place for frame numbers, but {arguments.input} is one "
            "file; give both a place, as in in.####.exr, or neither."
        )
    if arguments.seed == "frame":
        arguments.seed = _number_in(arguments.input)
    frames = [_checked(each, asked) for each in view_files.each(arguments)]
    if arguments.dry_run:
        for eye in (eye for frame in frames for eye in frame.eyes):
            tell_rest(eye, asked.settings)
        _print_plan(asked, arguments, frames)
        return 0
    rows, shots = [], []
    with messages_once():
        # All views are read before one is written.
        started = time.perf_counter()
        exposed = [_load_views(frame.arguments, asked, frame.eyes) for frame in frames]
        LOG.debug("read in %.2f s", time.perf_counter() - started)
        for frame, own in zip(frames, exposed, strict=True):
            chosen, made, seconds = _make(asked, frame, own)
            labels = [view_files.label_of(eye, len(made) > 1) for eye in frame.eyes]
            rows += view_rows(labels, [scores_of(*each) for each in made], chosen.name)
            if arguments.result:
                shots += _shots(frame, chosen, made, seconds)
    if rows:
        print_table(SCORE_COLUMNS, rows)
    if shots:
        results.write(arguments, frames[0].arguments, shots)
    return 0


class _Frame(NamedTuple):
    """A frame, or the one view of it that its files are of.

    Attributes:
        arguments: of the command for these files, from `view_files.each`.
        eyes: the same for each view of the frame, from `views.each`.
        sources: files that are read.
        files: files that are written.
    """

    arguments: argparse.Namespace
    eyes: list[argparse.Namespace]
    sources: list[pathlib.Path]
    files: list[pathlib.Path]


def _checked(arguments: argparse.Namespace, asked: Choice) -> _Frame:
    """Check the files of a frame before any work."""
    from jaxblur import exr

    outputs.check_output(arguments)
    _check_neighbors(arguments, asked)
    read_files = _sources(arguments)
    for source in read_files:
        exr.inspect(source)
    eyes = views.each(arguments)
    files = outputs.files_of(arguments, arguments.output, [eye.layer for eye in eyes])
    for source, output in itertools.product(read_files, files):
        exr.refuse_overwrite(output, source)
    for eye in eyes:
        outputs.warn_of_double_blur(eye)
    check_outputs(files, arguments.overwrite)
    mattes.warn_of_sharp(arguments, arguments.input)
    return _Frame(arguments, eyes, read_files, files)


def _make(
    asked: Choice, frame: _Frame, exposed: list[list[Loaded]]
) -> tuple[Choice, list[tuple[Loaded, Any]], float]:
    """Blur and write a frame; returns what was run, each view and its blur, and the seconds."""
    arguments, eyes, _, files = frame
    started = time.perf_counter()
    chosen, made = _blur_views(arguments, asked, eyes, exposed)
    seconds = time.perf_counter() - started
    LOG.debug("started and blurred in %.2f s", seconds)
    whole, _ = views.merged(made)
    notes = outputs.provenance(eyes[0], chosen, whole, views.notes(eyes))
    if arguments.subframes:
        names = ", ".join(path.name for path in _subframe_files(arguments))
        notes = {**notes, outputs.SUBFRAMES: names}
    outputs.write(eyes[0], files, notes, made)
    for output in files:
        print_line(f"{output}")
    return chosen, made, seconds


def _print_plan(asked: Choice, arguments: argparse.Namespace, frames: Sequence[_Frame]) -> None:
    """Print what would be read, done and written."""
    method = f"--plan {arguments.plan}"
    if not arguments.plan:
        radius = "auto" if arguments.radius == 0 else f"{asked.settings.radius} px"
        method = f"{asked.name}, {asked.settings.samples} samples, radius {radius}"
    files = [path for frame in frames for path in frame.files]
    rows = [
        *(("read", path) for path in dict.fromkeys(p for frame in frames for p in frame.sources)),
        ("blur", method),
        *(("replace" if path.exists() else "write", path) for path in files),
    ]
    print_table(("action", "what"), rows)


def _shots(
    frame: _Frame, chosen: Choice, made: list[tuple[Loaded, Any]], seconds: float
) -> list[Any]:
    """The shot of each view for `results.write`."""
    shots = []
    for eye, (loaded, blurred) in zip(frame.eyes, made, strict=True):
        # The name of a file that has one tells the view.
        view = eye.layer if len(made) > 1 else None
        title = " ".join(filter(None, (eye.input.name, view)))
        settings = results.settings_of(views.with_samples(eye, chosen))
        picture, sources = loaded.picture(blurred), vars(eye)
        shots.append(
            results.make_shot(title, loaded, picture, chosen.name, settings, sources, seconds)
        )
    return shots


def _load_views(
    arguments: argparse.Namespace, asked: Choice, eyes: list[argparse.Namespace]
) -> list[list[Loaded]]:
    """Read the frame of each view, followed by its sub-frames."""
    frames = [_load(eye, asked) for eye in eyes]
    views.check_alike(frames, [eye.layer for eye in eyes])
    exposed = [
        [frame, *_load_subframes(eye, asked, frame)]
        for eye, frame in zip(eyes, frames, strict=True)
    ]
    if not any(frame.selects for frame in frames):
        raise CommandError(f"{strength.SELECTS_NOTHING} of {arguments.input}.")
    return exposed


def _blur_views(
    arguments: argparse.Namespace,
    asked: Choice,
    eyes: list[argparse.Namespace],
    exposed: list[list[Loaded]],
) -> tuple[Choice, list[tuple[Loaded, Any]]]:
    """Blur each view; the choice is that for the fastest of them."""
    if arguments.plan:
        start_jax(not arguments.no_compile_cache)
    # Where there are sub-frames, they are blurred in place of the frame.
    parts = [own[1:] or own for own in exposed]
    fastest = max(itertools.chain(*parts), key=lambda part: part.speeds.suggested_radius)
    chosen = choose(arguments, asked, fastest)
    made = []
    for eye, (loaded, *_), own in zip(eyes, exposed, parts, strict=True):
        its = views.with_samples(eye, chosen)
        blurred = _blur(eye, its, own)
        changes = mattes.blur(its, loaded, eye.seed, own)
        loaded = dataclasses.replace(loaded, changes=changes)
        made.append((loaded, blurring.after_blur(eye, its, loaded, blurred, eye.seed)))
    return chosen, made


def _load(arguments: argparse.Namespace, asked: Choice) -> Loaded:
    """Read the frame, and its neighbors by the same options."""
    loaded = load(arguments, asked.settings)
    neighbors = {
        side: read(argparse.Namespace(**vars(arguments) | files))
        for side in ("before", "after")
        if (files := stack.files_of(arguments, side))
    }
    for side, source in neighbors.items():
        if differs := mismatch(loaded, source):
            raise CommandError(f"--{side}: {source.path} {differs}; render both alike.")
        _warn_of_other(arguments, side, loaded, source)
        neighbors[side] = placed(source, loaded.buffers.windows.data)
    return loaded.with_neighbors(neighbors)


def _warn_of_other(
    arguments: argparse.Namespace, side: str, loaded: Loaded, source: Source
) -> None:
    """Warn of a neighbor that is hardly the frame before or after.

    A sequence does not use such a frame. One that is named is used: that is the way to overrule
    the test.
    """
    from jaxblur.sequence import frame_number, is_cut, with_frame_number

    own, other = frame_number(arguments.input), frame_number(source.path)
    if own is not None and other is not None:
        alike = with_frame_number(arguments.input, other) == source.path
        if alike and (other < own) != (side == "before"):
            LOG.warning(
                "--%s: by its number %s is not %s %s; it is used as if it were: check the option.",
                side,
                source.path,
                side,
                arguments.input,
            )
    first, second = source.buffers, loaded.buffers
    if side == "after":
        first, second = second, first
    if is_cut(first, second, arguments.shutter):
        LOG.warning(
            "--%s: what %s and %s show differs too much for frames next to each other, as at a "
            "cut; it is used as it is: check the file, or leave it out.",
            side,
            source.path,
            arguments.input,
        )


def _load_subframes(arguments: argparse.Namespace, asked: Choice, loaded: Loaded) -> list[Loaded]:
    """Read the sub-frames, each with the motion of its part of the exposure and its neighbors."""
    files = _subframe_files(arguments)
    shutter = arguments.shutter / max(len(files), 1)
    changes = {"shutter": shutter, "exposure": None, "truth": None}
    parts = [argparse.Namespace(**vars(arguments) | changes | {"input": path}) for path in files]
    sources = [read(part) for part in parts]
    for source in sources:
        if differs := mismatch(loaded, source):
            raise CommandError(f"--subframes: {source.path} {differs}; render all alike.")
        _check_outside(loaded, source)
    sources = [placed(source, loaded.buffers.windows.data) for source in sources]
    frames = []
    for index, (part, source) in enumerate(zip(parts, sources, strict=True)):
        near = {
            "before": sources[max(index - 1, 0) : index],
            "after": sources[index + 1 : index + 2],
        }
        found = {side: one[0] for side, one in near.items() if one}
        frame = load(part, asked.settings, source).with_neighbors(found)
        # From one sub-frame to the next it takes as long as its part of the exposure.
        frames.append(dataclasses.replace(frame, shutter=1.0))
    return frames


def _check_outside(loaded: Loaded, source: Source) -> None:
    """Reject a sub-frame of which nothing is known in a part of the frame's data window."""
    from jaxblur import exr

    wanted = loaded.buffers.windows.data
    unmasked = dataclasses.replace(source.buffers, valid=None)
    if not exr.known_in(unmasked, wanted).all():
        own = source.buffers.windows.data
        raise CommandError(
            f"--subframes: {source.path} has the pixels {exr.window_words(own)}, but the frame has "
            f"{exr.window_words(wanted)}, and nothing is known of the others; render all with the "
            "same data window."
        )


def _subframe_files(arguments: argparse.Namespace) -> list[pathlib.Path]:
    """The sub-frames on disk in the order of their numbers; none without the option."""
    if arguments.subframes is None:
        return []
    from jaxblur.sequence import parse_names

    names = parse_names(arguments.subframes)
    return [names.path(number) for number in names.frames_on_disk()]


def _blur(arguments: argparse.Namespace, chosen: Choice, parts: list[Loaded]) -> Any:
    """Blur the parts of the exposure, or the one frame of all of it, and take the mean."""
    if len(parts) == 1 and programs.serves(arguments, chosen, parts[0]):
        return programs.blur(chosen, parts[0].buffers)
    start_jax(not arguments.no_compile_cache)
    if parts[0].neighbors and not takes_neighbors(chosen.name) and not arguments.subframes:
        LOG.warning("%s takes no neighbors: --before and --after are not used.", chosen.name)
    total = blurring.blur(chosen, parts[0], arguments.seed)
    for part in parts[1:]:
        total = total + blurring.blur(chosen, part, arguments.seed)
    return total / len(parts) if len(parts) > 1 else total


def _check_neighbors(arguments: argparse.Namespace, asked: Choice) -> None:
    """Reject neighbors and sub-frames that cannot be used, before any work."""
    sides = [side for side in ("before", "after") if getattr(arguments, side) is not None]
    more = [*sides, *(["subframes"] if arguments.subframes is not None else [])]
    if not more:
        return
    if arguments.shutter == 0:
        raise CommandError(f"--{more[0]}: --shutter 0 blurs nothing; leave out one of the two.")
    _check_distinct(arguments, sides)
    for option in ("velocity_from", "depth_from", "matte_from"):
        if getattr(arguments, option) is not None:
            raise CommandError(
                f"--{more[0]}: such frames bring their own vectors, depth and mattes; leave out "
                f"--{option.replace('_', '-')}, or give the frames as a sequence: name.####.exr."
            )
    if sides and arguments.subframes is not None:
        raise CommandError(
            f"--{sides[0]}: sub-frames are neighbors of each other; leave out one of the two."
        )
    if arguments.subframes is not None and arguments.exposure is not None:
        raise CommandError(
            f"{option_of(arguments)}: sub-frames are equal parts of an exposure centered on the "
            "frame; leave out one of the two."
        )
    if sides and arguments.plan is None:
        require_neighbors(asked.name, f"--{sides[0]}")
    if arguments.subframes is not None and not _subframe_files(arguments):
        raise CommandError(f"--subframes: {arguments.subframes}: no such files.")


def _check_distinct(arguments: argparse.Namespace, sides: Sequence[str]) -> None:
    """Reject the frame itself as its neighbor, and one neighbor for both sides."""
    frame = {role: getattr(arguments, role) for role in stack.roles(arguments)}
    given = {"the frame itself": frame}
    for side in sides:
        files = stack.files_of(arguments, side)
        for whose, others in given.items():
            # A clean plate may be the same at all times, but not every layer.
            if all(_is_same(files[role], others[role]) for role in files):
                raise CommandError(
                    f"--{side}: {files['input']} is {whose}; give the frame {side}, or leave it "
                    "out."
                )
        given[f"--{sides[0]} too"] = files


def _is_same(first: pathlib.Path, second: pathlib.Path) -> bool:
    return first.exists() and second.exists() and first.samefile(second)


def _number_in(path: pathlib.Path) -> int:
    """The number of a frame, which is the last one in its name, for ``--seed frame``."""
    from jaxblur.sequence import frame_number

    if (number := frame_number(path)) is None:
        raise CommandError(f"--seed frame: {path.name} has no frame number; give a number.")
    return number


def _sources(arguments: argparse.Namespace) -> list[pathlib.Path]:
    roles = (*stack.roles(arguments), "velocity_from", "depth_from")
    files = [getattr(arguments, r) for r in (*roles, *view_files.truths_of(arguments))]
    near = [path for s in ("before", "after") for path in stack.files_of(arguments, s).values()]
    more = (arguments.matte_from, *near, *_subframe_files(arguments))
    return [path for path in (*files, *more) if path is not None]
