"""Read one frame, its truth and its place among others, for a single frame and in a sequence."""

import argparse
import dataclasses
import logging
import pathlib
from collections.abc import Mapping
from typing import Any, NamedTuple

from jaxblur.settings import Settings

from . import layer_reading, posts, sources, stack, strength, view_files
from .arguments import CommandError
from .colors import shown_colors
from .disparity import disparity_of
from .shutter import Exposure, reach_of
from .windows import in_window

LOG = logging.getLogger("jaxblur")

STILL = 0.5
"""Half-spread in pixels that no filter blurs."""


class Source(NamedTuple):
    """The files of a frame as they were read, without a truth.

    Attributes:
        path: the file with the color.
        buffers: as `jaxblur.exr.read_buffers` gives them.
        states: a `jaxblur.exr.FileStates` of the files, from before they were read.
        motion: how its motion was changed, in words; see `strength.apply`.
        ranks: a `jaxblur.exr.Ranks` of each Cryptomatte layer, if they are to be blurred.
        selects: whether ``--scale-motion`` is for any pixel; see `strength.Changed`.
        layers: `.stack.ReadLayer` of each layer, of which the buffers are the composite; empty for
            a frame without layers.
    """

    path: pathlib.Path
    buffers: Any
    states: Any
    motion: str = ""
    ranks: tuple[Any, ...] = ()
    selects: bool = True
    layers: tuple[stack.ReadLayer, ...] = ()


@dataclasses.dataclass(frozen=True)
class Loaded:
    """A frame as it was read.

    Attributes:
        buffers: as `jaxblur.exr.read_buffers` gives them.
        truth: (H, W, C) linear light that a screen shows, or None.
        colors: a `jaxblur.exr.Conversion` of the frame's colors to such light.
        speeds: a `jaxblur.vectors.SpeedStatistics`.
        mean_speed: mean half-spread in pixels.
        states: a `jaxblur.exr.FileStates` of the files, from before they were read.
        neighbors: the frames ``before`` and ``after``, as far as they are used.
        shutter: exposure, in units of the time from one neighbor to the frame.
        exposure: a `.shutter.Exposure`; None for a box centered on the frame.
        lens: a `jaxblur.posts.Lens` through which it is blurred; None for a pinhole.
        motion: how its motion was changed, in words.
        ranks: of `Source`.
        changes: a `jaxblur.exr.ChannelChange` of each Cryptomatte layer, once they are blurred.
        selects: of `Source`.
        layers: of `Source`.
        disparity: (H, W) pixels by which its noise is that of the left eye; None for its own.
    """

    buffers: Any
    truth: Any
    colors: Any
    speeds: Any
    mean_speed: float
    states: Any
    neighbors: Mapping[str, Source] = dataclasses.field(default_factory=dict)
    shutter: float = 0.5
    exposure: Exposure | None = None
    lens: Any = None
    motion: str = ""
    ranks: tuple[Any, ...] = ()
    changes: tuple[Any, ...] = ()
    selects: bool = True
    layers: tuple[stack.ReadLayer, ...] = ()
    disparity: Any = None

    def picture(self, blurred: Any) -> Any:
        """The blurred picture, without further passes."""
        return blurred[..., : self.buffers.color.shape[2]]

    def with_neighbors(self, neighbors: Mapping[str, Source]) -> "Loaded":
        """The frame with neighbors, whose files must not change either."""
        states = (self.states, *(source.states for source in neighbors.values()))
        every = type(self.states)(tuple(state for each in states for state in each.states))
        return dataclasses.replace(self, neighbors=neighbors, states=every)

    def without_neighbor_pixels(self) -> "Loaded":
        """The frame for what follows the filter, in less memory."""
        names = {
            side: source._replace(buffers=None, ranks=(), layers=())
            for side, source in self.neighbors.items()
        }
        return dataclasses.replace(self, neighbors=names, ranks=())


def add_motion_option(parser: argparse.ArgumentParser) -> None:
    """Add the option that demands motion; `check_motion` and `load` read it."""
    parser.add_argument(
        "--require-motion",
        action="store_true",
        help="fail, rather than warn, if the vectors move nothing by half a pixel",
    )


def check_motion(arguments: argparse.Namespace) -> None:
    """Reject a shutter that leaves every frame sharp where motion is required.

    Raises:
        CommandError: it does.
    """
    if arguments.require_motion and arguments.shutter == 0:
        raise CommandError(
            "--require-motion: at --shutter 0 nothing moves; give an exposure above 0, or leave "
            "out one of the two."
        )


