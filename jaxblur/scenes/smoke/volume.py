"""Voxels of density with their distance map [Navarro 2012, section 2.3.1]."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .puff import Puff, bounds, density


class Volume(NamedTuple):
    """Density on a grid, interpolated linearly between the eight corners of a cell.

    Attributes:
        corners: (X, Y, Z, 8) density at the corners of each cell; corner 4 i + 2 j + k is the one
            at (i, j, k). Eight values that are read together lie together.
        gap: (X, Y, Z) no point of a cell is nearer than this to a cell with smoke, scene units.
        low: (3,) lowest corner of the first cell, scene units.
        spacing: (3,) edges of a cell, scene units.
    """

    corners: jax.Array
    gap: jax.Array
    low: jax.Array
    spacing: jax.Array

    @property
    def high(self) -> jax.Array:
        """(3,) highest corner of the last cell, scene units."""
        return self.low + jnp.array(self.gap.shape) * self.spacing


def volume_of(
    values: Float[Array, "x y z"], low: Float[Array, " 3"], spacing: Float[Array, " 3"]
) -> Volume:
    """Make a volume of density at grid points.

    Args:
        values: (X + 1, Y + 1, Z + 1) not negative.
        low: (3,) place of the first, scene units.
        spacing: (3,) between grid points, scene units.

    Returns:
        The volume, of (X, Y, Z) cells.
    """
    corners = corners_of(values)
    return Volume(corners, distance_map(jnp.any(corners > 0, axis=-1), spacing), low, spacing)


def corners_of(values: Float[Array, "a b c"]) -> Float[Array, "x y z 8"]:
    """Lay the values of grid points at the corners of each cell together; see `Volume`."""
    ends = (slice(None, -1), slice(1, None))
    return jnp.stack([values[a, b, c] for a in ends for b in ends for c in ends], axis=-1)


@functools.partial(jax.jit, static_argnames="cells")
def smoke_at(puff: Puff, time: Float[Array, ""], cells: tuple[int, int, int]) -> Volume:
    """Sample the density of a puff at one time.

    Args:
        puff: the smoke.
        time: () frames.
        cells: static number of cells along x, y and z.

    Returns:
        The volume, which bounds the smoke.
    """
    low, high = bounds(puff, time)
    spacing = (high - low) / jnp.array(cells)
    axes = [low[i] + spacing[i] * jnp.arange(cells[i] + 1) for i in range(3)]

    def plane(x: Array) -> Array:
        y, z = jnp.meshgrid(axes[1], axes[2], indexing="ij")
        return density(puff, jnp.stack([jnp.broadcast_to(x, y.shape), y, z], axis=-1), time)

    values = jax.lax.map(plane, axes[0])
    # Rounding must not leave smoke on the faces of the box, where rays would cut it.
    inner = jnp.zeros_like(values).at[1:-1, 1:-1, 1:-1].set(values[1:-1, 1:-1, 1:-1])
    return volume_of(inner, low, spacing)


def distance_map(occupied: Array, spacing: Float[Array, " 3"]) -> Float[Array, "x y z"]:
    """Distance from every cell to the nearest occupied one, between their nearest points.

        gap(c)^2 = min over occupied c' of sum_i (spacing_i max(|c_i - c'_i| - 1, 0))^2

    one axis after the other. No point of c is nearer to c' than that, wherever in c it is: a ray
    may go as far without meeting smoke.

    Args:
        occupied: (X, Y, Z) bool.
        spacing: (3,) edges of a cell, scene units.

    Returns:
        (X, Y, Z) scene units; infinite if no cell is occupied.
    """
    squared = jnp.where(occupied, 0.0, jnp.inf)
    for axis in range(3):
        index = jnp.arange(occupied.shape[axis])
        apart = jnp.maximum(jnp.abs(index[:, None] - index) - 1, 0) * spacing[axis]
        lines = jnp.moveaxis(squared, axis, -1)
        lines = jax.lax.map(
            lambda row, lines=lines, apart=apart: jnp.min(lines + row**2, axis=-1), apart
        )
        squared = jnp.moveaxis(lines, 0, axis)
    return jnp.sqrt(squared)


class Place(NamedTuple):
    """Where points are in a volume.

    Attributes:
        index: (...) int, of the cell.
        weights: for each axis the weights (...) of the lower and the upper corner.
        within: (...) bool, whether they are in the box at all.
    """

    index: jax.Array
    weights: list[tuple[jax.Array, jax.Array]]
    within: jax.Array


def read(
    volume: Volume, points: Float[Array, "3 ..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Read density and the distance to smoke at points.

    Args:
        volume: the voxels.
        points: (3, ...) scene units.

    Returns:
        Density (...), 0 outside of the volume, and the distance (...), scene units.
    """
    place = _locate(volume, points)
    value = _mixed(volume.corners.reshape(-1, 8)[place.index], place)
    return jnp.where(place.within, value, 0.0), volume.gap.reshape(-1)[place.index]


def read_light(
    volume: Volume, light: Float[Array, "x y z 24"], points: Float[Array, "3 ..."]
) -> Float[Array, "3 ..."]:
    """Read light that is given at the corners of the cells; see `.lighting.light_of_corners`."""
    place = _locate(volume, points)
    corners = light.reshape(-1, 24)[place.index]
    return jnp.stack([_mixed(corners[..., 8 * c : 8 * c + 8], place) for c in range(3)])


def _locate(volume: Volume, points: Array) -> Place:
    weights, index, within = [], jnp.int32(0), jnp.bool_(True)
    for axis, count in enumerate(volume.gap.shape):
        place = (points[axis] - volume.low[axis]) / volume.spacing[axis]
        cell = jnp.clip(jnp.floor(place), 0, count - 1)
        within = within & (place >= 0) & (place <= count)
        rest = jnp.clip(place - cell, 0, 1)
        weights.append((1 - rest, rest))
        index = index * count + cell.astype(jnp.int32)
    return Place(index, weights, within)


def _mixed(corners: Array, place: Place) -> Array:
    x, y, z = place.weights
    # Along one axis after the other; the first half of the corners are the lower ones.
    for low, high in (x, y, z):
        half = corners.shape[-1] // 2
        corners = low[..., None] * corners[..., :half] + high[..., None] * corners[..., half:]
    return corners[..., 0]


def crossing(
    volume: Volume, origin: Float[Array, "3 ..."], direction: Float[Array, "3 ..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Find where rays enter and leave the box of a volume, by its slabs.

    Args:
        volume: the voxels.
        origin: (3, ...) scene units.
        direction: (3, ...) unit vectors.

    Returns:
        Distances (...) of entry, at least 0, and of exit, scene units; a ray that misses the box
        leaves it before it enters.
    """
    enter, leave = jnp.float32(0), jnp.float32(jnp.inf)
    low, high = volume.low, volume.high
    for axis in range(3):
        along = direction[axis]
        safe = jnp.where(jnp.abs(along) < 1e-9, 1e-9, along)
        first = (low[axis] - origin[axis]) / safe
        second = (high[axis] - origin[axis]) / safe
        enter = jnp.maximum(enter, jnp.minimum(first, second))
        leave = jnp.minimum(leave, jnp.maximum(first, second))
    return enter, leave
