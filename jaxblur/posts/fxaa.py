"""Fast approximate antialiasing, FXAA 3.11, its quality path [Lottes 2009, 2011]."""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..frame import check_parameters, register_record
from ..kernels import At, Image, Outcome, each_pixel
from ..settings import Backend
from ._inputs import beside, checked_image, checked_plane
from .luma import perceived_luma

STEPS = {
    12: (1, 1.5, 2, 4, 12),
    29: (1, 1.5, 2, 2, 2, 2, 2, 2, 2, 2, 4, 8),
    39: (1, 1, 1, 1, 1, 1.5, 2, 2, 2, 2, 4, 8),
}
"""Steps of the search in pixels, by published preset. Nothing is read after the last one."""

EQUAL = 1e-4
"""Relative difference of second differences that counts as none."""


@register_record
@dataclasses.dataclass(frozen=True)
class FXAAParameters:
    """Parameters of FXAA, with the published defaults.

    Attributes:
        subpixel: how much single pixels are smoothed, 0 (not at all) to 1.
        threshold: least contrast of an edge, as a share of the brightest luma around the pixel.
        threshold_min: least contrast of an edge, in luma.
    """

    subpixel: float | jax.Array = 0.75
    threshold: float | jax.Array = 0.166
    threshold_min: float | jax.Array = 0.0833


class Edge(NamedTuple):
    """What the search finds at a pixel; all 0 where there is no edge.

    Attributes:
        down: rows to the neighbor on the other side of the edge: -1, 0 or 1.
        across: columns to it.
        share: of the neighbor in the pixel, 0 to 1/2, by the pixel's place along the edge.
    """

    down: Array
    across: Array
    share: Array


class Lumas(NamedTuple):
    """The image that the search reads: (H, W, 1) luma."""

    luma: Image


class Images(NamedTuple):
    """Images of the blend: (H, W, C) color, (H, W, 1) luma, (H, W, 3) `Edge`."""

    color: Image
    luma: Image
    edge: Image


class Neighborhood(NamedTuple):
    """Luma of a pixel and its eight neighbors."""

    center: Array
    north: Array
    south: Array
    west: Array
    east: Array
    north_west: Array
    north_east: Array
    south_west: Array
    south_east: Array

    @classmethod
    def read(cls, image: Image, at: At) -> "Neighborhood":
        """Read all nine."""
        cross = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
        corners = ((-1, -1), (-1, 1), (1, -1), (1, 1))
        return cls(*(beside(image, at, *place)[0] for place in cross + corners))

    def contrast(self) -> tuple[Array, Array]:
        """The largest luma of the pixel and its four neighbors, and the range."""
        largest = smallest = self.center
        for value in (self.north, self.south, self.west, self.east):
            largest, smallest = jnp.maximum(largest, value), jnp.minimum(smallest, value)
        return largest, largest - smallest


def find_edge(at: At, images: Lumas, parameters: FXAAParameters, quality: int) -> Outcome:
    """Pass 1: whether an edge passes the pixel, on which side, and where on it the pixel lies."""
    luma = Neighborhood.read(images.luma, at)
    largest, contrast = luma.contrast()
    is_edge = contrast >= jnp.maximum(parameters.threshold_min, largest * parameters.threshold)

    # Second differences along columns and rows: an edge is horizontal where the former are larger.
    along_columns = (
        jnp.abs(luma.north_west + luma.south_west - 2 * luma.west)
        + 2 * jnp.abs(luma.north + luma.south - 2 * luma.center)
        + jnp.abs(luma.north_east + luma.south_east - 2 * luma.east)
    )
    along_rows = (
        jnp.abs(luma.north_west + luma.north_east - 2 * luma.north)
        + 2 * jnp.abs(luma.west + luma.east - 2 * luma.center)
        + jnp.abs(luma.south_west + luma.south_east - 2 * luma.south)
    )
    # At many a pixel both are equal but for rounding, which may not decide.
    horizontal = along_columns >= (1 - EQUAL) * along_rows

    # The edge is on the side of the steeper step.
    before = jnp.where(horizontal, luma.north, luma.west)
    after = jnp.where(horizontal, luma.south, luma.east)
    steps = jnp.abs(before - luma.center), jnp.abs(after - luma.center)
    side = jnp.where(steps[0] >= steps[1], -1, 1)
    opposite = jnp.where(steps[0] >= steps[1], before, after)
    level = (opposite + luma.center) / 2
    enough = jnp.maximum(steps[0], steps[1]) / 4
    down, across = jnp.where(horizontal, side, 0), jnp.where(horizontal, 0, side)

    def on_edge(distance: Array, sign: int) -> Array:
        """Mean luma of both sides at a distance along the edge, linear between pixels."""
        whole = jnp.floor(distance).astype(jnp.int32)
        near, far = sign * whole, sign * (whole + 1)
        pairs = []
        for along in (near, far):
            row, column = jnp.where(horizontal, 0, along), jnp.where(horizontal, along, 0)
            own = beside(images.luma, at, row, column)[0]
            other = beside(images.luma, at, row + down, column + across)[0]
            pairs.append((own + other) / 2)
        return pairs[0] + (distance - whole.astype(distance.dtype)) * (pairs[1] - pairs[0])

    def advance(k: Array, state: tuple[Array, ...]) -> tuple[Array, ...]:
        """Go on in both directions, unless the end was seen there; read where that leads."""
        step = jnp.full_like(level, STEPS[quality][0])
        for number, size in enumerate(STEPS[quality][1:-1], 1):
            step = jnp.where(k == number, size, step)
        found = []
        for sign, distance, end in ((-1, *state[:2]), (1, *state[2:])):
            goes_on = jnp.abs(end) < enough
            distance = jnp.where(goes_on, distance + step, distance)
            found += [distance, jnp.where(goes_on, on_edge(distance, sign) - level, end)]
        return tuple(found)

    zero = 0 * level
    start = (zero, zero, zero, zero)
    first, first_end, second, second_end = lax.fori_loop(0, len(STEPS[quality]) - 1, advance, start)
    last = STEPS[quality][-1]
    first = jnp.where(jnp.abs(first_end) < enough, first + last, first)
    second = jnp.where(jnp.abs(second_end) < enough, second + last, second)

    # The pixel takes from the other side if, at the nearer end, the other side goes on.
    nearer, end = jnp.minimum(first, second), jnp.where(first < second, first_end, second_end)
    good = (end < 0) != (luma.center < level)
    length = jnp.maximum(first + second, 1)
    share = jnp.where(good, 0.5 - nearer / length, 0)
    edge = Edge(down.astype(share.dtype), across.astype(share.dtype), share)
    return Outcome(edge, where=is_edge, otherwise=Edge(zero, zero, zero))


