"""Write an image in place of the color of a model file, and keep all else that the model holds."""

import dataclasses
import functools
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio

from jaxblur._util.atomic import replacing
from jaxblur._util.errors import JaxblurIOError, JaxblurIOWarning, PathLike
from jaxblur._util.text import printable

from .channels import read_span
from .choose import choose_color, is_depth
from .chunks import alike, copy_chunks
from .header import relabel_as_uint
from .listing import FileInfo, describe, inspect
from .opening import open_input, pending_message
from .output import STORAGE, check, clamp_half, set_attributes, set_formats, writer
from .ranks import ChannelChange
from .windows import Window, put_into

LOSSLESS = ("none", "rle", "zip", "zips", "piz", "zstd", "htj2k", "htj2k32", "htj2k256")

# Schemes that treat a 32-bit integer and a 32-bit float alike, see `relabel_as_uint`.
TYPE_BLIND = ("none", "rle", "zip", "zips", "piz")


def write_like(
    path: PathLike,
    image: np.ndarray,
    like: PathLike,
    changes: Sequence[ChannelChange],
    decoded: np.ndarray | None,
    window: Window | None,
    sky: float,
    *,
    layer: str | None,
    color_channels: Sequence[str] | None,
    keep_extra: bool,
    dtype: str | None,
    attributes: Mapping[str, str | int | float] | None,
    mend: bool,
    last_check: Callable[[], None] | None,
) -> None:
    """Write an image in place of the color of a model file.

    Args:
        path: ``.exr`` to write, another file than the model.
        image: (H, W, C) finite float32.
        like: the model.
        changes: as `jaxblur.exr.write_image`.
        decoded: as `jaxblur.exr.write_image`.
        window: as `jaxblur.exr.write_image`.
        sky: as `jaxblur.exr.write_image`.
        layer: as `jaxblur.exr.write_image`.
        color_channels: as `jaxblur.exr.write_image`.
        keep_extra: whether channels and parts that are not color are written too.
        dtype: as `jaxblur.exr.write_image`.
        attributes: as `jaxblur.exr.write_image`.
        mend: whether NaN and infinity in the channels that are copied are replaced.
        last_check: called when the file is complete, before it gets its name.

    Raises:
        JaxblurIOError: image and model do not fit each other, or reading or writing failed.
    """
    with open_input(like) as source:
        info = describe(source, like)
        names = choose_color(info, layer, color_channels).channels
        stored = info.parts[info.channel(names[0]).part].data_window
        _check_model(path, image, info, names, window or stored)
        if keep_extra:
            _refuse_deep(path, info)
            _refuse_equal_names(path, info)
        new = _New(
            image,
            None if window == stored else window,
            sky,
            names,
            changes,
            _decoded(info, names, decoded),
        )
        plans = _plan_parts(source, info, new, keep_extra, dtype, attributes)
        with replacing(path, last_check) as temporary:
            _write_parts(path, temporary, source, info, plans, new, mend)


def _check_model(
    path: PathLike, image: np.ndarray, info: FileInfo, names: Sequence[str], window: Window
) -> None:
    """Check the image against the model's size and number of color channels."""
    if not info.path.lower().endswith(".exr"):
        raise JaxblurIOError(info.path, "`like` must be an .exr file.")
    *_, width, height = window
    if image.shape != (height, width, len(names)):
        rows, columns, count = image.shape
        raise JaxblurIOError(
            path,
            f"the image has {columns}x{rows} pixels and {count} channels, but {info.path} has "
            f"{width}x{height} and {', '.join(names)}.",
        )


def _decoded(
    info: FileInfo, names: Sequence[str], decoded: np.ndarray | None
) -> Mapping[int, np.ndarray]:
    """What was decoded before, by the part that it is of."""
    if decoded is None:
        return {}
    number = info.channel(names[0]).part
    *_, width, height = info.parts[number].data_window
    shape = height, width, len(info.parts[number].channels)
    if decoded.shape != shape:
        raise ValueError(
            f"`decoded` must be `decoded` of the buffers of {info.path}, {shape}, got "
            f"{decoded.shape}."
        )
    return {number: decoded}


