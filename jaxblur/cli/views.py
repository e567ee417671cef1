"""``--views``: the views of a stereo file in one run, each by its own buffers."""

import argparse
import dataclasses
import logging
from collections.abc import Mapping, Sequence
from typing import Any

from . import posts, view_files
from .arguments import CommandError, channel_names, positive_integer
from .choice import Choice
from .disparity import CAMERAS, disparity
from .filtering import find_filter
from .loading import Loaded

LOG = logging.getLogger("jaxblur")

SEED_OF_A_VIEW = 1_000_003
"""Between the seeds of two views: beyond the numbers of frames, which are seeds too."""

ONE_VIEW = {
    "layer": "chooses one view or layer",
    "color_channels": "names channels of one view",
    "velocity_channels": "names channels of one view",
    "depth_channel": "names a channel of one view",
}
"""Options that a run over several views cannot have, and why."""


def add_options(parser: argparse.ArgumentParser, blurs: bool = True) -> None:
    """Add the options.

    Args:
        parser: of a command.
        blurs: whether the command has a filter, with samples and noise.
    """
    group = parser.add_argument_group("views of a stereo file (multiView, or parts with a view)")
    group.add_argument(
        "--views",
        type=channel_names,
        metavar="all|NAME[,NAME]",
        help="views to work on, each by its own depth and vectors; an .exr has the layout of the "
        "input, a picture holds one view: OUT.left.png, OUT.right.png (default: all that have "
        "color, unless --layer or channels are given); where %%V in the names of files stands for "
        "a view, their names (default left,right)",
    )
    if not blurs:
        return
    group.add_argument(
        "--view-samples",
        type=_samples,
        metavar="NAME=N[,NAME=N]",
        help="samples per pixel of some views, such as right=17; the others take --samples",
    )
    group.add_argument(
        "--disparity",
        type=disparity,
        metavar="cameras|PX[,DISTANCE]",
        help="share the noise of views left and right on the surfaces that both see: by "
        "worldToCamera and worldToNDC in the part or file of each view, or by distance of "
        "the eyes times focal length in pixels, the disparity at depth 1, and the depth at which "
        "the eyes converge (default inf); without it each view has noise of its own",
    )


def check(arguments: argparse.Namespace) -> None:
    """Reject options that contradict each other, before any file is read.

    Raises:
        CommandError: they do.
    """
    if arguments.views is None:
        return
    if view_files.are_named(arguments):
        if arguments.views == view_files.ALL:
            raise CommandError(
                f"--views all: of {arguments.input} no file lists the views; name them: --views "
                "left,right."
            )
        return
    for name, why in ONE_VIEW.items():
        if getattr(arguments, name, None) is not None:
            option = f"--{name.replace('_', '-')}"
            raise CommandError(f"{option}: {why}; leave out that, or --views.")
    if len(arguments.views) == 1 and arguments.views != view_files.ALL:
        arguments.layer = arguments.views[0]


def check_samples(arguments: argparse.Namespace, asked: Choice) -> None:
    """Reject samples of views that the filter cannot take.

    Args:
        arguments: of the command.
        asked: filter and settings from the options.

    Raises:
        CommandError: a plan chooses the samples.
        ValueError: the filter cannot run with such a number.
    """
    if not arguments.view_samples:
        return
    if arguments.plan:
        raise CommandError("--view-samples: --plan chooses the samples; leave out one of the two.")
    info = find_filter(asked.name)
    for count in arguments.view_samples.values():
        if info.check is not None:
            info.check(dataclasses.replace(asked.settings, samples=count))


def each(arguments: argparse.Namespace) -> list[argparse.Namespace]:
    """The arguments for each view of a frame.

    Args:
        arguments: of the command, or of `view_files.each`, with the frame in ``input`` and its
            ``seed``, a number or None.

    Returns:
        One for each view, whose ``layer`` is the view; those of the command where the file has no
        views, or where one layer is asked for; one with noise of its own where the file is that of
        a view, see `view_files.each`.

    Raises:
        JaxblurIOError: the file has no such view, or a view lacks vectors or depth.
        CommandError: an option is for other views.
    """
    from jaxblur import exr

    info = exr.inspect(arguments.input)
    names = _chosen(arguments, info)
    file: view_files.ViewFile | None = getattr(arguments, "view_file", None)
    if file is not None:
        _check_truth(arguments, arguments.in_truth)
        noise = _noise_of(arguments, file.name, file.number)
        return [argparse.Namespace(**vars(arguments) | noise)]
    view_files.check_options_of(arguments, info.path, names)
    _check_truth(arguments, names)
    _tell_sharp(arguments, info, names or [arguments.layer])
    if not names:
        truth = view_files.own_truth(arguments, arguments.layer)
        return [argparse.Namespace(**vars(arguments) | truth)]
    views = []
    for name in names:
        _check_own(arguments, info, name, names)
        noise = _noise_of(arguments, name, exr.views_of(info).index(name))
        own = noise | view_files.own_truth(arguments, name)
        own |= {"layer": name, "shares_file": True}
        views.append(argparse.Namespace(**vars(arguments) | own))
    return views