def blend_pixel(at: At, images: Images, parameters: FXAAParameters, settings: None) -> Outcome:
    """Pass 2: mix the pixel and its neighbor on the other side of the edge."""
    edge = Edge(*images.edge.here())
    is_edge = jnp.abs(edge.down) + jnp.abs(edge.across) > 0
    luma = Neighborhood.read(images.luma, at)
    _, contrast = luma.contrast()

    # A pixel that differs from the mean of all around it, by its share of the contrast.
    cross = luma.north + luma.south + luma.west + luma.east
    corners = luma.north_west + luma.north_east + luma.south_west + luma.south_east
    differs = jnp.abs((2 * cross + corners) / 12 - luma.center)
    lone = jnp.minimum(differs / jnp.where(contrast > 0, contrast, 1), 1)
    smooth = lone * lone * (3 - 2 * lone)
    share = jnp.maximum(edge.share, smooth * smooth * parameters.subpixel)

    down, across = (part.astype(jnp.int32) for part in (edge.down, edge.across))
    own, other = images.color.here(), beside(images.color, at, down, across)
    mixed = (a + share * (b - a) for a, b in zip(own, other, strict=True))
    return Outcome(tuple(mixed), where=is_edge)


def fxaa(
    image: ArrayLike,
    hint: ArrayLike | None = None,
    parameters: FXAAParameters = FXAAParameters(),
    *,
    quality: int = 39,
    backend: Backend = "auto",
) -> Float[Array, "height width channels"]:
    """Smooth the stairs of edges, and lone pixels, by their luma.

    At a pixel whose contrast to its neighbors reaches the threshold, the edge is followed in both
    directions until the mean luma of its two sides changes by a quarter of its step. The pixel then
    takes the share ``1/2 - nearer / (first + second)`` of its neighbor across the edge, of the
    distances to both ends, or that of a lone pixel if larger.

    Source: Lottes, FXAA 3.11, quality path; steps of the search are those of presets 12, 29 and 39.
    Departures: luma is `perceived_luma`, so that linear light of any range may be given, and colors
    mix as linear light.

    Args:
        image: (H, W, C) linear light.
        hint: (H, W) linear luma to look for edges in, instead of that of the image, such as
            `jaxblur.luma_hint` [Guertin et al. 2014, 3.4.5].
        parameters: thresholds and strength.
        quality: preset of the search: 12 (up to 20.5 px), 29 (29.5 px) or 39 (26.5 px, whole
            pixels first).
        backend: see `jaxblur.Settings`.

    Returns:
        (H, W, C): every pixel a mix of itself and one neighbor. Differentiable in the image, the
        hint and ``subpixel``. Which pixels are edges, the side, and the distances to the ends are
        held constant, so that the derivative in the thresholds is 0.

    Raises:
        ValueError: a shape or the quality is wrong.
    """
    if quality not in STEPS:
        raise ValueError(f"`quality` must be one of {', '.join(map(str, STEPS))}, got {quality!r}.")
    check_parameters(parameters, FXAAParameters)
    color = checked_image(image)
    plane = None if hint is None else checked_plane(hint, color, "hint")
    return _fxaa(color, plane, parameters, quality=quality, backend=backend)


@functools.partial(jax.jit, static_argnames=("quality", "backend"))
def _fxaa(
    color: jax.Array,
    hint: jax.Array | None,
    parameters: FXAAParameters,
    quality: int,
    backend: Backend,
) -> jax.Array:
    size = color.shape[0], color.shape[1]
    parameters = jax.tree.map(lambda p: jnp.asarray(p, color.dtype), parameters)
    luma = perceived_luma(color if hint is None else hint)
    held, still = lax.stop_gradient((luma, parameters))
    edge = each_pixel(find_edge, size, Lumas(Image(held)), still, quality, backend=backend)
    images = Images(Image(color), Image(luma), Image(edge))
    return each_pixel(blend_pixel, size, images, parameters, kept=color, backend=backend)
