"""Mattes by the names of objects, materials or assets, from Cryptomatte layers.

A layer ``name`` has channels ``name00.R``, ``.G``, ``.B``, ``.A``, ``name01.R`` and so on: in
pairs, the identifier of a thing and its coverage of the pixel, in order of coverage. An identifier
is the 32-bit MurmurHash3 of the thing's name, whose bits are those of a float. The header names the
layer, and may list the names of all things in it (the manifest).

Source: Friedman and Jones, Cryptomatte specification 1.2.0, Psyop 2018, and MurmurHash3_x86_32 by
Austin Appleby.
"""

from __future__ import annotations

import dataclasses
import fnmatch
import json
import os
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxblur._util.errors import JaxblurIOError, PathLike
from jaxblur._util.small_files import MOST_BYTES, read_text
from jaxblur._util.text import nearest

from .channels import read_channels
from .listing import FileInfo, inspect

if TYPE_CHECKING:
    from jaxtyping import Float

_ENTRY = re.compile(r"cryptomatte/(?P<key>[^/]+)/(?P<field>\w+)")
_COMPONENTS = {"r": 0, "g": 1, "b": 2, "a": 3, "red": 0, "green": 1, "blue": 2, "alpha": 3}
_RANKS = re.compile(r"(?P<layer>.+?)(?P<number>\d\d)\.(?P<component>[A-Za-z]+)")
_PATTERN = re.compile(r"[*?\[]")
_IDENTIFIER = re.compile(r"[0-9A-Fa-f]{1,8}")


@dataclasses.dataclass(frozen=True)
class CryptomatteLayer:
    """A layer of a file.

    Attributes:
        path: the file.
        name: as in the header, such as ``ViewLayer.CryptoObject``.
        channels: identifier and coverage in turn, in order of coverage.
        manifest: identifiers by name; empty if the file lists none.
    """

    path: str
    name: str
    channels: tuple[str, ...]
    manifest: Mapping[str, int]


def cryptomatte_layers(path: PathLike) -> list[CryptomatteLayer]:
    """List the layers of a file; no pixels are read.

    Args:
        path: EXR file.

    Returns:
        The layers in the order of the header; without such entries, those with channels like
        ``CryptoObject00.R``.

    Raises:
        JaxblurIOError: the file cannot be opened, a layer has no channels or another hash, or its
            manifest is damaged or missing.
    """
    info = inspect(path)
    entries: dict[str, dict[str, str]] = {}
    for part in info.parts:
        for attribute, value in part.attributes.items():
            if found := _ENTRY.fullmatch(attribute):
                entries.setdefault(found["key"], {})[found["field"]] = str(value)
    if not entries:
        return [
            CryptomatteLayer(info.path, name, channels, {})
            for name, channels in _layers_by_channels(info).items()
        ]
    return [_layer(info, fields) for fields in entries.values()]


def read_cryptomatte(path: PathLike, name: str) -> Float[np.ndarray, "height width"]:
    """Read the matte of a thing: its share of each pixel.

    Args:
        path: EXR file.
        name: of the thing, such as ``/hero``; or a pattern with ``*``, ``?`` or ``[...]`` for all
            whose names in the manifest match, such as ``/set/*``; or, where layers share a name,
            ``LAYER:name``, with the layer's name or the last part of it.

    Returns:
        (H, W) float32, 0 to 1; 0 everywhere if the manifest lists the thing and the frame does not
        show it.

    Raises:
        JaxblurIOError: the file has no Cryptomatte, no layer lists that name, or several do.
    """
    layers = cryptomatte_layers(path)
    if not layers:
        raise JaxblurIOError(
            path, "no Cryptomatte; render with it, or use a matte or an object-id channel."
        )
    first, colon, rest = name.partition(":")
    found = _search(layers, name)
    if not found and colon:
        found = _search([layer for layer in layers if first in _names_of(layer)], rest)
    if not found:
        raise _unknown(path, layers, name)
    if len(found) > 1:
        names = " or ".join(f"{_names_of(layer)[-1]}:{name}" for layer, _, _ in found)
        raise JaxblurIOError(path, f"several Cryptomatte layers know {name!r}; write {names}.")
    ((layer, identifiers, listed),) = found
    matte, seen = _coverage(layer, identifiers)
    if not seen and not listed:
        raise JaxblurIOError(
            path,
            f"no pixel of {layer.name} is of {name!r}, and the file has no manifest to look it up; "
            "check the name, or render with a manifest.",
        )
    return matte


