"""Choose the color, depth and vector channels of a file by their names."""

import dataclasses
from collections.abc import Sequence

from jaxblur import vectors
from jaxblur._util.errors import JaxblurIOError

from .files import FileInfo

# Names of layers that hold the picture, the clearest first; the empty name is the root layer.
COLOR_LAYERS = ("", "combined", "rgba", "rgb", "beauty", "color", "c", "main", "finalimage")
DEPTH_PATTERNS = (
    *("Depth.Z", "Depth.V", "depth.Z", "depth.V", "depth.z", "Depth.R", "depth.R", "depth.Y"),
    *("*WorldDepth.R", "ZDepth.R", "ZDepth.Z", "zdepth.R", "__depth.r", "Z.Z", "Z.R", "Z.V"),
    *("VRayZDepth.R", "VRayZDepth.Z", "Z-Depth.R", "Z-Depth.Z", "Pz.R", "Pz.Z", "Pz.Y"),
    *("ZDepth", "zdepth", "Depth", "depth", "VRayZDepth", "Z-Depth", "Pz"),
)
# RenderMan's velocities in scene units, which only the camera could turn into pixels.
THREE_DIMENSIONAL = ("dPdtime", "dPcameradtime")
# A lone Z is a depth only at the root or beside the color; elsewhere it is an axis.
ROOT_DEPTH = ("Z", "z")


@dataclasses.dataclass(frozen=True)
class ColorGroup:
    """The color channels of a file.

    Attributes:
        prefix: part of the name before the component, with its dot; empty at the root.
        channels: full names in the order R, G, B, A or Y, A, or as given.
        alpha: full name of the alpha channel, or None.
    """

    prefix: str
    channels: tuple[str, ...]
    alpha: str | None


def names_in_layer(info: FileInfo, layer: str | None) -> tuple[str, ...]:
    """List the channels of a layer, or all of them.

    Args:
        info: listing of the file.
        layer: view layer, view or part; it may stand anywhere in the dotted name.

    Returns:
        Full names.

    Raises:
        JaxblurIOError: the file has no such layer.
    """
    if layer is None:
        return info.channel_names
    names = tuple(name for name in info.channel_names if f".{layer}." in f".{name}")
    if not names:
        listing = vectors.describe_names(info.channel_names)
        raise JaxblurIOError(info.path, f"no layer {layer!r}; the file holds {listing}.")
    return names


def choose_color(
    info: FileInfo, layer: str | None = None, color_channels: Sequence[str] | None = None
) -> ColorGroup:
    """Find the picture in a file.

    Args:
        info: listing of the file.
        layer: search this layer only.
        color_channels: full names to take instead.

    Returns:
        The group.

    Raises:
        JaxblurIOError: there is no color, or several layers could be it.
    """
    if color_channels is not None:
        names = tuple(info.channel(name).name for name in color_channels)
        alpha = next((name for name in names if _component(name) == "A"), None)
        return ColorGroup(names[0].rpartition(".")[0], names, alpha)
    names = names_in_layer(info, layer)
    groups = _color_groups(names)
    for wanted in COLOR_LAYERS:
        found = [group for group in groups if _layer_name(group.prefix) == wanted]
        if found:
            return _single(info, found)
    if not groups:
        listing = vectors.describe_names(names)
        raise JaxblurIOError(
            info.path, f"no color (R, G, B or Y) among {listing}; give `color_channels`."
        )
    return _single(info, groups)


def choose_vectors(
    info: FileInfo,
    preset: str = "auto",
    layer: str | None = None,
    velocity_channels: Sequence[str] | None = None,
) -> vectors.Guess:
    """Find the motion vectors in a file and their convention.

    Args:
        info: listing of the file.
        preset: a convention, or "auto" to recognize it.
        layer: search this layer only.
        velocity_channels: full names to take, for conventions that cannot be recognized by name.

    Returns:
        Convention, channels and the reason.

    Raises:
        JaxblurIOError: no channels match, or several sets of them do.
    """
    try:
        if velocity_channels is not None:
            names = [info.channel(name).name for name in velocity_channels]
            if any(set(name.split(".")) & set(THREE_DIMENSIONAL) for name in names):
                raise ValueError(
                    f"{', '.join(names)} are velocities in the scene, not in the picture; render "
                    "motionFore and motionBack instead."
                )
            if preset == "auto":
                raise ValueError(
                    "`velocity_channels` do not say what the values mean; name the convention "
                    "with `preset`."
                )
            return vectors.assign_channels(preset, names)
        names = names_in_layer(info, layer)
        if preset == "auto":
            return vectors.guess_preset(names)
        return vectors.match_preset(preset, names)
    except ValueError as error:
        raise JaxblurIOError(info.path, str(error)) from error