def read(arguments: argparse.Namespace) -> Source:
    """Read the frame that the arguments of `blur` name.

    Args:
        arguments: of the command.

    Returns:
        The frame.

    Raises:
        JaxblurIOError: a file is missing, damaged or holds something else.
    """
    from jaxblur import exr

    mattes = getattr(arguments, "matte_from", None)
    files = [getattr(arguments, role) for role in stack.roles(arguments)]
    files += [arguments.velocity_from, arguments.depth_from, mattes]
    states = exr.FileStates.of(path for path in files if path is not None)
    if getattr(arguments, "stack", ()):
        layers, motion, selects = layer_reading.read(arguments)
        picture = stack.composite(layers)
        return Source(arguments.input, picture, states, motion, selects=selects, layers=layers)
    buffers, motion, selects = strength.apply(arguments, sources.read(arguments, keep_decoded=True))
    ranks = ()
    if getattr(arguments, "cryptomatte", None):
        group = exr.ColorGroup("", buffers.color_channels, None)
        ranks = exr.read_ranks(arguments.input, group)
        LOG.info("Cryptomattes: %s", ", ".join(each.layer.name for each in ranks))
    return _with_room(arguments, Source(arguments.input, buffers, states, motion, ranks, selects))


def _with_room(arguments: argparse.Namespace, source: Source) -> Source:
    """A frame in a data window that holds its blur; views of one file share theirs."""
    from jaxblur import exr

    if getattr(arguments, "shares_file", False):
        exr.warn_cropped(source.path, source.buffers)
        return source
    spread = posts.spread_of(arguments, source.buffers)
    return placed(source, exr.blur_window(source.buffers, reach_of(arguments), spread))


def load(arguments: argparse.Namespace, settings: Settings, source: Source | None = None) -> Loaded:
    """Read the frame that the arguments of `blur` name, and its truth.

    Args:
        arguments: of the command.
        settings: whose radius the speeds are compared with.
        source: the frame, if it was read before.

    Returns:
        The frame.

    Raises:
        JaxblurIOError: a file is missing, damaged or holds something else.
        CommandError: the truth has another size.
    """
    import numpy as np

    from jaxblur import vectors

    source = source or read(arguments)
    buffers = source.buffers
    truth = shown_truth(arguments, buffers.windows)
    velocity = buffers.velocity
    # The radius limits the displacement at the longest time from the frame.
    reach = reach_of(arguments)
    seen = velocity if reach == 1 else velocity * np.float32(reach)
    speeds = vectors.speed_statistics(seen, settings.radius)
    _warn_of_rest(arguments, source, speeds.percentiles[100.0])
    path, named = arguments.input, buffers
    if source.layers:
        path, named = source.layers[0].path, source.layers[0].buffers
    return Loaded(
        buffers,
        truth,
        shown_colors(arguments, path, named.color_channels[0]),
        speeds,
        float(np.hypot(velocity[..., 0], velocity[..., 1]).mean()),
        source.states,
        shutter=arguments.shutter,
        exposure=getattr(arguments, "exposure", None),
        lens=posts.lens_of(arguments, buffers.windows) if posts.looks_through(arguments) else None,
        motion=source.motion,
        ranks=source.ranks,
        selects=source.selects,
        layers=source.layers,
        disparity=disparity_of(arguments, buffers.depth),
    )


def tell_rest(arguments: argparse.Namespace, settings: Settings) -> None:
    """Say whether nothing moves in a frame that is not blurred now, by reading it.

    Args:
        arguments: of the command, for a frame or a view of it.
        settings: as for `load`.

    Raises:
        JaxblurIOError: a file is missing, damaged or holds something else.
        CommandError: nothing moves, and motion is required.
    """
    if arguments.shutter == 0:
        LOG.warning(
            "%s: nothing moves, so nothing is blurred: the exposure is 0; check --shutter.",
            arguments.input,
        )
        return
    load(argparse.Namespace(**vars(arguments) | {"truth": None}), settings)


