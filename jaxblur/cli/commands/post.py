"""``jaxblur post``: defocus and antialiasing alone, of pictures that need no blur."""

import argparse
import contextlib
import logging
import pathlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import jaxblur

from .. import posts, view_files, views
from ..arguments import (
    CommandError,
    add_command,
    add_compute_options,
    check_outputs,
    file_path,
    frame_numbers,
    in_option_names,
)
from ..colors import add_color_options, check_colors, shown_colors
from ..compute import start_jax
from ..console import print_line, print_table, track
from ..errors import FAILED, is_foreseeable, message_of
from ..loading import shown_truth
from ..outputs import add_output_option, check_output, files_of
from ..progress import about_frame, messages_once
from ..scores import SCORE_COLUMNS, add_truth_options, scores, view_rows
from ..sequence import (
    WRITE_FAILURES,
    check_truth,
    frames_on_disk,
    hint_of,
    names_of,
    options_that_count,
    print_scores,
    refuse_existing,
    refuse_shell_pattern,
    scores_record,
    with_all_frames,
)
from ..sources import add_channel_options
from ..windows import in_window

LOG = logging.getLogger("jaxblur")


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands, "post", "Defocus or antialias a picture, or a sequence of pictures.", run
    )
    parser.add_argument(
        "input",
        type=file_path,
        help="picture, or pictures: name.####.exr, name.%%04d.exr; name.%%V.####.exr has a file "
        "for each view",
    )
    add_output_option(parser)
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace existing outputs; without it a sequence keeps frames that were made in the "
        "same way, and makes those again whose inputs have changed",
    )
    parser.add_argument(
        "-F",
        "--frames",
        type=frame_numbers,
        metavar="A-B[xN]",
        help="of a sequence (default: all)",
    )
    posts.add_options(parser, "--do", required=True)
    views.add_options(parser, blurs=False)
    group = parser.add_argument_group("where color and depth are")
    group.add_argument("--layer", metavar="NAME", help="view layer, stereo view or part to look in")
    add_channel_options(group)
    group.add_argument("--depth-from", type=file_path, metavar="FILE")
    group.add_argument(
        "--depth",
        metavar="KIND",
        help="z, 1/z, --depth=-z or --depth=-1/z (default z)",
    )
    add_truth_options(parser)
    add_color_options(parser)
    add_compute_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the posts on a picture or a sequence; see `add_parser`."""
    posts.check(arguments)
    check_colors(arguments)
    views.check(arguments)
    _check_depth(arguments)
    found = [job for each in with_all_frames(view_files.each(arguments)) for job in _jobs(each)]
    refuse_existing([job.plan for job in found if job.plan])
    jobs = [job for job in found if not job.is_kept]
    if len(jobs) < len(found):
        LOG.info("%d of %d frames are kept, done before", len(found) - len(jobs), len(found))
    start_jax(not arguments.no_compile_cache)
    with messages_once():
        done = _do(jobs)
    _print_scores(",".join(arguments.posts), done)
    if failed := len(jobs) - len(done):
        LOG.error("%d of %d frames are not done.", failed, len(jobs))
    return FAILED if failed else 0


_Scored = list[tuple[str | None, dict[str, Any]]]
"""The name of each view of a picture, None if it has none, and its scores."""


def _do(jobs: Sequence["_Job"]) -> list[tuple["_Job", _Scored]]:
    """Do all pictures; a frame of a sequence that cannot be done is reported and left out."""
    done, refused = [], 0
    numbers = range(len(jobs))
    for job in (jobs[k] for k in (track(numbers, "post") if len(jobs) > 1 else numbers)):
        stage = "read"
        try:
            with about_frame(job.frame):
                made = _made(job)
                stage = "write"
                _write(job, made)
        except Exception as error:
            if job.frame is None or not is_foreseeable(error):
                raise
            reason = in_option_names(message_of(error), vars(job.arguments))
            LOG.error("frame %d: %s", job.frame, reason)
            refused = refused + 1 if stage == "write" else 0
            if refused == WRITE_FAILURES:
                LOG.error("%d frames in a row cannot be written; stopping.", refused)
                break
            continue
        refused = 0
        names = [view_files.label_of(view.arguments, len(made.views) > 1) for view in made.views]
        scored = [view.scores(image) for view, image in zip(made.views, made.images, strict=True)]
        done.append((job, list(zip(names, scored, strict=True))))
    return done


def _print_scores(method: str, done: Sequence[tuple["_Job", _Scored]]) -> None:
    """Print the scores of all pictures that have a truth."""
    rows, records = [], []
    for job, of_views in done:
        names, each = zip(*of_views, strict=True)
        if job.frame is None:
            rows += view_rows(names, each, method)
        else:
            record = {"frame": job.frame, "filter": method, "view": names[0]}
            records.append(record | scores_record(names, each))
    if rows:
        print_table(SCORE_COLUMNS, rows)
    print_scores(records)


def _check_depth(arguments: argparse.Namespace) -> None:
    """Reject options for depth where nothing looks at it.

    Raises:
        CommandError: an option is left over.
    """
    if posts.needs_depth(arguments):
        return
    for option in ("depth", "depth_from", "depth_channel"):
        if getattr(arguments, option) is not None:
            raise CommandError(
                f"--{option.replace('_', '-')}: --do {','.join(arguments.posts)} looks at no depth"
                f"; only {' and '.join(sorted(posts.NEEDS_DEPTH))} do; leave it out."
            )


class _Job(NamedTuple):
    """A picture and what is written: see `files_of`.

    Its arguments are those of the command, or of a view that has files, with the files of the
    picture in ``input``, ``depth_from`` and ``truth``. Its plan is a `jaxblur.sequence.Job`, None
    for a single picture.
    """

    arguments: argparse.Namespace
    plan: Any
    files: list[pathlib.Path]

    @property
    def frame(self) -> int | None:
        """The number of the frame; None for a single picture."""
        return self.plan and self.plan.frame

    @property
    def is_kept(self) -> bool:
        """Whether a former run has made the same."""
        return self.plan is not None and self.plan.action == "keep"

    def sources(self) -> list[pathlib.Path]:
        """The files that are read."""
        given = [getattr(self.arguments, role) for role in _roles(self.arguments)]
        return [path for path in given if path is not None]

    def missing(self) -> pathlib.Path | None:
        """The first file that is to be read and is not there; None if all are."""
        return next((path for path in self.sources() if not path.exists()), None)


def _roles(arguments: argparse.Namespace) -> tuple[str, ...]:
    """The arguments with files of a picture."""
    return ("input", "depth_from", *view_files.truths_of(arguments))


def _jobs(arguments: argparse.Namespace) -> list[_Job]:
    """The work on every frame, or on every frame of a view that has files."""
    from jaxblur import exr
    from jaxblur.sequence import at_frame, has_frame_number, parse_names, plan_frame

    check_output(arguments)
    if arguments.frames is None and not has_frame_number(arguments.input):
        refuse_shell_pattern(arguments.input)
        files = files_of(arguments, arguments.output, views.names_of(arguments))
        job = _Job(arguments, None, files)
        for output in files:
            exr.refuse_overwrite(output, *job.sources())
        check_outputs(files, arguments.overwrite)
        return [job]
    roles = _roles(arguments)
    sources, outputs = names_of(arguments, roles), parse_names(arguments.output)
    choices = options_that_count(arguments, roles)
    numbers = arguments.frames or frames_on_disk(sources["input"])
    check_truth(arguments, numbers)
    found = []
    for number in numbers:
        inputs = at_frame(sources, number)
        here = argparse.Namespace(**vars(arguments) | inputs)
        names: list[str] = []
        # A frame that cannot be read is reported when it is its turn.
        with contextlib.suppress(exr.JaxblurIOError):
            names = views.names_of(here)
        files = files_of(here, outputs.path(number), names)
        plan = plan_frame(
            number, inputs, files, choices, overwrite=arguments.overwrite, neighbors={}
        )
        found.append(_Job(here, plan, files))
    if all(job.missing() for job in found):
        hint = "" if found[0].arguments.input.is_file() else hint_of(sources["input"])
        raise CommandError(
            f"{found[0].missing()}: no such file, nor any other frame asked for{hint}."
        )
    return found


class _View(NamedTuple):
    """A picture, or a view of it, as it was read.

    Attributes:
        arguments: of the command for this view; see `views.each`.
        color: (H, W, C) values of the file.
        channels: full names of the color channels.
        windows: `jaxblur.exr.Windows` of the color.
        colors: a `jaxblur.exr.Conversion` of the color to light that a screen shows.
        truth: (H, W, C) such light, or None.
    """

    arguments: argparse.Namespace
    color: Any
    channels: tuple[str, ...]
    windows: Any
    colors: Any
    truth: Any

    def scores(self, image: Any) -> dict[str, Any]:
        """Score the picture, and what has become of it, against the truth; empty without one."""
        if self.truth is None:
            return {}
        light = self.colors.light
        return scores({"input": light(self.color), "output": light(image)}, self.truth)


def _read(arguments: argparse.Namespace) -> _View:
    """Read the color of a view and its truth."""
    from jaxblur import exr

    source = arguments.input
    channels = exr.choose_color(
        exr.inspect(source), arguments.layer, arguments.color_channels
    ).channels
    color = exr.read_image(source, arguments.layer, arguments.color_channels)
    colors = shown_colors(arguments, source, channels[0])
    windows = exr.windows_of(exr.inspect(source), channels[0])
    return _View(arguments, color, channels, windows, colors, shown_truth(arguments, windows))


class _Made(NamedTuple):
    """A picture after the posts.

    Attributes:
        views: the picture as it was read, or its views.
        images: (H, W, C) of each view after the posts.
        states: of the files that were read, as a `jaxblur.exr.FileStates`.
    """

    views: list[_View]
    images: list[Any]
    states: Any


def _made(job: _Job) -> _Made:
    """Read a picture and put it through the posts."""
    from jaxblur import exr

    if missing := job.missing():
        raise CommandError(f"{missing}: no such file.")
    source, depth = job.arguments.input, job.arguments.depth_from or job.arguments.input
    states = exr.FileStates.of([source, depth])
    pictures = [_read(eye) for eye in views.each(job.arguments)]
    if len({picture.color.shape[:2] for picture in pictures}) > 1:
        names = " and ".join(picture.arguments.layer for picture in pictures)
        raise CommandError(
            f"{source}: views {names} have different sizes; do one after the other, with --layer."
        )
    return _Made(pictures, [_through_posts(picture, depth) for picture in pictures], states)


def _write(job: _Job, made: _Made) -> None:
    """Write a picture, its views in one file where the format holds them."""
    import numpy as np

    from jaxblur import exr

    arguments, files = job.arguments, job.files
    source = arguments.input
    for part in exr.inspect(source).parts:
        if again := posts.earlier(part.attributes, arguments.posts):
            LOG.warning("%s: has been through %s before; this does it again.", source, again)
            break
    sources = dict.fromkeys(path.name for path in (source, arguments.depth_from or source))
    notes = {
        "jaxblur:version": jaxblur.__version__,
        "jaxblur:post_inputs": ", ".join(sources),
        **posts.notes(arguments),
        **(job.plan.marks if job.plan else {}),
    }
    like = source if source.suffix.lower() == ".exr" else None
    images, channels = made.images, [view.channels for view in made.views]
    if len(files) < len(images):
        images, channels = [np.concatenate(images, axis=-1)], [sum(channels, ())]
    for view, output, image, names in zip(made.views, files, images, channels, strict=False):
        exr.write_image(
            output,
            image,
            like=like,
            attributes=notes,
            layer=view.arguments.layer,
            color_channels=names if like else None,
            unchanged=made.states if output == files[0] else None,
            color_space=arguments.color_space,
            view=arguments.view,
            bits=arguments.bits,
        )
        print_line(f"{output}")


def _through_posts(picture: _View, depth: pathlib.Path) -> Any:
    """A picture, or a view of it, after the posts."""
    from jaxblur import exr

    arguments, color = picture.arguments, picture.color
    distance = None
    if posts.needs_depth(arguments):
        where = {"layer": arguments.layer, "depth_channel": arguments.depth_channel}
        channel = exr.choose_depth(exr.inspect(depth), **where, needed=True)
        distance = in_window(
            exr.read_depth(depth, arguments.depth or "z", **where),
            depth,
            channel,
            arguments.input,
            picture.windows,
            what="the depth",
        )
    return posts.apply(arguments, color, distance, color.shape[2], picture.windows)
