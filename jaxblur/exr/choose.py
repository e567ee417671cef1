"""Choose the color, depth and vector channels of a file by their names."""

import dataclasses
import difflib
import functools
import shlex
from collections.abc import Mapping, Sequence

from jaxblur import vectors
from jaxblur._util.errors import JaxblurIOError

from .listing import FileInfo, Part

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
        prefix: part of the name before the component, with its dot and without a view; empty at
            the root.
        channels: full names in the order R, G, B, A or Y, A, or as given.
        alpha: full name of the alpha channel, or None.
    """

    prefix: str
    channels: tuple[str, ...]
    alpha: str | None


def views_of(info: FileInfo) -> tuple[str, ...]:
    """List the views of a stereo file, the default view first.

    Args:
        info: listing of the file.

    Returns:
        Names from the attribute ``multiView`` of a single part, or from the attributes ``view`` of
        several parts, in their order; empty if the file has none.
    """
    first, *others = info.parts
    if others:
        return tuple(dict.fromkeys(filter(None, map(_view_of_part, info.parts))))
    found = first.attributes.get("multiView", ())
    names = (found,) if isinstance(found, str) else found
    return tuple(map(str, names)) if isinstance(names, tuple) else ()


def colored_views(info: FileInfo) -> tuple[str, ...]:
    """List the views of a stereo file that have a picture of their own.

    Args:
        info: listing of the file.

    Returns:
        Names as `views_of` gives them. A view that was not kept when the file was written is named
        in it, but has no channels.
    """
    views = views_of(info)
    of_view: dict[str, dict[str, str]] = {}
    for name in info.channel_names if views else ():
        of_view.setdefault(_view(info, name), {})[_without_view(info, name)] = name
    return tuple(view for view in views if _color_groups(of_view.get(view, {})))


def _view_of_part(part: Part) -> str:
    """Return the view of a part of several, empty if it belongs to none in particular."""
    view = part.attributes.get("view")
    return view if isinstance(view, str) else ""


def borrowed_from(info: FileInfo, layer: str | None, names: Sequence[str]) -> str:
    """Say in words that a view has no such channels of its own.

    Args:
        info: listing of the file.
        layer: view that was asked for.
        names: channels that were chosen for it.

    Returns:
        Half a sentence, or nothing if the channels are those of the view.
    """
    views = views_of(info)
    if layer not in views or all(_view(info, name) == layer for name in names):
        return ""
    default = views[0]
    if layer == default and not any(_view(info, name) for name in names):
        return ""
    return f"view {layer} has none of its own, so {', '.join(names)} of view {default} is used"


def _view(info: FileInfo, name: str) -> str:
    """Return the view of a channel, empty if it belongs to none in particular.

    Source: the rules of OpenEXR's ImfMultiView: the view stands before the component, and channels
    without any layer belong to the default view. Here the view may stand anywhere before the
    component, since not every program that writes such files keeps to the rules. Where there are
    several parts, each names its view.
    """
    if len(info.parts) > 1:
        return _view_of_part(info.parts[info.channel(name).part])
    layers, views = name.split(".")[:-1], views_of(info)
    if not layers:
        return views[0]
    return next((view for view in reversed(layers) if view in views), "")


def _scope(info: FileInfo, layer: str | None, shared: bool = False) -> dict[str, str]:
    """List the channels of a layer or view, or all of them.

    Args:
        info: listing of the file.
        layer: view layer, view or part; it may stand anywhere in the dotted name.
        shared: the channels of the default view, for a view that lacks some.

    Returns:
        Full names by the names without the view. Without a view or for the default view, channels
        of other views are left out.

    Raises:
        JaxblurIOError: the file has no such layer.
    """
    views, names = views_of(info), info.channel_names
    plain = {name: name for name in names}
    if views:
        wanted = layer if layer in views and not shared else views[0]
        allowed = (wanted, "") if wanted == views[0] else (wanted,)
        plain = {_without_view(info, name): name for name in names if _view(info, name) in allowed}
    if layer is not None and layer not in views:
        plain = {short: name for short, name in plain.items() if f".{layer}." in f".{short}"}
    if not plain:
        listing = vectors.describe_names(names)
        raise JaxblurIOError(
            info.path,
            f"no layer {layer!r}{_nearest_layer(layer, names)}; the file holds {listing}.",
        )
    return plain


def _nearest_layer(layer: str | None, names: Sequence[str]) -> str:
    """Suggest the layer whose name is nearest, or nothing."""
    paths = [name.split(".")[:-1] for name in names]
    known = {
        ".".join(path[begin:end])
        for path in paths
        for end in range(1, len(path) + 1)
        for begin in range(end)
    }
    lowered = {name.lower(): name for name in sorted(known)}
    near = difflib.get_close_matches(str(layer).lower(), lowered, n=1)
    return f" (did you mean {lowered[near[0]]!r}?)" if near else ""


def _without_view(info: FileInfo, name: str) -> str:
    *layers, component = name.split(".")
    view = _view(info, name)
    return ".".join((*(layer for layer in layers if layer != view), component))


def _scopes(info: FileInfo, layer: str | None) -> list[dict[str, str]]:
    """List where data of a view may be: among its own channels, else in the default view."""
    views = views_of(info)
    own = _scope(info, layer)
    return [own, _scope(info, layer, shared=True)] if layer in views[1:] else [own]


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
        alpha = next((name for name in names if component_of(name) == "A"), None)
        return ColorGroup(names[0].rpartition(".")[0], names, alpha)
    scope = _scope(info, layer)
    groups = _color_groups(scope)
    for wanted in COLOR_LAYERS:
        found = [group for group in groups if _layer_name(group.prefix) == wanted]
        if found:
            return _single(info, found)
    of_its_name = [g for g in groups if layer and _layer_name(g.prefix) == layer.lower()]
    if of_its_name:
        return _single(info, of_its_name)
    if not groups:
        listing = vectors.describe_names(tuple(scope.values()))
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
        return _choose_vectors(_scopes(info, layer), preset)
    except vectors.NoVectorsError as error:
        raise JaxblurIOError(info.path, f"{_elsewhere(info, layer, preset)}{error}") from error
    except ValueError as error:
        raise JaxblurIOError(info.path, str(error)) from error


def _elsewhere(info: FileInfo, layer: str | None, preset: str) -> str:
    """Say that vectors are in another layer than the one asked for, and what to do, or nothing."""
    if layer is None:
        return ""
    try:
        found = _choose_vectors(_scopes(info, None), preset).channels
        color = choose_color(info, layer).channels
    except (ValueError, JaxblurIOError):
        return ""
    return (
        f"layer {layer!r} has no vectors of its own, and the file has {', '.join(found)}; to blur "
        f"this layer by those, give `color_channels` {shlex.quote(','.join(color))} in place of "
        "`layer`; or else: "
    )


def _choose_vectors(scopes: Sequence[dict[str, str]], preset: str) -> vectors.Guess:
    """Find the vectors in the first scope that has any; the names of channels become full."""
    for position, scope in enumerate(scopes):
        try:
            names = tuple(scope)
            guess = (
                vectors.guess_preset(names)
                if preset == "auto"
                else vectors.match_preset(preset, names)
            )
        except vectors.NoVectorsError:
            if position == len(scopes) - 1:
                raise
            continue
        full = tuple(scope[name] for name in guess.channels)
        reason = guess.reason.replace(", ".join(guess.channels), ", ".join(full))
        return dataclasses.replace(guess, channels=full, reason=reason)
    raise vectors.NoVectorsError("no channels.")


def choose_depth(
    info: FileInfo,
    layer: str | None = None,
    depth_channel: str | None = None,
    color_prefix: str = "",
    taken: Sequence[str] = (),
    *,
    needed: bool = False,
) -> str:
    """Find the depth channel of a file.

    Args:
        info: listing of the file.
        layer: search this layer only.
        depth_channel: full name to take instead.
        color_prefix: layer of the color; a Z in the same layer is depth.
        taken: channels that have another use (the vectors).
        needed: whether the caller cannot do with the same distance everywhere; for the message.

    Returns:
        Its full name.

    Raises:
        JaxblurIOError: the file has no depth channel, or several candidates.
    """
    if depth_channel is not None:
        return info.channel(depth_channel).name
    found: list[str] = []
    for scope in _scopes(info, layer):
        names = {short: name for short, name in scope.items() if name not in taken}
        roots = {prefix + z for prefix in ("", color_prefix) for z in ROOT_DEPTH}
        candidates = [vectors.find_channels(pattern, list(names)) for pattern in DEPTH_PATTERNS]
        candidates.append([name for name in names if name in roots])
        found = [names[name] for name in next((group for group in candidates if group), [])]
        if found:
            break
    if len(found) == 1:
        return found[0]
    if found:
        raise JaxblurIOError(
            info.path, f"several depth channels: {', '.join(found)}; choose with `depth_channel`."
        )
    without = "" if needed else ", or depth='flat' to blur without occlusion"
    raise JaxblurIOError(
        info.path,
        f"no depth channel among {_listing(info, layer, taken)}; give `depth_channel` or "
        f"`depth_from`{without}.",
    )


def is_depth(name: str) -> bool:
    """Decide by name whether a channel holds depth, in which infinity is sky.

    Args:
        name: full name of the channel.

    Returns:
        True if it holds depth.
    """
    return any(vectors.find_channels(pattern, [name]) for pattern in (*DEPTH_PATTERNS, *ROOT_DEPTH))


def color_layers(info: FileInfo, layer: str | None = None) -> list[ColorGroup]:
    """List all layers that hold red, green and blue, or luminance, but no known motion vectors.

    Args:
        info: listing of the file.
        layer: view layer, view or part to look in.

    Returns:
        The groups, in the order of the file.

    Raises:
        JaxblurIOError: the file has no such layer.
    """
    return _color_groups(_scope(info, layer))


def component_of(name: str) -> str:
    """R, G, B, A or Y, if the name of a channel is that of one of them."""
    letter = name.rpartition(".")[2]
    words = {"red": "R", "green": "G", "blue": "B", "alpha": "A", "luminance": "Y"}
    return words.get(letter.lower(), letter.upper())


def _layer_name(prefix: str) -> str:
    return prefix.rstrip(".").rpartition(".")[2].lower()


def _listing(info: FileInfo, layer: str | None, taken: Sequence[str]) -> str:
    names = [name for name in _scope(info, layer).values() if name not in taken]
    return vectors.describe_names(names)


def _color_groups(names: Mapping[str, str]) -> list[ColorGroup]:
    """Group R, G, B and Y channels by layer, leaving out known motion vectors.

    Args:
        names: full names by the names to group.

    Returns:
        Groups with full names.
    """
    layers: dict[str, dict[str, str]] = {}
    for name, full in names.items():
        if component_of(name) in ("R", "G", "B", "A", "Y"):
            prefix = name[: len(name) - len(name.rpartition(".")[2])]
            layers.setdefault(prefix, {})[component_of(name)] = full
    groups = []
    for prefix, found in layers.items():
        members = next((m for m in ("RGB", "Y") if set(m) <= set(found)), None)
        if members is not None and not _is_velocity(prefix):
            channels = tuple(found[c] for c in (members + "A") if c in found)
            groups.append(ColorGroup(prefix, channels, found.get("A")))
    return groups


@functools.lru_cache(maxsize=4096)
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