def mismatch(loaded: Loaded, source: Source) -> str:
    """How picture or channels of another frame differ from those of a frame; empty if they agree.

    Data windows may differ, see `placed`.
    """
    from jaxblur import exr

    own, other = loaded.buffers, source.buffers
    windows = own.windows, other.windows
    if windows[0].data != windows[1].data and windows[0].display != windows[1].display:
        wanted, given = (exr.window_words(each.display) for each in windows)
        return f"has a display window of {given}, but the frame has one of {wanted}"
    wanted, given = own.color.shape[2], other.color.shape[2]
    if wanted != given:
        return f"has {given} color channels, but the frame has {wanted}"
    if other.pass_channels != own.pass_channels:
        return "has other color passes"
    names, others = ([r.layer.name for r in each.ranks] for each in (loaded, source))
    return "" if names == others else "has other Cryptomattes"


def placed(source: Source, wanted: tuple[int, int, int, int]) -> Source:
    """A frame in another data window, see `jaxblur.exr.buffers_in`."""
    from jaxblur import exr

    window = source.buffers.windows.data
    if window == wanted:
        return source
    return source._replace(
        buffers=exr.buffers_in(source.buffers, wanted),
        ranks=tuple(exr.ranks_in(ranks, window, wanted) for ranks in source.ranks),
        layers=tuple(
            layer._replace(buffers=exr.buffers_in(layer.buffers, wanted)) for layer in source.layers
        ),
    )


def _warn_of_rest(arguments: argparse.Namespace, source: Source, fastest: float) -> None:
    """Warn if nothing moves by more than half a pixel, or fail with ``--require-motion``.

    Raises:
        CommandError: nothing moves, and motion is required.
    """
    if fastest >= STILL or arguments.shutter == 0:
        return
    if source.motion:
        why = f"the longest half-spread is {fastest:.2g} px with motion {source.motion}"
    elif fastest == 0:
        why = "all vectors are zero; check that the pass was rendered"
    else:
        why = f"the longest half-spread is {fastest:.2g} px: check --preset and --shutter"
        # Over a full frame, fractions of the picture are below 1, in pixels or not.
        if source.buffers.guess.preset.scale == "pixels" and 2 * fastest / arguments.shutter <= 1:
            why += "; such values can be fractions of the frame: try --preset uv, ndc or unity"
    file = arguments.velocity_from or arguments.input
    if getattr(arguments, "require_motion", False):
        raise CommandError(f"{file}: nothing moves; {why}.")
    LOG.warning("%s: nothing moves, so nothing is blurred; %s.", file, why)


def shown_truth(arguments: argparse.Namespace, windows: Any) -> Any:
    """Read the truth for scores, if the arguments name one.

    Args:
        arguments: of the command.
        windows: `jaxblur.exr.Windows` of the frame.

    Returns:
        (H, W, C) linear light that a screen shows, or None.

    Raises:
        JaxblurIOError: the file is missing, damaged or holds something else.
        CommandError: it does not hold all pixels of the frame, or these are too few for scores.
    """
    if arguments.truth is None:
        return None
    from jaxblur import metrics

    *_, width, height = windows.data
    if min(height, width) < (least := metrics.SSIM_WINDOW):
        raise CommandError(
            f"--truth: {arguments.input} has {width}x{height} pixels, but scores need "
            f"{least}x{least} or more (the window of SSIM); leave it out."
        )
    stored, colors = read_truth(arguments, windows, arguments.view)
    if not colors.is_identity:
        LOG.info("colors of the truth: %s", colors.words)
    return colors.light(stored)


def read_truth(arguments: argparse.Namespace, windows: Any, view: str | None) -> tuple[Any, Any]:
    """Read the truth that the arguments name, for the pixels of the frame.

    Args:
        arguments: of the command.
        windows: `jaxblur.exr.Windows` of the frame.
        view: OpenColorIO view that it is to be shown in, or None.

    Returns:
        (H, W, C) in the colors of its file, and their `jaxblur.exr.Conversion`.

    Raises:
        JaxblurIOError: the file is missing, damaged or holds something else.
        CommandError: it does not hold all pixels of the frame.
    """
    from jaxblur import exr

    info, layer = exr.inspect(arguments.truth), arguments.truth_layer
    if layer is None and (eye := view_files.name_of(arguments)) in exr.views_of(info):
        # A view is compared with the truth for the same eye.
        layer = eye
    channels = exr.choose_color(info, layer).channels
    truth = exr.read_image(arguments.truth, layer)
    truth = in_window(
        truth,
        arguments.truth,
        channels[0],
        arguments.input,
        windows,
        what="the truth",
        outside=0 if exr.is_element(truth, channels) else None,
    )
    return truth, exr.conversion_of(info, channels[0], arguments.color_space, view)
