"""Read frames: color, depth and vectors, converted and checked on input."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, TypedDict, Unpack

import numpy as np

from jaxblur import vectors
from jaxblur._util.errors import JaxblurIOError, JaxblurIOWarning, PathLike
from jaxblur.nonfinite import NONE_IGNORED, Ignored, Nonfinite, check_policy

from .channels import read_channels, read_together
from .checks import check_speed, refuse_or_zero, warn_lossy, without_depth
from .choose import (
    ColorGroup,
    borrowed_from,
    choose_color,
    choose_depth,
    choose_vectors,
    views_of,
)
from .convert import DEPTH_KINDS, as_light, depth_kind_of, half_spread, to_distance
from .listing import FileInfo, inspect
from .passes import Passes, choose_passes, sharp_layers
from .windows import Windows, warn_cropped, window_words, windows_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from jaxblur.frame import Frame


@dataclasses.dataclass(frozen=True)
class Buffers:
    """A frame as NumPy arrays, with a record of how it was read.

    Attributes:
        color: (H, W, C) float32 as stored, premultiplied if it has alpha.
        depth: (H, W) float32 positive distance, +inf for sky.
        velocity: (H, W, 2) float32 half-spread in pixels, x right, y down.
        path: (H, W, 2, 2) displacement at shutter opening and closing, or None.
        color_channels: full names of the color channels.
        depth_channel: full name, or None where depth is flat.
        depth_kind: the kind that depth was read as.
        guess: convention and channels of the vectors, and the reason for them.
        windows: data window of these pixels, and the display window of the picture.
        valid: (H, W) False where the color is NaN or infinite, or outside what the file holds, and
            is left out, or None if all pixels are used.
        ignored: numbers of pixels that ``nonfinite="ignore"`` left out.
        pass_channels: full names of the channels of further color passes.
        pass_colors: (H, W, K) their values, or None.
        guide: (H, W, G) colors that show of which surface a pixel is, or None, as in
            `jaxblur.Frame`; not beside passes.
        decoded: float32 all channels of the part with the picture, as stored and in the data window
            of the file, if `read_buffers` was asked to keep them and has read all of them; else
            None.
        sharp_layers: names of layers of color that are not blurred with the picture.
    """

    color: Float[np.ndarray, "height width channels"]
    depth: Float[np.ndarray, "height width"]
    velocity: Float[np.ndarray, "height width 2"]
    path: Float[np.ndarray, "height width 2 2"] | None
    color_channels: tuple[str, ...]
    depth_channel: str | None
    depth_kind: str
    guess: vectors.Guess
    windows: Windows
    valid: Bool[np.ndarray, "height width"] | None = None
    ignored: Ignored = NONE_IGNORED
    pass_channels: tuple[str, ...] = ()
    pass_colors: Float[np.ndarray, "height width channels"] | None = None
    guide: Float[np.ndarray, "height width channels"] | None = None
    decoded: Float[np.ndarray, "stored_height stored_width stored"] | None = None
    sharp_layers: tuple[str, ...] = ()

    def frame(self) -> Frame:
        """The buffers as a `jaxblur.Frame` of JAX arrays.

        With further passes the color holds those too, behind the picture, which is the guide.
        """
        # Imported late, so that listings and path errors do not load jax.
        import jax.numpy as jnp

        from jaxblur.frame import Frame

        color, guide = jnp.asarray(self.color), self.guide
        if self.pass_colors is not None:
            color, guide = jnp.concatenate([color, jnp.asarray(self.pass_colors)], axis=-1), color
        return Frame(
            color=color,
            depth=jnp.asarray(self.depth),
            velocity=jnp.asarray(self.velocity),
            path=None if self.path is None else jnp.asarray(self.path),
            valid=None if self.valid is None else jnp.asarray(self.valid),
            guide=None if guide is None else jnp.asarray(guide),
        )


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
    also: Passes
    keep_decoded: bool


def read_frame(
    path: PathLike, preset: str = "auto", shutter: float = 0.5, **options: Unpack[ReadOptions]
) -> Frame:
    """Read a frame for the filters.

    Args:
        path: image with the color and, unless other files are given, vectors and depth.
        preset: a key of `jaxblur.vectors.PRESETS`, or "auto" to recognize channel names.
        shutter: exposure to blur for, frames.
        **options: see `read_buffers`.

    Returns:
        The frame, in the conventions of `jaxblur.frame`.

    Raises:
        JaxblurIOError: as for `read_buffers`.
        ValueError: as for `read_buffers`.
    """
    buffers = read_buffers(path, preset, shutter, **options)
    warn_cropped(path, buffers)
    return buffers.frame()


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
    also: Passes = (),
    keep_decoded: bool = False,
) -> Buffers:
    """Read color, depth and vectors, convert and check them; jax is not loaded.

    Args:
        path: image with the color and, unless other files are given, vectors and depth; integer
            images are decoded with the sRGB curve.
        preset: a key of `jaxblur.vectors.PRESETS`, or "auto" to recognize channel names.
        shutter: exposure to blur for, frames.
        depth: "z" positive distance, "-z" negated, "1/z" inverse (also reversed z-buffers), "-1/z"
            negated inverse, "normalized-near1" 0..1 with white as nearest (only the order is used:
            2 - value), "flat" the same distance everywhere, "auto" the usual kind of the preset's
            renderer.
        velocity_from: file with the vectors.
        depth_from: file with the depth.
        file_shutter: exposure of the render that wrote the vectors, frames; only for presets
            that span the shutter.
        max_displace: displacement in pixels of a full-range vector; only for presets scaled by it.
        layer: view layer, view or part to search. A view of single-part stereo that lacks vectors
            or depth of its own takes those of the default view, with a warning.
        color_channels: full names of the color channels.
        velocity_channels: full names of the vector channels, x and y of each pair.
        depth_channel: full name of the depth channel.
        nonfinite: treatment of NaN and infinity in color or vectors, and of NaN and negative
            infinity in depth: "error", "ignore" (with a warning; see `jaxblur.nonfinite`), or
            "keep" for inspection.
        also: names or patterns of further color passes, or "all" of them, to be blurred with the
            picture by the same weights, so that they add up to it as before; see
            `jaxblur.exr.choose_passes`.
        keep_decoded: keep `Buffers.decoded`, from which `write_image` copies what does not change;
            it would decode the same pixels again.

    Returns:
        The buffers, all of one size.

    Raises:
        JaxblurIOError: a file is missing or damaged, a channel is missing or ambiguous, values
            are out of range or not finite, or sizes differ. The message names file and channel.
        ValueError: an argument is wrong whatever the file holds.
    """
    _check_arguments(preset, shutter, depth, nonfinite)
    info = inspect(path)
    group = choose_color(info, layer, color_channels)
    passes, extra = choose_passes(info, group, also, layer), None
    vector_info = inspect(velocity_from) if velocity_from else info
    vector_layer = _layer_in(vector_info, layer, velocity_from)
    guess = choose_vectors(vector_info, preset, vector_layer, velocity_channels)
    if velocity_channels is None:
        _warn_borrowed(vector_info, vector_layer, "vectors", guess.channels)
    depth_info, channel = info, None
    if "flat" not in (depth, guess.preset.depth if depth == "auto" else None):
        depth_info = inspect(depth_from) if depth_from else info
        taken = guess.channels if depth_info.path == vector_info.path else ()
        depth_layer = _layer_in(depth_info, layer, depth_from)
        channel = choose_depth(depth_info, depth_layer, depth_channel, group.prefix, taken)
        if depth_channel is None:
            _warn_borrowed(depth_info, depth_layer, "depth", [channel])

    wanted = [(info, group.channels), (vector_info, guess.channels)]
    wanted += [(info, passes)] if passes else []
    wanted += [] if channel is None else [(depth_info, (channel,))]
    for data, names in wanted[1:]:
        _check_window(data, names, info, group)
    (colors, vectors_read, *more), decoded = read_together(wanted)
    color, unknown = as_light(info, group, colors, nonfinite)
    if passes:
        extra, lacking = refuse_or_zero(info.path, passes, more[0], nonfinite)
        unknown = unknown | lacking
    data = [(vector_info, name) for name in guess.channels]
    warn_lossy(data if channel is None else [*data, (depth_info, channel)])
    raw, still = refuse_or_zero(
        vector_info.path, guess.channels, vectors_read, nonfinite, "taken as at rest"
    )
    alpha = color[..., group.channels.index(group.alpha)] if group.alpha else None
    scale = {"max_displace": max_displace, "file_shutter": file_shutter}
    velocity, curve = half_spread(vector_info, guess, raw, still, alpha, shutter, scale)
    if nonfinite != "keep":
        check_speed(velocity, vector_info.path, guess)

    if channel is None:
        kind = "flat"
        distance, lost = np.ones(color.shape[:2], np.float32), np.zeros(color.shape[:2], bool)
    else:
        kind = depth_kind_of(depth, guess, channel, path)
        stored = more[-1][..., 0]
        signed = -stored if kind.startswith("-") else stored
        lost = without_depth(depth_info.path, channel, signed, nonfinite)
        distance = to_distance(stored, kind, depth_info.path, channel)
    return Buffers(
        color,
        distance,
        velocity,
        curve,
        group.channels,
        channel,
        kind,
        guess,
        windows_of(info, group.channels[0]),
        valid=~unknown if unknown.any() else None,
        ignored=Ignored(*(int(np.count_nonzero(where)) for where in (unknown, still, lost))),
        pass_channels=passes,
        pass_colors=extra,
        decoded=decoded if keep_decoded else None,
        sharp_layers=sharp_layers(info, group, passes, layer),
    )


def read_image(
    path: PathLike, layer: str | None = None, color_channels: Sequence[str] | None = None
) -> Float[np.ndarray, "height width channels"]:
    """Read the picture of a file: the color of an EXR, or a PNG, TIFF or HDR.

    Integer files are decoded with the sRGB curve, so that every result is linear light.

    Args:
        path: image file.
        layer: view layer, view or part to search.
        color_channels: full names to read instead of the recognized ones.

    Returns:
        (H, W, C) float32 linear light, channels in the order R, G, B, A.

    Raises:
        JaxblurIOError: the file is missing or damaged, has no color, or holds values that are not
            finite.
    """
    info = inspect(path)
    group = choose_color(info, layer, color_channels)
    return as_light(info, group, read_channels(info.path, group.channels), "error")[0]


def read_depth(
    path: PathLike,
    depth: str = "z",
    *,
    layer: str | None = None,
    depth_channel: str | None = None,
) -> Float[np.ndarray, "height width"]:
    """Read the depth of a file that needs to hold nothing else.

    Args:
        path: EXR file.
        depth: "z" positive distance, "-z" negated, "1/z" inverse, "-1/z" negated inverse.
        layer: view layer, view or part to search.
        depth_channel: full name of the depth channel.

    Returns:
        (H, W) float32, positive, +inf for background.

    Raises:
        JaxblurIOError: the file is missing or damaged, has no depth, or values contradict the kind
            of depth.
        ValueError: the kind is unknown.
    """
    kinds = ("z", "-z", "1/z", "-1/z")
    if depth not in kinds:
        raise ValueError(f"`depth` must be one of {', '.join(kinds)}; got {depth!r}.")
    info = inspect(path)
    channel = choose_depth(info, layer, depth_channel, needed=True)
    raw = read_channels(info.path, [channel])[..., 0]
    warn_lossy([(info, channel)])
    without_depth(info.path, channel, -raw if depth.startswith("-") else raw, "error")
    return to_distance(raw, depth, info.path, channel)


def _check_arguments(preset: str, shutter: float, depth: str, nonfinite: str) -> None:
    if preset != "auto":
        vectors.known_preset(preset)
    vectors.check_shutter(shutter, "shutter")
    if depth not in ("auto", *DEPTH_KINDS):
        raise ValueError(f"`depth` must be auto or one of {', '.join(DEPTH_KINDS)}; got {depth!r}.")
    check_policy(nonfinite, "keep")


def _layer_in(info: FileInfo, layer: str | None, given: PathLike | None) -> str | None:
    """Return the layer to search; a file of its own has another one, unless it has that view."""
    return None if given and layer not in views_of(info) else layer


def _warn_borrowed(info: FileInfo, layer: str | None, what: str, names: Sequence[str]) -> None:
    if words := borrowed_from(info, layer, names):
        warnings.warn(f"{info.path}: {what}: {words}.", JaxblurIOWarning, stacklevel=3)


def _check_window(
    data: FileInfo, names: Sequence[str], picture: FileInfo, group: ColorGroup
) -> None:
    window = windows_of(data, names[0]).data
    wanted = windows_of(picture, group.channels[0]).data
    if window != wanted:
        color = "the color" if data.path == picture.path else f"the color of {picture.path}"
        raise JaxblurIOError(
            data.path,
            f"{', '.join(names)}: pixels {window_words(window)}, but {color} has "
            f"{window_words(wanted)}; render them with the same data window.",
        )
