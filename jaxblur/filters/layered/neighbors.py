"""The frames before and after, as `layered` reads them: where their points are in the exposure."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from ...frame import Frame
from ...kernels import At, Image, Outcome, each_pixel, sum_over
from ...settings import Backend
from .._weights import finite_depth
from .arcs import Arc

_BLOCK_BITS = 3
_BLOCK = 2**_BLOCK_BITS
"""Pixels of a block over whose neighborhood light is compared."""
_ONE_SURFACE = 1.03
"""Depths of one surface differ by a smaller factor."""
_SAME_LIGHT, _OTHER_LIGHT = 0.05, 0.2
"""Relative differences of square roots of light up to which light is the same, and from which it is
another."""
_MOST = 0.85
"""What a neighbor counts in the same light, beside what the frame knows: the mean of two guesses
errs less than either."""
_FEWEST = 4
"""Points that both frames must show for a comparison."""
_UNKNOWN_LIGHT = 0.7
"""What counts where there are fewer."""
_DARK = 1e-3
"""Root of the light that counts as none."""
_AWAY = 1e5
"""Pixels that lead out of every picture."""


class Neighbor(NamedTuple):
    """A neighbor frame.

    Attributes:
        color: (H, W, C).
        motion: (H, W, 5) displacement of each pixel to its places at opening and at closing of
            the blurred frame's exposure, x and y of each, pixels; and its log depth.
        light: (ceil(H/8), ceil(W/8), 1) how far its light is that of the blurred frame, 0 to 1,
            see `light_of`.
    """

    color: Image
    motion: Image
    light: Image

    def light_at(self, row: Int[Array, ""], column: Int[Array, ""]) -> Array:
        """`light` of a pixel; of the nearest one outside the frame."""
        (light,) = self.light.read(row >> _BLOCK_BITS, column >> _BLOCK_BITS)
        return light


class Vectors(NamedTuple):
    """Images that `motion_of_pixel` reads.

    Attributes:
        motion: (H, W, 2) velocity, or (H, W, 4) displacement at opening and closing of the
            neighbor's own exposure.
        depth: (H, W, 1).
    """

    motion: Image
    depth: Image


def motion_of_pixel(
    at: At, images: Vectors, inputs: tuple[Sequence[Array], Array], _: None
) -> Outcome:
    """The displacement of a pixel at some times, in half exposures, and its log depth."""
    vectors = images.motion.here()
    (depth,) = images.depth.here()
    times, half = inputs
    arc = Arc.through(vectors, half)
    places = [part for time in times for part in arc.at(time)]
    log_depth = jnp.log(finite_depth(depth))
    rests = [jnp.zeros_like(place) for place in places]
    moves = functools.reduce(jnp.logical_or, [part != 0 for part in vectors])
    return Outcome((*places, log_depth), where=moves, otherwise=(*rests, log_depth))


class Both(NamedTuple):
    """Images that `common_light` reads.

    Attributes:
        here: (H, W, C) picture of the blurred frame.
        depth: (H, W, 1) of the blurred frame.
        valid: (H, W, 1) where the blurred frame has light, or None.
        there: (H, W, C) picture of the neighbor.
        vectors: of the neighbor.
        known: (H, W, 1) 0 where the picture of the neighbor is masked, or None.
    """

    here: Image
    depth: Image
    valid: Image | None
    there: Image
    vectors: Vectors
    known: Image | None


def common_light(at: At, images: Both, inputs: tuple[Array, Array], _: None) -> Outcome:
    """The number of a block's points that both frames show, and the roots of their light, summed.

    Args:
        at: the block.
        images: see `Both`.
        inputs: time of the blurred frame in half exposures, and half of the exposure in frames.
    """
    time, half = inputs
    height, width = jnp.asarray(images.here.height), jnp.asarray(images.here.width)

    def point(i: Int[Array, ""]) -> tuple[Array, ...]:
        own_row = at.row * _BLOCK + (i >> _BLOCK_BITS)
        own_column = at.column * _BLOCK + (i & (_BLOCK - 1))
        exists = (own_row < height) & (own_column < width)
        own_row, own_column = jnp.minimum(own_row, height - 1), jnp.minimum(own_column, width - 1)
        vectors = images.vectors.motion.read_inside(own_row, own_column)
        x, y = Arc.through(vectors, half).at(time)
        (own_depth,) = images.vectors.depth.read_inside(own_row, own_column)
        # The nearest texel, for a mean of two would differ from a texel.
        row = own_row + jnp.floor(y + 0.5).astype(jnp.int32)
        column = own_column + jnp.floor(x + 0.5).astype(jnp.int32)
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        row, column = jnp.clip(row, 0, height - 1), jnp.clip(column, 0, width - 1)
        (depth,) = images.depth.read_inside(row, column)
        depth, own_depth = finite_depth(depth), finite_depth(own_depth)
        farther = _ONE_SURFACE * jnp.minimum(depth, own_depth)
        both = exists & inside & (jnp.maximum(depth, own_depth) < farther)
        if images.valid is not None:
            (valid,) = images.valid.read_inside(row, column)
            both = both & (valid > 0)
        if images.known is not None:
            (known,) = images.known.read_inside(own_row, own_column)
            both = both & (known > 0)
        here = images.here.read_inside(row, column)
        there = images.there.read_inside(own_row, own_column)
        roots = [jnp.where(both, jnp.sqrt(jnp.maximum(light, 0)), 0) for light in (*here, *there)]
        return both.astype(x.dtype), *roots

    return Outcome(sum_over(_BLOCK * _BLOCK, point))


def neighbor_of(
    frame: Frame, frames: int, shutter: ArrayLike, blurred: Frame, backend: Backend
) -> Neighbor:
    """A neighbor, from the frame that it is.

    Args:
        frame: its motion is that of an exposure as long as the blurred frame's.
        frames: from it to the blurred frame, 1 or -1.
        shutter: exposure in frames.
        blurred: the frame that is blurred.
        backend: see `jaxblur.Settings`.

    Returns:
        The neighbor. Differentiable, with `light` held. Its masked pixels are found nowhere, since
        they move far away. Were the mask a channel of the color, they would hide what the other
        neighbor shows.
    """
    height, width = frame.depth.shape
    half = jnp.asarray(shutter, frame.color.dtype) / 2
    times = [(frames + side * half) / half for side in (-1, 1)]
    vectors = vectors_of(frame)
    inputs = (times, half)
    motion = each_pixel(motion_of_pixel, (height, width), vectors, inputs, None, backend=backend)
    if frame.valid is not None:
        motion = jnp.where(frame.valid[..., None] > 0, motion, _AWAY)
    light = light_of(blurred, frame, frames, half, backend)
    return Neighbor(Image(frame.color), Image(motion), Image(light))


def vectors_of(frame: Frame) -> Vectors:
    """The vectors of a frame, as images."""
    vectors = frame.velocity if frame.path is None else frame.path.reshape(*frame.depth.shape, 4)
    return Vectors(Image(vectors), Image(frame.depth))


def light_of(
    blurred: Frame, frame: Frame, frames: int, half: Array, backend: Backend
) -> Float[Array, "block_rows block_columns 1"]:
    """How far a neighbor shows its points in the light of the blurred frame.

        0.85 (0.2 - |A - B| / (A + B)) / 0.15,   clipped to 0..0.85

    with A and B the means, of the square roots of light, over those points of 24 x 24 pixels that
    both frames show. A shadow that has moved on makes them differ, texture does not: both means are
    over the same points. The channel that differs most counts.

    Args:
        blurred: the blurred frame.
        frame: the neighbor.
        frames: as `neighbor_of`.
        half: half of the exposure, in frames.
        backend: see `jaxblur.Settings`.

    Returns:
        (ceil(H/8), ceil(W/8), 1) for the blocks of the neighbor; 0.7 where both frames show hardly
        a point in common. It has no derivative.
    """
    blurred, frame = lax.stop_gradient((blurred, frame))
    pictures = [blurred.color, frame.color]
    if blurred.guide is not None and frame.guide is not None:
        pictures = [blurred.guide, frame.guide]
    here, there = map(Image, pictures)
    # A masked frame has the mask as the last channel of its color.
    valid = None if blurred.valid is None else Image(blurred.color[..., -1:])
    known = None if frame.valid is None else Image(frame.valid[..., None])
    images = Both(here, Image(blurred.depth), valid, there, vectors_of(frame), known)
    height, width = frame.depth.shape
    blocks, channels = (-(-height // _BLOCK), -(-width // _BLOCK)), here.channels
    lights = each_pixel(common_light, blocks, images, (frames / half, half), backend=backend)
    lights = lax.reduce_window(lights, 0.0, lax.add, (3, 3, 1), (1, 1, 1), "SAME")
    count = lights[..., :1]
    mine, other = lights[..., 1 : 1 + channels], lights[..., 1 + channels :]
    apart = jnp.abs(mine - other) / (mine + other + _DARK * count + 1e-9)
    most = apart.max(axis=-1, keepdims=True)
    light = _MOST * jnp.clip((_OTHER_LIGHT - most) / (_OTHER_LIGHT - _SAME_LIGHT), 0, 1)
    return lax.stop_gradient(jnp.where(count > _FEWEST, light, _UNKNOWN_LIGHT))
