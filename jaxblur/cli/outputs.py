"""Write one frame that was blurred, with a record of how it was made; for a sequence too."""

import argparse
import dataclasses
import logging
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

import jaxblur

from . import posts, sources, stack
from .arguments import CommandError, check_parent, file_path
from .choice import PASSED_THROUGH, Choice
from .filtering import takes_neighbors
from .loading import Loaded

LOG = logging.getLogger("jaxblur")

PNG_TRANSFORM = "8-bit sRGB, clipped to 0..1"
BLURRED = "jaxblur:blurred"
"""Header attribute: the color channels that were blurred, by this and by earlier runs."""

NEIGHBORS = "jaxblur:neighbors"
"""Header attribute: the frames before and after that a frame was blurred with."""

MOTION = "jaxblur:motion"
"""Header attribute: how the motion of the frame was changed before the blur, in words."""

LAYERS = "jaxblur:layers"
"""Header attribute: the layers that were blurred together, the front one first."""

SUBFRAMES = "jaxblur:subframes"
"""Header attribute: the renders inside the exposure whose blur was averaged."""


def add_output_option(parser: argparse.ArgumentParser) -> None:
    """Add the option for the output; `check_output` checks it."""
    parser.add_argument(
        "-o",
        "--output",
        type=file_path,
        required=True,
        metavar="OUT",
        help=f".exr, or .png ({PNG_TRANSFORM}); never an input",
    )


def add_png_option(parser: argparse.ArgumentParser) -> None:
    """Add the option for a preview beside the output; `with_preview` reads it."""
    parser.add_argument("--png", action="store_true", help="write OUT.png beside OUT.exr too")


def check_output(output: pathlib.Path) -> None:
    """Reject the name of an output that cannot be written.

    Raises:
        CommandError: another format, or there is no such folder, or it is not writable.
    """
    if output.is_dir():
        raise CommandError(f"{output}: is a folder; give a file name.")
    if output.suffix.lower() not in (".exr", ".png"):
        raise CommandError(f"{output}: can write .exr and .png only; change the extension.")
    check_parent(output)


def with_preview(arguments: argparse.Namespace, output: Any) -> list[Any]:
    """An output and, with ``--png``, the preview beside it.

    Args:
        arguments: of the command.
        output: a path, or the `jaxblur.sequence.FrameNames` of a sequence.
    """
    beside = arguments.png and arguments.output.suffix.lower() != ".png"
    return [output, *([output.with_suffix(".png")] if beside else [])]


def write(
    arguments: argparse.Namespace,
    outputs: Sequence[pathlib.Path],
    image: Any,
    provenance: Mapping[str, str],
    loaded: Loaded,
) -> None:
    """Write an image to every output of a frame.

    Args:
        arguments: of the command.
        outputs: ``.exr`` and ``.png`` files; only the first may be an ``.exr``.
        image: (H, W, C) linear light.
        provenance: metadata to add.
        loaded: the frame that it was made of.

    Raises:
        JaxblurIOError: a file cannot be written or cannot hold such values; or an input has changed
            before the first was complete, and nothing is written.
    """
    from jaxblur import exr

    colors, buffers = loaded.colors, loaded.buffers
    from_exr = arguments.input.suffix.lower() == ".exr"
    channels = arguments.color_channels
    if buffers.pass_channels:
        channels = [*buffers.color_channels, *buffers.pass_channels]
    for position, output in enumerate(outputs):
        # Once the first file is there, the others, of the same pixels, belong beside it: an input
        # that changes after that is not used any more.
        unchanged = loaded.states if position == 0 else None
        if loaded.layers and output.suffix.lower() == ".exr":
            _write_composite(output, image, provenance, loaded, unchanged)
            continue
        if output.suffix.lower() == ".png":
            words = {} if colors.is_identity else {exr.COLORS: colors.words}
            shown, notes = colors.light(loaded.picture(image)), dict(provenance) | words
            exr.write_image(output, shown, attributes=notes, unchanged=unchanged)
            LOG.info(".png: %s", PNG_TRANSFORM if colors.view is None else "8 bit, in that view")
            continue
        exr.write_image(
            output,
            image,
            like=arguments.input if from_exr else None,
            extra="drop" if arguments.drop_extra else "keep",
            attributes=provenance,
            layer=arguments.layer,
            color_channels=channels,
            nonfinite="zero" if arguments.nonfinite == "ignore" else "keep",
            unchanged=unchanged,
            changes=loaded.changes,
        )


