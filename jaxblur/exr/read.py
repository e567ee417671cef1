"""Read frames: color, depth and vectors, converted and checked at the door."""

import dataclasses
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, TypedDict, Unpack

import numpy as np
from jaxtyping import Bool, Float

from jaxblur import srgb, vectors
from jaxblur.nonfinite import NONE_IGNORED, Ignored, Nonfinite, check_policy, not_finite

from .choose import ColorGroup, choose_color, choose_depth, choose_vectors, is_depth
from .files import (
    Channel,
    FileInfo,
    JaxblurIOError,
    JaxblurIOWarning,
    PathLike,
    inspect,
    read_channels,
)

if TYPE_CHECKING:
    from jaxblur.frame import Frame

DEPTH_KINDS = ("z", "-z", "1/z", "normalized-near1", "flat")
# Renderers that cannot write infinity write 1e10 or 1e30 for the sky.
SKY_DEPTH = 1e9
# Squares of larger displacements overflow single precision; no picture is that large.
SPEED_LIMIT = 1e6


@dataclasses.dataclass(frozen=True)
class Buffers:
    """A frame as NumPy arrays, with how it was read.

    Attributes:
        color: (H, W, C) float32 as stored, premultiplied if it has alpha.
        depth: (H, W) float32 positive distance, +inf for sky.
        velocity: (H, W, 2) float32 half-spread in pixels, x right, y down.
        path: (H, W, 2, 2) displacement at shutter opening and closing, or None.
        color_channels: full names of the color channels.
        depth_channel: full name, or None where depth is flat.
        depth_kind: how depth was read.
        guess: convention and channels of the vectors, and why.
        valid: (H, W) False where the color is NaN or infinite and is to be left out, or None
            where all of it is used.
        ignored: how many pixels ``nonfinite="ignore"`` left out.
    """

    color: Float[np.ndarray, "height width channels"]
    depth: Float[np.ndarray, "height width"]
    velocity: Float[np.ndarray, "height width 2"]
    path: Float[np.ndarray, "height width 2 2"] | None
    color_channels: tuple[str, ...]
    depth_channel: str | None
    depth_kind: str
    guess: vectors.Guess
    valid: Bool[np.ndarray, "height width"] | None = None
    ignored: Ignored = NONE_IGNORED


class ReadOptions(TypedDict, total=False):
    """Keyword arguments of `read_buffers`, which documents them and their defaults."""

    depth: str
    velocity_from: PathLike | None
    depth_from: PathLike | None
    file_shutter: float | None
    max_displace: float | None
    layer: str | None
    color_channels: Sequence[str] | None
    velocity_channels: Sequence[str] | None
    depth_channel: str | None
    nonfinite: Nonfinite


def read_frame(
    path: PathLike, preset: str = "auto", shutter: float = 0.5, **options: Unpack[ReadOptions]
) -> "Frame":
    """Read a frame for the filters.

    Args:
        path: image with the color and, unless given apart, vectors and depth.
        preset: a key of `jaxblur.vectors.PRESETS`, or "auto" to recognize channel names.
        shutter: exposure to blur for, frames.
        **options: see `read_buffers`.

    Returns:
        The frame, in the conventions of `jaxblur.frame`.

    Raises:
        JaxblurIOError: as `read_buffers`.
        ValueError: as `read_buffers`.
    """
    buffers = read_buffers(path, preset, shutter, **options)
    # Late, so that listings and path errors answer without loading jax.
    import jax.numpy as jnp

    from jaxblur.frame import Frame

    return Frame(
        color=jnp.asarray(buffers.color),
        depth=jnp.asarray(buffers.depth),
        velocity=jnp.asarray(buffers.velocity),
        path=None if buffers.path is None else jnp.asarray(buffers.path),
        valid=None if buffers.valid is None else jnp.asarray(buffers.valid),
    )


