"""Taps along a line: their positions, and how they are read."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .settings import Border, Fetch, Settings

_ONE_ELEMENT = lax.GatherDimensionNumbers(
    offset_dims=(), collapsed_slice_dims=(0,), start_index_map=(0,)
)

FEWEST = 5
"""Samples that even the shortest path takes."""


class Texels(NamedTuple):
    """Where a tap reads.

    Attributes:
        index: row-major index of the nearest texel, inside the image.
        counts: False where the tap has no weight (outside the image under ``skip``).
        column: of the nearest texel, possibly outside the image.
        row: of the nearest texel.
        across: how far the tap is to the right of its middle, in [-1/2, 1/2).
        down: how far it is below.
    """

    index: Int[Array, "*shape"]
    counts: Array
    column: Int[Array, "*shape"]
    row: Int[Array, "*shape"]
    across: Float[Array, "*shape"]
    down: Float[Array, "*shape"]


def path_samples(
    reach: Float[Array, "*shape"], settings: Settings
) -> dict[str, Float[Array, "*shape"]]:
    """How many samples a path takes: one every `spacing` pixels, but never more than `samples`.

    Args:
        reach: half the length of the path in pixels.
        settings: samples and spacing.

    Returns:
        Under "count" an odd number, at least `FEWEST` if there are so many samples; nothing where
        the spacing is 0 and every path takes all samples.
    """
    if settings.spacing == 0:
        return {}
    pairs = jnp.ceil(lax.stop_gradient(reach) / settings.spacing)
    wanted = jnp.maximum(2 * pairs + 1, FEWEST)
    return {"count": jnp.minimum(wanted, settings.samples)}


def sample_limit(settings: Settings) -> Callable[..., jax.Array] | None:
    """Where the samples end, for `jaxblur.native.Stages`."""
    return None if settings.spacing == 0 else _count


def _count(prepared: Mapping[str, Any]) -> jax.Array:
    """What `path_samples` prepared."""
    return prepared["count"]


def tap_position(
    sample: Int[Array, "*i"], count: int | Float[Array, "*c"], jitter: Float[Array, "*j"]
) -> Float[Array, "*k"]:
    """Position of a tap on the line, ``t = -1 + 2 (i + 1 + j) / (N + 1)``, in (-1, 1).

    Source: Guertin et al. 2014, Annexe I; McGuire et al. 2012, listing 1.

    Args:
        sample: i = 0 .. N - 1.
        count: N.
        jitter: j in sample spacings.

    Returns:
        Signed position; 1 is the end of the line.
    """
    # Symmetric about the middle to the bit, so that a reversed path has the same taps.
    spacing = 1 / (count + 1)
    return (2 * sample + 1 - count) * spacing + 2 * jitter * spacing


def read_position(
    offset_x: Float[Array, "*shape"],
    offset_y: Float[Array, "*shape"],
    size: tuple[int, int],
    border: Border,
) -> Texels:
    """The texel nearest to ``pixel + offset``: ``floor(p + offset + 1/2)`` per axis.

    The offset is rounded before the pixel index is added, which keeps all its digits on large
    frames, and makes what is read of a part of a frame the same as of the whole.

    Args:
        offset_x: (H, W, n) offset of the tap from its pixel, in pixels to the right.
        offset_y: (H, W, n) offset in pixels downward.
        size: (H, W) of the image.
        border: what happens outside the image, see `jaxblur.Settings`.

    Returns:
        Texels of shape (H, W, n).
    """
    height, width = size
    row = lax.broadcasted_iota(jnp.int32, (height, width, 1), 0)
    column = lax.broadcasted_iota(jnp.int32, (height, width, 1), 1)
    right, down = (jnp.floor(offset + 0.5).astype(jnp.int32) for offset in (offset_x, offset_y))
    x, y = column + right, row + down
    near_x, near_y = jnp.clip(x, 0, width - 1), jnp.clip(y, 0, height - 1)
    inside = (near_x == x) & (near_y == y)
    counts = inside if border == "skip" else jnp.ones_like(inside)
    return Texels(near_y * width + near_x, counts, x, y, offset_x - right, offset_y - down)


def _toward(share: jax.Array) -> tuple[Int[Array, "*shape"], jax.Array]:
    """On which side of a texel's middle a tap is, -1 or 1, and how far.

    In the middle the next texel is the one to the right or below, so that there is a derivative.
    """
    return jnp.where(share < 0, -1, 1), jnp.where(share < 0, -share, share)


def read_nearest(
    table: Float[Array, " texels"], index: Int[Array, "*shape"]
) -> Float[Array, "*shape"]:
    """Read a flat table at indices that are known to lie inside it.

    Args:
        table: (texels,) values.
        index: positions in it.

    Returns:
        Values of the index's shape.
    """
    return lax.gather(
        *(table, index[..., None], _ONE_ELEMENT, (1,)),
        mode=lax.GatherScatterMode.PROMISE_IN_BOUNDS,
    )


def read_row(
    table: Float[Array, " elements"],
    index: Int[Array, "*shape"],
    width: int,
    count: int | None = None,
) -> tuple[Float[Array, "*shape"], ...]:
    """Read rows of a flat table; neighbors in memory come in one piece from the cache.

    Args:
        table: (rows * width,) values, row by row.
        index: number of the row, known to lie inside.
        width: elements of a row.
        count: how many of them, the first ones, are wanted; all if None.

    Returns:
        One array for each element that is wanted, of the index's shape.
    """
    start, count = index * width, width if count is None else count
    return tuple(read_nearest(table, start + k if k else start) for k in range(count))


def channel(image: Float[Array, "height width channels"], k: int) -> Float[Array, "height width 1"]:
    """A channel of an image as a plane with a trailing sample axis.

    Args:
        image: (H, W, C).
        k: number of the channel.

    Returns:
        (H, W, 1).
    """
    return lax.slice_in_dim(image, k, k + 1, axis=2)


def read_color(
    table: Float[Array, " texels"], texels: Texels, size: tuple[int, int], fetch: Fetch
) -> tuple[Float[Array, "*shape"], ...]:
    """Read color at the taps.

    ``bilinear`` mixes the nearest texel and its neighbors on the side of the tap; beyond the border
    the edge texel continues. Differentiable in the color, and under ``bilinear`` in the position.

    Args:
        table: color, flat.
        texels: where to read.
        size: (H, W) of the image.
        fetch: ``nearest`` or ``bilinear``.

    Returns:
        One array a channel, of the texels' shape.
    """
    height, width = size
    channels = table.size // (height * width)
    if fetch == "nearest":
        return read_row(table, texels.index, channels)
    (right, across), (below, down) = _toward(texels.across), _toward(texels.down)
    columns = [jnp.clip(texels.column + k, 0, width - 1) for k in (0, right)]
    rows = [jnp.clip(texels.row + k, 0, height - 1) * width for k in (0, below)]
    corners = [read_row(table, row + column, channels) for row in rows for column in columns]

    def mix(a, b, c, d):
        upper, lower = a + across * (b - a), c + across * (d - c)
        return upper + down * (lower - upper)

    return tuple(mix(*values) for values in zip(*corners, strict=True))


def read_color_along(
    table: Float[Array, " texels"],
    texels: Texels,
    size: tuple[int, int],
    along_x: Bool[Array, "*pixels"],
) -> tuple[Float[Array, "*taps"], ...]:
    """Read color at the taps, mixed of two texels that are neighbors along one axis.

    Along a path it is as smooth as bilinear reading, for half of the reads; across, the nearest
    texel is taken. Differentiable in the color, and in the position along the axis.

    Args:
        table: color, flat.
        texels: where to read.
        size: (H, W) of the image.
        along_x: whether to mix neighbors in a row, rather than in a column.

    Returns:
        One array a channel, of the texels' shape.
    """
    height, width = size
    channels = table.size // (height * width)
    step, share = _toward(jnp.where(along_x, texels.across, texels.down))
    column = jnp.clip(texels.column + jnp.where(along_x, step, 0), 0, width - 1)
    row = jnp.clip(texels.row + jnp.where(along_x, 0, step), 0, height - 1)
    first = read_row(table, texels.index, channels)
    second = read_row(table, row * width + column, channels)
    return tuple(a + share * (b - a) for a, b in zip(first, second, strict=True))
