"""One frame: read it, blur it, write it; the same for a single frame and in a sequence."""

import argparse
import dataclasses
import logging
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jaxblur
from jaxblur.filters.registry import filter_info
from jaxblur.settings import Settings

from . import layer_reading, posts, sources, stack, strength
from .arguments import PNG_TRANSFORM, CommandError, check_folder
from .filtering import apply_filter, noise_of, takes_neighbors
from .shutter import Exposure

LOG = logging.getLogger("jaxblur")

SCORE_COLUMNS = ("against truth", ">PSNR dB", ">SSIM", ">FLIP")

# Every radius costs a compilation, so a sequence uses few: from 20 px on, each at most 1.5 times
# as large as needed.
SEQUENCE_RADII = (10, 20, 30, 40, 60, 80, 120, 160, 240, 320, 480, 640, 960, 1280, 1920)

STILL = 0.5
"""Half-spread in pixels that no filter blurs."""
PASSED_THROUGH = "none"
"""In the place of the filter's name for a frame that was not blurred."""
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


@dataclasses.dataclass(frozen=True)
class Choice:
    """A filter with its parameters and settings.

    Attributes:
        name: of a registered filter, or `PASSED_THROUGH`.
        parameters: of the filter, by name.
        settings: of the filter.
    """

    name: str
    parameters: Mapping[str, float]
    settings: Settings


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
        motion: how its motion was changed, in words.
        ranks: of `Source`.
        changes: a `jaxblur.exr.ChannelChange` of each Cryptomatte layer, once they are blurred.
        selects: of `Source`.
        layers: of `Source`.
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
    motion: str = ""
    ranks: tuple[Any, ...] = ()
    changes: tuple[Any, ...] = ()
    selects: bool = True
    layers: tuple[stack.ReadLayer, ...] = ()

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


def check_output(output: pathlib.Path) -> None:
    """Reject the name of an output that cannot be written.

    Raises:
        CommandError: another format, or there is no such folder, or it is not writable.
    """
    if output.is_dir():
        raise CommandError(f"{output}: is a folder; give a file name.")
    if output.suffix.lower() not in (".exr", ".png"):
        raise CommandError(f"{output}: can write .exr and .png only; change the extension.")
    if not output.parent.is_dir():
        raise CommandError(f"{output}: no folder {output.parent}; create it first.")
    check_folder(output.parent)


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
    buffers, motion, selects = strength.apply(arguments, sources.read(arguments))
    ranks = ()
    if getattr(arguments, "cryptomatte", None):
        group = exr.ColorGroup("", buffers.color_channels, None)
        ranks = exr.read_ranks(arguments.input, group)
        LOG.info("Cryptomattes: %s", ", ".join(each.layer.name for each in ranks))
    return Source(arguments.input, buffers, states, motion, ranks, selects)


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
    truth = _read_truth(arguments, buffers.color.shape)
    velocity = buffers.velocity
    exposure = getattr(arguments, "exposure", None)
    # The radius limits the displacement at the longest time from the frame.
    seen = velocity if exposure is None else velocity * np.float32(exposure.reach)
    speeds = vectors.speed_statistics(seen, settings.radius)
    _check_motion(arguments, source, speeds.percentiles[100.0])
    path, named = arguments.input, buffers
    if source.layers:
        path, named = source.layers[0].path, source.layers[0].buffers
    return Loaded(
        buffers,
        truth,
        _colors(arguments, path, named.color_channels[0]),
        speeds,
        float(np.hypot(velocity[..., 0], velocity[..., 1]).mean()),
        source.states,
        shutter=arguments.shutter,
        exposure=exposure,
        motion=source.motion,
        ranks=source.ranks,
        selects=source.selects,
        layers=source.layers,
    )


def mismatch(loaded: Loaded, source: Source) -> str:
    """How size or channels of another frame differ from those of a frame; empty if they agree."""
    (height, width, channels), (rows, columns, others) = (
        buffers.color.shape for buffers in (loaded.buffers, source.buffers)
    )
    if (height, width, channels) == (rows, columns, others):
        if source.buffers.pass_channels != loaded.buffers.pass_channels:
            return "has other color passes"
        names, others = ([r.layer.name for r in each.ranks] for each in (loaded, source))
        return "" if names == others else "has other Cryptomattes"
    return (
        f"has {columns}x{rows} pixels and {others} color channels, but the frame has "
        f"{width}x{height} and {channels}"
    )


