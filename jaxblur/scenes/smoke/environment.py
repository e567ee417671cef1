"""HDR environments, and their reduction to lights by median cut [Debevec 2005].

A map is latitude by longitude: row 0 is overhead (+y), column 0 begins at longitude 0, which is +z;
longitude grows toward +x.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..scene import Light

LUMINANCE = (0.2126, 0.7152, 0.0722)
SUN_RADIUS = 0.08
"""Radians. The sun of a map must cover a few texels; its light does not depend on its size."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Lights:
    """A constellation of lights at infinity.

    Attributes:
        toward: (N, 3) unit vectors from the smoke to the lights.
        power: (N, 3) radiance times solid angle, linear light.
    """

    toward: jax.Array
    power: jax.Array


def directions(height: int) -> Float[np.ndarray, "height width 3"]:
    """Unit vectors through the texels of a map of `height` rows and twice as many columns."""
    colatitude = (np.arange(height) + 0.5) * np.pi / height
    longitude = (np.arange(2 * height) + 0.5) * np.pi / height
    level, up = np.sin(colatitude)[:, None], np.cos(colatitude)[:, None]
    return np.stack(
        [
            level * np.sin(longitude),
            np.broadcast_to(up, (height, 2 * height)),
            level * np.cos(longitude),
        ],
        axis=-1,
    )


def solid_angles(height: int, width: int) -> Float[np.ndarray, "height 1"]:
    """Steradians of a texel in each row; the sum over the map is 4 pi."""
    edges = np.cos(np.linspace(0, np.pi, height + 1))
    return ((edges[:-1] - edges[1:]) * 2 * np.pi / width)[:, None]


def environment_map(light: Light, height: int = 64) -> Float[np.ndarray, "height width 3"]:
    """Make an HDR map of a scene's light: the sky without clouds, ground, and the sun as a disc.

    The sun gives a surface that faces it the light `light.sun`, as in the scene: its irradiance is
    pi times that.

    Args:
        light: of a scene.
        height: rows; there are twice as many columns.

    Returns:
        (height, 2 height, 3) radiance, linear light.

    Raises:
        ValueError: there are fewer than 2 rows.
    """
    if height < 2:
        raise ValueError(f"`height` must be at least 2 rows, got {height}.")
    toward = directions(height)
    up = toward[..., 1:2]
    zenith, horizon, ground, sun = (
        np.asarray(color, float) for color in (light.zenith, light.horizon, light.ground, light.sun)
    )
    sky = horizon + (zenith - horizon) * np.sqrt(np.clip(up, 0, 1))
    radiance = np.where(up > 0, sky, ground)
    toward_sun = np.asarray(light.toward_sun, float)
    angle = np.arccos(np.clip(toward @ toward_sun, -1, 1))
    radius = max(SUN_RADIUS, np.pi / height)
    disc = np.clip((radius - angle) / (0.5 * radius), 0, 1)[..., None]
    covered = np.sum(disc * solid_angles(height, 2 * height)[..., None])
    return radiance + disc / covered * np.pi * sun


def median_cut(radiance: Float[np.ndarray, "height width 3"], lights: int = 16) -> Lights:
    """Reduce a map to lights of about equal energy.

    Regions are cut in two halves of equal energy, luminance times solid angle, along the longer of
    their sides: their width counts by the cosine of their latitude. Each of the final regions
    becomes a light with the sum of its radiance, at the centroid of its energy.

    Args:
        radiance: (H, W, 3) latitude by longitude, linear light, not negative.
        lights: a power of two.

    Returns:
        The lights; their power adds up to that of the map.

    Raises:
        ValueError: `lights` is not a power of two, or the map has too few texels, no light, or
            values that are negative or not finite.

    Source: Debevec 2005, "A median cut algorithm for light probe sampling".
    """
    if lights < 1 or lights & (lights - 1):
        raise ValueError(f"`lights` must be a power of two, got {lights}.")
    radiance = np.asarray(radiance, float)
    if radiance.ndim != 3 or radiance.shape[-1] != 3:
        raise ValueError(f"`radiance` must have shape (height, width, 3), got {radiance.shape}.")
    if not np.all(np.isfinite(radiance)) or radiance.min() < 0 or not radiance.max() > 0:
        raise ValueError("`radiance` must be finite, not negative and not all zero.")
    height, width, _ = radiance.shape
    power = radiance * solid_angles(height, width)[..., None]
    energy = power @ LUMINANCE
    regions = [(0, height, 0, width)]
    while len(regions) < lights:
        regions = [half for region in regions for half in _cut(energy, region)]
    colatitude = (np.arange(height) + 0.5) * np.pi / height
    longitude = (np.arange(width) + 0.5) * 2 * np.pi / width
    toward, powers = [], []
    for top, bottom, left, right in regions:
        part = energy[top:bottom, left:right]
        # A region without light has its center; its power is 0.
        part = part if part.sum() > 0 else np.ones_like(part)
        down = colatitude[top:bottom] @ part.sum(axis=1) / part.sum()
        around = part.sum(axis=0) @ longitude[left:right] / part.sum()
        level = np.sin(down)
        toward.append([level * np.sin(around), np.cos(down), level * np.cos(around)])
        powers.append(power[top:bottom, left:right].sum(axis=(0, 1)))
    return Lights(jnp.asarray(toward, jnp.float32), jnp.asarray(powers, jnp.float32))


Region = tuple[int, int, int, int]
"""First row, row after the last, first column, column after the last."""


def _cut(energy: np.ndarray, region: Region) -> tuple[Region, Region]:
    """Cut a region in two of equal energy."""
    top, bottom, left, right = region
    height, width = energy.shape
    middle = (top + bottom) / 2 / height * np.pi
    rows, columns = bottom - top, (right - left) * 2 * height / width * np.sin(middle)
    if right - left == 1 or (rows >= columns and rows > 1):
        if rows == 1:
            raise ValueError("`lights` must be fewer: a region of a single texel cannot be cut.")
        at = top + _half(energy[top:bottom, left:right].sum(axis=1))
        return (top, at, left, right), (at, bottom, left, right)
    at = left + _half(energy[top:bottom, left:right].sum(axis=0))
    return (top, bottom, left, at), (top, bottom, at, right)


def _half(energy: np.ndarray) -> int:
    """Where to cut a row of values, so that both sides have a part and their sums are closest."""
    before = np.cumsum(energy)[:-1]
    return 1 + int(np.argmin(np.abs(2 * before - energy.sum())))
