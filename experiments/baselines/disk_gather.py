"""Disk gather: every pixel looks at all pixels within the radius for those that pass it.

Pixel Y at a distance d from X passes X if X is on its line: ``|d . V(Y)| <= |V(Y)|^2`` and
``|d x V(Y)| <= |V(Y)| / 2``. It does so for ``a(Y) = 1 / (2 |V(Y)|)`` of the exposure. What
passes is added up in three groups, nearer than X, as deep as X, and farther, with ``A_n``, ``A_s``
and ``A_f`` the sums of a:

    n = min(A_n, 1),    s = min(A_s, 1 - n),    f = 1 - n - s if A_f > 0 else 0
    result = (n C_n + s C_s + f C_f) / (n + s + f),    C_g the mean color of a group

Source: McGuire et al. 2012, section 2.1 and figure 2 (e), "a conservative gathering
implementation"; the paper rejects it for its O(k^2 n) and does not say how it composites.

Departures: the three groups stand for the order of depth; they are soft, by the relative depth
of Guertin et al. 2014. The disk is a square, whose corners no velocity reaches.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

import jaxblur
from jaxblur.filters._weights import finite_depth, relative_closeness
from jaxblur.filters.tiles import dominant_velocity, own_tile
from jaxblur.kernels import At, Image, Outcome, each_pixel, sum_over
from jaxblur.safe_math import clamp_speed

SHARPNESS = 20.0
"""Depths that differ by a twentieth are nearer and farther."""


class Images(NamedTuple):
    """Images of the gather; the dominant velocity is one a tile."""

    color: Image
    velocity: Image
    depth: Image
    dominant: Image


class Group(NamedTuple):
    """Color and share of the exposure of what passes."""

    color: list
    share: jax.Array


def blur_pixel(at: At, images: Images, _: None, settings: jaxblur.Settings) -> Outcome:
    """Sums of what passes a pixel, composited."""
    radius, side = settings.radius, 2 * settings.radius + 1
    (depth,) = images.depth.here()
    dominant_x, dominant_y = images.dominant.read_inside(*own_tile(at, radius), 2)

    def pixel(i):
        row, column = at.row + i // side - radius, at.column + i % side - radius
        near_row = jnp.clip(row, 0, images.color.height - 1)
        near_column = jnp.clip(column, 0, images.color.width - 1)
        inside = (near_row == row) & (near_column == column)
        x, y = images.velocity.read_inside(near_row, near_column)
        right = (column - at.column).astype(x.dtype)
        down = (row - at.row).astype(x.dtype)
        squared = x**2 + y**2
        along, across = right * x + down * y, right * y - down * x
        moves = squared > 0.25
        on_line = (jnp.abs(along) <= squared) & (4 * across**2 <= squared)
        passes = inside & jnp.where(moves, on_line, (right == 0) & (down == 0))
        share = jnp.where(moves, 0.5 / jnp.sqrt(jnp.where(moves, squared, 1)), 1)
        share = jnp.where(passes, share, 0)
        (other,) = images.depth.read_inside(near_row, near_column)
        front, back = relative_closeness(other, depth, SHARPNESS)
        color = images.color.read_inside(near_row, near_column)
        weights = share * (1 - back), share * front * back, share * (1 - front)
        return tuple(Group([weight * value for value in color], weight) for weight in weights)

    near, level, far = sum_over(side**2, pixel)
    of_near = jnp.minimum(near.share, 1)
    of_level = jnp.minimum(level.share, 1 - of_near)
    of_far = jnp.where(far.share > 0, 1 - of_near - of_level, 0)
    groups = [(near, of_near), (level, of_level), (far, of_far)]
    factors = [part / jnp.maximum(group.share, 1e-6) for group, part in groups]
    total = jnp.maximum(of_near + of_level + of_far, 1e-6)
    colors = zip(near.color, level.color, far.color, strict=True)
    values = (sum(f * c for f, c in zip(factors, color, strict=True)) / total for color in colors)
    return Outcome(tuple(values), where=dominant_x**2 + dominant_y**2 > 0.25)


@functools.partial(jax.jit, static_argnames=("settings",))
@jaxblur.filters.honoring_mask
def disk_gather(
    frame: jaxblur.Frame,
    parameters: None = None,
    *,
    settings: jaxblur.Settings = jaxblur.Settings(),
    noise: jaxblur.Noise | None = None,
) -> jax.Array:
    """Blur a frame; samples, border, fetch and noise of the settings have no meaning here."""
    height, width = frame.depth.shape
    velocity, _ = clamp_speed(frame.velocity, settings.radius)
    # No pixel of a tile whose neighborhood is still can be passed: such tiles are skipped.
    dominant = dominant_velocity(frame.velocity, settings.radius, "all")
    images = Images(
        *(Image(frame.color), Image(velocity)),
        *(Image(finite_depth(frame.depth)), Image(dominant)),
    )
    return each_pixel(
        *(blur_pixel, (height, width), images, None, settings),
        kept=frame.color,
        backend=settings.backend,
    )


jaxblur.register(
    jaxblur.FilterInfo(
        name="disk_gather",
        summary="all pixels within the radius that pass [McGuire 2012, figure 2 e]",
        function=disk_gather,
    )
)
