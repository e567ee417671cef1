"""Write images atomically, with the windows, metadata and other channels of a model file."""

import dataclasses
import os
import pathlib
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import OpenImageIO as oiio
from jaxtyping import Float

from jaxblur import srgb, vectors
from jaxblur._util.atomic import replacing
from jaxblur._util.errors import JaxblurIOError, PathLike
from jaxblur._util.text import printable

from .choose import choose_color, is_depth
from .chunks import alike, copy_chunks
from .color import COLORS, Conversion, check_color_space, check_view, conversion_of
from .files import (
    FileInfo,
    FileStates,
    JaxblurIOWarning,
    describe,
    inspect,
    open_input,
    pending_message,
    read_span,
)
from .header import relabel_as_uint
from .output import check, writer
from .ranks import ChannelChange

if TYPE_CHECKING:
    from jaxblur.frame import Frame

HALF_MAX = 65504.0
LOSSLESS = ("none", "rle", "zip", "zips", "piz", "zstd", "htj2k", "htj2k32", "htj2k256")
# Schemes that treat a 32-bit integer and a 32-bit float alike, see `relabel_as_uint`.
TYPE_BLIND = ("none", "rle", "zip", "zips", "piz")
# These attributes describe how the model is stored, which may change here; with `textureformat` the
# writer would expect all levels of a mip-mapped picture.
STORAGE = (
    *("openexr:chunkCount", "openexr:levelmode", "openexr:roundingmode", "oiio:miplevels"),
    *("textureformat", "openexr:dwaCompressionLevel"),
)
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
    color_space: str | None = None,
    view: str | None = None,
) -> None:
    """Write an image, alone or in place of the color of another file.

    The file appears under its name only when it is complete. With ``like``, windows, metadata,
    timecode, channel names and types are those of that file, and all its other channels and parts
    are copied bit for bit; its compression is kept if it is lossless and replaced by zip otherwise.
    Of a mip-mapped file level 0 is written, and a warning says so.
    A ``.png`` gets 8-bit sRGB of the color without alpha, clipped to 0..1, converted from the color
    space of ``like`` (`jaxblur.exr.conversion_of`); its text ``jaxblur:colors`` says how.

    Args:
        path: ``.exr`` or ``.png`` to write.
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
        color_space: color space of the image, for ``.png``; that of ``like`` if None.
        view: OpenColorIO view for ``.png``, such as "ACES 2.0 - SDR 100 nits (Rec.709)"; plain sRGB
            if None.

    Raises:
        JaxblurIOError: the image is not finite, sizes or channel counts differ, ``path`` is
            ``like`` itself or exists without ``overwrite``, an input has changed, or writing
            failed. Then no partial file is left, and an older file stays as it was.
        ValueError: an argument is wrong.
    """
    if extra not in ("keep", "drop"):
        raise ValueError(f"`extra` must be keep or drop; got {extra!r}.")
    if nonfinite not in ("keep", "zero"):
        raise ValueError(f"`nonfinite` must be keep or zero; got {nonfinite!r}.")
    if not overwrite and os.path.exists(path):
        raise JaxblurIOError(path, "exists; pass overwrite=True to replace it.")
    pixels = _checked_image(path, image, like)
    last_check = unchanged.check if unchanged is not None else None
    kind = pathlib.Path(path).suffix.lower()
    if kind == ".png":
        colors = _colors(like, layer, color_channels, color_space, view)
        if not colors.is_identity:
            attributes = {**(attributes or {}), COLORS: colors.words}
        _write_png(path, colors.light(pixels), attributes, last_check)
    elif kind != ".exr":
        raise JaxblurIOError(path, "can write .exr and .png only; change the extension.")
    elif like is None:
        names = COLOR_NAMES.get(pixels.shape[2]) or [f"channel{i}" for i in range(pixels.shape[2])]
        channels = {name: pixels[..., index] for index, name in enumerate(names)}
        _write_channels(path, channels, dtype or "half", attributes, last_check)
    else:
        refuse_overwrite(path, like)
        with open_input(like) as source:
            info = describe(source, like)
            names = choose_color(info, layer, color_channels).channels
            _check_model(path, pixels, info, names)
            _refuse_deep(path, info, extra)
            _refuse_equal_names(path, info, extra)
            new = _New(pixels, names, changes)
            plans = _plan_parts(source, info, new, extra == "keep", dtype, attributes)
            with replacing(path, last_check) as temporary:
                _write_parts(path, temporary, source, info, plans, new, nonfinite == "zero")


