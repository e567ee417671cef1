"""Pass L0 of `layered`: paths through five places, where neighbors tell two more than the frame.

The vectors of a frame lead from a point to its places one frame before and one frame after. A
motion that reverses within a few frames, such as that of a camera held by hand, is much faster at
the frame itself than an arc through three places says. Where a neighbor shows the point, its own
vectors lead one frame farther.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...frame import Frame
from ...kernels import At, Image, Outcome, each_pixel
from ...safe_math import safe_divide, safe_norm
from ...settings import Backend
from .arcs import Arc
from .paths import Vector

NEAR, RELATIVE = 0.5, 0.1
"""A neighbor shows a point if its vector leads back to it within so many pixels, or within this
share of the vector's length."""


class Images(NamedTuple):
    """Images that `path_of_pixel` reads.

    Attributes:
        path: (H, W, 4) displacement at opening and closing.
        before: (H, W, 4) likewise, of the frame before; None without one.
        after: (H, W, 4) likewise, of the frame after.
    """

    path: Image
    before: Image | None
    after: Image | None


def path_of_pixel(at: At, images: Images, half: Array, _: None) -> Outcome:
    """The path of a pixel, from the arc through three places and from where that errs at others.

    With t in frames, and e(-2), e(2) the displacements that the neighbors tell less those of the
    arc, the arc is changed by the smallest polynomial that leaves its three places,

        r(t) = t (t^2 - 1) (A + B t),   A = (e(2) - e(-2))/12,   B = (e(2) + e(-2))/24.

    An error that is unknown is taken to be 0. The change of an end is at most as long as its
    displacement.
    """
    ends = images.path.here()
    arc = Arc.through(ends, half)
    before, after = (
        _error(at, arc, neighbor, side, half)
        for side, neighbor in ((-1, images.before), (1, images.after))
    )
    cubic = [(late - early) / 12 for early, late in zip(before, after, strict=True)]
    quartic = [(late + early) / 24 for early, late in zip(before, after, strict=True)]
    changed = []
    for side, end in ((-1, ends[:2]), (1, ends[2:])):
        time = side * half
        scale = time * (jnp.square(time) - 1)
        change = [scale * (a + b * time) for a, b in zip(cubic, quartic, strict=True)]
        share = safe_divide(safe_norm(*end), safe_norm(*change))
        share = jnp.where(share < 1, share, 1)
        changed += [part + share * more for part, more in zip(end, change, strict=True)]
    moves = functools.reduce(jnp.logical_or, [part != 0 for part in ends])
    return Outcome(tuple(changed), where=moves, otherwise=ends)


def _error(at: At, arc: Arc, neighbor: Image | None, side: int, half: Array) -> Vector:
    """How far the arc errs two frames from now on one side; 0 where that is not known."""
    if neighbor is None:
        return jnp.zeros_like(arc.line[0]), jnp.zeros_like(arc.line[0])
    x, y = arc.at(side / half)
    height, width = jnp.asarray(neighbor.height), jnp.asarray(neighbor.width)
    # A displacement that is no number, or far too long, leads to no place that an integer holds.
    near = (jnp.abs(x) < width.astype(x.dtype)) & (jnp.abs(y) < height.astype(x.dtype))
    row = at.row + jnp.floor(jnp.where(near, y, 0) + 0.5).astype(jnp.int32)
    column = at.column + jnp.floor(jnp.where(near, x, 0) + 0.5).astype(jnp.int32)
    inside = near & (row >= 0) & (row < height) & (column >= 0) & (column < width)
    row, column = jnp.clip(row, 0, height - 1), jnp.clip(column, 0, width - 1)
    its_arc = Arc.through(neighbor.read_inside(row, column), half)
    previous_x, previous_y = its_arc.at(-1 / half)
    next_x, next_y = its_arc.at(1 / half)
    back = (previous_x, previous_y) if side > 0 else (next_x, next_y)
    miss = jnp.sqrt(jnp.square(back[0] + x) + jnp.square(back[1] + y))
    known = inside & (miss < NEAR + RELATIVE * jnp.sqrt(x * x + y * y))
    # The texel lies beside the point. Of its vectors the sum, which is how the motion changes, is
    # nearly that of the point.
    far_x, far_y = arc.at(2 * side / half)
    error_x = 2 * x + previous_x + next_x - far_x
    error_y = 2 * y + previous_y + next_y - far_y
    return jnp.where(known, error_x, 0), jnp.where(known, error_y, 0)


def through_five_places(
    frame: Frame, before: Frame | None, after: Frame | None, shutter: Array, backend: Backend
) -> Frame:
    """The frame with paths through five places, where its neighbors know them.

    Args:
        frame: with a path, or it is returned as it is.
        before: the frame before, or None; not used without a path.
        after: the frame after, likewise.
        shutter: exposure in frames.
        backend: see `jaxblur.Settings`.

    Returns:
        The frame with another path. Differentiable, with the texels of neighbors held.
    """
    near = [one if one is not None and one.path is not None else None for one in (before, after)]
    if frame.path is None or near == [None, None]:
        return frame
    height, width = frame.depth.shape
    half = jnp.asarray(shutter, frame.color.dtype) / 2
    others = (None if one is None else Image(_as_image(one)) for one in near)
    images = Images(Image(_as_image(frame)), *others)
    path = each_pixel(path_of_pixel, (height, width), images, half, backend=backend)
    return frame.replace(path=path.reshape(height, width, 2, 2))


def _as_image(frame: Frame) -> Float[Array, "height width 4"]:
    assert frame.path is not None
    return frame.path.reshape(*frame.depth.shape, 4)
