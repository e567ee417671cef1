"""Options for the place of color, passes, vectors and depth of a frame, and reading by them."""

import argparse
import dataclasses
import logging
import pathlib
from collections.abc import Sequence
from typing import Any

from .arguments import channel_names, file_path, positive_number, preset_name
from .shutter import add_exposure, add_fps

LOG = logging.getLogger("jaxblur")


def add_vector_options(parser: argparse.ArgumentParser, layer: bool = True) -> None:
    """Add the options that say what the vectors in a file mean.

    Args:
        parser: of a command.
        layer: whether one option names the layer, for commands that take one frame.
    """
    group = parser.add_argument_group("motion vectors")
    add_exposure(group, "--shutter", "exposure to blur for", default=0.5)
    group.add_argument(
        "--preset",
        type=preset_name,
        default="auto",
        metavar="NAME",
        help="convention of the vectors (default auto: by channel names; `blur` on a sequence also "
        "compares two frames, where names settle nothing)",
    )
    group.add_argument(
        "--velocity-channels",
        type=channel_names,
        metavar="X,Y[,X,Y]",
        help="names of the vector channels, where the preset does not know them",
    )
    add_exposure(
        group,
        "--file-shutter",
        "exposure of the render that wrote the vectors, for presets that span the shutter",
    )
    add_fps(group)
    add_max_displace(group)
    if layer:
        group.add_argument(
            "--layer", metavar="NAME", help="view layer, stereo view or part to look in"
        )


def add_max_displace(parser: Any) -> None:
    """Add ``--max-displace`` to a parser, or to a group of one."""
    parser.add_argument(
        "--max-displace",
        type=positive_number,
        metavar="PX",
        help="length in pixels of a vector at the end of the range, for presets that need it",
    )


def add_channel_options(group: Any) -> None:
    """Add the options that name the channels of color and depth."""
    group.add_argument("--color-channels", type=channel_names, metavar="R,G,B[,A]")
    group.add_argument("--depth-channel", metavar="NAME")


def add_source_options(parser: argparse.ArgumentParser, of_many: str = "") -> Any:
    """Add the options, for `read`.

    Args:
        parser: of a command.
        of_many: how files are matched to frames, for commands that take many frames.

    Returns:
        Their group.
    """
    group = parser.add_argument_group("where color, vectors and depth are")
    add_channel_options(group)
    files: dict[str, Any] = {"nargs": "+", "help": of_many} if of_many else {"type": file_path}
    for name in ("--velocity-from", "--depth-from"):
        group.add_argument(name, metavar="FILE", **files)
    _add_kinds(group)
    return group


def add_depth_options(parser: argparse.ArgumentParser) -> Any:
    """Add those of `add_source_options` that hold for each of several layers.

    Args:
        parser: of a command.

    Returns:
        Their group.
    """
    group = parser.add_argument_group("depth and sky")
    group.add_argument("--depth-channel", metavar="NAME")
    _add_kinds(group)
    return group


def add_depth_kind(group: Any, use: str = "") -> None:
    """Add ``--depth``.

    Args:
        group: of a parser.
        use: what it is for, where that is not all of the command.
    """
    group.add_argument(
        "--depth",
        default="auto",
        metavar="KIND",
        help=f"{use}auto, z, 1/z, normalized-near1, flat (no occlusion), --depth=-z or "
        "--depth=-1/z",
    )


def _add_kinds(group: Any) -> None:
    """Add the options for the kind of depth and for the sky."""
    add_depth_kind(group)
    group.add_argument(
        "--sky",
        choices=("file", "camera"),
        default="file",
        help="velocity of the sky: as in the file, or, where it is zero there, that of the "
        "camera's turn, estimated from the surfaces (default %(default)s)",
    )


def add_pass_options(group: Any) -> None:
    """Add the options for further color passes.

    Args:
        group: of a parser.
    """
    which = group.add_mutually_exclusive_group()
    which.add_argument(
        "--also",
        type=channel_names,
        action="extend",
        default=[],
        metavar="LAYER[,LAYER]",
        help="blur these color passes by the weights of the picture, so that they add up to it as "
        "before: diffuse,'spec*'; repeat for more",
    )
    which.add_argument(
        "--all-color",
        action="store_true",
        help="the same for all color passes; normals, positions, mattes, identifiers stay",
    )


def passes_of(arguments: argparse.Namespace) -> Any:
    """The color passes, as `jaxblur.exr.read_buffers` takes them."""
    return "all" if getattr(arguments, "all_color", False) else getattr(arguments, "also", ())


def read(arguments: argparse.Namespace, keep_decoded: bool = False) -> Any:
    """Read the frame that the arguments name, and log how it was read.

    Args:
        arguments: with ``input`` and the options of `add_source_options` and of the vectors.
        keep_decoded: as `jaxblur.exr.read_buffers`, for a frame that is written again.

    Returns:
        Buffers as `jaxblur.exr.read_buffers` gives them, the sky turned with the camera if asked.

    Raises:
        JaxblurIOError: a file is missing, damaged or holds something else.
    """
    from jaxblur import exr

    buffers = exr.read_buffers(
        arguments.input,
        arguments.preset,
        arguments.shutter,
        depth=arguments.depth,
        velocity_from=arguments.velocity_from,
        depth_from=arguments.depth_from,
        file_shutter=arguments.file_shutter,
        max_displace=arguments.max_displace,
        layer=arguments.layer,
        color_channels=arguments.color_channels,
        velocity_channels=arguments.velocity_channels,
        depth_channel=arguments.depth_channel,
        nonfinite=arguments.nonfinite,
        also=passes_of(arguments),
        keep_decoded=keep_decoded,
    )
    LOG.info("color: %s", ", ".join(buffers.color_channels))
    if buffers.pass_channels:
        LOG.info("passes: %s", _describe_passes(buffers.pass_channels))
    is_kept = not getattr(arguments, "drop_extra", True)
    if is_kept and buffers.sharp_layers and arguments.output.suffix.lower() == ".exr":
        LOG.info("stay sharp: %s; --also blurs them too", ", ".join(buffers.sharp_layers))
    LOG.info("vectors: %s", buffers.guess.reason)
    LOG.info("depth: %s, read as %s", buffers.depth_channel or "none", buffers.depth_kind)
    return _with_turning_sky(arguments.input, buffers) if arguments.sky == "camera" else buffers


def _describe_passes(names: Sequence[str]) -> str:
    """Layers of channels, in words."""
    return ", ".join(dict.fromkeys(name.rpartition(".")[0] for name in names))


def _with_turning_sky(path: pathlib.Path, buffers: Any) -> Any:
    """Give the sky the velocity of the camera's turn, and log whether one was found."""
    import numpy as np

    from jaxblur.vectors.sky import turning_sky

    frame = buffers.frame()
    turned = turning_sky(frame)
    if turned is frame:
        LOG.info("sky: %s: as in the file; no turn of the camera was found", path)
        return buffers
    speeds = np.linalg.norm(np.asarray(turned.velocity)[np.isposinf(buffers.depth)], axis=-1)
    LOG.info("sky: %s: turns with the camera, half-spread %.1f px", path, speeds.mean())
    curved = None if turned.path is None else np.asarray(turned.path)
    return dataclasses.replace(buffers, velocity=np.asarray(turned.velocity), path=curved)