def _tell_sharp(arguments: argparse.Namespace, info: Any, chosen: Sequence[str | None]) -> None:
    """Say which views are copied to the output without blur, beside those that are blurred."""
    from jaxblur import exr

    if getattr(arguments, "drop_extra", True) or arguments.output.suffix.lower() != ".exr":
        return
    colored = exr.colored_views(info)
    sharp = [name for name in colored if name not in chosen]
    if sharp and any(name in colored for name in chosen):
        LOG.info("stay sharp: view %s; --views all blurs all", ", ".join(sharp))


def names_of(arguments: argparse.Namespace) -> list[str]:
    """The names of the views of a frame that `each` gives; empty where it looks at none.

    Args:
        arguments: of the command, with the frame in ``input``.

    Raises:
        JaxblurIOError: the file cannot be read, or has no such view.
    """
    from jaxblur import exr

    return _chosen(arguments, exr.inspect(arguments.input))


def _chosen(arguments: argparse.Namespace, info: Any) -> list[str]:
    """See `names_of`."""
    from jaxblur import exr

    asked, colored = arguments.views, list(exr.colored_views(info))
    if asked is None:
        given = (getattr(arguments, name, None) for name in ("stack", *ONE_VIEW))
        names = [] if any(given) or len(colored) < 2 else colored
        if names and getattr(arguments, "view_file", None):
            raise exr.JaxblurIOError(
                info.path,
                f"holds the views {', '.join(names)}, and {view_files.PLACE} stands for files of "
                "one view each; leave it out of the names of files, or choose with --layer.",
            )
    elif not colored:
        raise exr.JaxblurIOError(
            info.path, "no views with color; leave out --views, or name a layer by --layer."
        )
    else:
        names = colored if asked == view_files.ALL else list(dict.fromkeys(asked))
    for name in names:
        if name not in colored:
            raise exr.JaxblurIOError(
                info.path,
                f"no view {name!r} with color; --views takes {', '.join(colored)} or all.",
            )
    # A single named view is read like a layer: channels that it lacks come from the default view.
    return [] if asked is not None and asked != view_files.ALL and len(asked) == 1 else names


def _check_truth(arguments: argparse.Namespace, names: Sequence[str]) -> None:
    """Reject one truth for several views that does not hold each of them."""
    from jaxblur import exr

    if len(names) < 2 or arguments.truth is None or view_files.has_place(arguments.truth):
        return
    one = f"choose one view with --views {names[0]}"
    if arguments.truth_layer is not None:
        raise CommandError(
            f"--truth-layer: each of the views {', '.join(names)} is compared with that of its "
            f"name in the truth; leave it out, or {one}."
        )
    found = exr.inspect(arguments.truth)
    lacking = [name for name in names if name not in exr.colored_views(found)]
    if lacking:
        raise exr.JaxblurIOError(
            found.path,
            f"truth: no view {lacking[0]!r}, and each view is compared with its own truth; give a "
            f"truth with views {', '.join(names)}, or one for each, with {view_files.PLACE} in its "
            f"name, or {one}.",
        )


def _check_own(arguments: argparse.Namespace, info: Any, name: str, names: Sequence[str]) -> None:
    """Reject a view that would be blurred by vectors or depth of another one."""
    from jaxblur import exr

    remedy = "render it"
    if others := [other for other in names if other != name]:
        remedy += f", leave view {name} out with --views {','.join(others)}"

    def looked_in(path: Any, what: str) -> Any:
        found = info if path is None else exr.inspect(path)
        if name not in exr.views_of(found):
            raise exr.JaxblurIOError(found.path, f"{what}: no view {name!r}; {remedy}.")
        return found

    def require_own(found: Any, what: str, channels: Sequence[str]) -> None:
        if exr.borrowed_from(found, name, channels):
            raise exr.JaxblurIOError(
                found.path,
                f"view {name} has no {what} of its own; {remedy}, or let it take "
                f"{', '.join(channels)} with --layer {name}.",
            )

    taken, flat = (), arguments.depth == "flat"
    if hasattr(arguments, "velocity_from"):
        vectors_in = looked_in(arguments.velocity_from, "vectors")
        guess = exr.choose_vectors(vectors_in, arguments.preset, name)
        require_own(vectors_in, "vectors", guess.channels)
        taken = () if arguments.velocity_from else guess.channels
        flat |= arguments.depth == "auto" and guess.preset.depth == "flat"
    elif not posts.needs_depth(arguments):
        return
    if not flat:
        depth_in = looked_in(arguments.depth_from, "depth")
        prefix = exr.choose_color(info, name).prefix
        channel = exr.choose_depth(depth_in, name, None, prefix, taken)
        require_own(depth_in, "depth", [channel])