def write_channels(
    path: PathLike,
    channels: Mapping[str, Float[np.ndarray, "height width"]],
    *,
    dtype: Literal["half", "float"] | Mapping[str, Literal["half", "float"]] = "float",
    attributes: Mapping[str, str | int | float] | None = None,
    like: tuple[PathLike, int] | None = None,
    unchanged: FileStates | None = None,
) -> None:
    """Write named channels as a single-part EXR with zip compression, atomically.

    Args:
        path: ``.exr`` to write.
        channels: (H, W) arrays by full channel name, all of one size.
        dtype: type of all channels, or by name (float where not named).
        attributes: metadata to add.
        like: EXR file, flat or deep, and number of its part, whose windows and metadata are taken.
        unchanged: as `write_image`.

    Raises:
        JaxblurIOError: writing failed, or the size is not that of ``like``, or an input has
            changed.
        ValueError: no channels, or sizes differ.
    """
    last_check = unchanged.check if unchanged is not None else None
    header = None
    if like is not None:
        refuse_overwrite(path, like[0])
        header = _header_like(*like)
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
    _set_formats(spec, kinds)
    spec.attribute("compression", "zip")
    _set_attributes(spec, attributes)
    pixels = np.stack(list(arrays.values()), axis=-1)
    half = [index for index, kind in enumerate(kinds) if kind == "half"]
    pixels[..., half] = _clamp_half(path, pixels[..., half])
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
    frame: "Frame",
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


class _New(NamedTuple):
    """What replaces pixels of the model.

    Attributes:
        image: (H, W, C).
        color: full names of the channels that it replaces.
        changes: of further channels.
    """

    image: np.ndarray
    color: Sequence[str]
    changes: Sequence[ChannelChange]

    def names(self) -> set[str]:
        """All channels that are replaced or changed."""
        return {*self.color, *(name for change in self.changes for name in change.channels)}


@dataclasses.dataclass(frozen=True)
class _Plan:
    """Plan for writing one part of the model.

    Attributes:
        part: its index in the model.
        spec: header of the output part.
        keep: indices of the model's channels that are written, in order.
        color: (position in ``keep``, channel of the image) of each replaced channel.
        changed: positions in ``keep`` of changed channels by name.
        half: positions in ``keep`` of replaced and changed channels that are written as half.
        uint: positions in ``keep`` of integer channels.
    """

    part: int
    spec: Any
    keep: tuple[int, ...]
    color: tuple[tuple[int, int], ...]
    changed: Mapping[str, int]
    half: tuple[int, ...]
    uint: tuple[int, ...]


def _plan_parts(
    source: Any,
    info: FileInfo,
    new: _New,
    keep_extra: bool,
    dtype: str | None,
    attributes: Mapping[str, str | int | float] | None,
) -> list[_Plan]:
    plans, names = [], new.names()
    for index, part in enumerate(info.parts):
        is_new = any(channel.name in names for channel in part.channels)
        if is_new or keep_extra:
            source.seek_subimage(index, 0)
            plan = _plan_part(source.spec(), info, index, new, keep_extra, dtype)
            if plan.color:
                _set_attributes(plan.spec, attributes)
            plans.append(plan)
    return plans


