"""The lens of `layered`: where on the aperture each map of owners and each sample lies.

Seen from the point (u, v) of the unit disc, a pixel is displaced by ``c (u, v)``, c being the
signed radius of its circle of confusion: what lies before the focus moves against what lies behind
it. So a path and a disc are one displacement for each time and point, and what covers a pixel is
found as it is for time alone.

The maps are seen from points that are spread evenly over the disc, in an order that does not
follow the time: points of one lattice would make stripes of what moves. Noise moves a sample about
the point of its map from pixel to pixel.

A color that is read between texels is blurred by the reading. This widens a disc, so that the
discs are narrower by as much.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array

from ...kernels import At, Image, Outcome, each_pixel
from ...safe_math import safe_norm
from ...settings import Fetch, Settings
from .clock import Maps
from .paths import Path, Vector

MOST_MAPS = 64
"""Largest number of maps, so that many samples need no more memory."""

CELL = 0.5
"""Side of the square over which the samples of a map lie, as a share of the root of the area that
its point stands for. Larger ones bring more noise than they hide bands."""

_VARIANCE = {"nearest": 1 / 12, "blend": 1 / 12, "bilinear": 1 / 6}
"""By how much reading a texel, or between texels, widens what is read; squared pixels a side."""


class Aperture(NamedTuple):
    """A lens as the programs need it.

    Attributes:
        infinity: radius of the disc of a point at infinity, pixels.
        focus: depth of the plane in focus, scene units.
        variance: of what reading a color adds to a disc, squared pixels.
    """

    infinity: Array
    focus: Array
    variance: Array

    def disc(self, log_depth: Array) -> Array:
        """The signed radius over which samples lie, pixels.

        It is that of the disc, ``c = c_inf (1 - F / z)``, less what reading adds. The variance of a
        disc is ``c^2 / 4`` a side, so that ``sqrt(c^2 - 4 variance)`` would keep it; this is nearly
        that, and smooth.
        """
        radius = self.infinity * (1 - self.focus * jnp.exp(-log_depth))
        squared = radius * radius
        return radius * squared / (squared + 2 * self.variance)

    @classmethod
    def of(cls, infinity: Array, focus: Array, fetch: Fetch) -> Aperture:
        """The aperture for a way to read colors."""
        return cls(infinity, focus, jnp.asarray(_VARIANCE[fetch], infinity.dtype))


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


def points_of(maps: Maps, dtype: DTypeLike) -> Array:
    """The points of the unit disc that the maps are seen from.

    Rings of equal area and sectors hold one point each. The Halton sequence says which of them
    follow one another.

    Args:
        maps: how many.
        dtype: of the result.

    Returns:
        (1, T, 2) points with mean zero: another mean would move what is out of focus.
    """
    from scipy.stats import qmc

    order = qmc.Halton(2, scramble=False).random(maps.total).argsort(axis=0).argsort(axis=0)
    area, turn = (order.T + 0.5) / maps.total
    points = np.sqrt(area) * np.stack([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)])
    points = points.T - points.mean(axis=1)
    points /= max(1.0, np.hypot(*points.T).max())
    return jnp.asarray(points, dtype)[None]


def point_in_cell(
    point: Vector, turn: Vector, number: Array, maps: Maps, jitter: Array | float
) -> Vector:
    """The point from which a sample is seen, in a square about that of its map.

    Noise moves it, by half a square more in every other sample.

    Args:
        point: of the map.
        turn: noise of the pixel, in [-1/2, 1/2).
        number: of the sample.
        maps: how many.
        jitter: share of `CELL` over which samples lie.

    Returns:
        A point of the disc, or slightly beyond its rim.
    """
    side = CELL * math.sqrt(math.pi / maps.total) * jitter

    def within(middle: Array, noise: Array) -> Array:
        shift = noise + number.astype(noise.dtype) / 2 + 0.5
        return middle + side * (shift - jnp.floor(shift) - 0.5)

    return within(point[0], turn[0]), within(point[1], turn[1])