def names_in(path: PathLike) -> list[str]:
    """The names of what a frame shows, in the order of the pixels that show most of it.

    Args:
        path: EXR file.

    Returns:
        Names by the manifest, identifiers as in ``<1a2b3c4d>`` where it lists none; of all layers.

    Raises:
        JaxblurIOError: see `cryptomatte_layers`.
    """
    names: list[str] = []
    for layer in cryptomatte_layers(path):
        known = {identifier: name for name, identifier in layer.manifest.items()}
        names += [known.get(number, f"<{number:08x}>") for number in identifiers_in(layer)]
    return list(dict.fromkeys(names))


def identifiers_in(layer: CryptomatteLayer) -> list[int]:
    """The identifiers of a layer that pixels have, the most frequent first.

    Args:
        layer: of `cryptomatte_layers`.

    Returns:
        They; of channels that cannot hold identifiers none.

    Raises:
        JaxblurIOError: pixels cannot be read.
    """
    info, counts = inspect(layer.path), dict[int, int]()
    pairs = zip(layer.channels[::2], layer.channels[1::2], strict=True)
    for pair in pairs:
        if info.channel(pair[0]).type != "float":
            return []
        values = read_channels(layer.path, pair)
        bits = np.ascontiguousarray(values[..., 0]).view(np.uint32)[values[..., 1] > 0]
        for number, count in zip(*np.unique(bits, return_counts=True), strict=True):
            counts[int(number)] = counts.get(int(number), 0) + int(count)
    counts.pop(0, None)
    return sorted(counts, key=lambda number: -counts[number])


def identifier_of(name: str) -> int:
    """The identifier of a name: its hash, with an exponent that is that of a normal float.

    Args:
        name: any text.

    Returns:
        32 bits.

    Examples:
        >>> f"{identifier_of('hello'):08x}"
        '248bfa47'
    """
    value = murmur3_32(name.encode())
    # Neither zero, denormal, infinite nor NaN, which programs change.
    return value ^ (1 << 23) if value >> 23 & 255 in (0, 255) else value


def murmur3_32(data: bytes, seed: int = 0) -> int:
    """MurmurHash3, x86 32-bit.

    Examples:
        >>> murmur3_32(b"") , hex(murmur3_32(b"hello, world"))
        (0, '0x149bbb7f')
    """
    mask, state = 0xFFFFFFFF, seed
    whole = len(data) // 4 * 4

    def scrambled(word: int) -> int:
        word = word * 0xCC9E2D51 & mask
        return ((word << 15 | word >> 17) & mask) * 0x1B873593 & mask

    for start in range(0, whole, 4):
        state ^= scrambled(int.from_bytes(data[start : start + 4], "little"))
        state = ((state << 13 | state >> 19) & mask) * 5 + 0xE6546B64 & mask
    if len(data) > whole:
        state ^= scrambled(int.from_bytes(data[whole:], "little"))
    state ^= len(data)
    state = (state ^ state >> 16) * 0x85EBCA6B & mask
    state = (state ^ state >> 13) * 0xC2B2AE35 & mask
    return state ^ state >> 16


def _layer(info: FileInfo, fields: Mapping[str, str]) -> CryptomatteLayer:
    """One layer of the header."""
    name = fields.get("name", "")
    by_channels = _layers_by_channels(info)
    # Multi-part files may have the view layer in the part's name alone, or repeat it.
    fitting = [key for key in by_channels if key == name or key.endswith(f".{name}")]
    if not name or not fitting:
        raise JaxblurIOError(
            info.path,
            f"the header lists a Cryptomatte {name!r}, and there are no channels {name}00.R and so "
            "on; copy them with the picture, or render again.",
        )
    hashed = fields.get("hash", "MurmurHash3_32")
    conversion = fields.get("conversion", "uint32_to_float32")
    if (hashed, conversion) != ("MurmurHash3_32", "uint32_to_float32"):
        raise JaxblurIOError(
            info.path,
            f"Cryptomatte {name}: hash {hashed} with {conversion} is not known, only "
            "MurmurHash3_32 with uint32_to_float32; use a matte instead.",
        )
    return CryptomatteLayer(info.path, name, by_channels[fitting[0]], _manifest(info, name, fields))


def _layers_by_channels(info: FileInfo) -> dict[str, tuple[str, ...]]:
    """Channels of identifiers and coverages by layer, in order."""
    layers: dict[str, dict[tuple[int, int], str]] = {}
    for channel in info.channels:
        found = _RANKS.fullmatch(channel.name)
        place = _COMPONENTS.get(found["component"].lower()) if found else None
        if found and place is not None and channel.type in ("float", "half", "uint"):
            layers.setdefault(found["layer"], {})[int(found["number"]), place] = channel.name
    headed = any(_ENTRY.fullmatch(name) for part in info.parts for name in part.attributes)
    return {
        name: tuple(ranks[key] for key in sorted(ranks))
        for name, ranks in layers.items()
        if len(ranks) % 2 == 0 and (headed or "crypto" in name.lower())
    }


