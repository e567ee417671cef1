"""The layers of a frame: their names on the command line, compositing, and their blur."""

import argparse
import dataclasses
import os
import pathlib
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from .arguments import CommandError, file_path

_FORM = re.compile(r"(?P<path>.+\.(?:exr|png|tiff?|hdr)):(?P<layer>[^/\\:]+)", re.IGNORECASE)


class LayerName(NamedTuple):
    """A layer on the command line: ``FILE``, or ``FILE:LAYER`` for a part or layer by name.

    Attributes:
        path: of the file, or names of a sequence.
        layer: view layer, view or part to look in, or None.
    """

    path: pathlib.Path
    layer: str | None

    @property
    def text(self) -> str:
        """As it was given, without folders."""
        return self.path.name + (f":{self.layer}" if self.layer else "")


class LayerPlace(NamedTuple):
    """What is known of a layer before it is read.

    Attributes:
        role: of its file, see `jaxblur.sequence.plan_jobs`.
        layer: as `LayerName`.
        holdout: whether it hides and is not seen.
        still: whether it has no vectors, and nothing moves in it.
    """

    role: str
    layer: str | None
    holdout: bool
    still: bool


class ReadLayer(NamedTuple):
    """A layer that was read; a deep file gives several.

    Attributes:
        path: of its file.
        layer: as `LayerName`.
        buffers: as `jaxblur.exr.read_buffers` gives them, with alpha.
        holdout: as `LayerPlace`.
        number: on the command line, from 0; None for those of a deep file.
    """

    path: pathlib.Path
    layer: str | None
    buffers: Any
    holdout: bool
    number: int | None

    @property
    def name(self) -> str:
        """As on the command line, without folders."""
        return LayerName(self.path, self.layer).text

    def frame(self, passes: Sequence[str], valid: Any = None) -> Any:
        """The `jaxblur.Frame`, alpha last.

        Args:
            passes: of the color, by `pass_name`.
            valid: (H, W) mask; None, since alpha says what is there.
        """
        import jax.numpy as jnp

        frame = self.buffers.frame()
        picture = self.buffers.color.shape[-1]
        found = list(map(pass_name, self.buffers.pass_channels))
        order = [picture + found.index(name) for name in passes]
        order = [*range(picture - 1), *order, picture - 1]
        return frame.replace(color=frame.color[..., jnp.array(order)], valid=valid)


def layer_name(text: str) -> LayerName:
    """Parse ``FILE`` or ``FILE:LAYER``."""
    found = None if os.path.exists(text) else _FORM.fullmatch(text)
    if found is None:
        return LayerName(file_path(text), None)
    return LayerName(file_path(found["path"]), found["layer"])


def pass_name(channel: str) -> str:
    """The name by which the passes of several layers are matched: ``diffuse.R``."""
    return ".".join(channel.split(".")[-2:])


def places_of(arguments: argparse.Namespace) -> tuple[LayerPlace, ...]:
    """The layers of the command, which get the roles ``input``, ``layer_2``, and so on.

    Args:
        arguments: of ``jaxblur layers``; the file of each role is set in place.

    Returns:
        The layers, the front one first.

    Raises:
        CommandError: ``--holdout`` or ``--still`` names none of them.
    """
    from jaxblur.sequence import has_frame_number

    names = arguments.layers
    # The role of the input is that of a sequence, if there is one.
    numbered = [k for k, name in enumerate(names) if has_frame_number(name.path)]
    first = numbered[0] if numbered else 0
    holdouts = {_found(text, names, "--holdout") for text in arguments.holdout}
    still = {_found(text, names, "--still") for text in arguments.still}
    places = []
    for k, name in enumerate(names):
        role = "input" if k == first else f"layer_{k + 1}"
        setattr(arguments, role, name.path)
        places.append(LayerPlace(role, name.layer, k in holdouts, k in still))
    return tuple(places)


def _found(text: str, names: Sequence[LayerName], option: str) -> int:
    """The index of the layer that an option names: by number, layer, or file."""
    if text.isascii() and text.isdigit() and 1 <= int(text) <= len(names):
        return int(text) - 1
    known = [
        {name.layer, *({name.path.name, name.path.stem, name.path.name.partition(".")[0]})}
        if name.layer is None
        else {name.layer, f"{name.path.name}:{name.layer}"}
        for name in names
    ]
    found = [k for k, words in enumerate(known) if text in words]
    if len(found) != 1:
        problem = "no layer" if not found else f"{len(found)} layers"
        listing = ", ".join(
            f"{k + 1} {name.layer or name.path.name}" for k, name in enumerate(names)
        )
        raise CommandError(f"{option} {text}: {problem} of that name; there are {listing}.")
    return found[0]