def _write_composite(
    output: pathlib.Path, image: Any, notes: Mapping[str, str], loaded: Loaded, unchanged: Any
) -> None:
    """Write the blurred layers with the windows and the metadata of the front one."""
    import numpy as np

    from jaxblur import exr

    names = (*loaded.buffers.color_channels, *loaded.buffers.pass_channels)
    front = loaded.layers[0]
    part = stack.part_of(front)
    colors = [c for c in part.channels if c.name in front.buffers.color_channels]
    exr.write_channels(
        output,
        dict(zip(names, np.moveaxis(image, -1, 0), strict=True)),
        dtype="half" if all(channel.type == "half" for channel in colors) else "float",
        attributes=notes,
        like=(front.path, colors[0].part) if front.path.suffix.lower() == ".exr" else None,
        unchanged=unchanged,
    )


def provenance(
    arguments: argparse.Namespace,
    chosen: Choice,
    loaded: Loaded,
    more: Mapping[str, Any] | None = None,
) -> dict[str, str]:
    """Everything needed to make an output again; file names without folders.

    Args:
        arguments: of the command.
        chosen: what was run.
        loaded: the frame.
        more: further settings.

    Returns:
        Header attributes by name.
    """
    buffers = loaded.buffers
    used = dataclasses.asdict(chosen.settings) | {
        "shutter": arguments.shutter,
        "preset": buffers.guess.preset.name,
        "depth": buffers.depth_kind,
        "sky": arguments.sky,
        **(more or {}),
    }
    if loaded.exposure is not None and chosen.name != PASSED_THROUGH:
        used |= loaded.exposure.notes()
    if arguments.seed is not None:
        used["seed"] = arguments.seed
    others = (arguments.velocity_from, arguments.depth_from, arguments.matte_from)
    files = (getattr(arguments, role) for role in stack.roles(arguments))
    inputs = [*dict.fromkeys(files), *others]
    earlier = {} if loaded.layers else _blurred_before(arguments.input)
    neighbors = ""
    if loaded.neighbors and chosen.name != PASSED_THROUGH and takes_neighbors(chosen.name):
        near = {side: source.path.name for side, source in loaded.neighbors.items()}
        neighbors = ", ".join(f"{side} {name}" for side, name in near.items())
    now = (
        set()
        if chosen.name == PASSED_THROUGH
        else {
            *(*buffers.color_channels, *buffers.pass_channels),
            *(name for change in loaded.changes for name in change.channels),
        }
    )
    return {
        "jaxblur:version": jaxblur.__version__,
        "jaxblur:filter": chosen.name,
        "jaxblur:parameters": _toml(chosen.parameters),
        "jaxblur:settings": _toml(used),
        "jaxblur:inputs": ", ".join(path.name for path in inputs if path is not None),
        BLURRED: ", ".join(sorted(now | earlier.keys())),
        **({LAYERS: stack.describe(loaded.layers)} if loaded.layers else {}),
        **({NEIGHBORS: neighbors} if neighbors else {}),
        **({MOTION: loaded.motion} if loaded.motion else {}),
        **posts.notes(arguments),
    }


def warn_of_double_blur(arguments: argparse.Namespace) -> None:
    """Warn if the color of a frame was blurred before; other views and layers do not count."""
    from jaxblur import exr

    for here in stack.each(arguments):
        path, info = here.input, exr.inspect(here.input)
        found = exr.choose_color(info, here.layer, here.color_channels)
        passes = exr.choose_passes(info, found, sources.passes_of(here), here.layer)
        mattes: list[Any] = []
        if getattr(here, "cryptomatte", None):
            mattes = exr.layers_of_picture(info, found)
        earlier = _blurred_before(path)
        names = (*found.channels, *passes, *(name for layer in mattes for name in layer.channels))
        for name in dict.fromkeys(earlier[name] for name in names if name in earlier):
            LOG.warning("%s: was blurred by %s before; this blurs it again.", path, name)


def _blurred_before(path: pathlib.Path) -> dict[str, str]:
    """The channels of a frame that were blurred before, and the filter recorded for their part."""
    from jaxblur import exr

    blurred: dict[str, str] = {}
    info = exr.inspect(path)
    for part in info.parts:
        notes = part.attributes
        recorded = str(notes.get(BLURRED, "")).split(", ")
        names = [name for name in recorded if name in info.channel_names]
        if not names and notes.get("jaxblur:filter", PASSED_THROUGH) != PASSED_THROUGH:
            # Names change if parts are dropped, and older versions recorded none.
            names = [channel.name for channel in part.channels]
        blurred |= dict.fromkeys(names, str(notes.get("jaxblur:filter")))
    return blurred


def _toml(values: Mapping[str, Any]) -> str:
    return "\n".join(
        f'{name} = "{value}"' if isinstance(value, str) else f"{name} = {value}"
        for name, value in values.items()
    )
