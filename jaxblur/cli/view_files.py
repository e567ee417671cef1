"""``%V`` in the names of files: a stereo frame with a file for each view."""

import argparse
import pathlib
from collections.abc import Sequence
from typing import Any, NamedTuple

from .arguments import CommandError
from .disparity import CAMERAS

PLACE = "%V"
"""Stands for the name of a view, in a file name or in the name of a folder, as in Nuke."""
VIEWS = ["left", "right"]
"""The views that there are where ``--views`` names none."""

SOURCES = {
    "truth": "is compared with its own truth",
    "velocity_from": "is blurred by its own vectors",
    "depth_from": "has its own depth",
    "matte_from": "has its own mattes",
    "before": "has its own neighbors",
    "after": "has its own neighbors",
    "subframes": "has its own sub-frames",
    "camera": "has its own camera",
}
"""Options with files of one view each, and why."""


class ViewFile(NamedTuple):
    """The view that a file is of.

    Attributes:
        name: of the view.
        number: among the views of the run, from 0.
    """

    name: str
    number: int


def are_named(arguments: argparse.Namespace) -> bool:
    """Whether the input has a file for each view."""
    return PLACE in str(arguments.input)


def each(arguments: argparse.Namespace) -> list[argparse.Namespace]:
    """The arguments for the files of each view.

    Args:
        arguments: of the command.

    Returns:
        Those of the command where the input has no `PLACE`. Else one for each view, with its name
        in place of `PLACE` in every path, and a `ViewFile` in ``view_file``. Where the noise of the
        right view is to be shared by cameras, its ``left_input`` is the input of the left one.

    Raises:
        CommandError: a file of each view is needed and is not named so, or an option is for a view
            that there is not.
    """
    given = {key: value for key, value in vars(arguments).items() if _has_place(value)}
    if not are_named(arguments):
        if given:
            key, path = next(iter(given.items()))
            raise CommandError(
                f"{_option(key)}: {path} has {PLACE} for the name of a view, but "
                f"{arguments.input} has none; write {PLACE} in both or in neither, or work on one "
                f"view at a time: --views left and {_of_view(path, 'left')}."
            )
        return [arguments]
    names = list(dict.fromkeys(arguments.views or VIEWS))
    check_options_of(arguments, arguments.input, names)
    _check_sources(arguments, names)
    found = []
    for number, name in enumerate(names):
        here: dict[str, Any] = {key: _of_view(path, name) for key, path in given.items()}
        here |= {"views": None, "view_file": ViewFile(name, number)}
        if getattr(arguments, "disparity", None) == CAMERAS and name == "right":
            here["left_input"] = _of_view(arguments.input, "left")
        found.append(argparse.Namespace(**vars(arguments) | here))
    return found


def name_of(arguments: argparse.Namespace) -> str | None:
    """The name of the view that arguments are for, or the layer; None for a frame without views.

    Args:
        arguments: of `each`, or of `views.each`.
    """
    file: ViewFile | None = getattr(arguments, "view_file", None)
    return arguments.layer if file is None else file.name


def label_of(arguments: argparse.Namespace, several: bool) -> str | None:
    """The name of a view for tables and shots; None where there is one view, in a plain file.

    Args:
        arguments: as for `name_of`.
        several: whether the file holds several views.
    """
    return name_of(arguments) if several or getattr(arguments, "view_file", None) else None


def check_options_of(
    arguments: argparse.Namespace, path: pathlib.Path | str, names: Sequence[str]
) -> None:
    """Reject samples and noise for views that are not blurred.

    Args:
        arguments: of the command.
        path: of the frame, or its pattern.
        names: of the views that are blurred.

    Raises:
        CommandError: an option is for other views.
    """
    there = f"the views are {', '.join(names)}" if names else "no views are blurred"
    for name in getattr(arguments, "view_samples", None) or {}:
        if name not in names:
            raise CommandError(f"--view-samples: {path}: no view {name!r}; {there}.")
    if getattr(arguments, "disparity", None) and (not names or {*names} - {"left", "right"}):
        raise CommandError(
            f"--disparity: is that of views left and right, but of {path} {there}; leave it out."
        )


def _check_sources(arguments: argparse.Namespace, names: Sequence[str]) -> None:
    """Reject an output, or a file beside the input, that would be that of several views."""
    if not _has_place(arguments.output):
        raise CommandError(
            f"{arguments.output}: each view of {arguments.input} becomes a file; write {PLACE} in "
            f"the name of the output too, such as out.{PLACE}.exr."
        )
    if _has_place(getattr(arguments, "result", None)):
        raise CommandError(
            f"--result: {arguments.result} has {PLACE}, but one result holds all views; leave "
            f"{PLACE} out."
        )
    for key, why in SOURCES.items():
        path = getattr(arguments, key, None)
        if len(names) > 1 and isinstance(path, pathlib.Path) and not _has_place(path):
            raise CommandError(
                f"{_option(key)}: {path} is one file for the views {', '.join(names)}, and each "
                f"view {why}; write {PLACE} in its name, or choose one view with --views "
                f"{names[0]}."
            )


def _has_place(value: Any) -> bool:
    return isinstance(value, pathlib.Path) and PLACE in str(value)


def _of_view(path: pathlib.Path, name: str) -> pathlib.Path:
    return pathlib.Path(str(path).replace(PLACE, name))


def _option(key: str) -> str:
    return f"--{key.replace('_', '-')}"