def _plan_part(
    spec: Any, info: FileInfo, index: int, new: _New, keep_extra: bool, dtype: str | None
) -> _Plan:
    part, color, names = info.parts[index], new.color, new.names()
    kept = [c for c in part.channels if keep_extra or c.name in names]
    replaced = tuple(
        (position, color.index(c.name)) for position, c in enumerate(kept) if c.name in color
    )
    changed = {c.name: i for i, c in enumerate(kept) if c.name in names and c.name not in color}
    kinds = [channel.type for channel in kept]
    for position, _ in replaced:
        kinds[position] = dtype or ("half" if kinds[position] == "half" else "float")
    is_merged = bool(replaced or changed)
    uint = tuple(i for i, kind in enumerate(kinds) if kind == "uint") if is_merged else ()
    header = oiio.ImageSpec(spec)
    if len(kept) < len(part.channels):
        header.nchannels = len(kept)
        header.channelnames = tuple(spec.channelnames[channel.index] for channel in kept)
    _set_formats(header, ["float" if i in uint else kind for i, kind in enumerate(kinds)])
    scheme = part.compression.partition(":")[0]
    allowed = TYPE_BLIND if uint else LOSSLESS
    header.attribute("compression", scheme if scheme in allowed else "zip")
    for name in STORAGE:
        header.erase_attribute(name)
    written = (*(position for position, _ in replaced), *changed.values())
    half = tuple(position for position in written if kinds[position] == "half")
    return _Plan(index, header, tuple(c.index for c in kept), replaced, changed, half, uint)


def _write_parts(
    path: PathLike,
    temporary: str,
    source: Any,
    info: FileInfo,
    plans: list[_Plan],
    new: _New,
    mend: bool,
) -> None:
    specs = [plan.spec for plan in plans]
    stored = _stored_alike(info, temporary, plans, mend)

    def append() -> None:
        try:
            copy_chunks(info.path, temporary, stored)
        except OSError as error:
            raise JaxblurIOError(path, f"cannot be written: {error.strerror}.") from error

    with writer(path, temporary, specs, append if stored else None) as output:
        for position, plan in enumerate(plans):
            if position:
                check(path, output, output.open(temporary, plan.spec, "AppendSubimage"))
            if plan.part in stored:
                continue
            if plan.color or plan.changed:
                pixels = _merged(path, source, info, plan, new, mend)
                check(path, output, output.write_image(pixels))
            elif (mended := _mended_part(path, source, info, plan, mend)) is not None:
                check(path, output, output.write_image(mended))
            else:
                source.seek_subimage(plan.part, 0)
                _copy_part(path, source, info, output)
    _report_storage(info, temporary, plans)
    for position, plan in enumerate(plans):
        if plan.uint:
            names = [plan.spec.channelnames[index] for index in plan.uint]
            relabel_as_uint(temporary, position, names)


def _stored_alike(info: FileInfo, temporary: str, plans: list[_Plan], mend: bool) -> dict[int, int]:
    """The parts that are copied as they are stored: their positions by their numbers.

    Whether that is possible is found out from a file with the headers alone, since the writer may
    store a part in another way than asked for.
    """
    kept = {
        plan.part: position
        for position, plan in enumerate(plans)
        if not plan.color and not plan.changed and info.parts[plan.part].levels == 1
    }
    if not kept or mend or len(plans) == len(kept):
        return {}
    output = oiio.ImageOutput.create(temporary)
    if output is None or not output.open(temporary, tuple(plan.spec for plan in plans)):
        # The writer gives the reason.
        pending_message(output)
        return {}
    output.close()
    pending_message(output)
    return {old: new for old, new in kept.items() if alike(info.path, temporary, {old: new})}


def _report_storage(info: FileInfo, temporary: str, plans: list[_Plan]) -> None:
    """Say where the file is stored in another way than its model: levels and compression."""
    levels = {info.parts[plan.part].levels for plan in plans}
    changes = []
    if max(levels) > 1:
        changes.append(f"its level 0 of {max(levels)} is used, and written without the others")
    for plan, written in zip(plans, inspect(temporary).parts, strict=True):
        # What the header asks for is lossless; OpenImageIO falls back to zip in silence.
        wanted = str(plan.spec["compression"])
        if written.compression != wanted:
            changes.append(
                f"part {plan.part} is stored with {written.compression}, because this OpenImageIO "
                f"cannot write it with {wanted}"
            )
    if changes:
        warnings.warn(
            f"{printable(info.path)}: {printable('; '.join(changes))}.",
            JaxblurIOWarning,
            stacklevel=5,
        )


