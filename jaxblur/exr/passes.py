"""Choose the color passes that are blurred with the picture, so that they still add up to it."""

import fnmatch
import re
from collections.abc import Sequence
from typing import Literal

from jaxblur import vectors
from jaxblur._util.errors import JaxblurIOError
from jaxblur._util.text import nearest

from .choose import ColorGroup, color_layers
from .listing import FileInfo

Passes = Sequence[str] | Literal["all"]
"""Names or patterns of layers, or all of them."""

_IDENTIFIERS = re.compile(r"crypto|(^|_)ids?$|object_?id|material_?id|index", re.IGNORECASE)
"""Layers whose values are names: the mean of two of them is the name of a third."""

_DATA = re.compile(
    r"normal|^n$|^ng$|position|^p$|^pref$|^pworld$|^uvs?$|^st$|depth|^z$|vector|velocity|motion|"
    r"tangent|mask|matte|sample_?count|variance|^debug|^denoising|^noisy image",
    re.IGNORECASE,
)
"""Layers in red, green and blue that hold something else than color."""


def choose_passes(
    info: FileInfo, group: ColorGroup, passes: Passes, layer: str | None = None
) -> tuple[str, ...]:
    """Find the channels of further color passes.

    A name is compared with the last part of a layer's name, and with all of it, in any case:
    ``diffuse`` is ``diffuse.R`` and ``ViewLayer.Diffuse.R``. ``*``, ``?`` and ``[...]`` stand for
    other letters, and never for a layer of data, such as normals, positions and mattes, which must
    be named. Layers of identifiers are refused.

    Args:
        info: listing of the file.
        group: the picture, which is left out.
        passes: names and patterns, or "all" for every layer of color.
        layer: view layer, view or part to look in.

    Returns:
        Full names, in the order of the file; empty if nothing is asked for.

    Raises:
        JaxblurIOError: a name or pattern finds nothing, or finds identifiers.
    """
    if not passes:
        return ()
    groups = _groups(info, group, layer)
    colors = _colors(groups)
    if passes == "all":
        found = set(colors)
        if not found:
            raise JaxblurIOError(info.path, f"no other layer of color than {_names(group)}.")
    else:
        found = {name for text in passes for name in _matching(info, text, groups, colors)}
    return tuple(name for key, other in groups.items() if key in found for name in other.channels)


def sharp_layers(
    info: FileInfo, group: ColorGroup, passes: Sequence[str], layer: str | None = None
) -> tuple[str, ...]:
    """Find the layers of color that are not blurred with the picture.

    Args:
        info: listing of the file.
        group: the picture.
        passes: full names of the channels that are blurred with it.
        layer: view layer, view or part to look in.

    Returns:
        Names of layers, in the order of the file.
    """
    groups = _groups(info, group, layer)
    return tuple(name for name in _colors(groups) if not set(groups[name].channels) & set(passes))


def _groups(info: FileInfo, group: ColorGroup, layer: str | None) -> dict[str, ColorGroup]:
    """The other layers in red, green and blue, by name."""
    return {
        other.prefix.rstrip("."): other
        for other in color_layers(info, layer)
        if not set(other.channels) & set(group.channels)
        and info.channel(other.channels[0]).type in ("half", "float")
    }


def _colors(groups: dict[str, ColorGroup]) -> list[str]:
    """The layers among them that hold color."""
    return [name for name in groups if not _is(_DATA, name) and not _is(_IDENTIFIERS, name)]


def _matching(
    info: FileInfo, text: str, groups: dict[str, ColorGroup], colors: Sequence[str]
) -> list[str]:
    """The layers of one name or pattern."""
    wanted = text.strip().rstrip(".").lower()
    is_pattern = re.search(r"[*?\[]", wanted) is not None
    named = [
        name
        for name in groups
        if any(fnmatch.fnmatchcase(each.lower(), wanted) for each in (name, _last(name)))
    ]
    found = [name for name in named if name in colors or not is_pattern]
    identifiers = [name for name in (found or named) if _is(_IDENTIFIERS, name)]
    if identifiers:
        raise JaxblurIOError(
            info.path, f"{identifiers[0]} holds identifiers, which a blur would destroy; leave out."
        )
    if not found and named:
        raise JaxblurIOError(
            info.path,
            f"{', '.join(named)}: {text!r} is a pattern, and patterns leave out data; give names.",
        )
    if not found:
        known = colors or [name for name in groups if not _is(_IDENTIFIERS, name)]
        hint = nearest(wanted, [*known, *map(_last, known)])
        listing = f"the layers of color are {', '.join(known)}" if known else "there is none"
        raise JaxblurIOError(info.path, f"no other layer of color {text!r}{hint}; {listing}.")
    return found


def _is(kind: re.Pattern[str], name: str) -> bool:
    return kind.search(_last(name)) is not None


def _last(name: str) -> str:
    return name.rpartition(".")[2]


def _names(group: ColorGroup) -> str:
    return vectors.describe_names(group.channels)