def choose_depth(
    info: FileInfo,
    layer: str | None = None,
    depth_channel: str | None = None,
    color_prefix: str = "",
    taken: Sequence[str] = (),
) -> str:
    """Find the depth channel of a file.

    Args:
        info: listing of the file.
        layer: search this layer only.
        depth_channel: full name to take instead.
        color_prefix: layer of the color; a Z in the same layer is depth.
        taken: channels that have another use (the vectors).

    Returns:
        Its full name.

    Raises:
        JaxblurIOError: the file has no depth channel, or several candidates.
    """
    if depth_channel is not None:
        return info.channel(depth_channel).name
    names = [name for name in names_in_layer(info, layer) if name not in taken]
    roots = {prefix + z for prefix in ("", color_prefix) for z in ROOT_DEPTH}
    candidates = [vectors.find_channels(pattern, names) for pattern in DEPTH_PATTERNS]
    candidates.append([name for name in names if name in roots])
    found = next((group for group in candidates if group), [])
    if len(found) == 1:
        return found[0]
    if found:
        raise JaxblurIOError(
            info.path, f"several depth channels: {', '.join(found)}; choose with `depth_channel`."
        )
    raise JaxblurIOError(
        info.path,
        f"no depth channel among {vectors.describe_names(names)}; give `depth_channel` or "
        "`depth_from`, or depth='flat' to blur without occlusion.",
    )


def is_depth(name: str) -> bool:
    """Decide by name whether a channel holds depth, in which infinity is sky.

    Args:
        name: full name of the channel.

    Returns:
        True if it holds depth.
    """
    return any(vectors.find_channels(pattern, [name]) for pattern in (*DEPTH_PATTERNS, *ROOT_DEPTH))


def _component(name: str) -> str:
    letter = name.rpartition(".")[2]
    words = {"red": "R", "green": "G", "blue": "B", "alpha": "A", "luminance": "Y"}
    return words.get(letter.lower(), letter.upper())


def _layer_name(prefix: str) -> str:
    return prefix.rstrip(".").rpartition(".")[2].lower()


def _color_groups(names: Sequence[str]) -> list[ColorGroup]:
    """Group R, G, B and Y channels by layer, leaving out known motion vectors."""
    layers: dict[str, dict[str, str]] = {}
    for name in names:
        if _component(name) in ("R", "G", "B", "A", "Y"):
            prefix = name[: len(name) - len(name.rpartition(".")[2])]
            layers.setdefault(prefix, {})[_component(name)] = name
    groups = []
    for prefix, found in layers.items():
        members = next((m for m in ("RGB", "Y") if set(m) <= set(found)), None)
        if members is not None and not _is_velocity(prefix):
            channels = tuple(found[c] for c in (members + "A") if c in found)
            groups.append(ColorGroup(prefix, channels, found.get("A")))
    return groups


def _is_velocity(prefix: str) -> bool:
    return any(
        vectors.find_channels(pair.x, [prefix + pair.x.rpartition(".")[2]])
        for preset in vectors.PRESETS.values()
        for layout in preset.layouts
        for pair in layout
        if "." in pair.x
    )


def _single(info: FileInfo, groups: list[ColorGroup]) -> ColorGroup:
    if len(groups) > 1:
        options = "; ".join(", ".join(group.channels) for group in groups)
        raise JaxblurIOError(
            info.path,
            f"several layers of color: {options}; choose with `layer` or `color_channels`.",
        )
    return groups[0]
