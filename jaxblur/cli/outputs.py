"""Write one frame that was blurred, with a record of how it was made; for a sequence too."""

import argparse
import dataclasses
import itertools
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
        help=".exr; or a picture of the display window, of several views one for each "
        "(OUT.left.png): .png or .jpg as a screen shows it (sRGB, clipped to 0..1), .tif with the "
        "linear light as floats; never an input",
    )
    parser.add_argument(
        "--bits",
        type=int,
        choices=(8, 16, 32),
        help="of a channel of pictures: .png 8 or 16, .tif 8, 16 (as a screen shows it) or 32 "
        "(linear light), .jpg 8 (default: 8, and 32 of .tif)",
    )


def add_png_option(parser: argparse.ArgumentParser) -> None:
    """Add the option for a preview beside the output; `files_of` reads it."""
    parser.add_argument(
        "--png",
        action="store_true",
        help="write OUT.png beside OUT too, of several views one for each: OUT.left.png",
    )


def check_output(arguments: argparse.Namespace) -> None:
    """Reject an output that cannot be written.

    Raises:
        CommandError: another format, or there is no such folder, or it is not writable.
        ValueError: a format has no such ``--bits``.
    """
    from jaxblur import exr

    output = arguments.output
    if output.is_dir():
        raise CommandError(f"{output}: is a folder; give a file name.")
    if not output.suffix:
        takes_folders = "inputs" in arguments
        why = "no such folder; create it, or give" if takes_folders else "has no extension; give"
        raise CommandError(f"{output}: {why} a file, such as {output}.exr.")
    if output.suffix.lower() not in exr.WRITABLE:
        raise CommandError(
            f"{output}: can write {', '.join(exr.WRITABLE)} only; change the extension."
        )
    pictures = pictures_of(arguments, output)
    if arguments.bits is not None and not pictures:
        raise CommandError("--bits: is for pictures, and an .exr keeps its types; leave it out.")
    for picture in pictures:
        exr.bits_of(picture, arguments.bits)
    check_parent(output)


def pictures_of(arguments: argparse.Namespace, output: Any) -> list[Any]:
    """The pictures that a frame without views becomes: OUT if it is none, and OUT.png with --png.

    Args:
        arguments: of the command.
        output: a path, or the `jaxblur.sequence.FrameNames` of a sequence.
    """
    suffix = arguments.output.suffix.lower()
    pictures = [] if suffix == ".exr" else [output]
    if getattr(arguments, "png", False) and suffix != ".png":
        pictures.append(output.with_suffix(".png"))
    return pictures


def files_of(arguments: argparse.Namespace, output: Any, names: Sequence[str | None]) -> list[Any]:
    """The files of a frame: the output and, with ``--png``, the picture beside it.

    Args:
        arguments: of the command.
        output: a path, or the `jaxblur.sequence.FrameNames` of a sequence.
        names: of its views, of which each gets a picture of its own if there are several.

    Returns:
        Paths, or names of sequences: an ``.exr`` first, then the pictures of each format in the
        order of the views.

    Raises:
        CommandError: the name of a view cannot stand in that of a file.
    """
    from jaxblur.sequence import with_view

    files = [output] if arguments.output.suffix.lower() == ".exr" else []
    pictures = pictures_of(arguments, output)
    if len(names) < 2 or not pictures:
        return [*files, *pictures]
    # Names come from a file that may be crafted, and must not lead to another folder.
    for name in names:
        if not re.fullmatch(r"[\w-]+", str(name)):
            raise CommandError(
                f"{arguments.output}: a picture is named after its view, and {name!r} is no name "
                "for a file; choose one view with --views NAME."
            )
    return [*files, *(with_view(each, str(name)) for each in pictures for name in names)]


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
    pictures = [output for output in outputs if output.suffix.lower() != ".exr"]
    if len(pictures) < len(outputs):
        _write_exr(arguments, outputs[0], provenance, views.merged(made), unchanged)
        unchanged = None
    # The views, once for each format.
    for output, (loaded, image) in zip(pictures, itertools.cycle(made), strict=False):
        _write_picture(arguments, output, provenance, loaded, image, unchanged)
        unchanged = None
    for suffix, output in {output.suffix.lower(): output for output in pictures}.items():
        LOG.info("%s: %s", suffix, _transform(arguments, output, made[0][0].colors))


def _transform(arguments: argparse.Namespace, picture: pathlib.Path, colors: Any) -> str:
    """What the values of a picture are, in words."""
    from jaxblur import exr

    bits = exr.bits_of(picture, arguments.bits)
    if bits == exr.LINEAR_BITS:
        return "linear light of the frame, 32-bit float"
    if colors.view is not None:
        return f"{bits} bit, in that view"
    return f"{bits}-bit sRGB, clipped to 0..1"


def _write_picture(
    arguments: argparse.Namespace,
    output: pathlib.Path,
    notes: Mapping[str, str],
    loaded: Loaded,
    image: Any,
    unchanged: Any,
) -> None:
    """Write the picture of a frame, or of a view: light as it is, or as a screen shows it."""
    from jaxblur import exr

    picture, colors = loaded.picture(image), loaded.colors
    if exr.bits_of(output, arguments.bits) != exr.LINEAR_BITS:
        picture = colors.light(picture)
        notes = dict(notes) | ({} if colors.is_identity else {exr.COLORS: colors.words})
    picture = exr.put_into(picture, *loaded.buffers.windows)
    exr.write_image(output, picture, attributes=notes, unchanged=unchanged, bits=arguments.bits)


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
        window=loaded.buffers.windows.data,
        sky=exr.SKY[loaded.buffers.depth_kind],
    )


def _write_composite(
    output: pathlib.Path, image: Any, notes: Mapping[str, str], loaded: Loaded, unchanged: Any
) -> None:
    """Write the blurred layers with the metadata of the front one."""
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
        window=loaded.buffers.windows.data,
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
        **_decoding(arguments, loaded),
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


def _decoding(arguments: argparse.Namespace, loaded: Loaded) -> dict[str, Any]:
    """The other choices by which vectors and depth were read, as far as they matter."""
    read = [layer.buffers for layer in loaded.layers] or [loaded.buffers]
    presets = [buffers.guess.preset for buffers in read]
    values = {
        "velocity_channels": ", ".join(
            dict.fromkeys(name for buffers in read for name in buffers.guess.channels)
        ),
        "depth_channel": ", ".join(
            dict.fromkeys(buffers.depth_channel for buffers in read if buffers.depth_channel)
        ),
        "file_shutter": any(preset.span == "shutter" for preset in presets)
        and arguments.file_shutter,
        "max_displace": any(preset.scale == "max-displace" for preset in presets)
        and arguments.max_displace,
        "nonfinite": arguments.nonfinite,
    }
    return {name: value for name, value in values.items() if value}


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