def _mended_part(
    path: PathLike, source: Any, info: FileInfo, plan: _Plan, mend: bool
) -> np.ndarray | None:
    """Report NaN and infinity in a part that is copied; return its pixels if they were repaired."""
    part = info.parts[plan.part]
    kinds = {channel.type for channel in part.channels}
    if not kinds & {"half", "float"}:
        return None
    try:
        pixels = read_span(source, info, plan.part, 0, len(part.channels), "float")
    except JaxblurIOError as error:
        raise _not_copied(path, info, plan.part, error.reason) from error
    # Integers do not survive conversion to float, so a part that has some is copied as it is.
    mend = mend and kinds <= {"half", "float"}
    found = _not_finite(info, plan, pixels, (), mend)
    return pixels if mend and found else None


def _not_finite(
    info: FileInfo, plan: _Plan, pixels: np.ndarray, replaced: Collection[int], mend: bool
) -> bool:
    """Warn of NaN and infinity in the channels that are kept, and repair them on request."""
    found = []
    for position, index in enumerate(plan.keep):
        channel = info.parts[plan.part].channels[index]
        if position in replaced or channel.type not in ("half", "float"):
            continue
        values = pixels[..., position]
        bad = ~np.isfinite(values)
        if bad.any() and is_depth(channel.name):
            bad &= ~np.isposinf(values)
        if bad.any():
            found.append(f"{channel.name} ({int(bad.sum())} pixels)")
            if mend:
                # Unknown depth becomes infinitely far, as filters treat it; 0 would be in front of
                # everything.
                values[bad] = np.inf if is_depth(channel.name) else 0
    if found:
        done = "set to 0 (depth to infinity)" if mend else "copied as they are"
        warnings.warn(
            f"{printable(info.path)}: NaN or infinity in {printable(', '.join(found))}, {done}.",
            JaxblurIOWarning,
            stacklevel=5,
        )
    return bool(found)


def _merged(
    path: PathLike, source: Any, info: FileInfo, plan: _Plan, new: _New, mend: bool
) -> np.ndarray:
    """Read a part of the model, replace its color and change further channels."""
    channels = info.parts[plan.part].channels
    if len(plan.color) == len(plan.keep) and len(plan.half) in (0, len(plan.keep)):
        # Nothing of the model is left.
        order = [channel for _, channel in plan.color]
        is_all = order == list(range(new.image.shape[2]))
        pixels = np.ascontiguousarray(new.image if is_all else new.image[..., order])
        return _clamp_half(path, pixels) if plan.half else pixels
    old = read_span(source, info, plan.part, 0, len(channels), "float")
    is_whole = plan.keep == tuple(range(len(channels)))
    pixels = np.ascontiguousarray(old if is_whole else old[..., plan.keep])
    _not_finite(info, plan, pixels, {position for position, _ in plan.color}, mend)
    for position in plan.uint:
        index = plan.keep[position]
        bits = read_span(source, info, plan.part, index, index + 1, "uint")
        pixels[..., position] = bits[..., 0].view(np.float32)
    for position, channel in plan.color:
        pixels[..., position] = new.image[..., channel]
    flat = pixels.reshape(-1, pixels.shape[-1])
    for change in new.changes:
        for index, name in enumerate(change.channels):
            if name in plan.changed:
                flat[change.pixels, plan.changed[name]] = change.values[:, index]
    half = pixels[..., plan.half]
    if (clamped := _clamp_half(path, half)) is not half:
        pixels[..., plan.half] = clamped
    return pixels


def _copy_part(path: PathLike, source: Any, info: FileInfo, output: Any) -> None:
    try:
        copied = output.copy_image(source)
    except (RuntimeError, ValueError, MemoryError, UnicodeDecodeError):
        copied = False
    if not copied:
        messages = f"{pending_message(source)}; {pending_message(output)}"
        raise _not_copied(path, info, source.current_subimage(), messages)


def _not_copied(path: PathLike, info: FileInfo, part: int, why: str) -> JaxblurIOError:
    name = info.parts[part].name
    return JaxblurIOError(
        path, f"part {name!r} of {info.path} cannot be copied ({why}); pass extra='drop'."
    )


