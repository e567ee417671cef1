"""``blur --result``: write pictures, motion and scores to a folder for ``jaxblur report``."""

import argparse
import dataclasses
import pathlib
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from jaxblur.settings import Settings

from . import view_files, views
from .arguments import check_folder, file_path
from .choice import Choice
from .loading import Loaded, load
from .progress import about_frame

ROLES = ("input", "velocity_from", "depth_from", "truth")
NOTES = ("jaxblur:settings", "jaxblur:parameters")
TIMES = "of the blur of a frame, all views, with what it compiled"


def add_option(parser: argparse.ArgumentParser) -> None:
    """Add the option."""
    parser.add_argument(
        "--result",
        type=file_path,
        metavar="DIR",
        help="write input, output, motion vectors and times there, with --truth also that and "
        "scores, for `jaxblur report DIR`; replaces an earlier result",
    )


def check(arguments: argparse.Namespace) -> None:
    """Reject a result that cannot be written, before any work is done.

    Raises:
        CommandError: the folder cannot be made.
    """
    if arguments.result is not None:
        check_folder(arguments.result)


def make_shot(
    name: str,
    loaded: Loaded,
    blurred: Any,
    method: str,
    settings: Mapping[str, Any],
    sources: Mapping[str, pathlib.Path | None],
    seconds: float | None,
) -> Any:
    """Gather a frame, its motion, its blur and its truth, if it has one.

    Args:
        name: of the shot.
        loaded: the frame.
        blurred: (H, W, C) in the colors of the frame.
        method: name of the filter.
        settings: of the filter, parameters among them.
        sources: files by role, see `ROLES`.
        seconds: that the blur of the frame took, or None if this run did not blur it.

    Returns:
        A `jaxblur.report.Shot`.
    """
    from jaxblur.report import Picture, Shot, sha256_of

    files = [path for role in ROLES if (path := sources.get(role)) is not None]
    output = Picture(
        method,
        loaded.colors.light(blurred),
        milliseconds=None if seconds is None else 1000 * seconds,
        settings=settings,
        group=method,
    )
    return Shot(
        name=name,
        truth=loaded.truth,
        pictures=[Picture("input", loaded.colors.light(loaded.buffers.color)), output],
        hashes={path.name: sha256_of(path) for path in files},
        velocity=loaded.buffers.velocity,
    )


def settings_of(chosen: Choice) -> dict[str, Any]:
    """Settings and parameters of a run as one table."""
    return dataclasses.asdict(chosen.settings) | dict(chosen.parameters)


def write(arguments: argparse.Namespace, first: argparse.Namespace, shots: Iterable[Any]) -> None:
    """Write the result folder of `blur --result`.

    Args:
        arguments: of the command.
        first: those of its first frame, for the words on colors.
        shots: as `make_shot` gives them.
    """
    from jaxblur.report import COLORS, VIEW, write_result

    truth = arguments.truth
    title = f"{arguments.input.name} {'blurred' if truth is None else f'against {truth.name}'}"
    settings = {"shutter": arguments.shutter, COLORS: _words(first), "times": TIMES}
    if arguments.exposure is not None:
        settings |= arguments.exposure._replace(points=()).notes()
    if arguments.view:
        settings[VIEW] = arguments.view
    write_result(arguments.result, title, shots, settings)


def _words(arguments: argparse.Namespace) -> str:
    """How colors are converted, for the page."""
    from jaxblur import exr

    info = exr.inspect(arguments.input)
    channel = exr.choose_color(info, arguments.layer, arguments.color_channels).channels[0]
    return exr.conversion_of(info, channel, arguments.color_space, arguments.view).words


def shots_of_frame(arguments: argparse.Namespace, job: Any, seconds: float | None) -> Iterator[Any]:
    """Read a frame of a sequence back; a whole sequence does not fit into memory.

    Args:
        arguments: of the command, or of `view_files.each`, with the files of the frame.
        job: of the frame, whose outputs exist; the first is an ``.exr``.
        seconds: see `make_shot`.

    Yields:
        A shot for each view.
    """
    from jaxblur import exr

    eyes = views.each(arguments)
    output = job.outputs[0]
    notes = exr.inspect(output).parts[0].attributes
    for eye in eyes:
        with about_frame(job.frame):
            loaded = load(eye, Settings())
        blurred = exr.read_image(output, eye.layer)
        # A plan and an automatic radius depend on the frame.
        settings = tomllib.loads("\n".join(str(notes.get(key, "")) for key in NOTES))
        method = str(notes.get("jaxblur:filter", "output"))
        view = view_files.label_of(eye, len(eyes) > 1)
        name = " ".join(filter(None, (f"frame {job.frame}", view)))
        yield make_shot(name, loaded, blurred, method, settings, vars(eye), seconds)
