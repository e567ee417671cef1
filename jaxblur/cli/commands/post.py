"""``jaxblur post``: defocus and antialiasing alone, of pictures that need no blur."""

import argparse
import itertools
import logging
import pathlib
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
)
from ..compute import start_jax
from ..console import print_line, track
from ..outputs import add_output_option, check_output, files_of
from ..sources import add_channel_options

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
    parser.add_argument("--overwrite", action="store_true", help="replace existing outputs")
    parser.add_argument(
        "--frames", type=frame_numbers, metavar="A-B[xN]", help="of a sequence (default: all)"
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
    add_compute_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the posts on a picture or a sequence; see `add_parser`."""
    from jaxblur import exr

    from ..sequence import with_all_frames

    posts.check(arguments)
    views.check(arguments)
    _check_depth(arguments)
    jobs = [job for each in with_all_frames(view_files.each(arguments)) for job in _jobs(each)]
    for _, source, depth, files in jobs:
        for file, output in itertools.product((source, depth), files):
            exr.refuse_overwrite(output, file)
    check_outputs([output for *_, files in jobs for output in files], arguments.overwrite)
    start_jax(not arguments.no_compile_cache)
    if len(jobs) == 1:
        _run_one(jobs[0])
        return 0
    for index in track(list(range(len(jobs))), "post"):
        _run_one(jobs[index])
    return 0


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
    """A picture, the file with its depth, and what is written: see `files_of`.

    Its arguments are those of the command, or of a view that has files.
    """

    arguments: argparse.Namespace
    source: pathlib.Path
    depth: pathlib.Path
    files: list[pathlib.Path]


def _jobs(arguments: argparse.Namespace) -> list[_Job]:
    """The work on every frame, or on every frame of a view that has files."""
    from jaxblur.sequence import has_frame_number, parse_names

    from ..sequence import frames_on_disk, refuse_shell_pattern

    check_output(arguments)
    depth = arguments.depth_from or arguments.input
    if arguments.frames is None and not has_frame_number(arguments.input):
        refuse_shell_pattern(arguments.input)
        return [_job(arguments, arguments.input, depth, arguments.output)]
    sources, outputs = parse_names(arguments.input), parse_names(arguments.output)
    depths = parse_names(depth) if has_frame_number(depth) else None
    numbers = arguments.frames or frames_on_disk(sources)
    return [
        _job(
            arguments,
            sources.path(n),
            depth if depths is None else depths.path(n),
            outputs.path(n),
        )
        for n in numbers
    ]


def _job(
    arguments: argparse.Namespace, source: pathlib.Path, depth: pathlib.Path, output: pathlib.Path
) -> _Job:
    names = views.names_of(argparse.Namespace(**vars(arguments) | {"input": source}))
    return _Job(arguments, source, depth, files_of(arguments, output, names))


def _run_one(job: _Job) -> None:
    import numpy as np

    from jaxblur import exr

    arguments, source, depth, files = job
    states = exr.FileStates.of([source, depth])
    eyes = views.each(argparse.Namespace(**vars(arguments) | {"input": source}))
    channels, images = [], []
    for eye in eyes:
        group = exr.choose_color(exr.inspect(source), eye.layer, eye.color_channels)
        channels.append(group.channels)
        images.append(_through_posts(eye, depth))
    if len({image.shape[:2] for image in images}) > 1:
        names = " and ".join(eye.layer for eye in eyes)
        raise CommandError(
            f"{source}: views {names} have different sizes; do one after the other, with --layer."
        )
    for part in exr.inspect(source).parts:
        if again := posts.earlier(part.attributes, arguments.posts):
            LOG.warning("%s: has been through %s before; this does it again.", source, again)
            break
    sources = dict.fromkeys(path.name for path in (source, depth))
    notes = {
        "jaxblur:version": jaxblur.__version__,
        "jaxblur:post_inputs": ", ".join(sources),
        **posts.notes(arguments),
    }
    like = source if source.suffix.lower() == ".exr" else None
    if len(files) < len(images):
        # All views go into one file.
        images, channels = [np.concatenate(images, axis=-1)], [sum(channels, ())]
    for eye, output, image, names in zip(eyes[: len(files)], files, images, channels, strict=True):
        exr.write_image(
            output,
            image,
            like=like,
            attributes=notes,
            layer=eye.layer,
            color_channels=names if like else None,
            unchanged=states if output == files[0] else None,
            bits=arguments.bits,
        )
        print_line(f"{output}")


def _through_posts(arguments: argparse.Namespace, depth: pathlib.Path) -> Any:
    """A picture, or a view of it, after the posts."""
    from jaxblur import exr

    source = arguments.input
    color = exr.read_image(source, arguments.layer, arguments.color_channels)
    distance = None
    if posts.needs_depth(arguments):
        distance = exr.read_depth(
            depth,
            arguments.depth or "z",
            layer=arguments.layer,
            depth_channel=arguments.depth_channel,
        )
        if distance.shape != color.shape[:2]:
            (rows, columns), (height, width) = distance.shape, color.shape[:2]
            raise CommandError(
                f"{depth}: the depth has {columns}x{rows} pixels, but {source} has {width}x{height}"
                "; render both with the same data window."
            )
    return posts.apply(arguments, color, distance, color.shape[2])
