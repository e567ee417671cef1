"""The lens of `layered`: where on the aperture each map of owners and each sample lies.

Seen from the point (u, v) of the unit disc, a pixel is displaced by ``c (u, v)``, c being the
signed radius of its circle of confusion: what lies before the focus moves against what lies behind
it. So a path and a disc are one displacement for each time and point, and what covers a pixel is
found as it is for time alone.

The maps are seen from points that are spread evenly over the disc, in an order that does not
follow the time. Noise moves a sample within the cell of its map from pixel to pixel.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array

from ...kernels import At, Image, Outcome, each_pixel
from ...safe_math import safe_norm
from ...settings import Settings
from .clock import Maps
from .paths import Path, Vector

MOST_MAPS = 64
"""Largest number of maps, so that many samples need no more memory."""

GOLDEN = 1.32471795724474602596
"""The number whose powers make the R2 sequence [Roberts 2018]."""


class Aperture(NamedTuple):
    """A lens as the programs need it.

    Attributes:
        infinity: radius of the disc of a point at infinity, pixels.
        focus: depth of the plane in focus, scene units.
    """

    infinity: Array
    focus: Array

    def disc(self, log_depth: Array) -> Array:
        """The signed radius of a disc, ``c_inf (1 - F / z)``, pixels."""
        return self.infinity * (1 - self.focus * jnp.exp(-log_depth))


class Paths(NamedTuple):
    """The image that the program reads: (H, W, 5), see `.paths.Path`."""

    paths: Image


def disc_of_pixel(at: At, images: Paths, aperture: Aperture, settings: Settings) -> Outcome:
    """Pass L2 through a lens: the path, and a disc that leads it no farther than the radius."""
    path = Path(*images.paths.here())
    way = safe_norm(path.x, path.y) + safe_norm(path.bend_x, path.bend_y)
    left = jnp.maximum(settings.radius - way, 0)
    disc = jnp.clip(aperture.disc(path.log_depth), -left, left)
    return Outcome((*path[:5], disc))


def with_discs(paths: Array, aperture: Aperture, settings: Settings) -> Array:
    """The paths of all pixels with their discs.

    Args:
        paths: (H, W, 5), see `.paths.Path`.
        aperture: the lens.
        settings: radius and backend are used.

    Returns:
        (H, W, 6), see `.paths.Path`.
    """
    images = Paths(Image(paths))
    size = paths.shape[0], paths.shape[1]
    return each_pixel(disc_of_pixel, size, images, aperture, settings, backend=settings.backend)


def maps_through_lens(samples: int) -> Maps:
    """The maps of owners with a lens: one for each sample, or for each two, three and so on."""
    shared = -(-samples // MOST_MAPS)
    count = -(-samples // shared)
    return Maps(count, count)


def places_of(maps: Maps, dtype: DTypeLike) -> Array:
    """Where on the aperture the maps are seen from, on the square [-1, 1]^2 of `on_disc`.

    Args:
        maps: how many.
        dtype: of the result.

    Returns:
        (1, T, 2) points of the R2 sequence, with mean zero: another mean would move what is out of
        focus.
    """
    places = 2 * (np.outer(np.arange(maps.total), [1 / GOLDEN, 1 / GOLDEN**2]) % 1.0)
    return jnp.asarray(places - places.mean(axis=0), dtype)[None]


def place_in_cell(
    place: Vector, turn: Vector, number: Array, maps: Maps, jitter: Array | float | float
) -> Vector:
    """The place of a sample in the cell of its map, a square of side ``2 / sqrt(T)``.

    Noise moves it, by half a cell more in every other sample.

    Args:
        place: of the map.
        turn: noise of the pixel, in [-1/2, 1/2).
        number: of the sample.
        maps: how many.
        jitter: share of the cell over which samples lie.

    Returns:
        A place on the square, folded at its border.
    """
    side = 2 / math.sqrt(maps.total) * jitter

    def within(middle: Array, noise: Array) -> Array:
        shift = noise + number.astype(noise.dtype) / 2 + 0.5
        moved = middle + side * (shift - jnp.floor(shift) - 0.5)
        moved = jnp.where(moved > 1, 2 - moved, moved)
        return jnp.where(moved < -1, -2 - moved, moved)

    return within(place[0], turn[0]), within(place[1], turn[1])


def on_disc(place: Vector) -> Vector:
    """The concentric map of the square [-1, 1]^2 to the unit disc, which keeps areas.

    Source: Shirley and Chiu 1997.
    """
    across, down = place
    wide = jnp.abs(across) > jnp.abs(down)
    radius, other = jnp.where(wide, across, down), jnp.where(wide, down, across)
    angle = (math.pi / 4) * other / jnp.where(radius == 0, 1, radius)
    # Angles are within pi / 4, where these terms of the series are right to 4e-5; calls of sine and
    # cosine take half of the time of pass L5.
    squared = angle * angle
    aside = radius * angle * (1 - squared / 6 * (1 - squared / 20))
    along = radius * (1 - squared / 2 * (1 - squared / 12 * (1 - squared / 30)))
    return jnp.where(wide, along, aside), jnp.where(wide, aside, along)