def _refuse_deep(path: PathLike, info: FileInfo) -> None:
    """Refuse what OpenImageIO cannot write: deep parts in one file with a flat picture.

    So nothing deep is ever written, which OpenImageIO would store with zips, unasked, where a model
    has zstd or htj2k.
    """
    deep = next((index for index, part in enumerate(info.parts) if part.deep), None)
    if deep is not None:
        raise JaxblurIOError(
            path,
            f"part {deep} of {info.path} is deep, and OpenImageIO cannot write deep and flat parts "
            "into one file; pass extra='drop'.",
        )


def _refuse_equal_names(path: PathLike, info: FileInfo) -> None:
    """Refuse what OpenEXR reads but does not write: parts of one name."""
    names = [part.name for part in info.parts]
    if len(set(names)) < len(names):
        name = next(name for name in names if names.count(name) > 1)
        raise JaxblurIOError(
            path,
            f"{names.count(name)} parts of {info.path} are named {name!r}, and OpenEXR writes no "
            "such file; name them apart, or pass extra='drop'.",
        )


class _New(NamedTuple):
    """What replaces pixels of the model.

    Attributes:
        image: (H, W, C).
        window: data window of the image; None for that of the model.
        sky: depth where the model has none.
        color: full names of the channels that it replaces.
        changes: of further channels.
        decoded: all channels of parts of the model that were read before, (H, W, K) by part.
    """

    image: np.ndarray
    window: Window | None
    sky: float
    color: Sequence[str]
    changes: Sequence[ChannelChange]
    decoded: Mapping[int, np.ndarray]

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
                set_attributes(plan.spec, attributes)
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
    if is_merged and new.window is not None:
        header.x, header.y, header.width, header.height = new.window
    if len(kept) < len(part.channels):
        header.nchannels = len(kept)
        header.channelnames = tuple(spec.channelnames[channel.index] for channel in kept)
    set_formats(header, ["float" if i in uint else kind for i, kind in enumerate(kinds)])
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

    append = functools.partial(copy_chunks, info.path, temporary, stored) if stored else None
    with writer(path, temporary, specs, append) as output:
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
    return alike(info.path, temporary, kept)


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
        done = "written as 0 (depth as infinity)" if mend else "copied as they are"
        warnings.warn(
            f"{printable(info.path)}: NaN or infinity in {printable(', '.join(found))}, {done}.",
            JaxblurIOWarning,
            stacklevel=6,
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
        return clamp_half(path, pixels) if plan.half else pixels
    is_whole = plan.keep == tuple(range(len(channels)))
    if plan.part in new.decoded:
        old = new.decoded[plan.part]
        pixels = old.copy() if is_whole else old[..., plan.keep]
    else:
        old = read_span(source, info, plan.part, 0, len(channels), "float")
        pixels = np.ascontiguousarray(old if is_whole else old[..., plan.keep])
    _not_finite(info, plan, pixels, {position for position, _ in plan.color}, mend)
    stored = info.parts[plan.part].data_window
    window = new.window or stored
    outside = [new.sky if is_depth(channels[index].name) else 0 for index in plan.keep]
    pixels = put_into(pixels, stored, window, outside)
    for position in plan.uint:
        index = plan.keep[position]
        bits = read_span(source, info, plan.part, index, index + 1, "uint")
        pixels[..., position] = put_into(bits[..., 0], stored, window).view(np.float32)
    for position, channel in plan.color:
        pixels[..., position] = new.image[..., channel]
    flat = pixels.reshape(-1, pixels.shape[-1])
    for change in new.changes:
        for index, name in enumerate(change.channels):
            if name in plan.changed:
                flat[change.pixels, plan.changed[name]] = change.values[:, index]
    half = pixels[..., plan.half]
    if (clamped := clamp_half(path, half)) is not half:
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
