"""Read the layers of a frame, and reject what cannot be one."""

import argparse
import dataclasses
import functools
import itertools
import logging
import pathlib
from collections.abc import Sequence
from typing import Any

from . import sources, stack, strength
from .arguments import CommandError
from .shutter import reach_of

LOG = logging.getLogger("jaxblur")

DEEP_LAYERS = 2
"""Layers of a deep file, by default."""
COVERS, NEARER, MOSTLY = 0.1, 1.02, 0.5
"""The order is told by pixels of at least this alpha; it is wrong where depths differ by at least
this factor in more than this share of them."""
ALPHA_BEYOND = 0.1
"""How far alpha may lie outside 0..1, as in `jaxblur.blur_layers`."""


def read(arguments: argparse.Namespace) -> tuple[tuple[stack.ReadLayer, ...], str, bool]:
    """Read the layers of a frame.

    Args:
        arguments: of ``jaxblur layers``, with the files of the frame.

    Returns:
        The layers, the front one first; how their motion was changed, in words; and whether
        ``--scale-motion`` is for any pixel of one, see `strength.Changed`.

    Raises:
        JaxblurIOError: a file is missing, damaged or holds something else, or a layer has no alpha.
    """
    layers, motions, selections = [], [], []
    if len(arguments.stack) == 1 and not _is_deep(arguments, 0):
        raise CommandError(
            f"{arguments.layers[0].text}: is one layer; give more, from the front to the back, or "
            "use `jaxblur blur`."
        )
    if arguments.deep_layers and not any(
        _is_deep(arguments, number) for number in range(len(arguments.stack))
    ):
        raise CommandError("--deep-layers: no layer is of a deep file; leave it out.")
    for number, place in enumerate(arguments.stack):
        last = number == len(arguments.stack) - 1 and number > 0
        found, motion, selects = _read_place(arguments, number, place, last)
        layers += found
        selections.append(selects)
        motions += [f"{found[0].name}: {motion}"] if motion else []
    layers = _in_one_window(arguments, layers)
    _check_alike(layers)
    _warn_of_order([layer for layer in layers if not _is_still(arguments, layer)])
    return tuple(layers), "; ".join(motions), any(selections)


def _is_deep(arguments: argparse.Namespace, number: int) -> bool:
    from jaxblur import exr

    return exr.is_deep(exr.inspect(stack.each(arguments)[number].input))


def _read_place(
    arguments: argparse.Namespace, number: int, place: stack.LayerPlace, last: bool
) -> tuple[list[stack.ReadLayer], str, bool]:
    """One layer of the command line, how its motion was changed, and whether any pixel's was."""
    from jaxblur import exr

    here = stack.each(arguments)[number]
    path = here.input
    LOG.info("layer %d: %s", number + 1, arguments.layers[number].text)
    info, motion, selects = exr.inspect(path), "", False
    if exr.is_deep(info):
        found, selects = _read_deep(here)
        return (
            [stack.ReadLayer(path, place.layer, buffers, place.holdout, None) for buffers in found],
            "",
            selects,
        )
    try:
        buffers = _read_still(here) if place.still else sources.read(here)
    except exr.JaxblurIOError as error:
        raise _explained(error, number, place) from error
    buffers = _with_alpha(path, place, buffers, last)
    if not place.still:
        buffers, motion, selects = strength.apply(here, buffers)
    return [stack.ReadLayer(path, place.layer, buffers, place.holdout, number)], motion, selects


def _read_deep(arguments: argparse.Namespace) -> tuple[tuple[Any, ...], bool]:
    """The layers of a deep file, and whether the motion of any was changed."""
    from jaxblur import exr

    path, count = arguments.input, arguments.deep_layers or DEEP_LAYERS
    if arguments.sky == "camera":
        raise CommandError(f"--sky camera: {path} is deep; leave it out, or flatten the file.")
    if sources.passes_of(arguments):
        raise CommandError(
            f"{path}: color passes of deep files are not read; leave out --also and --all-color."
        )
    found = exr.read_deep_layers(
        path,
        count,
        arguments.preset,
        arguments.shutter,
        depth=arguments.depth,
        file_shutter=arguments.file_shutter,
        max_displace=arguments.max_displace,
        layer=arguments.layer,
        velocity_channels=arguments.velocity_channels,
        depth_channel=arguments.depth_channel,
    )
    # Deep layers are read already, so that their motion is changed one by one.
    changed = [strength.apply(arguments, buffers) for buffers in found]
    given = "" if arguments.deep_layers else "; --deep-layers K asks for another number"
    LOG.info("%s: deep, flattened into %d layers%s", path, len(found), given)
    return tuple(one.buffers for one in changed), any(one.selects for one in changed)


def _read_still(arguments: argparse.Namespace) -> Any:
    """A layer without motion, whose depth does not matter."""
    import numpy as np

    from jaxblur import exr, vectors

    info = exr.inspect(arguments.input)
    group = exr.choose_color(info, arguments.layer)
    color = exr.read_image(arguments.input, arguments.layer)
    passes = exr.choose_passes(info, group, sources.passes_of(arguments), arguments.layer)
    values = exr.read_channels(arguments.input, passes) if passes else None
    LOG.info("color: %s, at rest", ", ".join(group.channels))
    size = color.shape[:2]
    preset = vectors.PRESETS["jaxblur"]
    guess = vectors.Guess(preset, preset.layouts[-1], (), "at rest")
    still = np.zeros((*size, 2), np.float32)
    return exr.Buffers(
        color,
        np.ones(size, np.float32),
        still,
        None,
        group.channels,
        None,
        "flat",
        guess,
        exr.windows_of(info, group.channels[0]),
        pass_channels=passes,
        pass_colors=values,
    )