def _check_motion(arguments: argparse.Namespace, source: Source, fastest: float) -> None:
    """Warn if nothing moves by more than half a pixel, or fail with ``--require-motion``.

    Raises:
        CommandError: nothing moves, and motion is required.
    """
    if fastest >= STILL or arguments.shutter == 0:
        return
    if source.motion:
        why = f"the longest half-spread is {fastest:.2g} px with motion {source.motion}"
    elif fastest == 0:
        why = "all vectors are zero: was the pass rendered?"
    else:
        why = f"the longest half-spread is {fastest:.2g} px: check --preset and --shutter"
        # Over a full frame, fractions of the picture are below 1, in pixels or not.
        if source.buffers.guess.preset.scale == "pixels" and 2 * fastest / arguments.shutter <= 1:
            why += "; such values can be fractions of the frame: try --preset uv, ndc or unity"
    file = arguments.velocity_from or arguments.input
    if getattr(arguments, "require_motion", False):
        raise CommandError(f"{file}: nothing moves; {why}.")
    LOG.warning("%s: nothing moves, so nothing is blurred; %s.", file, why)


def choose(arguments: argparse.Namespace, asked: Choice, loaded: Loaded) -> Choice:
    """Make the choices that depend on the frame: plan and radius.

    Args:
        arguments: of the command.
        asked: choices from the options.
        loaded: the frame.

    Returns:
        The choice to run.

    Raises:
        CommandError: no plan fits the frame.
    """
    if arguments.plan:
        chosen = _planned(arguments, loaded.buffers)
        return _with_radius(chosen, chosen.settings.radius, arguments)
    if arguments.radius == 0:
        chosen = _with_radius(asked, loaded.speeds.suggested_radius, arguments)
        fastest = loaded.speeds.percentiles[100.0]
        LOG.info("radius: %d px, for half-spreads up to %.1f px", chosen.settings.radius, fastest)
        return chosen
    if loaded.speeds.beyond_share > 0:
        enough = loaded.speeds.suggested_radius
        LOG.warning(
            "%.2g %% of the vectors are longer than the radius of %d px and are cut to it; %s",
            100 * loaded.speeds.beyond_share,
            asked.settings.radius,
            f"--radius auto would take {enough}"
            if enough > asked.settings.radius
            else "some are longer than the frame is wide: check --preset and --shutter (frames)",
        )
    return asked


def passed_through(asked: Choice) -> Choice:
    """The choice for a frame that is not blurred, in a run whose other frames are."""
    names = [field.name for field in dataclasses.fields(Settings)]
    settings = Settings(**{name: getattr(asked.settings, name) for name in names})
    return Choice(PASSED_THROUGH, {}, settings)


def blur(chosen: Choice, loaded: Loaded, seed: int | None = None) -> Any:
    """Run the filter; a frame that is passed through is filtered as if nothing moved.

    Neighbors are given to filters that take them.

    Args:
        chosen: what is to be run.
        loaded: the frame.
        seed: moves the noise; None leaves it where it is.

    Returns:
        (H, W, C) NumPy array.
    """
    import numpy as np

    buffers = loaded.buffers
    if chosen.name == PASSED_THROUGH:
        still = np.zeros_like(buffers.velocity)
        buffers = dataclasses.replace(buffers, velocity=still, path=None)
        return apply_filter("pixel_velocity", buffers, {}, chosen.settings)
    if loaded.layers:
        return _blur_layers(chosen, loaded, seed)
    more: dict[str, Any] = {}
    if loaded.neighbors and takes_neighbors(chosen.name):
        given = {side: source.buffers.frame() for side, source in loaded.neighbors.items()}
        more = {**given, "shutter": loaded.shutter}
    if loaded.exposure is not None:
        more["exposure"] = loaded.exposure.shutter()
    return apply_filter(chosen.name, buffers, chosen.parameters, chosen.settings, seed, more)


def _blur_layers(chosen: Choice, loaded: Loaded, seed: int | None) -> Any:
    """Blur layers together; see `blur`."""
    near = {side: source.layers for side, source in loaded.neighbors.items()}
    exposure = loaded.exposure
    return stack.blur(
        loaded.layers,
        near,
        filter_info(chosen.name).make_parameters(**chosen.parameters),
        loaded.buffers.pass_channels,
        settings=chosen.settings,
        noise=noise_of(chosen.settings, seed, loaded.buffers.depth.shape),
        shutter=loaded.shutter,
        exposure=None if exposure is None else exposure.shutter(),
    )


def after_blur(
    arguments: argparse.Namespace, chosen: Choice, loaded: Loaded, image: Any, seed: int | None
) -> Any:
    """Run the posts that the arguments name on a blurred frame.

    Args:
        arguments: of the command.
        chosen: what has blurred it.
        loaded: the frame.
        image: (H, W, C) NumPy array, blurred.
        seed: as `blur` was given it.

    Returns:
        (H, W, C) NumPy array.

    Raises:
        CommandError: a post needs depth, and the frame has none; or the hint of another filter.
    """
    buffers = loaded.buffers
    depth = None if buffers.depth_channel is None else buffers.depth

    def hint() -> Any:
        if chosen.name == PASSED_THROUGH:
            # What is not blurred has the luma of its picture.
            return posts.linear_luma(image[..., : buffers.color.shape[2]])
        if chosen.name != posts.HINTING:
            raise CommandError(
                f"--then {posts.HINTED}: {chosen.name} gives no hint; pass --filter "
                f"{posts.HINTING}, or --then fxaa."
            )
        from jaxblur.filters.guertin2014 import luma_hint

        return apply_filter(
            chosen.name, buffers, chosen.parameters, chosen.settings, seed, call=luma_hint
        )

    velocity = None if chosen.name == PASSED_THROUGH else buffers.velocity
    return posts.apply(arguments, image, depth, buffers.color.shape[2], hint, velocity)