def read_buffers(
    path: PathLike,
    preset: str = "auto",
    shutter: float = 0.5,
    *,
    depth: str = "auto",
    velocity_from: PathLike | None = None,
    depth_from: PathLike | None = None,
    file_shutter: float | None = None,
    max_displace: float | None = None,
    layer: str | None = None,
    color_channels: Sequence[str] | None = None,
    velocity_channels: Sequence[str] | None = None,
    depth_channel: str | None = None,
    nonfinite: Nonfinite | Literal["keep"] = "error",
) -> Buffers:
    """Read color, depth and vectors, convert and check them; jax is not loaded.

    Args:
        path: image with the color and, unless given apart, vectors and depth; integer images are
            decoded with the sRGB curve.
        preset: a key of `jaxblur.vectors.PRESETS`, or "auto" to recognize channel names.
        shutter: exposure to blur for, frames.
        depth: "z" positive distance, "-z" negated, "1/z" inverse (also reversed z-buffers),
            "normalized-near1" 0..1 with near white (only its order is used: 2 - value), "flat"
            everything equally far, "auto" as the preset's renderer does.
        velocity_from: file with the vectors.
        depth_from: file with the depth.
        file_shutter: exposure of the render that wrote the vectors, frames; only for presets
            that span the shutter.
        max_displace: pixels that a full-range vector stands for; only for presets scaled so.
        layer: view layer, view or part to look in.
        color_channels: full names of the color channels.
        velocity_channels: full names of the vector channels, x and y of each pair.
        depth_channel: full name of the depth channel.
        nonfinite: NaN and infinity in color or vectors, and NaN in depth: "error", "ignore" (with
            a warning; see `jaxblur.nonfinite`), or "keep" for looking at them.

    Returns:
        The buffers, all of one size.

    Raises:
        JaxblurIOError: a file is missing or damaged, a channel is missing or ambiguous, values
            are out of range or not finite, or sizes differ. The message names file and channel.
        ValueError: an argument that does not depend on the file is wrong.
    """
    _check_arguments(preset, shutter, depth, nonfinite)
    info = inspect(path)
    group = choose_color(info, layer, color_channels)
    color, unknown = _finite(info.path, group.channels, _linear_color(info, group), nonfinite)

    vector_info = inspect(velocity_from) if velocity_from else info
    guess = choose_vectors(vector_info, preset, None if velocity_from else layer, velocity_channels)
    raw = _read_data(vector_info, guess.channels, info, group.channels[0])
    raw, still = _finite(vector_info.path, guess.channels, raw, nonfinite)
    alpha = color[..., group.channels.index(group.alpha)] if group.alpha else None
    scale = {"max_displace": max_displace, "file_shutter": file_shutter}
    velocity, curve = _half_spread(vector_info, guess, raw, still, alpha, shutter, scale)
    if nonfinite != "keep":
        _check_speed(velocity, vector_info.path, guess)

    if "flat" in (depth, guess.preset.depth if depth == "auto" else None):
        distance, lost = np.ones(color.shape[:2], np.float32), np.zeros(color.shape[:2], bool)
        channel, kind = None, "flat"
    else:
        depth_info = inspect(depth_from) if depth_from else info
        taken = guess.channels if depth_info.path == vector_info.path else ()
        channel = choose_depth(
            depth_info, None if depth_from else layer, depth_channel, group.prefix, taken
        )
        kind = _depth_kind(depth, guess, channel, path)
        raw = _read_data(depth_info, [channel], info, group.channels[0])[..., 0]
        lost = _without_depth(depth_info.path, channel, raw, nonfinite)
        distance = to_distance(raw, kind, depth_info.path, channel)
    return Buffers(
        *(color, distance, velocity, curve, group.channels, channel, kind, guess),
        valid=~unknown if unknown.any() else None,
        ignored=Ignored(*(int(np.count_nonzero(where)) for where in (unknown, still, lost))),
    )


def read_image(
    path: PathLike, layer: str | None = None, color_channels: Sequence[str] | None = None
) -> Float[np.ndarray, "height width channels"]:
    """Read the picture of a file: the color of an EXR, or a PNG, TIFF or HDR.

    Integer files are decoded with the sRGB curve, so that every result is linear light.

    Args:
        path: image file.
        layer: view layer, view or part to look in.
        color_channels: full names to read instead of the recognized ones.

    Returns:
        (H, W, C) float32 linear light, channels in the order R, G, B, A.

    Raises:
        JaxblurIOError: missing, damaged, no color, or values that are not finite.
    """
    info = inspect(path)
    group = choose_color(info, layer, color_channels)
    return _finite(info.path, group.channels, _linear_color(info, group), "error")[0]


