"""``%V`` in the names of files: a stereo frame with a file for each view."""

import argparse
import pathlib
from collections.abc import Sequence
from typing import Any, NamedTuple

from .arguments import CommandError
from .disparity import CAMERAS
from .stack import LayerName

PLACE = "%V"
"""Stands for the name of a view, in a file name or in the name of a folder, as in Nuke."""
INITIAL = "%v"
"""Nuke's place for the first letter of a view, which is not replaced here."""
VIEWS = ["left", "right"]
"""The views that there are where ``--views`` names none."""
ALL = ["all"]
"""``--views`` of all views that a file holds."""

SOURCES = {
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
        Those of the command where the input has no `PLACE`, with those of `truths_of`. Else
        one for each view, with its name in place of `PLACE` in every path, a `ViewFile` in
        ``view_file``, and in ``in_truth`` the views that one truth must hold, none where each has
        its own. Where the noise of the right view is to be shared by cameras, its ``left_input``
        is the input of the left one.

    Raises:
        CommandError: a file of each view is needed and is not named so, or an option is for a view
            that there is not, or a name has `INITIAL`.
    """
    _refuse_initials([path for value in vars(arguments).values() for path in _paths(value)])
    given = {key: value for key, value in vars(arguments).items() if has_place(value)}
    if not are_named(arguments):
        for key, value in given.items():
            if key != "truth":
                path = next(filter(has_place, _paths(value)))
                option = "" if key == "layers" else f"{_option(key)}: "
                raise CommandError(
                    f"{option}{path} has {PLACE} for the name of a view, but "
                    f"{arguments.input} has none; write {PLACE} in both or in neither, or work on "
                    f"one view at a time: --views left and {_of_view(path, 'left')}."
                )
        return [argparse.Namespace(**vars(arguments) | truths_of(arguments))]
    names = list(dict.fromkeys(arguments.views or VIEWS))
    check_options_of(arguments, arguments.input, names)
    _check_sources(arguments, names)
    in_truth = names if arguments.truth is not None and not has_place(arguments.truth) else ()
    found = []
    for number, name in enumerate(names):
        here: dict[str, Any] = {key: _of_view(path, name) for key, path in given.items()}
        here |= {"views": None, "view_file": ViewFile(name, number), "in_truth": in_truth}
        if getattr(arguments, "disparity", None) == CAMERAS and name == "right":
            here["left_input"] = _of_view(arguments.input, "left")
        found.append(argparse.Namespace(**vars(arguments) | here))
    return found


def files_of(paths: Sequence[pathlib.Path], names: Sequence[str] | None) -> list[pathlib.Path]:
    """The files that paths stand for, those of each view for one with `PLACE`.

    Args:
        paths: of files, or names of sequences.
        names: of the views, or None for `VIEWS`.

    Raises:
        CommandError: views are named, and no path has a place for them, or one has `INITIAL`.
    """
    _refuse_initials(paths)
    if names and not any(map(has_place, paths)):
        raise CommandError(
            f"--views: no file has {PLACE} for the name of a view; write it, such as "
            f"shot.{PLACE}.exr, or leave out --views."
        )
    views = list(dict.fromkeys(names or VIEWS))
    return [
        file
        for path in paths
        for file in ([_of_view(path, name) for name in views] if has_place(path) else [path])
    ]


def truths_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """The arguments that hold truths.

    Args:
        arguments: of the command.

    Returns:
        ``truth``; where the truth has `PLACE` and the input has not, since it holds several views,
        ``truth:left`` and so on, by the views that are named.
    """
    truth = arguments.truth
    if not has_place(truth):
        return {"truth": truth}
    return {f"truth:{name}": _of_view(truth, name) for name in _in_one_file(arguments)}


def own_truth(arguments: argparse.Namespace, name: str | None) -> dict[str, pathlib.Path]:
    """The truth of a view of a file that holds several, as an argument.

    Args:
        arguments: of the command, from `each`.
        name: of the view, or None for a frame without.

    Returns:
        Nothing where the truth is one file for all views.

    Raises:
        CommandError: the truth has a file for each view, and the frame has no views, or others.
    """
    truth = arguments.truth
    if not has_place(truth):
        return {}
    if name is None:
        raise CommandError(
            f"--truth: {truth} has {PLACE} for the name of a view, but {arguments.input} has none, "
            f"and holds no views; write {PLACE} in both or in neither, or work on one view at a "
            f"time: --views left and {_of_view(truth, 'left')}."
        )
    if (role := f"truth:{name}") not in truths_of(arguments):
        raise CommandError(
            f"--truth: in {truth}, {PLACE} stands for {', '.join(_in_one_file(arguments))}, but "
            f"{arguments.input} has a view {name}; name the views with --views."
        )
    return {"truth": getattr(arguments, role)}


def _in_one_file(arguments: argparse.Namespace) -> list[str]:
    """The views that `PLACE` stands for where the input is one file for all of them."""
    if arguments.views not in (None, ALL):
        return list(dict.fromkeys(arguments.views))
    return [arguments.layer] if arguments.layer else VIEWS


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
    if not has_place(arguments.output):
        raise CommandError(
            f"{arguments.output}: each view of {arguments.input} becomes a file; write {PLACE} in "
            f"the name of the output too, such as out.{PLACE}.exr."
        )
    if has_place(getattr(arguments, "result", None)):
        raise CommandError(
            f"--result: {arguments.result} has {PLACE}, but one result holds all views; leave "
            f"{PLACE} out."
        )
    if len(names) < 2:
        return
    for key, why in SOURCES.items():
        value = getattr(arguments, key, None)
        # The frames before and after have a file for each layer.
        frame = _paths(arguments.layers) if isinstance(value, list) else [arguments.input]
        for path, of_frame in zip(_paths(value), frame, strict=False):
            if has_place(of_frame) and not has_place(path):
                raise CommandError(
                    f"{_option(key)}: {path} is one file for the views {', '.join(names)}, and "
                    f"each view {why}; write {PLACE} in its name, or choose one view with --views "
                    f"{names[0]}."
                )


def _refuse_initials(paths: Sequence[pathlib.Path]) -> None:
    """Reject `INITIAL` in the name of a file that does not exist.

    Raises:
        CommandError: it is there.
    """
    for path in paths:
        if INITIAL in str(path) and not path.exists():
            raise CommandError(
                f"{path}: {INITIAL} is not replaced; write {PLACE}, which stands for "
                f"{' and '.join(VIEWS)}, or for the names after --views, such as --views l,r."
            )


def has_place(value: Any) -> bool:
    """Whether a value of an option is a path with `PLACE`, or holds one."""
    return any(PLACE in str(path) for path in _paths(value))


def _paths(value: Any) -> list[pathlib.Path]:
    """The paths in a value of an option: itself, or those of several layers."""
    if isinstance(value, pathlib.Path):
        return [value]
    if isinstance(value, list):
        return [each.path for each in value if isinstance(each, LayerName)]
    return []


def _of_view(value: Any, name: str) -> Any:
    """A value of an option with the name of a view in place of `PLACE`."""
    if isinstance(value, pathlib.Path):
        return pathlib.Path(str(value).replace(PLACE, name))
    return [each._replace(path=_of_view(each.path, name)) for each in value]


def _option(key: str) -> str:
    return f"--{key.replace('_', '-')}"
