"""Write PNG, TIFF and JPEG: integers as a screen shows them, floats as linear light."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
import OpenImageIO as oiio

from jaxblur import srgb
from jaxblur._util.atomic import free_bytes, full_disk, replacing
from jaxblur._util.errors import JaxblurIOError, PathLike

from .notes import DESCRIPTION, to_text
from .output import LONGEST_TEXT, bytes_needed, check, set_attributes, writer

if TYPE_CHECKING:
    from jaxtyping import Float

BITS = {
    ".png": (8, 16),
    ".tif": (32, 16, 8),
    ".tiff": (32, 16, 8),
    ".jpg": (8,),
    ".jpeg": (8,),
}
"""Bits of a channel that a format can have, by extension; the first are the default."""
LINEAR_BITS = 32
"""Bits of the floats that hold linear light; fewer bits are integers."""
# Exif's number for colors that are not those of sRGB. Without any attribute of Exif the writer of
# OpenImageIO fails to write an empty table of them.
_UNCALIBRATED = 65535
_JPEG = (".jpg", ".jpeg")


def bits_of(path: PathLike, bits: int | None) -> int:
    """Return the bits of a channel that a picture is written with.

    Args:
        path: picture with an extension of `BITS`.
        bits: as asked for, or None for the default of the format.

    Raises:
        ValueError: the format has no such number of bits.
    """
    suffix = pathlib.Path(path).suffix.lower()
    able = BITS[suffix]
    if bits is not None and bits not in able:
        numbers = " or ".join(map(str, sorted(able)))
        raise ValueError(f"`bits` must be {numbers} for {suffix}, got {bits}.")
    return able[0] if bits is None else bits


def write_picture(
    path: PathLike,
    image: Float[np.ndarray, "height width channels"],
    bits: int,
    attributes: Mapping[str, str | int | float] | None,
    last_check: Callable[[], None] | None,
) -> None:
    """Write a picture, atomically.

    Args:
        path: with an extension of `BITS`.
        image: (H, W, C) linear light, for integers with the primaries of the screen.
        bits: 8 or 16 for sRGB of the color without alpha, clipped to 0..1; `LINEAR_BITS` for the
            light itself, with alpha.
        attributes: metadata to add.
        last_check: called when the file is complete; if it raises, nothing appears.

    Raises:
        JaxblurIOError: writing failed.
    """
    count = image.shape[2]
    if bits == LINEAR_BITS:
        pixels, kind = image, "float"
    else:
        color = image[..., : 1 if count in (1, 2) else 3]
        kind = f"uint{bits}"
        pixels = np.round(srgb.encode(np.clip(color, 0, 1)) * (2**bits - 1)).astype(kind)
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, kind)
    spec.alpha_channel = channels - 1 if channels in (2, 4) else -1
    if bits == LINEAR_BITS:
        spec.attribute("Exif:ColorSpace", _UNCALIBRATED)
    else:
        spec.attribute("oiio:ColorSpace", "sRGB")
    file = pathlib.Path(path)
    suffix = file.suffix.lower()
    text = to_text(attributes)
    if suffix == ".png":
        set_attributes(spec, attributes)
    else:
        spec.attribute(DESCRIPTION, text)
    if suffix in _JPEG and file.parent.is_dir():
        _check_jpeg(file, bytes_needed([spec]), text)
    with replacing(path, last_check) as temporary, writer(path, temporary, [spec]) as output:
        check(path, output, output.write_image(pixels))


def _check_jpeg(path: pathlib.Path, needed: int, text: str) -> None:
    """Reject what libjpeg would end the process for: long metadata, and a full disk."""
    if len(text) > LONGEST_TEXT:
        raise JaxblurIOError(
            path, f"has {len(text)} bytes of metadata, a JPEG holds {LONGEST_TEXT}; write .png."
        )
    if (free := free_bytes(path)) < needed:
        raise full_disk(path, needed, free)
