"""The coverages that the Cryptomatte layers of a file hold, as lists, and changes to them.

Where a layer has six ranks most of them are empty, so that a list of what is not is several times
smaller than the channels. A change is written into a copy of the file, pixel by pixel; what is not
changed stays bit for bit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxblur._util.errors import JaxblurIOError, PathLike

from .channels import read_channels
from .choose import ColorGroup, views_of
from .cryptomatte import CryptomatteLayer, check_identifiers, cryptomatte_layers
from .listing import FileInfo, inspect

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt32


class Ranks(NamedTuple):
    """What covers the pixels of a layer.

    Attributes:
        layer: of a file.
        size: height and width of the frame.
        pixels: (N,) number of a pixel, row by row; in any order.
        identifiers: (N,) what covers it; no pixel has one twice.
        coverages: (N,) how much, above 0.
    """

    layer: CryptomatteLayer
    size: tuple[int, int]
    pixels: Int[np.ndarray, " entries"]
    identifiers: UInt32[np.ndarray, " entries"]
    coverages: Float[np.ndarray, " entries"]


class ChannelChange(NamedTuple):
    """Other values for some pixels of some channels of a file.

    Attributes:
        channels: full names.
        pixels: (N,) numbers of pixels, row by row.
        values: (N, number of channels) float32.
    """

    channels: tuple[str, ...]
    pixels: Int[np.ndarray, " pixels"]
    values: Float[np.ndarray, "pixels channels"]


def layers_of_picture(info: FileInfo, group: ColorGroup) -> list[CryptomatteLayer]:
    """The Cryptomatte layers that belong to a picture.

    Args:
        info: listing of the file.
        group: channels of the picture.

    Returns:
        Those whose names begin as that of the picture does, such as with the view layer, if there
        are any; otherwise those that are not of another stereo view.

    Raises:
        JaxblurIOError: see `cryptomatte_layers`.
    """
    layers = cryptomatte_layers(info.path)
    home = group.channels[0].split(".")[0] if "." in group.channels[0] else ""
    own = [layer for layer in layers if home and layer.channels[0].startswith(f"{home}.")]
    if own:
        return own
    views = {view for view in views_of(info) if view != home}
    return [layer for layer in layers if not views & set(layer.channels[0].split(".")[:-1])]


def read_ranks(path: PathLike, group: ColorGroup) -> tuple[Ranks, ...]:
    """Read all Cryptomatte layers of a picture.

    Args:
        path: EXR file.
        group: channels of the picture, of which data windows are compared.

    Returns:
        The coverages of each layer.

    Raises:
        JaxblurIOError: there is no such layer, or one is damaged, of another type, or of another
            data window than the picture.
    """
    info = inspect(path)
    layers = layers_of_picture(info, group)
    if not layers:
        raise JaxblurIOError(
            path, "no Cryptomatte of this picture; render with it, or leave out `cryptomatte`."
        )
    return tuple(_ranks(info, layer, group) for layer in layers)


def _ranks(info: FileInfo, layer: CryptomatteLayer, group: ColorGroup) -> Ranks:
    check_identifiers(info, layer)
    windows = {
        info.parts[info.channel(name).part].data_window
        for name in (group.channels[0], *layer.channels)
    }
    if len(windows) > 1:
        raise JaxblurIOError(
            info.path,
            f"Cryptomatte {layer.name} has another data window than {group.channels[0]}: "
            f"{windows}; render both with the same one.",
        )
    values = read_channels(info.path, layer.channels)
    height, width, _ = values.shape
    bits = np.ascontiguousarray(values[..., ::2]).view(np.uint32).reshape(height * width, -1)
    shares = values[..., 1::2].reshape(height * width, -1)
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    repeats = False
    for rank in range(bits.shape[1]):
        share = shares[:, rank]
        # Identifier 0 stands for nothing.
        pixels = np.flatnonzero((share > 0) & np.isfinite(share) & (bits[:, rank] != 0))
        own = bits[pixels, rank]
        repeats |= any((bits[pixels, before] == own).any() for before in range(rank))
        found.append((pixels.astype(np.int32), own, share[pixels]))
    columns = (np.concatenate([entry[i] for entry in found]) for i in range(3))
    ranks = Ranks(layer, (height, width), *columns)
    return _once_each(ranks) if repeats else ranks


def _once_each(ranks: Ranks) -> Ranks:
    """Add up coverages of one identifier in one pixel, which some renderers list twice."""
    key = ranks.pixels.astype(np.uint64) << np.uint64(32) | ranks.identifiers
    keys, places = np.unique(key, return_inverse=True)
    coverages = np.bincount(places.ravel(), ranks.coverages, len(keys)).astype(np.float32)
    pixels = (keys >> np.uint64(32)).astype(np.int32)
    return Ranks(ranks.layer, ranks.size, pixels, keys.astype(np.uint32), coverages)


def change_of(ranks: Ranks, pixels: Int[np.ndarray, " pixels"]) -> ChannelChange:
    """Write coverages as ranks.

    Args:
        ranks: the coverages, all of them in ``pixels``.
        pixels: (N,) numbers of the pixels whose ranks are to be written, ascending.

    Returns:
        The channels of the layer in these pixels: identifiers and coverages in turn, in order of
        coverage. What has no rank left is dropped, ranks that are left over are 0.
    """
    count = len(ranks.layer.channels) // 2
    # The bits of positive floats are in the order of their values.
    falling = np.uint32(0xFFFFFFFF) - ranks.coverages.view(np.uint32)
    key = ranks.pixels.astype(np.uint64) << np.uint64(32) | falling
    order = np.argsort(key, kind="stable")
    rows = np.searchsorted(pixels, ranks.pixels[order])
    places = np.arange(len(rows)) - np.searchsorted(rows, rows)
    kept = places < count
    order, rows, places = order[kept], rows[kept], places[kept]
    values = np.zeros((len(pixels), 2 * count), np.float32)
    values[rows, 2 * places + 1] = ranks.coverages[order]
    values.view(np.uint32)[rows, 2 * places] = ranks.identifiers[order]
    return ChannelChange(ranks.layer.channels, pixels, values)


def unchanged_ranks(ranks: Ranks) -> ChannelChange:
    """The ranks of a layer as they are, which are then kept with the picture."""
    channels = ranks.layer.channels
    nothing = np.zeros((0, len(channels)), np.float32)
    return ChannelChange(channels, np.zeros(0, np.int32), nothing)