def roles(arguments: argparse.Namespace) -> tuple[str, ...]:
    """The roles of the files of layers; the one of the input alone for other commands."""
    return tuple(place.role for place in getattr(arguments, "stack", ())) or ("input",)


def files_of(arguments: argparse.Namespace, side: str) -> dict[str, pathlib.Path]:
    """The files by role of the frame before or after that an option gives; none without it.

    Args:
        arguments: of ``blur`` or ``layers``.
        side: ``before`` or ``after``.
    """
    given = getattr(arguments, side)
    if given is None:
        return {}
    if not getattr(arguments, "stack", ()):
        return {"input": given}
    return dict(zip(roles(arguments), (name.path for name in given), strict=True))


def each(arguments: argparse.Namespace) -> list[argparse.Namespace]:
    """The arguments for each file that has color: one, or those of the layers."""
    stack = getattr(arguments, "stack", ())
    if not stack:
        return [arguments]
    here = [{"input": getattr(arguments, place.role), "layer": place.layer} for place in stack]
    return [argparse.Namespace(**vars(arguments) | changes) for changes in here]


def part_of(layer: ReadLayer) -> Any:
    """The `jaxblur.exr.Part` with the color of a layer."""
    from jaxblur import exr

    info = exr.inspect(layer.path)
    return info.parts[info.channel(layer.buffers.color_channels[0]).part]


def composite(layers: Sequence[ReadLayer]) -> Any:
    """The layers at rest as one frame: color over nothing, the depth of the first that covers.

    The velocity is the longest of the layers, so that nothing that moves is missed.

    Args:
        layers: the front one first.

    Returns:
        `jaxblur.exr.Buffers` with plain channel names.
    """
    import numpy as np

    from jaxblur.nonfinite import Ignored

    first = layers[0].buffers
    passes = tuple(map(pass_name, first.pass_channels))
    color = np.zeros_like(first.color)
    extra = None if first.pass_colors is None else np.zeros_like(first.pass_colors)
    through = np.ones((*color.shape[:2], 1), np.float32)
    depth = np.full(color.shape[:2], np.inf, np.float32)
    velocity = np.zeros((*color.shape[:2], 2), np.float32)
    for layer in layers:
        buffers = layer.buffers
        if not layer.holdout:
            color += through * buffers.color
            if extra is not None:
                found = list(map(pass_name, buffers.pass_channels))
                extra += through * buffers.pass_colors[..., [found.index(n) for n in passes]]
        alpha = np.clip(buffers.color[..., -1:], 0, 1)
        depth = np.where(np.isposinf(depth) & (alpha[..., 0] > 0), buffers.depth, depth)
        longer = np.sum(buffers.velocity**2, axis=-1) > np.sum(velocity**2, axis=-1)
        velocity = np.where(longer[..., None], buffers.velocity, velocity)
        through = through * (1 - alpha)
    names = ("R", "G", "B", "A") if color.shape[-1] == 4 else ("Y", "A")
    ignored = [dataclasses.astuple(layer.buffers.ignored) for layer in layers]
    return dataclasses.replace(
        first,
        color=color,
        depth=depth,
        velocity=velocity,
        path=None,
        color_channels=names,
        valid=None,
        ignored=Ignored(*map(sum, zip(*ignored, strict=True))),
        pass_channels=passes,
        pass_colors=extra,
    )


def blur(
    layers: Sequence[ReadLayer],
    neighbors: Mapping[str, Sequence[ReadLayer]],
    parameters: Any,
    passes: Sequence[str],
    **options: Any,
) -> Any:
    """Blur the layers.

    A layer has the frame before or after from the layer of the same place. A file that is the same
    at every frame has none, and neither have layers of deep files, whose number and division differ
    from frame to frame.

    Args:
        layers: the front one first.
        neighbors: the layers ``before`` and ``after``, as far as they are given.
        parameters: of `layered`.
        passes: names of the color passes.
        **options: of `jaxblur.blur_layers`.

    Returns:
        (H, W, C) NumPy array: the picture with alpha, then the passes.
    """
    import numpy as np

    import jaxblur

    stack = []
    for layer in layers:
        near = {
            side: other.frame(passes, other.buffers.valid)
            for side, others in neighbors.items()
            for other in others
            if other.number is not None
            and other.number == layer.number
            and other.path != layer.path
        }
        stack.append(jaxblur.Layer(layer.frame(passes), holdout=layer.holdout, **near))
    blurred = np.asarray(jaxblur.blur_layers(stack, parameters, **options))
    picture = layers[0].buffers.color.shape[-1]
    return np.concatenate(
        [blurred[..., : picture - 1], blurred[..., -1:], blurred[..., picture - 1 : -1]], axis=-1
    )


def describe(layers: Sequence[ReadLayer]) -> str:
    """The layers in words, for the header of the output."""
    return ", ".join(layer.name + (" (holdout)" if layer.holdout else "") for layer in layers)