def _manifest(info: FileInfo, name: str, fields: Mapping[str, str]) -> dict[str, int]:
    """Identifiers by name, from the header or from the file beside the picture that it names."""
    text = fields.get("manifest")
    try:
        if text is None and (file := fields.get("manif_file")):
            beside = os.path.join(os.path.dirname(info.path), os.path.basename(file))
            text = read_text(beside, "copy it with the picture.")
        return {} if text is None else _listed(text)
    except JaxblurIOError as error:
        raise JaxblurIOError(info.path, f"Cryptomatte {name}: its manifest {error}") from error
    # Deep nesting exhausts the recursion of the parser.
    except (ValueError, RecursionError) as error:
        raise JaxblurIOError(
            info.path, f"Cryptomatte {name}: damaged manifest ({error}); render again."
        ) from error


def _listed(text: str) -> dict[str, int]:
    """Identifiers by name, of a manifest."""
    if len(text) > MOST_BYTES:
        raise ValueError(f"it is larger than {MOST_BYTES / 1e6:.0f} MB")
    manifest: Any = json.loads(text)
    if not isinstance(manifest, dict):
        raise ValueError("it is no object with names")
    for name, digits in manifest.items():
        if not isinstance(digits, str) or not _IDENTIFIER.fullmatch(digits):
            raise ValueError(f"{name!r:.60} has {digits!r:.60} in place of 8 hexadecimal digits")
    return {name: int(digits, 16) for name, digits in manifest.items()}


def _names_of(layer: CryptomatteLayer) -> tuple[str, str]:
    return layer.name, layer.name.rpartition(".")[2]


def _search(
    layers: list[CryptomatteLayer], name: str
) -> list[tuple[CryptomatteLayer, list[int], bool]]:
    """Layers that know a name, the identifiers there, and whether the manifest lists them."""
    found: list[tuple[CryptomatteLayer, list[int], bool]] = []
    for layer in layers:
        if name in layer.manifest:
            found.append((layer, [layer.manifest[name]], True))
    if not found and _PATTERN.search(name):
        for layer in layers:
            matching = [key for key in layer.manifest if fnmatch.fnmatchcase(key, name)]
            if matching:
                found.append((layer, [layer.manifest[key] for key in matching], True))
    if not found and len(layers) == 1 and not layers[0].manifest:
        return [(layers[0], [identifier_of(name)], False)]
    if not found and not any(layer.manifest for layer in layers):
        # Which layer it is only the pixels tell.
        unlisted = [(layer, [identifier_of(name)], False) for layer in layers]
        found = [entry for entry in unlisted if _coverage(entry[0], entry[1])[1]] or unlisted[:1]
    return found


def _unknown(path: PathLike, layers: list[CryptomatteLayer], name: str) -> JaxblurIOError:
    known = [key for layer in layers for key in layer.manifest]
    some = ", ".join(known[:8]) + (f" and {len(known) - 8} more" if len(known) > 8 else "")
    where = ", ".join(layer.name for layer in layers)
    return JaxblurIOError(
        path, f"no {name!r} in Cryptomatte {where}{nearest(name, known)}; it lists {some}."
    )


def check_identifiers(info: FileInfo, layer: CryptomatteLayer) -> None:
    """Reject a layer whose identifiers are stored with too few bits.

    Args:
        info: listing of its file.
        layer: the layer.

    Raises:
        JaxblurIOError: the message names the channel.
    """
    for name in layer.channels[::2]:
        if info.channel(name).type != "float":
            raise JaxblurIOError(
                info.path,
                f"{name}: {info.channel(name).type} cannot hold the identifiers of a Cryptomatte; "
                "write its channels as 32-bit float.",
            )


def _coverage(
    layer: CryptomatteLayer, identifiers: list[int]
) -> tuple[Float[np.ndarray, "height width"], bool]:
    """The share of each pixel that has one of the identifiers, and whether any has."""
    info = inspect(layer.path)
    check_identifiers(info, layer)
    values = np.ascontiguousarray(read_channels(layer.path, layer.channels))
    bits = np.ascontiguousarray(values[..., ::2]).view(np.uint32)
    hit = np.isin(bits, np.array(identifiers, np.uint32))
    share = np.where(hit, np.nan_to_num(values[..., 1::2]), 0).sum(axis=-1)
    return np.clip(share, 0, 1).astype(np.float32), bool(hit.any())
