"""What `guertin2014` decides for a pixel before it reads a tap: the tile, and two directions."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..noise import Noise
from ..safe_math import safe_normalize
from ..settings import GuertinSettings
from ..tiles import own_tile, reachable_tiles, stochastic_tile
from ..weights import SPEED_FLOOR

Vector = tuple[Float[Array, "*a"], Float[Array, "*a"]]


def tile_choices(
    shape: tuple[int, int], tau: Float[Array, ""], settings: GuertinSettings, noise: Noise
) -> tuple[Int[Array, "choices height width"], Float[Array, "choices height width"]]:
    """The tiles that a pixel may read and their probabilities (pass 4).

    Args:
        shape: (height, width) of the image.
        tau: reach of the tile jitter, in tiles.
        settings: its tile choice and radius are used.
        noise: of the tiles.

    Returns:
        Flat indices of tiles and probabilities, (K, H, W); K is 3 for ``expected``, else 1.
    """
    if settings.tile_choice == "expected":
        return reachable_tiles(shape, settings.radius, tau)
    if settings.tile_choice == "stochastic":
        tile = stochastic_tile(noise.tile, tau, settings.radius)
    else:
        tile = own_tile(shape, settings.radius)
    return tile[None, ..., 0], jnp.ones((1, *shape), tau.dtype)


def two_directions(
    velocity: Vector,
    inverse_speed: Float[Array, "*a"],
    dominant: Vector,
    gamma: float | Float[Array, "*b"],
) -> tuple[Vector, Vector]:
    """The two unit directions (pass 6): along the dominant velocity, and the center direction.

    ``w_c = normalize((1 - a) w_p + a v / ||v||)``, ``a = clip((||v|| - 0.5) / gamma, 0, 1)``,
    w_p the perpendicular of the dominant direction on the side of v.

    Source: Guertin et al. 2014, eq. 3.1, with departure 2.

    Args:
        velocity: x and y of the pixel's own velocity, pixels.
        inverse_speed: reciprocal of its floored norm, 1 / pixels.
        dominant: x and y of the dominant velocity of the neighborhood, pixels.
        gamma: pixels of speed over which the center direction turns, > 0; a scalar, or a plane.

    Returns:
        x and y of both; 0 where nothing moves.
    """
    along_x, along_y = safe_normalize(*dominant)
    # Compared before normalizing: where v is the dominant velocity the two products are equal to
    # the bit, and the side does not hang on rounding.
    side = jnp.where(dominant[0] * velocity[1] < dominant[1] * velocity[0], -1, 1)
    # Below the floor the share is 0, so that a vector that is too short there does no harm.
    own_share = jnp.clip((1 / inverse_speed - SPEED_FLOOR) / gamma, 0, 1)
    own_x, own_y = (part * inverse_speed for part in velocity)
    center_x = own_share * own_x - (1 - own_share) * side * along_y
    center_y = own_share * own_y + (1 - own_share) * side * along_x
    # Two unit vectors on one side: their mix is no shorter than 0.7, or 0 where nothing moves.
    squared = jnp.square(center_x) + jnp.square(center_y)
    inverse = 1 / jnp.sqrt(jnp.where(squared == 0, 1, squared))
    return (along_x, along_y), (center_x * inverse, center_y * inverse)


def follows_center(
    index: Int[Array, "*a"], settings: GuertinSettings, share: Float[Array, "*b"] | None
) -> Bool[Array, "*c"]:
    """Whether a tap follows the center direction: every odd one, or a share of N, interleaved.

    Args:
        index: of the tap, from 0.
        settings: its directions and samples are used.
        share: of the taps, 0 to 1; every odd one if None.

    Returns:
        True for those that do.
    """
    if settings.directions == "one":
        return jnp.zeros_like(index, bool)
    if share is None:
        return lax.rem(index, jnp.asarray(2, index.dtype)) == 1
    taps = jnp.round(share * settings.samples)
    return jnp.floor((index + 1) * taps / settings.samples) > jnp.floor(
        index * taps / settings.samples
    )
