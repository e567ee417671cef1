"""List what an image file holds: parts, channels, windows, metadata."""

import dataclasses
import os
from typing import Any

import numpy as np

from jaxblur._util.errors import JaxblurIOError, PathLike

from .notes import described
from .opening import escaped, open_input, pending_message

LONGEST_ARRAY = 100_000
"""Elements of an attribute that is listed: as objects of Python they take ten times the memory."""


@dataclasses.dataclass(frozen=True)
class Channel:
    """One channel of one part.

    Attributes:
        name: full name with the part's name before it where the file is multi-part and the
            channel name does not repeat it.
        type: "half", "float", "uint", "uint8", ...
        part: index of the part.
        index: index of the channel in its part.
    """

    name: str
    type: str
    part: int
    index: int


@dataclasses.dataclass(frozen=True)
class Part:
    """One part (sub-image) of a file.

    Attributes:
        name: part name, empty if it has none.
        channels: its channels in reading order.
        data_window: (x, y, width, height) of the stored pixels; the origin may be negative.
        display_window: (x, y, width, height) of the full picture.
        compression: scheme as the file names it, "none" if it names none.
        deep: whether pixels hold several samples each.
        levels: number of resolutions: 1, or more if mip-mapped; pixels are those of the first.
        attributes: metadata, values as OpenImageIO gives them; bytes of unknown types as a tuple;
            of an array longer than `LONGEST_ARRAY` its type, such as ``uint8[60000000]``.
    """

    name: str
    channels: tuple[Channel, ...]
    data_window: tuple[int, int, int, int]
    display_window: tuple[int, int, int, int]
    compression: str
    deep: bool
    levels: int
    attributes: dict[str, Any]


@dataclasses.dataclass(frozen=True)
class FileInfo:
    """Listing of a file.

    Attributes:
        path: the file.
        parts: its parts in order.
    """

    path: str
    parts: tuple[Part, ...]

    @property
    def channels(self) -> tuple[Channel, ...]:
        """All channels of all parts."""
        return tuple(channel for part in self.parts for channel in part.channels)

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Full names of all channels."""
        return tuple(channel.name for channel in self.channels)

    def channel(self, name: str) -> Channel:
        """Find a channel by its full name.

        Args:
            name: full name, as in ``channel_names``.

        Returns:
            The channel.

        Raises:
            JaxblurIOError: no channel or several channels have that name.
        """
        found = [channel for channel in self.channels if channel.name == name]
        if len(found) != 1:
            problem = "no channel" if not found else f"{len(found)} channels"
            names = ", ".join(self.channel_names)
            raise JaxblurIOError(self.path, f"{problem} called {name}; the file holds {names}.")
        return found[0]


def inspect(path: PathLike) -> FileInfo:
    """List parts, channels, windows, compression and metadata; read no pixels.

    Args:
        path: an EXR, PNG, TIFF, JPEG or HDR file.

    Returns:
        The listing.

    Raises:
        JaxblurIOError: the file is missing, unreadable, or not of the kind that its extension
            names.
    """
    with open_input(path) as source:
        return describe(source, path)


def describe(source: Any, path: PathLike) -> FileInfo:
    """List the parts of an open image.

    Args:
        source: an open ``ImageInput``.
        path: its file, for messages.

    Returns:
        The listing.

    Raises:
        JaxblurIOError: a header is damaged.
    """
    parts: list[Part] = []
    try:
        while source.seek_subimage(len(parts), 0):
            parts.append(_describe_part(source.spec(), len(parts)))
    except (UnicodeDecodeError, RuntimeError, ValueError) as error:
        raise JaxblurIOError(path, f"damaged header, copy or render it again ({error}).") from error
    pending_message(source)
    expected = parts[0].attributes.get("oiio:subimages", 1) if parts else 1
    if isinstance(expected, int) and len(parts) < expected:
        raise JaxblurIOError(path, f"only {len(parts)} of {expected} parts are readable.")
    several = len(parts) > 1
    named = tuple(_qualified(part) if several else part for part in parts)
    return FileInfo(os.fspath(path), named)


def _describe_part(spec: Any, index: int) -> Part:
    formats = spec.channelformats or [spec.format] * spec.nchannels
    channels = tuple(
        Channel(escaped(name), str(kind), index, position)
        for position, (name, kind) in enumerate(zip(spec.channelnames, formats, strict=True))
    )
    attributes = _attributes(spec)
    return Part(
        name=str(attributes.get("name", "")),
        channels=channels,
        data_window=(spec.x, spec.y, spec.width, spec.height),
        display_window=(spec.full_x, spec.full_y, spec.full_width, spec.full_height),
        compression=str(attributes.get("compression", "none")),
        deep=bool(spec.deep),
        levels=_levels(attributes.get("oiio:miplevels", 1)),
        attributes=attributes,
    )


def _attributes(spec: Any) -> dict[str, Any]:
    stored = {
        escaped(a.name): _plain(a.value) if a.type.arraylen <= LONGEST_ARRAY else str(a.type)
        for a in spec.extra_attribs
    }
    return stored | described(stored)


def _levels(count: Any) -> int:
    return count if isinstance(count, int) and count > 1 else 1


def _plain(value: Any) -> Any:
    """A value that can be compared and hashed; OpenImageIO gives arrays for types unknown to it."""
    if isinstance(value, np.ndarray):
        return tuple(value.ravel().tolist())
    return escaped(value) if isinstance(value, str) else value


def _qualified(part: Part) -> Part:
    def full(name: str) -> str:
        repeated = name == part.name or name.startswith(part.name + ".")
        return name if repeated or not part.name else f"{part.name}.{name}"

    channels = tuple(dataclasses.replace(c, name=full(c.name)) for c in part.channels)
    return dataclasses.replace(part, channels=channels)