def _refuse_deep(path: PathLike, info: FileInfo, extra: str) -> None:
    """Refuse what OpenImageIO cannot write: deep parts in one file with a flat picture.

    So nothing deep is ever written, which OpenImageIO would store with zips, unasked, where a model
    has zstd or htj2k.
    """
    deep = next((index for index, part in enumerate(info.parts) if part.deep), None)
    if deep is not None and extra == "keep":
        raise JaxblurIOError(
            path,
            f"part {deep} of {info.path} is deep, and OpenImageIO cannot write deep and flat parts "
            "into one file; pass extra='drop'.",
        )


def _refuse_equal_names(path: PathLike, info: FileInfo, extra: str) -> None:
    """Refuse what OpenEXR reads but does not write: parts of one name."""
    names = [part.name for part in info.parts]
    if extra == "keep" and len(set(names)) < len(names):
        name = next(name for name in names if names.count(name) > 1)
        raise JaxblurIOError(
            path,
            f"{names.count(name)} parts of {info.path} are named {name!r}, and OpenEXR writes no "
            "such file; name them apart, or pass extra='drop'.",
        )


def _check_model(path: PathLike, image: np.ndarray, info: FileInfo, names: Sequence[str]) -> None:
    """Check the image against the model's size and number of color channels."""
    if not info.path.lower().endswith(".exr"):
        raise JaxblurIOError(info.path, "`like` must be an .exr file.")
    *_, width, height = info.parts[info.channel(names[0]).part].data_window
    if image.shape != (height, width, len(names)):
        rows, columns, count = image.shape
        raise JaxblurIOError(
            path,
            f"the image has {columns}x{rows} pixels and {count} channels, but {info.path} has "
            f"{width}x{height} and {', '.join(names)}.",
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
        count = int(bad.sum())
        raise JaxblurIOError(
            path, f"{count} values of the image are NaN or infinite; nothing was written.{hint}"
        )
    return pixels


def _clamp_half(path: PathLike, values: np.ndarray) -> np.ndarray:
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


def _velocity_channels(frame: "Frame", shutter: float) -> dict[str, np.ndarray]:
    if frame.path is None:
        velocity = np.asarray(frame.velocity, np.float32) * np.float32(2 / shutter)
        return {"velocity.X": velocity[..., 0], "velocity.Y": velocity[..., 1]}
    moved = vectors.from_path(np.asarray(frame.path, np.float32), shutter)
    return {
        f"velocity.{side}.{axis}": np.asarray(displacement)[..., index]
        for side, displacement in (("previous", moved.previous), ("next", moved.next))
        for index, axis in enumerate("XY")
    }


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


def _write_png(
    path: PathLike,
    image: np.ndarray,
    attributes: Mapping[str, str | int | float] | None,
    last_check: Callable[[], None] | None,
) -> None:
    count = image.shape[2]
    color = image[..., : 1 if count in (1, 2) else 3]
    height, width, channels = color.shape
    spec = oiio.ImageSpec(width, height, channels, "uint8")
    spec.attribute("oiio:ColorSpace", "sRGB")
    _set_attributes(spec, attributes)
    pixels = np.round(srgb.encode(np.clip(color, 0, 1)) * 255).astype(np.uint8)
    with replacing(path, last_check) as temporary, writer(path, temporary, [spec]) as output:
        check(path, output, output.write_image(pixels))


def _set_formats(spec: Any, kinds: Sequence[str]) -> None:
    widest = next((kind for kind in ("float", "uint", "half") if kind in kinds), kinds[0])
    spec.set_format(widest)
    mixed = len(set(kinds)) > 1
    spec.channelformats = [oiio.TypeDesc(kind) for kind in kinds] if mixed else []
    names = list(spec.channelnames)
    is_alpha = [name.rpartition(".")[2] == "A" for name in names]
    spec.alpha_channel = is_alpha.index(True) if True in is_alpha else -1
    spec.z_channel = -1


def _set_attributes(spec: Any, attributes: Mapping[str, str | int | float] | None) -> None:
    for name, value in (attributes or {}).items():
        spec.attribute(name, value)
