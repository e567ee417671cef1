"""Deep EXR: the samples of every pixel, flattened into a few layers with depth and velocity.

The depths of the picture are cut into slabs, the same for all pixels, and a layer holds the samples
of a slab, composited. A cut at a depth counts the pairs of samples that follow each other in a
pixel, with the cut between them: each pair by the product of their alphas and by how far apart they
move, for flattening loses nothing of what moves together. The best cut is taken first, then the
best of what it leaves together. So things are divided between which something else moves, and a
thing is not torn into two layers from one pixel to the next, as it is where the samples of each
pixel are divided by themselves.

A sample of alpha 1 hides what is behind it in its own layer. What is in the layers behind is
kept, and shows when the motion uncovers it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Unpack

import numpy as np

from jaxblur._util.errors import JaxblurIOError, PathLike

from .checks import check_speed
from .choose import choose_color, choose_depth, choose_vectors
from .convert import depth_kind_of, half_spread, to_distance
from .listing import FileInfo, inspect
from .opening import open_input, pending_message
from .read import Buffers, ReadOptions
from .windows import windows_of

if TYPE_CHECKING:
    from jaxtyping import Float, Int

BINS = 1024
"""Log depths at which a picture can be cut."""
BAND = 4
"""Rows that are read at once, where there are no tiles."""
AT_REST = 0.1
"""Pixels added to how far apart two samples move, so that things at rest are divided too."""
DEEP_OPTIONS = ("depth", "file_shutter", "max_displace", "layer", "color_channels")
"""Options of `read_buffers` that deep files have too, with the next."""
DEEP_CHANNELS = ("velocity_channels", "depth_channel")


class Samples(NamedTuple):
    """The samples of a deep part, pixel by pixel, each from near to far.

    Attributes:
        pixel: (N,) row-major number of the pixel.
        color: (N, C) premultiplied, as in the file.
        alpha: (N,) 0 to 1.
        depth: (N,) positive distance.
        velocity: (N, 2) half-spread in pixels.
        path: (N, 2, 2), or None.
    """

    pixel: Int[np.ndarray, " samples"]
    color: Float[np.ndarray, "samples channels"]
    alpha: Float[np.ndarray, " samples"]
    depth: Float[np.ndarray, " samples"]
    velocity: Float[np.ndarray, "samples 2"]
    path: Float[np.ndarray, "samples 2 2"] | None

    def take(self, which: np.ndarray) -> Samples:
        """Some of the samples, in an order."""
        return Samples(
            self.pixel[which],
            self.color[which],
            self.alpha[which],
            self.depth[which],
            self.velocity[which],
            None if self.path is None else self.path[which],
        )


def is_deep(info: FileInfo) -> bool:
    """Whether a file has a deep part.

    Args:
        info: its listing.
    """
    return any(part.deep for part in info.parts)


def read_deep_layers(
    path: PathLike,
    layers: int,
    preset: str = "auto",
    shutter: float = 0.5,
    **options: Unpack[ReadOptions],
) -> tuple[Buffers, ...]:
    """Read a deep file as a few flat layers for `jaxblur.blur_layers`.

    The layers, composited, are the flat image. The depth, velocity and path of a pixel of a layer
    are means over its samples, weighted by what each contributes. Where a layer has none, alpha and
    velocity are 0, and depth is infinite. Where samples overlap in depth (from Z to ZBack), they
    are ordered by Z and not split. A sample takes about 60 bytes of memory.

    Args:
        path: deep EXR with color, alpha, depth and vectors in one part; color is premultiplied, as
            OpenEXR demands, vectors are not unless the preset says so.
        layers: largest number of layers, from 1; there are fewer if fewer divide everything.
        preset: as `read_buffers`.
        shutter: as `read_buffers`.
        **options: as `read_buffers`: ``depth``, ``file_shutter``, ``max_displace``, ``layer``,
            ``color_channels``, ``velocity_channels`` and ``depth_channel``.

    Returns:
        Buffers of each layer, the front one first.

    Raises:
        JaxblurIOError: as `read_buffers`, or the file has no alpha, or is not deep.
        ValueError: ``layers`` is below 1, or an option is not among those.
    """
    if layers < 1:
        raise ValueError(f"`layers` must be at least 1, got {layers}.")
    if unknown := options.keys() - {*DEEP_OPTIONS, *DEEP_CHANNELS}:
        raise ValueError(f"`{min(unknown)}` is not for deep files; leave it out.")
    info = inspect(path)
    layer, kind = options.get("layer"), options.get("depth", "auto")
    group = choose_color(info, layer, options.get("color_channels"))
    if group.alpha is None:
        raise JaxblurIOError(
            info.path, f"{', '.join(group.channels)}: no alpha (A), which deep samples need."
        )
    guess = choose_vectors(info, preset, layer, options.get("velocity_channels"))
    if kind == "flat":
        raise JaxblurIOError(info.path, "deep samples need depth; leave out depth='flat'.")
    channel = choose_depth(info, layer, options.get("depth_channel"), group.prefix, guess.channels)
    kind = depth_kind_of(kind, guess, channel, path)

    names = (*group.channels, channel, *guess.channels)
    scale = {name: options.get(name) for name in ("max_displace", "file_shutter")}

    def converted(pixel: np.ndarray, values: np.ndarray) -> Samples:
        color, raw = values[:, : len(group.channels)], values[:, len(group.channels) + 1 :]
        alpha = np.clip(color[:, group.channels.index(group.alpha)], 0, 1)
        # What converts frames takes the samples for a frame of one column.
        still = np.zeros((len(pixel), 1), bool)
        velocity, curve = half_spread(
            info, guess, raw[:, None], still, alpha[:, None], shutter, scale
        )
        check_speed(velocity, info.path, guess)
        distance = to_distance(values[:, len(group.channels), None], kind, info.path, channel)
        samples = Samples(
            pixel,
            color,
            alpha,
            distance[:, 0],
            velocity[:, 0],
            None if curve is None else curve[:, 0],
        )
        return samples.take(np.lexsort((samples.depth, pixel)))

    bands, sizes = [], []
    for size, pixel, values in _read_bands(info, names, channel):
        sizes.append(size)
        bands.append(converted(pixel, values))
    return tuple(
        Buffers(
            color,
            distance,
            velocity,
            path[0] if path else None,
            group.channels,
            channel,
            kind,
            guess,
            windows_of(info, group.channels[0]),
        )
        for color, distance, velocity, *path in _layers_of(bands, sizes, layers)
    )


def _layers_of(
    bands: Sequence[Samples], sizes: Sequence[tuple[int, int]], layers: int
) -> Iterator[list[np.ndarray]]:
    """Color, depth, velocity and, if known, path of the first layer and those with samples."""
    cuts = cuts_of(bands, layers)

    def layer_of(band: Samples) -> np.ndarray:
        return np.searchsorted(cuts, band.depth, side="right")

    filled = {0}.union(*(np.unique(layer_of(band)).tolist() for band in bands))
    for number in sorted(filled):
        flat = [
            _flattened(band.take(layer_of(band) == number), size)
            for band, size in zip(bands, sizes, strict=True)
        ]
        yield [np.concatenate(values) for values in zip(*flat, strict=True)]


def cuts_of(bands: Sequence[Samples], layers: int) -> Float[np.ndarray, " cuts"]:
    """The depths at which samples are divided into layers.

    Args:
        bands: the samples of a picture, by bands of rows.
        layers: largest number of layers.

    Returns:
        (layers - 1,) or fewer, ascending.
    """
    finite = [np.isfinite(band.depth) for band in bands]
    known = [depth for band, of in zip(bands, finite, strict=True) if len(depth := band.depth[of])]
    if layers < 2 or not known:
        return np.zeros(0)
    near, far = float(min(map(np.min, known))), float(max(map(np.max, known)))
    if not all(map(np.all, finite)):
        far *= 2
    edges = np.linspace(np.log(near), np.log(far), BINS + 1)[1:]
    # Pairs by the bins of both. A cut at an edge is in pairs from a bin before it to one behind it.
    weight = np.zeros((BINS + 1, BINS + 1))
    for band in bands:
        logs = np.log(np.minimum(band.depth.astype(np.float64), far))
        follows = band.pixel[1:] == band.pixel[:-1]
        moved = np.linalg.norm(np.diff(band.velocity, axis=0), axis=-1) + AT_REST
        pair = np.where(follows, band.alpha[1:] * band.alpha[:-1] * moved, 0)
        bins = np.searchsorted(edges, logs, side="right")
        np.add.at(weight, (bins[:-1], bins[1:]), pair)
    weight = np.triu(weight, 1)
    total = weight.sum()
    found: list[int] = []
    for _ in range(layers - 1):
        score = np.cumsum(weight.sum(axis=1) - weight.sum(axis=0))[:BINS]
        if not score.max() > 1e-9 * max(total, 1e-30):
            break
        best = np.flatnonzero(score >= score.max() * (1 - 1e-9))
        # The middle of the first run of them: a gap between things.
        run = best[: np.argmax(np.append(np.diff(best) != 1, True)) + 1]
        cut = int(run[len(run) // 2])
        found.append(cut)
        weight[: cut + 1, cut + 1 :] = 0
    return np.exp(edges[sorted(found)])


def _flattened(samples: Samples, size: tuple[int, int]) -> tuple[np.ndarray, ...]:
    """Color, depth, velocity and, if known, path of samples, composited, of a band of rows.

    The samples are ordered by pixel and depth.
    """
    count = size[0] * size[1]
    color = np.zeros((count, samples.color.shape[1]))
    through, total, depth = np.ones(count), np.zeros(count), np.zeros(count)
    motions = [samples.velocity, *([] if samples.path is None else [samples.path])]
    means = [np.zeros((count, *motion.shape[1:])) for motion in motions]
    _, starts, counts = np.unique(samples.pixel, return_index=True, return_counts=True)
    for rank in range(counts.max(initial=0)):
        which = starts[counts > rank] + rank
        pixel = samples.pixel[which]
        share = through[pixel] * samples.alpha[which]
        color[pixel] += through[pixel, None] * samples.color[which]
        total[pixel] += share
        # A mean of inverse depths takes infinity, and is that of what is seen in perspective.
        depth[pixel] += share / samples.depth[which]
        for mean, motion in zip(means, motions, strict=True):
            mean[pixel] += share.reshape(-1, *(1,) * (motion.ndim - 1)) * motion[which]
        through[pixel] *= 1 - samples.alpha[which]
    weight = np.where(total > 0, total, 1)
    with np.errstate(divide="ignore"):
        distance = np.where(depth > 0, weight / depth, np.inf)
    means = [mean / weight.reshape(-1, *(1,) * (mean.ndim - 1)) for mean in means]
    return tuple(
        values.reshape(*size, *values.shape[1:]).astype(np.float32)
        for values in (color, distance, *means)
    )


def _read_bands(
    info: FileInfo, names: tuple[str, ...], depth: str
) -> Iterator[tuple[tuple[int, int], np.ndarray, np.ndarray]]:
    """Read channels of a deep part by bands of rows, from the top, so that a bad one ends it.

    Yields:
        (rows, W) of the band, numbers of pixels in it (N,), and values (N, channels) float32.
    """
    channels = [info.channel(name) for name in names]
    parts = {channel.part for channel in channels}
    if len(parts) != 1:
        raise JaxblurIOError(
            info.path, f"{', '.join(names)} are in several parts; deep channels must share one."
        )
    (part,) = parts
    if not info.parts[part].deep:
        raise JaxblurIOError(info.path, f"{', '.join(names)}: not deep; read it as a frame.")
    left, top, width, height = info.parts[part].data_window
    with open_input(info.path) as source:
        source.seek_subimage(part, 0)
        step = source.spec().tile_height or BAND
        for first in range(top, top + height, step):
            last = min(first + step, top + height)
            data = _read_rows(source, info, part, (left, left + width, first, last))
            counts = np.fromiter(map(data.samples, range(data.pixels)), np.int64, data.pixels)
            pixel = np.repeat(np.arange(data.pixels, dtype=np.int32), counts)
            sample = np.arange(len(pixel)) - np.repeat(np.cumsum(counts) - counts, counts)
            values = np.empty((len(pixel), len(names)), np.float32)
            for position, channel in enumerate(channels):
                at = itertools.repeat(channel.index)
                read = map(data.deep_value, pixel.data, at, sample.data)
                values[:, position] = np.fromiter(read, np.float32, len(pixel))
            for position, name in enumerate(names):
                bad = ~np.isfinite(values[:, position])
                if name == depth:
                    bad &= ~np.isposinf(values[:, position])
                if bad.any():
                    row, column = divmod(int(pixel[np.argmax(bad)]), width)
                    raise JaxblurIOError(
                        info.path,
                        f"{name}: deep samples are NaN or infinite (first at row "
                        f"{first - top + row}, column {column}); repair it.",
                    )
            yield (last - first, width), pixel, values


def _read_rows(source: Any, info: FileInfo, part: int, box: tuple[int, int, int, int]) -> Any:
    """The ``DeepData`` of some rows of a part."""
    left, right, first, last = box
    channels = len(info.parts[part].channels)
    try:
        if source.spec().tile_width:
            data = source.read_native_deep_tiles(
                part, 0, left, right, first, last, 0, 1, 0, channels
            )
        else:
            data = source.read_native_deep_scanlines(part, 0, first, last, 0, 0, channels)
    except (RuntimeError, ValueError, MemoryError) as error:
        raise JaxblurIOError(info.path, f"deep pixels cannot be read: {error}") from error
    if data is None:
        raise JaxblurIOError(
            info.path,
            "deep pixels: truncated or damaged, copy or render it again "
            f"({pending_message(source)}).",
        )
    return data
