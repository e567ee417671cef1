"""Write one frame that was blurred, with a record of how it was made; for a sequence too."""

import argparse
import dataclasses
import logging
import pathlib
import re
from collections.abc import Mapping, Sequence
from typing import Any

import jaxblur

from . import posts, sources, stack, views
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
        help=f".exr, or .png ({PNG_TRANSFORM}), of several views one for each: OUT.left.png; never "
        "an input",
    )


def add_png_option(parser: argparse.ArgumentParser) -> None:
    """Add the option for a preview beside the output; `files_of` reads it."""
    parser.add_argument(
        "--png",
        action="store_true",
        help="write OUT.png beside OUT.exr too, of several views one for each: OUT.left.png",
    )


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


def writes_png(arguments: argparse.Namespace) -> bool:
    """Whether a frame becomes a ``.png``, alone or beside an ``.exr``."""
    beside: bool = getattr(arguments, "png", False)
    return beside or arguments.output.suffix.lower() == ".png"


def files_of(arguments: argparse.Namespace, output: Any, names: Sequence[str | None]) -> list[Any]:
    """The files of a frame: the output and, with ``--png``, the preview beside it.

    Args:
        arguments: of the command.
        output: a path, or the `jaxblur.sequence.FrameNames` of a sequence.
        names: of its views, of which each gets a ``.png`` of its own if there are several.

    Returns:
        Paths, or names of sequences: an ``.exr`` first, and the ``.png`` files in the order of the
        views.

    Raises:
        CommandError: the name of a view cannot stand in that of a file.
    """
    from jaxblur.sequence import with_view

    alone = arguments.output.suffix.lower() == ".png"
    files = [] if alone else [output]
    if not writes_png(arguments):
        return files
    picture = output if alone else output.with_suffix(".png")
    if len(names) < 2:
        return [*files, picture]
    # Names come from a file that may be crafted, and must not lead to another folder.
    for name in names:
        if not re.fullmatch(r"[\w-]+", str(name)):
            raise CommandError(
                f"{arguments.output}: a .png is named after its view, and {name!r} is no name for "
                "a file; choose one view with --views NAME."
            )
    return [*files, *(with_view(picture, str(name)) for name in names)]


def write(
    arguments: argparse.Namespace,
    outputs: Sequence[pathlib.Path],
    provenance: Mapping[str, str],
    made: Sequence[tuple[Loaded, Any]],
) -> None:
    """Write the pictures of a frame to its files.

    Args:
        arguments: of the command.
        outputs: as `files_of` gives them.
        provenance: metadata to add.
        made: each view as it was read, and its (H, W, C) picture in linear light; several share an
            ``.exr``.

    Raises:
        JaxblurIOError: a file cannot be written or cannot hold such values; or an input has changed
            before the first was complete, and nothing is written.
    """
    # Once the first file is there, the others, of the same pixels, belong beside it: an input that
    # changes after that is not used any more.
    unchanged = made[0][0].states
    pictures = [output for output in outputs if output.suffix.lower() == ".png"]
    if len(pictures) < len(outputs):
        _write_exr(arguments, outputs[0], provenance, views.merged(made), unchanged)
        unchanged = None
    for output, (loaded, image) in zip(pictures, made if pictures else (), strict=True):
        _write_png(output, provenance, loaded, image, unchanged)
        unchanged = None
    if pictures:
        plain = made[0][0].colors.view is None
        LOG.info(".png: %s", PNG_TRANSFORM if plain else "8 bit, in that view")


def _write_png(
    output: pathlib.Path, notes: Mapping[str, str], loaded: Loaded, image: Any, unchanged: Any
) -> None:
    """Write the picture of a frame, or of a view, as a screen shows it."""
    from jaxblur import exr

    colors = loaded.colors
    words = {} if colors.is_identity else {exr.COLORS: colors.words}
    shown = colors.light(loaded.picture(image))
    exr.write_image(output, shown, attributes=dict(notes) | words, unchanged=unchanged)


def _write_exr(
    arguments: argparse.Namespace,
    output: pathlib.Path,
    notes: Mapping[str, str],
    frame: tuple[Loaded, Any],
    unchanged: Any,
) -> None:
    """Write a frame, all views in one, in place of the sharp one in a copy of its file."""
    from jaxblur import exr

    loaded, image = frame
    if loaded.layers:
        _write_composite(output, image, notes, loaded, unchanged)
        return
    channels = arguments.color_channels
    if loaded.buffers.pass_channels:
        channels = [*loaded.buffers.color_channels, *loaded.buffers.pass_channels]
    exr.write_image(
        output,
        image,
        like=arguments.input if arguments.input.suffix.lower() == ".exr" else None,
        extra="drop" if arguments.drop_extra else "keep",
        attributes=notes,
        layer=arguments.layer,
        color_channels=channels,
        nonfinite="zero" if arguments.nonfinite == "ignore" else "keep",
        unchanged=unchanged,
        changes=loaded.changes,
        decoded=loaded.buffers.decoded,
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