def count_not_finite(info: FileInfo, names: Sequence[str]) -> dict[str, int]:
    """Count the pixels with NaN or infinity; infinite depth is sky and does not count.

    Args:
        info: listing of the file.
        names: full names of channels of one part.

    Returns:
        The number of pixels by channel.

    Raises:
        JaxblurIOError: the pixels cannot be read whole.
    """
    values = read_channels(info.path, names)
    counts = {}
    for index, name in enumerate(names):
        plane = values[..., index]
        sky = np.isposinf(plane) if is_depth(name) else False
        counts[name] = int(np.count_nonzero(not_finite(plane) & ~np.asarray(sky)))
    return counts


def to_distance(
    raw: Float[np.ndarray, "height width"], kind: str, path: PathLike, channel: str
) -> Float[np.ndarray, "height width"]:
    """Turn stored depth into positive distance, with +inf where nothing was hit.

    Background is what is not finite, 1e9 or more, or 0 ("z", "-z", "1/z", and near-white depth).

    Args:
        raw: (H, W) as stored.
        kind: "z", "-z", "1/z" or "normalized-near1", as in `read_buffers`.
        path: file, for messages.
        channel: channel, for messages.

    Returns:
        (H, W) float32, positive, +inf for background.

    Raises:
        JaxblurIOError: values contradict the kind of depth.
    """
    values = -raw if kind == "-z" else raw
    hit = np.isfinite(values) & (values < SKY_DEPTH) & (values != 0)
    _refuse(hit & (values < 0), path, channel, "negative", _NEGATIVE_DEPTH[kind])
    if kind == "normalized-near1":
        _refuse(hit & (values > 1), path, channel, "above 1", "pass depth='z' if it is a distance.")
        distance = 2 - values
    elif kind == "1/z":
        far = (values >= SKY_DEPTH) & np.isfinite(values)
        _refuse(far, path, channel, "1e9 or more", "pass depth='z', this is not an inverse.")
        with np.errstate(over="ignore"):
            distance = 1 / np.where(hit, values, np.float32(1))
    else:
        distance = values
    return np.where(hit, distance, np.inf).astype(np.float32)


_NEGATIVE_DEPTH = {
    "z": "pass depth='-z' if the camera looks along -z, or render depth again.",
    "-z": "pass depth='z', distances are positive here.",
    "1/z": "render depth again, or pass depth='z' or '-z'.",
    "normalized-near1": "pass depth='z' or '-z', values must lie in 0..1.",
}


def _check_arguments(preset: str, shutter: float, depth: str, nonfinite: str) -> None:
    if preset != "auto":
        vectors.known_preset(preset)
    vectors.check_shutter(shutter, "shutter")
    if depth not in ("auto", *DEPTH_KINDS):
        raise ValueError(f"`depth` must be auto or one of {', '.join(DEPTH_KINDS)}; got {depth!r}.")
    check_policy(nonfinite, "keep")


def _linear_color(info: FileInfo, group: ColorGroup) -> np.ndarray:
    """Read the color as linear light; integer files hold sRGB."""
    color = read_channels(info.path, group.channels)
    for index, name in enumerate(group.channels):
        if info.channel(name).type in ("uint8", "uint16") and name != group.alpha:
            color[..., index] = srgb.decode(color[..., index])
    return color


def _depth_kind(depth: str, guess: vectors.Guess, channel: str, path: PathLike) -> str:
    """Settle "auto"; warn where it means more than a plain distance."""
    if depth != "auto":
        return depth
    kind = guess.preset.depth
    if kind == "1/z" and channel == "Z":
        # OpenEXR reserves the plain name for distance; what inverts it names a layer.
        return "z"
    if kind != "z":
        warnings.warn(
            f"{path}: depth is read as {kind}, as {guess.preset.name} usually writes it; pass "
            f"depth='{kind}' or depth='z' to settle it.",
            JaxblurIOWarning,
            stacklevel=3,
        )
    return kind


def _read_data(
    data: FileInfo, names: Sequence[str], picture: FileInfo, color_name: str
) -> np.ndarray:
    """Read vectors or depth and hold their data window against the color's."""
    values = read_channels(data.path, names)
    window, wanted = _window(data, names[0]), _window(picture, color_name)
    if window != wanted:
        raise JaxblurIOError(
            data.path,
            f"{', '.join(names)}: pixels {window}, but the color of {picture.path} has {wanted}; "
            "render them with the same data window.",
        )
    for name in names:
        _warn_lossy(data, data.channel(name))
    return values


def _window(info: FileInfo, channel: str) -> str:
    """Spell out a data window, such as ``6x4 at (-1, 0)``."""
    x, y, width, height = info.parts[info.channel(channel).part].data_window
    return f"{width}x{height} at ({x}, {y})"


