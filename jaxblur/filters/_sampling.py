"""Samples along a line: their positions, the texels that they read, and how color is read there.

Functions of scalars, for the programs of the filters; they work on arrays too.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..kernels import At, Image, nearest_place
from ..settings import Fetch, Settings

FEWEST = 5
"""Least number of samples of a path."""


class Texel(NamedTuple):
    """The texel that a sample reads.

    Attributes:
        number: row-major number of the nearest texel, inside the image.
        counts: False where the sample has no weight (outside the image under ``skip``).
        column: of the nearest texel, possibly outside the image.
        row: of the nearest texel.
        across: how far the sample is to the right of the texel's middle, in [-1/2, 1/2).
        down: how far it is below.
    """

    number: Int[Array, "*shape"]
    counts: Array
    column: Int[Array, "*shape"]
    row: Int[Array, "*shape"]
    across: Float[Array, "*shape"]
    down: Float[Array, "*shape"]


def path_samples(
    reach: Float[Array, "*shape"], settings: Settings
) -> Float[Array, "*shape"] | None:
    """The number of samples of a path: one every `spacing` pixels, at most `samples`.

    Args:
        reach: half the length of the path in pixels.
        settings: samples and spacing.

    Returns:
        An odd number, at least `FEWEST` if there are so many samples; None where the spacing is 0
        and every path takes all samples.
    """
    if settings.spacing == 0:
        return None
    pairs = jnp.ceil(lax.stop_gradient(reach) / settings.spacing)
    wanted = jnp.maximum(2 * pairs + 1, FEWEST)
    return jnp.minimum(wanted, settings.samples)


def tap_position(
    sample: Int[Array, "*i"], count: int | Float[Array, "*c"], jitter: Float[Array, "*j"]
) -> Float[Array, "*k"]:
    """Position of a sample on the line, ``t = -1 + 2 (i + 1 + j) / (N + 1)``, in (-1, 1).

    Source: Guertin et al. 2014, Annexe I; McGuire et al. 2012, listing 1.

    Args:
        sample: i = 0 .. N - 1.
        count: N.
        jitter: j in sample spacings.

    Returns:
        Signed position; 1 is the end of the line.
    """
    # Symmetric about the middle to the bit, so that a reversed path has the same samples.
    spacing = 1 / (count + 1)
    return (2 * sample + 1 - count) * spacing + 2 * jitter * spacing


def find_texel(
    at: At,
    offset_x: Float[Array, "*shape"],
    offset_y: Float[Array, "*shape"],
    image: Image,
    settings: Settings | None = None,
    *,
    held: bool = False,
) -> Texel:
    """The texel nearest to ``pixel + offset``: ``floor(p + offset + 1/2)`` per axis.

    The offset is rounded before the pixel's place is added, which keeps all its digits on large
    frames, and makes the reads of a part of a frame the same as those of the whole.

    Args:
        at: the pixel.
        offset_x: from the pixel, in pixels to the right.
        offset_y: in pixels downward.
        image: its size counts; all images of this size have the same texel.
        settings: border and fetch count; the edge texel and the nearest one if None.
        held: whether what is read there has no derivative in the offset.

    Returns:
        The texel.
    """
    if held:
        right, down = (jnp.floor(part + 0.5).astype(jnp.int32) for part in (offset_x, offset_y))
    else:
        blends = settings is not None and settings.fetch == "blend"
        right, down = nearest_place(offset_x, offset_y, blends)
    x, y = at.column + right, at.row + down
    near_x, near_y = jnp.clip(x, 0, image.width - 1), jnp.clip(y, 0, image.height - 1)
    inside = (near_x == x) & (near_y == y)
    skips = settings is not None and settings.border == "skip"
    counts = inside if skips else jnp.ones_like(inside)
    index = near_y * image.width + near_x
    return Texel(index, counts, x, y, offset_x - right, offset_y - down)


def _toward(share: Array) -> tuple[Int[Array, "*shape"], Array]:
    """The side of a texel's middle on which a sample is, -1 or 1, and how far.

    In the middle it is the right or lower one, so that there is a derivative.
    """
    return jnp.where(share < 0, -1, 1), jnp.where(share < 0, -share, share)


def read_color(image: Image, texel: Texel, fetch: Fetch) -> tuple[Float[Array, "*shape"], ...]:
    """Read color at a sample.

    ``bilinear`` mixes the nearest texel and its neighbors on the side of the sample; beyond the
    border the edge texel continues. Differentiable in the color, and under ``bilinear`` in the
    position.

    Args:
        image: color.
        texel: where to read.
        fetch: see `jaxblur.Settings`; under ``blend`` too a texel is read alone.

    Returns:
        One value a channel.
    """
    if fetch != "bilinear":
        return image.read_texel(texel.number)
    (right, across), (below, down) = _toward(texel.across), _toward(texel.down)
    columns = [jnp.clip(texel.column + k, 0, image.width - 1) for k in (0, right)]
    rows = [jnp.clip(texel.row + k, 0, image.height - 1) * image.width for k in (0, below)]
    corners = [image.read_texel(row + column) for row in rows for column in columns]

    def mix(a: Array, b: Array, c: Array, d: Array) -> Array:
        upper, lower = a + across * (b - a), c + across * (d - c)
        return upper + down * (lower - upper)

    return tuple(mix(*values) for values in zip(*corners, strict=True))


def read_color_along(
    image: Image, texel: Texel, along_x: Bool[Array, "*pixels"]
) -> tuple[Float[Array, "*shape"], ...]:
    """Read color at a sample, mixed of two texels that are neighbors along one axis.

    Along a path this is as smooth as bilinear reading, for half of the reads; across the path the
    nearest texel is taken. Differentiable in the color, and in the position along the axis.

    Args:
        image: color.
        texel: where to read.
        along_x: whether to mix neighbors in a row, rather than in a column.

    Returns:
        One value a channel.
    """
    step, share = _toward(jnp.where(along_x, texel.across, texel.down))
    column = jnp.clip(texel.column + jnp.where(along_x, step, 0), 0, image.width - 1)
    row = jnp.clip(texel.row + jnp.where(along_x, 0, step), 0, image.height - 1)
    first = image.read_texel(texel.number)
    second = image.read_inside(row, column)
    return tuple(a + share * (b - a) for a, b in zip(first, second, strict=True))
