"""Velocity dilated along itself: each pixel draws its velocity on its line, the nearest one stays.

    W(q) = V(p) of the nearest p whose line p - V(p) .. p + V(p) passes q
    result(q) = 1/N sum_i C(q + t_i W(q))

Source: Sawada, CEDEC 2007 (Lost Planet), the third row of figure 5 of McGuire et al. 2012. Its
details are not published; McGuire et al. guess "opaque line segments with depth in a
low-resolution buffer" (section 1.1), which is what this file does.

Departures: the buffer has the resolution of the frame.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

import jaxblur
from jaxblur.kernels import At, Image, Outcome, largest_marks, mark_over
from jaxblur.safe_math import clamp_speed


class Images(NamedTuple):
    """Velocity, and the rank of each pixel by depth, the nearest largest."""

    velocity: Image
    rank: Image


def draw_segment(at: At, images: Images, _: None, __: None) -> Outcome:
    """Leave the pixel's rank at every pixel of its line, one step a pixel of the longer axis."""
    x, y = images.velocity.here()
    steps = jnp.ceil(jnp.maximum(jnp.abs(x), jnp.abs(y)))

    def mark(i):
        position = jnp.where(steps > 0, i / jnp.maximum(steps, 1) - 1, 0)
        row = at.row + jnp.round(position * y).astype(jnp.int32)
        column = at.column + jnp.round(position * x).astype(jnp.int32)
        near_row = jnp.clip(row, 0, images.rank.height - 1)
        near_column = jnp.clip(column, 0, images.rank.width - 1)
        counts = (near_row == row) & (near_column == column) & (i <= 2 * steps)
        (rank,) = images.rank.read_inside(at.row, at.column)
        return ((near_row * images.rank.width + near_column, jnp.where(counts, rank, 0)),)

    return Outcome(mark_over(2 * steps + 1, mark))


@functools.partial(jax.jit, static_argnames=("settings",))
@jaxblur.filters.honoring_mask
def velocity_segments(
    frame: jaxblur.Frame,
    parameters: None = None,
    *,
    settings: jaxblur.Settings = jaxblur.Settings(),
    noise: jaxblur.Noise | None = None,
) -> jax.Array:
    """Blur a frame along the velocity of the nearest thing that passes each pixel."""
    velocity, _ = clamp_speed(frame.velocity, settings.radius)
    height, width = frame.depth.shape
    far_to_near = jnp.argsort(-frame.depth.ravel())
    # Ranks start at 1, since 0 is no mark; the nearest pixel has the largest.
    ranks = jnp.arange(1, height * width + 1, dtype=jnp.int32)
    rank = jnp.zeros(height * width, jnp.int32).at[far_to_near].set(ranks)
    images = Images(Image(velocity), Image(rank.reshape(height, width)))
    marks = largest_marks(
        draw_segment, (height, width), images, height * width, backend=settings.backend
    )
    drawn = velocity.reshape(-1, 2)[far_to_near[marks - 1]].reshape(velocity.shape)
    dilated = frame.replace(velocity=drawn, path=None)
    return jaxblur.pixel_velocity(dilated, settings=settings, noise=noise)


jaxblur.register(
    jaxblur.FilterInfo(
        name="velocity_segments",
        summary="along the velocity of the nearest thing that passes [Sawada 2007]",
        function=velocity_segments,
    )
)