def _half_spread(
    info: FileInfo,
    guess: vectors.Guess,
    raw: np.ndarray,
    still: np.ndarray,
    alpha: np.ndarray | None,
    shutter: float,
    scale: dict[str, float | None],
) -> tuple[np.ndarray, np.ndarray | None]:
    """Velocity and perhaps paths, at rest where they are unknown."""
    *_, width, height = info.parts[info.channel(guess.channels[0]).part].display_window
    # Damaged values overflow here; a check or the caller's statistics report them.
    with np.errstate(invalid="ignore", over="ignore"):
        try:
            displacements = vectors.to_displacements(
                raw, guess, size=(height, width), alpha=alpha, **scale
            )
        except ValueError as error:
            raise JaxblurIOError(info.path, str(error)) from error
        velocity, curve = vectors.to_half_spread(displacements, shutter)
    return _stopped(velocity, still), None if curve is None else _stopped(curve, still)


def _warn_lossy(info: FileInfo, channel: Channel) -> None:
    compression = info.parts[channel.part].compression.partition(":")[0]
    # DWA takes channels called like color for color and stores the others exactly.
    like_color = channel.name.rpartition(".")[2].upper() in ("R", "G", "B", "Y", "RY", "BY")
    lossy = {
        "pxr24": channel.type == "float",
        "b44": channel.type == "half",
        "b44a": channel.type == "half",
        "dwaa": like_color,
        "dwab": like_color,
    }
    if lossy.get(compression, False):
        warnings.warn(
            f"{info.path}: {channel.name} is stored with lossy compression ({compression}), its "
            "values are inexact; write vectors and depth with zip.",
            JaxblurIOWarning,
            stacklevel=4,
        )


def _finite(
    path: PathLike, names: Sequence[str], values: np.ndarray, nonfinite: str
) -> tuple[np.ndarray, np.ndarray]:
    """Refuse NaN and infinity channel by channel, or set those pixels to 0 and say which."""
    somewhere = not_finite(values)
    if nonfinite == "keep" or not somewhere.any():
        return values, np.zeros_like(somewhere)
    if nonfinite == "error":
        for index, name in enumerate(names):
            bad = not_finite(values[..., index])
            _refuse(bad, path, name, "NaN or infinite", _IGNORE)
    _warn_ignored(path, ", ".join(names), int(somewhere.sum()), "NaN or infinity")
    return np.where(somewhere[..., None], np.float32(0), values), somewhere


_IGNORE = "repair it, or leave such pixels out with nonfinite='ignore'."


def _without_depth(path: PathLike, name: str, raw: np.ndarray, nonfinite: str) -> np.ndarray:
    """Refuse NaN in depth, or say where it counts as sky."""
    bad = np.isnan(raw)
    if nonfinite == "error":
        _refuse(bad, path, name, "NaN", _IGNORE)
    if bad.any() and nonfinite == "ignore":
        _warn_ignored(path, name, int(bad.sum()), "NaN")
    return bad & (nonfinite == "ignore")


def _warn_ignored(path: PathLike, names: str, count: int, what: str) -> None:
    warnings.warn(
        f"{path}: {count} pixels with {what} in {names} are ignored.",
        JaxblurIOWarning,
        stacklevel=4,
    )


def _stopped(motion: np.ndarray, still: np.ndarray) -> np.ndarray:
    """Set velocities or paths to 0 where they are unknown: raw values may rest elsewhere."""
    if not still.any():
        return motion
    return np.where(still.reshape(*still.shape, *(1,) * (motion.ndim - 2)), np.float32(0), motion)


def _check_speed(velocity: np.ndarray, path: PathLike, guess: vectors.Guess) -> None:
    # Negated, so that NaN from an overflow is caught too.
    fast = ~(np.abs(velocity).max(axis=-1) <= SPEED_LIMIT)
    remedy = f"check the preset ({guess.preset.name}) and the file."
    _refuse(fast, path, ", ".join(guess.channels), f"faster than {SPEED_LIMIT:.0e} px", remedy)


def _refuse(bad: np.ndarray, path: PathLike, channel: str, what: str, remedy: str) -> None:
    """Raise if any pixel is bad, naming the count and the first one."""
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise JaxblurIOError(
            path,
            f"{channel}: {int(bad.sum())} of {bad.size} pixels are {what} (first at row {row}, "
            f"column {column}); {remedy}",
        )
