"""Where the taps of one pixel lie, by the functions of the filter itself: to draw them."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..frame import Frame
from ..noise import Noise, resolve_noise
from ..safe_math import safe_norm
from ..sampling import tap_position
from ..settings import GuertinSettings, Settings, checked_settings
from ..tiles import clamp_speed, sample_tiles, tile_variance
from ..weights import floored_speed
from .guertin2014 import GuertinParameters, prepare_frame
from .two_directions import follows_center, tile_choices, two_directions


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
    height, width = frame.depth.shape
    frame, parameters, speed, tiles = prepare_frame(frame, parameters, settings)
    noise = resolve_noise(noise, settings.noise, height, width)
    velocity, speed = clamp_speed(frame.velocity, settings.radius, speed)
    indices, chances = tile_choices((height, width), jnp.asarray(parameters.tau), settings, noise)
    dominant = tiles.reshape(-1, 2)[indices[:, row, column]]
    own = (velocity[row, column, 0], velocity[row, column, 1])
    inverse_speed = 1 / floored_speed(speed[row, column])
    along, center = jax.vmap(
        lambda vector: two_directions(own, inverse_speed, tuple(vector), parameters.gamma)
    )(dominant)
    share = None
    if settings.split == "variance":
        share = sample_tiles(tile_variance(tiles), settings.radius, height, width)[row, column]
    index = jnp.arange(settings.samples)
    second = follows_center(index, settings, share)
    jitter = noise.tap[row, column] * parameters.eta * parameters.phi / settings.samples
    position = tap_position(index, settings.samples, jitter)
    along, center = (jnp.stack(direction, axis=-1) for direction in (along, center))
    reach = safe_norm(dominant[:, 0], dominant[:, 1])
    direction = jnp.where(second[None, :, None], center[:, None], along[:, None])
    offset = (reach[:, None] * position)[..., None] * direction
    return Taps(offset, second, dominant, along, center, chances[:, row, column])
