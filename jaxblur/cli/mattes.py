"""``--cryptomatte``: the ranks of Cryptomattes blurred by the weights of the picture."""

import argparse
import dataclasses
import logging
import pathlib
from collections.abc import Sequence
from typing import Any

from . import blurring
from .arguments import CommandError
from .choice import PASSED_THROUGH, Choice
from .filtering import takes_neighbors
from .loading import Loaded, Source

LOG = logging.getLogger("jaxblur")


def add_option(parser: argparse.ArgumentParser) -> None:
    """Add the option; `blur` and `.loading.read` read it."""
    parser.add_argument(
        "--cryptomatte",
        action=argparse.BooleanOptionalAction,
        help="blur the Cryptomattes by the weights of the picture, so that mattes cut from the "
        "result fit it (default: they stay as they are, sharp, with a warning; "
        "--no-cryptomatte: without)",
    )


def check(arguments: argparse.Namespace) -> None:
    """Reject the option where nothing can hold Cryptomattes.

    Args:
        arguments: of the command.

    Raises:
        CommandError: neither input nor output is an EXR file.
    """
    if not arguments.cryptomatte:
        return
    for path in (arguments.input, arguments.output):
        if path.suffix.lower() != ".exr":
            raise CommandError(
                f"--cryptomatte: {path.name} cannot hold Cryptomattes; take an .exr, or leave it "
                "out."
            )


def warn_of_sharp(arguments: argparse.Namespace, path: pathlib.Path) -> None:
    """Warn, once in a run, if the Cryptomattes of a file would be copied beside a blurred picture.

    Args:
        arguments: of the command.
        path: a frame that exists.
    """
    from jaxblur import exr

    unasked = arguments.cryptomatte is None and not arguments.drop_extra
    if not unasked or {path.suffix.lower(), arguments.output.suffix.lower()} != {".exr"}:
        return
    try:
        names = [layer.name for layer in exr.cryptomatte_layers(path)]
    except exr.JaxblurIOError:
        # Damaged, or not there; copies are as good as their models.
        return
    if names:
        LOG.warning(
            "%s: %s stays sharp and does not fit the blurred picture; --cryptomatte blurs it, "
            "--no-cryptomatte leaves it without this warning.",
            path,
            ", ".join(names),
        )


def blur(
    chosen: Choice, loaded: Loaded, seed: int | None, parts: Sequence[Loaded]
) -> tuple[Any, ...]:
    """Blur the Cryptomattes of a frame.

    Args:
        chosen: what the picture was blurred with.
        loaded: the frame.
        seed: of the noise.
        parts: the frame itself, or the sub-frames whose mean the picture is.

    Returns:
        A `jaxblur.exr.ChannelChange` for each layer; those of a frame that is passed through change
        no pixel.
    """
    from jaxblur import exr

    if not loaded.ranks:
        return ()
    if chosen.name == PASSED_THROUGH:
        return tuple(exr.unchanged_ranks(layer) for layer in loaded.ranks)
    with_neighbors = takes_neighbors(chosen.name)
    images, moves = [], []
    for part in parts:
        near = part.neighbors if with_neighbors else {}
        for ranks, motion in (
            (part.ranks, None),
            *((source.ranks, _motion_of(part, side, source)) for side, source in near.items()),
        ):
            if not any(ranks is each for each in images):
                images.append(ranks)
                moves.append(motion)

    def number_of(ranks: Any) -> int:
        return next(index for index, each in enumerate(images) if each is ranks)

    def of_part(part: Loaded, planes: list[Any]) -> Any:
        near = part.neighbors if with_neighbors else {}
        others = {
            side: source._replace(
                buffers=_in_place(source.buffers, planes[number_of(source.ranks)])
            )
            for side, source in near.items()
        }
        own = _in_place(part.buffers, planes[number_of(part.ranks)])
        return blurring.blur(chosen, dataclasses.replace(part, buffers=own, neighbors=others), seed)

    def blurred(planes: list[Any]) -> Any:
        total = of_part(parts[0], planes)
        for part in parts[1:]:
            total = total + of_part(part, planes)
        return total / len(parts)

    radius = float(chosen.settings.radius)
    reach = max(min(part.speeds.percentiles[100.0], radius) for part in parts)
    return exr.blur_ranks(loaded.ranks, images, blurred, reach=reach, moves=moves)


def _in_place(buffers: Any, planes: Any) -> Any:
    """Buffers whose picture is replaced by coverages, and remains their guide."""
    return dataclasses.replace(
        buffers, color=planes, guide=buffers.color, pass_channels=(), pass_colors=None
    )


def _motion_of(part: Loaded, side: str, source: Source) -> Any:
    """The motion of a neighbor's pixels to the time of the frame."""
    sign = 1 if side == "before" else -1
    return source.buffers.velocity * (2 * sign / part.shutter)