def with_remedies(error: Any) -> Any:
    """A `jaxblur.exr.JaxblurIOError` with the remedies of this command.

    Args:
        error: it, whose remedies are options of ``jaxblur blur``.
    """
    reason = error.reason.replace(
        "choose with `layer` or `color_channels`", "choose one as FILE:LAYER"
    )
    return type(error)(
        error.path, reason.replace("`depth_channel` or `depth_from`", "`depth_channel`")
    )


def _explained(error: Any, number: int, place: stack.LayerPlace) -> Any:
    """An error of reading a frame with the remedies of this command."""
    from jaxblur.exr import JaxblurIOError

    if "vectors" not in error.reason:
        return with_remedies(error)
    name, prefix = f"layer {number + 1}", f"{place.layer}." if place.layer else ""
    if place.layer:
        name += f" ({place.layer})"
    return JaxblurIOError(
        error.path,
        f"{name} has no motion vectors that are recognized; render {prefix}velocity.X and .Y or "
        f"name the channels (--preset, --velocity-channels), or pass --still {number + 1} if "
        "nothing moves in it.",
    )


def _with_alpha(path: pathlib.Path, place: stack.LayerPlace, buffers: Any, last: bool) -> Any:
    """The buffers with an alpha that can be one, the last channel; the last layer may be opaque."""
    import numpy as np

    from jaxblur import exr

    color, names = buffers.color, buffers.color_channels
    what = _about(place)
    position = next((k for k, name in enumerate(names) if _is_alpha(name)), None)
    if position is None:
        if not last:
            raise exr.JaxblurIOError(
                path,
                f"{what}{', '.join(names)}: no alpha (A), which every layer but the last needs; "
                "render it with alpha, or put it behind the others.",
            )
        alpha = np.ones((*color.shape[:2], 1), np.float32)
        if buffers.valid is not None:
            alpha[~buffers.valid] = 0
        color = np.concatenate([color, alpha], axis=-1)
        return dataclasses.replace(buffers, color=color, color_channels=(*names, "A"))
    alpha = color[..., position]
    if alpha.min() < -ALPHA_BEYOND or alpha.max() > 1 + ALPHA_BEYOND:
        raise exr.JaxblurIOError(
            path,
            f"{what}{names[position]}: alpha from {alpha.min():g} to {alpha.max():g}, not within "
            "0..1; render it again, or leave the channel out.",
        )
    return buffers


def _about(layer: stack.LayerPlace | stack.ReadLayer) -> str:
    """The beginning of a message about a layer of a file, which the message names already."""
    return f"layer {layer.layer}: " if layer.layer else ""


def _is_alpha(channel: str) -> bool:
    return channel.rpartition(".")[2].upper() in ("A", "ALPHA")


def _in_one_window(
    arguments: argparse.Namespace, layers: Sequence[stack.ReadLayer]
) -> list[stack.ReadLayer]:
    """The layers in one data window, which holds all of them and their blur."""
    from jaxblur import exr

    first = layers[0]
    display = first.buffers.windows.display
    for layer in layers[1:]:
        if (other := layer.buffers.windows.display) != display:
            raise exr.JaxblurIOError(
                layer.path,
                f"{_about(layer)}the display window is {exr.window_words(other)}, but that of "
                f"{first.name} is {exr.window_words(display)}; render both at one size.",
            )
    reach = reach_of(arguments)
    wanted = functools.reduce(
        exr.union, [exr.blur_window(layer.buffers, reach) for layer in layers]
    )
    return [layer._replace(buffers=exr.buffers_in(layer.buffers, wanted)) for layer in layers]


def _check_alike(layers: Sequence[stack.ReadLayer]) -> None:
    """Reject layers whose channels differ."""
    from jaxblur import exr

    first = layers[0]
    for layer in layers[1:]:
        count, expected = layer.buffers.color.shape[-1], first.buffers.color.shape[-1]
        if count != expected:
            raise exr.JaxblurIOError(
                layer.path,
                f"{_about(layer)}{count} color channels with alpha, but {first.name} has "
                f"{expected}; render both in color, or both in gray.",
            )
    names = {layer.name: set(map(stack.pass_name, layer.buffers.pass_channels)) for layer in layers}
    for layer in layers:
        if lacking := sorted(set().union(*names.values()) - names[layer.name]):
            raise exr.JaxblurIOError(
                layer.path,
                f"{_about(layer)}no pass {lacking[0].partition('.')[0]}, which other layers have "
                "and which would not add up without it; render it, or name with --also what all "
                "have.",
            )


def _is_still(arguments: argparse.Namespace, layer: stack.ReadLayer) -> bool:
    return layer.number is not None and arguments.stack[layer.number].still


def _warn_of_order(layers: Sequence[stack.ReadLayer]) -> None:
    """Warn of layers given back to front: depth says so where both cover a pixel."""
    import numpy as np

    for front, back in itertools.pairwise(layers):
        seen = [_alpha_of(layer) > COVERS for layer in (front, back)]
        depths = [np.asarray(layer.buffers.depth) for layer in (front, back)]
        told = seen[0] & seen[1] & np.isfinite(depths[0]) & np.isfinite(depths[1])
        if not told.any():
            continue
        behind = float(np.mean(depths[0][told] > NEARER * depths[1][told]))
        if behind > MOSTLY:
            LOG.warning(
                "%s is given in front of %s, but is farther away in %.0f %% of the pixels that "
                "both cover; layers go from the front to the back.",
                front.name,
                back.name,
                100 * behind,
            )


def _alpha_of(layer: stack.ReadLayer) -> Any:
    """(H, W) alpha of a layer."""
    names = layer.buffers.color_channels
    return layer.buffers.color[..., next(k for k, name in enumerate(names) if _is_alpha(name))]
