"""Where the taps of one pixel lie, by the functions of the filter itself: to draw them."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..frame import Frame
from ..kernels import At
from ..noise import Noise
from ..safe_math import safe_norm
from ..settings import GuertinSettings, Settings, checked_settings
from ._arguments import checked_inputs
from ._sampling import tap_position
from .guertin2014 import (
    GuertinParameters,
    Motion,
    Scalars,
    follows_center,
    prepare_images,
    read_tile,
    two_directions,
)
from .tiles import chances_of_tiles, read_between_tiles


class Taps(NamedTuple):
    """The taps of one pixel, for each tile that it may read (K of them; 1 unless ``expected``).

    Attributes:
        offset: (K, N, 2) from the pixel, in pixels, x right, y down; not rounded to texels.
        second: (N,) True for taps along the center direction.
        dominant: (K, 2) dominant velocity of the neighborhood, half-spread in pixels.
        along: (K, 2) unit vector of the dominant velocity; 0 where nothing moves.
        center: (K, 2) unit vector of the center direction.
        chance: (K,) of reading that tile; they sum to 1.
    """

    offset: Float[Array, "choices samples 2"]
    second: Bool[Array, " samples"]
    dominant: Float[Array, "choices 2"]
    along: Float[Array, "choices 2"]
    center: Float[Array, "choices 2"]
    chance: Float[Array, " choices"]


def taps_at(
    frame: Frame,
    parameters: GuertinParameters,
    row: int,
    column: int,
    *,
    settings: Settings = GuertinSettings(),
    noise: Noise | None = None,
) -> Taps:
    """Passes 1 to 7 of `guertin2014` for one pixel.

    Args:
        frame: as `guertin2014`.
        parameters: as `guertin2014`.
        row: of the pixel.
        column: of the pixel.
        settings: as `guertin2014`.
        noise: as `guertin2014`.

    Returns:
        Positions and directions of the taps.

    Raises:
        ValueError: the pixel lies outside the frame, or shapes disagree.
    """
    settings = checked_settings(settings, GuertinSettings, "guertin2014")
    height, width = frame.depth.shape
    if not (0 <= row < height and 0 <= column < width):
        raise ValueError(
            f"`row`, `column` must lie in a frame of {height} rows and {width} columns, got "
            f"{row}, {column}."
        )
    return _taps_at(frame, parameters, row, column, settings, noise)


@functools.partial(jax.jit, static_argnames=("settings",))
def _taps_at(
    frame: Frame,
    parameters: GuertinParameters,
    row: jax.Array,
    column: jax.Array,
    settings: GuertinSettings,
    noise: Noise | None,
) -> Taps:
    """Compiled once for all pixels of frames of one size."""
    frame, parameters = checked_inputs(frame, parameters, GuertinParameters)
    images = prepare_images(frame, settings, noise)
    at, count = At(row, column), settings.samples
    scalars = Scalars.of(parameters, settings)
    pixel = Motion(*images.motion.read_inside(row, column))
    jitter = jnp.zeros_like(pixel.x)
    if images.tap_noise is not None and images.tile_noise is not None:
        (tap_noise,) = images.tap_noise.read_inside(row, column)
        jitter = tap_noise * scalars.jitter
        images = images._replace(tile_noise=images.tile_noise.at(at))
    share = None
    if images.variance is not None:
        (share,) = read_between_tiles(at, images.variance, settings.radius)
    index = jnp.arange(count)
    second = follows_center(index, settings, share)
    choices: list[jax.Array | None] = [None]
    chances: tuple[jax.Array, ...] = (jnp.ones(()),)
    if settings.tile_choice == "expected":
        choices = [jnp.float32(k) for k in range(3)]
        chances = chances_of_tiles(at, scalars.tau, settings.radius, images.dominant)

    def of_choice(choice: jax.Array | None) -> tuple[jax.Array, ...]:
        tile = read_tile(at, images, scalars._replace(choice=choice), settings)
        dominant = images.dominant.read_inside(*tile)
        directions = two_directions(
            (pixel.x, pixel.y), pixel.inverse_speed, dominant, scalars.gamma
        )
        along, center = (jnp.stack(direction) for direction in directions)
        position = tap_position(index, count, jitter) * safe_norm(*dominant)
        offset = position[:, None] * jnp.where(second[:, None], center, along)
        return offset, jnp.stack(dominant), along, center

    found = zip(*map(of_choice, choices), strict=True)
    offset, dominant, along, center = (jnp.stack(parts) for parts in found)
    return Taps(offset, second, dominant, along, center, jnp.stack(chances))
