"""Light that reaches points in smoke: single scattering from lights at infinity."""

import dataclasses
from typing import Literal, get_args

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from .blocks import in_blocks, wanted_first
from .environment import Lights
from .volume import Volume, corners_of, crossing, read

Lighting = Literal["none", "primary", "shadows", "cached"]

DARK = 1e-4
"""Transmittance at which a ray ends."""
BLOCK = 256
"""Points whose light is found at once."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Medium:
    """What smoke does with light.

    Attributes:
        extinction: () per scene unit, where the density is 1.
        albedo: (3,) share of the extinction that is scattering, 0 to 1.
        emission: (3,) radiance that the rest emits, linear light.
        anisotropy: () g of Henyey and Greenstein, -1 to 1: above 0 scatters forward.
    """

    extinction: jax.Array
    albedo: jax.Array
    emission: jax.Array
    anisotropy: jax.Array


@dataclasses.dataclass(frozen=True, kw_only=True)
class Marching:
    """How rays are marched; static.

    Attributes:
        cells: number of cells along x, y and z of the volume.
        step: length of a step along a ray, in widths of a cell.
        shadow_step: likewise toward a light.
        lighting: ``shadows``: every sample marches toward every light. ``cached``: only the corners
            of cells with smoke do, and samples interpolate between them: many times faster, and
            nearly the same since shadows are soft. ``primary``: light arrives unattenuated.
            ``none``: every sample has the same light, plain alpha compositing.
        distance_map: whether steps skip what the distance map shows to be empty, and samples
            without smoke are not lit.
        validity_mask: whether rays that meet no smoke are found in a pass of their own, which also
            finds where the others begin.

    Raises:
        ValueError: a number is not positive, or the lighting is unknown.
    """

    cells: tuple[int, int, int] = (56, 56, 56)
    step: float = 0.75
    shadow_step: float = 2.0
    lighting: Lighting = "cached"
    distance_map: bool = True
    validity_mask: bool = True

    def __post_init__(self):
        if len(self.cells) != 3 or min(self.cells) < 3:
            raise ValueError(f"`cells` must be three numbers of at least 3, got {self.cells}.")
        for name in ("step", "shadow_step"):
            if not getattr(self, name) > 0:
                raise ValueError(f"`{name}` must be above 0 cells, got {getattr(self, name)}.")
        if self.lighting not in get_args(Lighting):
            names = ", ".join(map(repr, get_args(Lighting)))
            raise ValueError(f"`lighting` must be one of {names}, got {self.lighting!r}.")


def phase(cosine: ArrayLike, anisotropy: ArrayLike) -> Float[Array, "..."]:
    """The phase function of Henyey and Greenstein; its integral over the sphere is 1.

        p(c) = (1 - g^2) / (4 pi (1 + g^2 - 2 g c)^(3/2))

    Args:
        cosine: (...) of the angle between the directions before and after the scattering.
        anisotropy: () g.

    Returns:
        (...) per steradian.
    """
    cosine, anisotropy = jnp.asarray(cosine), jnp.asarray(anisotropy)
    base = 1 + anisotropy**2 - 2 * anisotropy * cosine
    return (1 - anisotropy**2) / (4 * jnp.pi * base**1.5)


def light_transmittance(
    volume: Volume,
    points: Float[Array, "3 points"],
    toward: Float[Array, "lights 3"],
    extinction: Float[Array, ""],
    lit: Bool[Array, " points"],
    marching: Marching,
) -> Float[Array, "lights points"]:
    """March from points toward lights: the share of their light that arrives.

    Args:
        volume: the voxels.
        points: (3, B) scene units.
        toward: (N, 3) unit vectors.
        extinction: () per scene unit.
        lit: (B,) the others are left out, with a transmittance of 1.
        marching: static.

    Returns:
        (N, B) 0 to 1. Below `DARK` it is not exact.
    """
    step = marching.shadow_step * volume.spacing[0]
    origin, direction = points[:, None, :], toward.T[:, :, None]
    _, leave = crossing(volume, origin, direction)
    count = jnp.where(lit, jnp.ceil(jnp.maximum(leave, 0) / step), 0).astype(jnp.int32)
    most = -jnp.log(DARK) / jnp.maximum(extinction, 1e-20)

    def going(state: tuple[Array, Array]) -> Array:
        i, passed = state
        return jnp.any((i < count) & (passed < most))

    def go(state: tuple[Array, Array]) -> tuple[Array, Array]:
        i, passed = state
        length = jnp.clip(leave - i * step, 0, step)
        value, gap = read(volume, origin + (i * step + length / 2) * direction)
        passed = passed + jnp.where((i < count) & (passed < most), value * length, 0.0)
        return i + stride(gap, step, marching), passed

    start = jnp.zeros(count.shape, jnp.int32), jnp.zeros(count.shape)
    _, passed = jax.lax.while_loop(going, go, start)
    return jnp.exp(-extinction * passed)


def arriving_light(
    volume: Volume,
    medium: Medium,
    lights: Lights,
    points: Float[Array, "3 points"],
    direction: Float[Array, "3 points"],
    lit: Bool[Array, " points"],
    marching: Marching,
) -> Float[Array, "3 points"]:
    """Light that points scatter toward the eye, and emit, per extinction.

        w sum_n p(cos theta_n) L_n tau_n + (1 - w) L_e

    Args:
        volume: the voxels.
        medium: albedo w and emission L_e.
        lights: the constellation L_n.
        points: (3, B) scene units.
        direction: (3, B) from the eye, unit vectors.
        lit: (B,) the points of interest; that of others may be wrong.
        marching: static.

    Returns:
        (3, B) radiance.
    """
    glow = ((1 - medium.albedo) * medium.emission)[:, None]
    if marching.lighting == "none":
        return medium.albedo[:, None] + glow
    arriving = phase(lights.toward @ direction, medium.anisotropy)
    if marching.lighting != "primary":
        arriving = arriving * light_transmittance(
            volume, points, lights.toward, medium.extinction, lit, marching
        )
    return medium.albedo[:, None] * (lights.power.T @ arriving) + glow


def light_of_corners(
    volume: Volume, medium: Medium, lights: Lights, eye: Float[Array, " 3"], marching: Marching
) -> Float[Array, "x y z 24"]:
    """The light of `arriving_light` at the corners of all cells that hold smoke.

    Args:
        volume: the voxels.
        medium: what they do with light.
        lights: the constellation.
        eye: (3,) from where the smoke is seen, scene units.
        marching: static.

    Returns:
        (X, Y, Z, 24) radiance: color by color, in each the corners as in `Volume.corners`. Not
        valid in cells without smoke.
    """
    counts = volume.gap.shape
    grid = [volume.low[a] + volume.spacing[a] * jnp.arange(counts[a] + 1) for a in range(3)]
    points = jnp.stack(jnp.meshgrid(*grid, indexing="ij")).reshape(3, -1)
    direction = points - eye[:, None]
    direction = direction / jnp.linalg.norm(direction, axis=0)
    occupied = jnp.pad(jnp.any(volume.corners > 0, axis=-1), 1)
    wanted = jax.lax.reduce_window(
        occupied, False, jnp.logical_or, (2, 2, 2), (1, 1, 1), "VALID"
    ).ravel()
    order, count = wanted_first(jnp.arange(points.shape[1]), wanted)

    def block(part: tuple[Array, Array], inside: Array) -> Array:
        return arriving_light(volume, medium, lights, *part, inside, marching)

    light = in_blocks(block, (points, direction), order, count, BLOCK, jnp.zeros(3))
    light = light.reshape(3, *(n + 1 for n in counts))
    return jnp.concatenate([corners_of(color) for color in light], axis=-1)


def stride(gap: Float[Array, "..."], step: Float[Array, ""], marching: Marching) -> Array:
    """Steps to the next sample: as many as the distance map shows to be empty, at least one.

    Args:
        gap: (...) distance to smoke, scene units.
        step: () scene units.
        marching: static; without its distance map, always one.

    Returns:
        (...) int.
    """
    if not marching.distance_map:
        return jnp.ones(gap.shape, jnp.int32)
    # Volumes without any smoke have infinite gaps.
    return jnp.clip(jnp.floor(gap / step), 1, 1 << 20).astype(jnp.int32)