def _noise_of(arguments: argparse.Namespace, name: str, index: int) -> dict[str, Any]:
    """Seed and disparity by which a view gets its noise; the first view has that of a frame."""
    if not hasattr(arguments, "disparity"):
        return {}
    if arguments.disparity is not None:
        return {"disparity": arguments.disparity if name == "right" else None}
    return {"seed": (arguments.seed or 0) + index * SEED_OF_A_VIEW} if index else {}


def with_samples(arguments: argparse.Namespace, chosen: Choice) -> Choice:
    """The choice for a view.

    Args:
        arguments: of the view, from `each`.
        chosen: for the frame.

    Returns:
        The same filter with the samples of the view.
    """
    count = (getattr(arguments, "view_samples", None) or {}).get(view_files.name_of(arguments))
    if count is None:
        return chosen
    settings = dataclasses.replace(chosen.settings, samples=count)
    return dataclasses.replace(chosen, settings=settings)


def check_alike(views: Sequence[Loaded], names: Sequence[str]) -> None:
    """Reject views that cannot be written together.

    Args:
        views: as they were read.
        names: of the views.

    Raises:
        JaxblurIOError: they have different sizes, or share a Cryptomatte.
    """
    from jaxblur import exr

    first, *others = views
    for name, other in zip(names[1:], others, strict=True):
        (height, width), (rows, columns) = (view.buffers.color.shape[:2] for view in (first, other))
        apart = f"blur them one after the other, --views {names[0]} and then --views {name}"
        path = first.states.states[0][0]
        if (height, width) != (rows, columns):
            raise exr.JaxblurIOError(
                path,
                f"view {names[0]} has {width}x{height} pixels, view {name} {columns}x{rows}; "
                f"{apart}.",
            )
        held = [ranks.layer for ranks in first.ranks]
        if shared := [ranks.layer.name for ranks in other.ranks if ranks.layer in held]:
            raise exr.JaxblurIOError(
                path, f"views {names[0]} and {name} share Cryptomatte {shared[0]}; {apart}."
            )


def merged(views: Sequence[tuple[Loaded, Any]]) -> tuple[Loaded, Any]:
    """The blurred views as one frame, in which the others are passes of the first.

    Args:
        views: each as it was read, and its (H, W, C) picture and passes.

    Returns:
        The frame and its (H, W, C) picture and passes, to be written together.
    """
    import numpy as np

    from jaxblur.nonfinite import Ignored

    (first, image), *others = views
    if not others:
        return first, image
    names = [
        name
        for loaded, _ in others
        for name in (*loaded.buffers.color_channels, *loaded.buffers.pass_channels)
    ]
    counts = (dataclasses.astuple(loaded.buffers.ignored) for loaded, _ in views)
    buffers = dataclasses.replace(
        first.buffers,
        pass_channels=(*first.buffers.pass_channels, *names),
        ignored=Ignored(*map(sum, zip(*counts, strict=True))),
    )
    whole = dataclasses.replace(
        first,
        buffers=buffers,
        changes=tuple(change for loaded, _ in views for change in loaded.changes),
        selects=any(loaded.selects for loaded, _ in views),
    )
    return whole, np.concatenate([image for _, image in views], axis=-1)


def notes(views: Sequence[argparse.Namespace]) -> Mapping[str, Any]:
    """What `jaxblur:settings` says of the views; empty for a frame without."""
    first = views[0]
    if len(views) < 2 and getattr(first, "view_file", None) is None:
        return {}
    names = [str(view_files.name_of(each)) for each in views]
    found: dict[str, Any] = {"views": ", ".join(names)}
    if first.view_samples:
        found["view_samples"] = ", ".join(f"{k}={v}" for k, v in first.view_samples.items())
    shared = next((each.disparity for each in views if each.disparity), None)
    if shared == CAMERAS:
        found["disparity"] = shared
    elif shared:
        found |= {"disparity": shared[0], "convergence": shared[1]}
    return found


def _samples(text: str) -> dict[str, int]:
    """Parse ``--view-samples``.

    Raises:
        ArgumentTypeError: it has another form.
    """
    found = {}
    for entry in text.split(","):
        name, equals, count = entry.partition("=")
        if not equals or not name.strip() or name.strip() in found:
            raise argparse.ArgumentTypeError(f"expected NAME=N[,NAME=N], got {text!r}")
        found[name.strip()] = positive_integer(count)
    return found
