"""Write images, frames and named channels; a file appears only when it is complete."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import OpenImageIO as oiio

from jaxblur import vectors
from jaxblur._util.atomic import replacing
from jaxblur._util.errors import JaxblurIOError, PathLike

from .choose import choose_color
from .color import COLORS, Conversion, check_color_space, check_view, conversion_of
from .listing import inspect
from .opening import FileStates, open_input
from .output import STORAGE, check, clamp_half, set_attributes, set_formats, writer
from .pictures import BITS, LINEAR_BITS, bits_of, write_picture
from .ranks import ChannelChange
from .windows import Window, put_into, windows_of
from .write_like import write_like

if TYPE_CHECKING:
    from jaxtyping import Float

    from jaxblur.frame import Frame

WRITABLE = (".exr", *BITS)
"""Extensions of images that can be written."""
COLOR_NAMES = {1: ("Y",), 2: ("Y", "A"), 3: ("R", "G", "B"), 4: ("R", "G", "B", "A")}


def write_image(
    path: PathLike,
    image: Float[np.ndarray, "height width channels"],
    like: PathLike | None = None,
    *,
    extra: Literal["keep", "drop"] = "keep",
    dtype: Literal["half", "float"] | None = None,
    attributes: Mapping[str, str | int | float] | None = None,
    layer: str | None = None,
    color_channels: Sequence[str] | None = None,
    overwrite: bool = True,
    nonfinite: Literal["keep", "zero"] = "keep",
    unchanged: FileStates | None = None,
    changes: Sequence[ChannelChange] = (),
    window: Window | None = None,
    sky: float = np.inf,
    decoded: Float[np.ndarray, "stored_height stored_width stored"] | None = None,
    color_space: str | None = None,
    view: str | None = None,
    bits: int | None = None,
) -> None:
    """Write an image, alone or in place of the color of another file.

    The file appears under its name only when it is complete. With ``like``, windows, metadata,
    timecode, channel names and types are those of that file, and all its other channels and parts
    are copied bit for bit; its compression is kept if it is lossless and replaced by zip otherwise.
    Of a mip-mapped file level 0 is written, and a warning says so.
    Pictures of integers (``.png``, ``.jpg``, ``.tif`` with 8 or 16 bits) get sRGB of the color
    without alpha, clipped to 0..1, converted from the color space of ``like``
    (`jaxblur.exr.conversion_of`); their text ``jaxblur:colors`` says how. A ``.tif`` of floats, the
    default, gets the light as it is. Where the image is of the data window of ``like``, pictures
    are of its display window: overscan is cut away, and what is missing is 0.

    Args:
        path: ``.exr``, ``.png``, ``.tif``, ``.tiff``, ``.jpg`` or ``.jpeg`` to write.
        image: (H, W, C) linear light; JAX arrays are accepted.
        like: EXR file whose color channels the image replaces.
        extra: "drop" leaves out all channels and parts of ``like`` that are not color.
        dtype: type of the color channels; that of ``like`` if None, else half.
        attributes: metadata to add, such as ``{"jaxblur:version": "0.1.0"}``.
        layer: layer of ``like`` to search for color, as in `read_frame`.
        color_channels: full names of the channels of ``like`` to replace.
        overwrite: replace an existing file, which must not be ``like``.
        nonfinite: treatment of NaN, and of infinity other than sky in depth, in the channels that
            are copied from ``like``: "keep" them, or replace them by "zero" (in depth by infinity);
            both give a warning, except for parts that are kept as they are stored.
        unchanged: states of the files that the image was made from, recorded before they were
            read; if one has changed when the new file is complete, that does not appear.
        changes: other values for pixels of further channels of ``like``, such as the ranks of a
            Cryptomatte; these channels are written even with ``extra="drop"``.
        window: ``(x, y, width, height)`` of the image in an ``.exr``, if it is not the data window
            of ``like``. Parts with new channels get it; what ``like`` does not hold of their other
            channels is 0.
        sky: the same in depth, which is infinite if it grows with the distance.
        decoded: `Buffers.decoded` of ``like``, which need not be decoded again then.
        color_space: color space of the image, for pictures of integers; that of ``like`` if None.
        view: OpenColorIO view for them, such as "ACES 2.0 - SDR 100 nits (Rec.709)"; plain sRGB if
            None.
        bits: of a channel of a picture: 8 or 16 of ``.png``, 8, 16 or 32 (float) of ``.tif``, 8 of
            ``.jpg``; the default of the format if None: 8, and 32 of ``.tif``.

    Raises:
        JaxblurIOError: the image is not finite, sizes or channel counts differ, ``path`` is
            ``like`` itself or exists without ``overwrite``, an input has changed, or writing
            failed. Then no partial file is left, and an older file stays as it was.
        ValueError: an argument is wrong, or the format has no such `bits`.
    """
    if extra not in ("keep", "drop"):
        raise ValueError(f"`extra` must be keep or drop; got {extra!r}.")
    if nonfinite not in ("keep", "zero"):
        raise ValueError(f"`nonfinite` must be keep or zero; got {nonfinite!r}.")
    if not overwrite and os.path.exists(path):
        raise JaxblurIOError(path, "exists; pass overwrite=True to replace it.")
    kind = pathlib.Path(path).suffix.lower()
    if bits is not None and kind == ".exr":
        raise ValueError("`bits` is for pictures; give `dtype` for an .exr.")
    pixels = _checked_image(path, image, like)
    last_check = unchanged.check if unchanged is not None else None
    if kind in BITS:
        depth = bits_of(path, bits)
        if depth != LINEAR_BITS:
            colors = _colors(like, layer, color_channels, color_space, view)
            pixels = colors.light(pixels)
            if not colors.is_identity:
                attributes = {**(attributes or {}), COLORS: colors.words}
        pixels = _in_display_window(pixels, like, layer, color_channels)
        write_picture(path, pixels, depth, attributes, last_check)
    elif kind != ".exr":
        raise JaxblurIOError(path, f"can write {', '.join(WRITABLE)} only; change the extension.")
    elif like is None:
        names = COLOR_NAMES.get(pixels.shape[2]) or [f"channel{i}" for i in range(pixels.shape[2])]
        channels = {name: pixels[..., index] for index, name in enumerate(names)}
        _write_channels(path, channels, dtype or "half", attributes, last_check)
    else:
        refuse_overwrite(path, like)
        write_like(
            path,
            pixels,
            like,
            changes,
            decoded,
            window,
            sky,
            layer=layer,
            color_channels=color_channels,
            keep_extra=extra == "keep",
            dtype=dtype,
            attributes=attributes,
            mend=nonfinite == "zero",
            last_check=last_check,
        )


def _checked_image(path: PathLike, image: Any, like: PathLike | None) -> np.ndarray:
    pixels = np.asarray(image, np.float32)
    if pixels.ndim != 3 or 0 in pixels.shape:
        raise ValueError(
            f"`image` must have shape (height, width, channels), none 0; got {pixels.shape}."
        )
    bad = ~np.isfinite(pixels)
    if bad.any():
        # What is read is finite, but sums of values near the end of single precision are not.
        hint = "" if like is None else f" If it was made from {like}, is the color there near 3e38?"
        hint += " Division by 0 and the root of a negative number make NaN."
        count = int(bad.sum())
        raise JaxblurIOError(
            path, f"{count} values of the image are NaN or infinite; nothing was written.{hint}"
        )
    return pixels


def _in_display_window(
    pixels: np.ndarray,
    like: PathLike | None,
    layer: str | None,
    color_channels: Sequence[str] | None,
) -> np.ndarray:
    if like is None:
        return pixels
    info = inspect(like)
    windows = windows_of(info, choose_color(info, layer, color_channels).channels[0])
    held = pixels.shape[1::-1] == windows.data[2:]
    return put_into(pixels, *windows) if held else pixels


def _colors(
    like: PathLike | None,
    layer: str | None,
    color_channels: Sequence[str] | None,
    color_space: str | None,
    view: str | None,
) -> Conversion:
    """Find out how the colors of a preview are converted."""
    if like is not None:
        info = inspect(like)
        names = choose_color(info, layer, color_channels).channels
        return conversion_of(info, names[0], color_space, view)
    check_view(view)
    check_color_space(color_space)
    return Conversion(color_space, "given" if color_space else "", view)


def write_channels(
    path: PathLike,
    channels: Mapping[str, Float[np.ndarray, "height width"]],
    *,
    dtype: Literal["half", "float"] | Mapping[str, Literal["half", "float"]] = "float",
    attributes: Mapping[str, str | int | float] | None = None,
    like: tuple[PathLike, int] | None = None,
    window: Window | None = None,
    unchanged: FileStates | None = None,
) -> None:
    """Write named channels as a single-part EXR with zip compression, atomically.

    Args:
        path: ``.exr`` to write.
        channels: (H, W) arrays by full channel name, all of one size.
        dtype: type of all channels, or by name (float where not named).
        attributes: metadata to add.
        like: EXR file, flat or deep, and number of its part, whose windows and metadata are taken.
        window: data window of the channels in the display window of ``like``, if it is another.
        unchanged: as `write_image`.

    Raises:
        JaxblurIOError: writing failed, or the size is not that of ``like`` or of `window`, or an
            input has changed.
        ValueError: no channels, or sizes differ.
    """
    last_check = unchanged.check if unchanged is not None else None
    header = None
    if like is not None:
        refuse_overwrite(path, like[0])
        header = _header_like(*like)
        if window is not None:
            header.x, header.y, header.width, header.height = window
    _write_channels(path, channels, dtype, attributes, last_check, header)


def _write_channels(
    path: PathLike,
    channels: Mapping[str, Any],
    dtype: str | Mapping[str, str],
    attributes: Mapping[str, str | int | float] | None,
    last_check: Callable[[], None] | None,
    header: Any = None,
) -> None:
    arrays = {name: np.asarray(values, np.float32) for name, values in channels.items()}
    shapes = {values.shape for values in arrays.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise ValueError(f"`channels` must be arrays of one (height, width), got {shapes}.")
    ((height, width),) = shapes
    kinds = [dtype if isinstance(dtype, str) else dtype.get(name, "float") for name in arrays]
    spec = oiio.ImageSpec(width, height, len(arrays), "float") if header is None else header
    if (spec.height, spec.width) != (height, width):
        raise JaxblurIOError(
            path, f"the image has {width}x{height} pixels, its model {spec.width}x{spec.height}."
        )
    spec.nchannels = len(arrays)
    spec.channelnames = tuple(arrays)
    set_formats(spec, kinds)
    spec.attribute("compression", "zip")
    set_attributes(spec, attributes)
    pixels = np.stack(list(arrays.values()), axis=-1)
    half = [index for index, kind in enumerate(kinds) if kind == "half"]
    pixels[..., half] = clamp_half(path, pixels[..., half])
    with replacing(path, last_check) as temporary, writer(path, temporary, [spec]) as output:
        check(path, output, output.write_image(pixels))


def _header_like(path: PathLike, part: int) -> Any:
    """The header of a part, without what belongs to its channels and its place among others."""
    with open_input(path) as source:
        source.seek_subimage(part, 0)
        header = oiio.ImageSpec(source.spec())
    header.deep = False
    for name in (*STORAGE, "name", "oiio:subimagename", "view", "multiView", "oiio:subimages"):
        header.erase_attribute(name)
    return header


def write_frame(
    path: PathLike,
    frame: Frame,
    shutter: float,
    *,
    attributes: Mapping[str, str | int | float] | None = None,
) -> None:
    """Write a frame in the convention of preset ``jaxblur``: color half, depth Z and vectors float.

    The velocity channels hold pixels per full frame, x right, y down: ``2/shutter * velocity``,
    or, with a path, the displacements to the previous and the next frame (see `vectors.from_path`).

    Args:
        path: ``.exr`` to write.
        frame: color with 1 to 4 channels, depth, half-spread, and optionally a path.
        shutter: exposure of the half-spread, frames, above 0.
        attributes: metadata to add.

    Raises:
        JaxblurIOError: writing failed.
        ValueError: ``shutter`` is not positive.
    """
    if not shutter > 0:
        raise ValueError(f"`shutter` must be above 0 to store vectors per frame, got {shutter}.")
    color = np.asarray(frame.color, np.float32)
    names = COLOR_NAMES[color.shape[2]]
    channels = {name: color[..., index] for index, name in enumerate(names)}
    channels["Z"] = np.asarray(frame.depth, np.float32)
    channels |= _velocity_channels(frame, shutter)
    write_channels(path, channels, dtype=dict.fromkeys(names, "half"), attributes=attributes)


def _velocity_channels(frame: Frame, shutter: float) -> dict[str, np.ndarray]:
    if frame.path is None:
        velocity = np.asarray(frame.velocity, np.float32) * np.float32(2 / shutter)
        return {"velocity.X": velocity[..., 0], "velocity.Y": velocity[..., 1]}
    moved = vectors.from_path(np.asarray(frame.path, np.float32), shutter)
    return {
        f"velocity.{side}.{axis}": np.asarray(displacement)[..., index]
        for side, displacement in (("previous", moved.previous), ("next", moved.next))
        for index, axis in enumerate("XY")
    }


def refuse_overwrite(output: PathLike, *inputs: PathLike) -> None:
    """Raise an error if an output path is one of the inputs, even under another name.

    Args:
        output: file to be written.
        *inputs: files that are read.

    Raises:
        JaxblurIOError: the output is the same file as an input.
    """
    for source in inputs:
        if os.path.exists(output) and os.path.exists(source) and os.path.samefile(output, source):
            raise JaxblurIOError(output, "is an input too; write to another file.")
