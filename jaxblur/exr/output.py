"""Headers and writers of OpenImageIO, with checks that opening, writing and closing succeeded."""

import contextlib
import os
import pathlib
import struct
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import OpenImageIO as oiio

from .._util.atomic import free_bytes, full_disk
from .._util.errors import JaxblurIOError, JaxblurIOWarning, PathLike
from .listing import inspect
from .notes import is_whole
from .opening import open_input, pending_message

LONGEST_TEXT = 60_000
"""Bytes of a description that a JPEG holds; it stores it twice."""
_JPEG_END = b"\xff\xd9"
_PNG_START = b"\x89PNG\r\n\x1a\n"
HALF_MAX = 65504.0
# These attributes describe how a model is stored, which may change; with `textureformat` the writer
# would expect all levels of a mip-mapped picture, and OpenEXR keeps `version` for itself.
STORAGE = (
    *("openexr:chunkCount", "openexr:levelmode", "openexr:roundingmode", "oiio:miplevels"),
    *("textureformat", "openexr:dwaCompressionLevel", "version"),
)


@contextlib.contextmanager
def writer(
    path: PathLike,
    temporary: str,
    specs: Sequence[Any],
    finish: Callable[[], None] | None = None,
) -> Iterator[Any]:
    """Open a writer for one or several parts; check opening and closing.

    Args:
        path: the final name, for messages.
        temporary: the file to write.
        specs: headers of the parts.
        finish: called when the file is closed, to add what is missing.

    Yields:
        An ``OpenImageIO.ImageOutput``, open for the first part.

    Raises:
        JaxblurIOError: opening or closing failed, or the file lacks bytes. If the disk is full,
            errors of the body say so too.
    """
    try:
        with _open_writer(path, temporary, specs) as output:
            yield output
        if finish is not None:
            finish()
        if not is_complete(temporary):
            raise JaxblurIOError(
                path, "cannot be written: bytes are missing; is the disk full, or a quota used up?"
            )
    except JaxblurIOError as error:
        if error.path != os.fspath(path):
            raise
        needed, free = bytes_needed(specs), free_bytes(path) + os.path.getsize(temporary)
        if free < needed:
            raise full_disk(path, needed, free) from error
        raise JaxblurIOError(path, error.reason.replace(temporary, error.path)) from error


def bytes_needed(specs: Sequence[Any]) -> int:
    """The bytes that a file of some headers needs at most: pixels and metadata as they are."""
    return sum(spec.image_bytes(True) for spec in specs) + 3 * LONGEST_TEXT


@contextlib.contextmanager
def _open_writer(path: PathLike, temporary: str, specs: Sequence[Any]) -> Iterator[Any]:
    output = oiio.ImageOutput.create(temporary)
    if output is None:
        raise JaxblurIOError(path, f"cannot be written: {pending_message()}")
    for spec in specs:
        # Without it the time of writing is stored, and the bytes differ between runs.
        if spec.getattribute("DateTime") is None:
            spec.attribute("DateTime", "")
    first = specs[0] if len(specs) == 1 else tuple(specs)
    check(path, output, output.open(temporary, first))
    try:
        yield output
    except BaseException:
        output.close()
        pending_message(output)
        raise
    closed = output.close()
    # The writer of PNG goes on after bytes that a full disk did not take.
    check(path, output, closed and not output.has_error)


def is_complete(path: PathLike) -> bool:
    """Whether a file that was written here has all that a full disk may take from it.

    Closing may lose the end of a file without an error. Before, bytes in the middle are lost only
    in a PNG, whose writer goes on, and which has checksums.

    Args:
        path: an EXR, PNG, TIFF or JPEG.
    """
    suffix = pathlib.Path(path).suffix.lower()
    if suffix in (".jpg", ".jpeg"):
        return pathlib.Path(path).read_bytes().endswith(_JPEG_END)
    if suffix == ".png":
        return _has_png_chunks(pathlib.Path(path).read_bytes())
    try:
        # The header of a TIFF is behind its pixels, and may end in the description.
        described = suffix == ".exr" or is_whole(inspect(path).parts[0].attributes)
        return described and _last_row_is_there(path)
    except JaxblurIOError:
        return False


def _has_png_chunks(data: bytes) -> bool:
    """Whether a PNG has all chunks up to the last one, IEND, each with its checksum."""
    place, kind = len(_PNG_START), b""
    while data.startswith(_PNG_START) and kind != b"IEND" and place + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, place)
        kind, checked = data[place + 4 : place + 8], data[place + 4 : place + 8 + length]
        place += 12 + length
        if data[place - 4 : place] != struct.pack(">I", zlib.crc32(checked)):
            return False
    return kind == b"IEND"


def _last_row_is_there(path: PathLike) -> bool:
    with open_input(path) as source:
        last = 0
        while source.seek_subimage(last + 1, 0):
            last += 1
        source.seek_subimage(last, 0)
        spec = source.spec()
        if spec.tile_width:
            found = source.read_image(last, 0, 0, spec.nchannels, "native")
        else:
            end = spec.y + spec.height
            found = source.read_scanlines(last, 0, end - 1, end, spec.z, 0, 1, "native")
    return found is not None


def check(path: PathLike, output: Any, succeeded: bool) -> None:
    """Raise an error if a writer reports a failure.

    Args:
        path: the final name, for messages.
        output: the writer.
        succeeded: return value of the writer's method.

    Raises:
        JaxblurIOError: the method failed.
    """
    if not succeeded:
        raise JaxblurIOError(path, f"cannot be written: {pending_message(output).rstrip('.')}.")


def set_formats(spec: Any, kinds: Sequence[str]) -> None:
    """Set the types of the channels of a header.

    Args:
        spec: an ``OpenImageIO.ImageSpec`` with names of channels.
        kinds: OpenImageIO's name of the type of each.
    """
    widest = next((kind for kind in ("float", "uint", "half") if kind in kinds), kinds[0])
    spec.set_format(widest)
    mixed = len(set(kinds)) > 1
    spec.channelformats = [oiio.TypeDesc(kind) for kind in kinds] if mixed else []
    names = list(spec.channelnames)
    is_alpha = [name.rpartition(".")[2] == "A" for name in names]
    spec.alpha_channel = is_alpha.index(True) if True in is_alpha else -1
    spec.z_channel = -1


def set_attributes(spec: Any, attributes: Mapping[str, str | int | float] | None) -> None:
    """Add metadata to a header."""
    for name, value in (attributes or {}).items():
        spec.attribute(name, value)


def clamp_half(path: PathLike, values: np.ndarray) -> np.ndarray:
    """Clamp values to the range of half, with a warning if there are some beyond.

    Args:
        path: the final name, for messages.
        values: of any shape.

    Returns:
        The values themselves if none is beyond.
    """
    over = np.abs(values) > HALF_MAX
    if over.any():
        warnings.warn(
            f"{path}: {int(over.sum())} values beyond {HALF_MAX:.0f} were clamped to the range of "
            "half; write float to keep them.",
            JaxblurIOWarning,
            stacklevel=4,
        )
        return np.clip(values, -HALF_MAX, HALF_MAX)
    return values