def scores_of(images: Mapping[str, Any], loaded: Loaded) -> dict[str, Any]:
    """Score images in the colors of a frame against its truth, as a screen shows them.

    Args:
        images: (H, W, C) colors of the frame by name.
        loaded: the frame.

    Returns:
        `jaxblur.metrics.Scores` by name; empty without a truth.
    """
    if loaded.truth is None:
        return {}
    shown = {name: loaded.colors.light(image) for name, image in images.items()}
    return scores(shown, loaded.truth)


def scores(images: Mapping[str, Any], truth: Any) -> dict[str, Any]:
    """Score images against a truth.

    Args:
        images: (H, W, C) linear light by name.
        truth: (H, W, C) linear light.

    Returns:
        `jaxblur.metrics.Scores` by name.
    """
    from jaxblur import metrics

    return {
        name: metrics.compare(metrics.rgb(image), metrics.rgb(truth))
        for name, image in images.items()
    }


def score_rows(scored: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Format `scores` as rows for `SCORE_COLUMNS`."""
    return [
        (name, f"{score.psnr:.2f}", f"{score.ssim:.4f}", f"{score.flip:.4f}")
        for name, score in scored.items()
    ]


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


def provenance(arguments: argparse.Namespace, chosen: Choice, loaded: Loaded) -> dict[str, str]:
    """Everything needed to make an output again; file names without folders."""
    buffers = loaded.buffers
    used = dataclasses.asdict(chosen.settings) | {
        "shutter": arguments.shutter,
        "preset": buffers.guess.preset.name,
        "depth": buffers.depth_kind,
        "sky": arguments.sky,
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
        passes = exr.choose_passes(info, found, strength.passes_of(here), here.layer)
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


def _read_truth(arguments: argparse.Namespace, shape: tuple[int, ...]) -> Any:
    from jaxblur import exr

    if arguments.truth is None:
        return None
    info = exr.inspect(arguments.truth)
    channel = exr.choose_color(info, arguments.truth_layer).channels[0]
    truth = exr.read_image(arguments.truth, arguments.truth_layer)
    colors = exr.conversion_of(info, channel, arguments.color_space, arguments.view)
    if not colors.is_identity:
        LOG.info("colors of the truth: %s", colors.words)
    if truth.shape[:2] != shape[:2]:
        (rows, columns), (height, width) = truth.shape[:2], shape[:2]
        raise CommandError(
            f"{arguments.truth}: the truth has {columns}x{rows} pixels, but {arguments.input} has "
            f"{width}x{height}; render both with the same data window."
        )
    return colors.light(truth)


def _colors(arguments: argparse.Namespace, path: pathlib.Path, channel: str) -> Any:
    """How the colors of a frame are shown; said in one line if they are shown and converted."""
    from jaxblur import exr

    colors = exr.conversion_of(exr.inspect(path), channel, arguments.color_space, arguments.view)
    png = arguments.png or arguments.output.suffix.lower() == ".png"
    if not colors.is_identity and (png or arguments.truth):
        LOG.info("colors: %s", colors.words)
    return colors


def _planned(arguments: argparse.Namespace, buffers: Any) -> Choice:
    """Choose from the frame's statistics what `complete` takes from the options, and log why."""
    from jaxblur.planning import plan

    try:
        chosen = plan(buffers.frame(), arguments.budget, arguments.tolerance)
    except ValueError as error:
        raise CommandError(f"--plan auto: {error}") from error
    LOG.info("plan: %s", chosen.reason)
    values = {} if chosen.parameters is None else dataclasses.asdict(chosen.parameters)
    return Choice(chosen.filter, values, chosen.settings)


def _with_radius(choice: Choice, radius: int, arguments: argparse.Namespace) -> Choice:
    """Take a radius from the frame; in a sequence, the next larger one of a few."""
    if arguments.in_sequence:
        radius = next((step for step in SEQUENCE_RADII if step >= radius), radius)
    settings = dataclasses.replace(choice.settings, radius=radius)
    return dataclasses.replace(choice, settings=settings)


def _toml(values: Mapping[str, Any]) -> str:
    return "\n".join(
        f'{name} = "{value}"' if isinstance(value, str) else f"{name} = {value}"
        for name, value in values.items()
    )
