"""A puff of smoke whose density at any time has a closed form: noise carried by a known flow.

The flow turns about a vertical axis and rises, both fastest at the axis:

    u(x) = drift + f(r) (spin e_y cross (x - c) + rise e_y),   f(r) = 1 / (1 + r^2 / core^2)

with the distance r from the axis, which itself drifts: ``c = center + drift t``. Turn and rise
depend on r alone and do not change it, so that the flow is free of divergence and its paths are
helices: where a point is at another time is exact, without integration.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

LATTICE = 32
OCTAVES = 4
BILLOW_CONTRAST = 3.0
SOFT_EDGE = 0.35
"""Over which part of the shape the density grows from 0 to 1."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Flow:
    """A turning and rising flow; see the module's first lines.

    Attributes:
        center: (3,) a point of the axis at time 0, scene units.
        drift: (3,) scene units per frame, of everything.
        spin: () radians per frame at the axis, about +y by the right-hand rule.
        rise: () scene units per frame at the axis.
        core: () distance from the axis at which both are halved, scene units.
    """

    center: jax.Array
    drift: jax.Array
    spin: jax.Array
    rise: jax.Array
    core: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Puff:
    """Smoke that the flow carries.

    Attributes:
        flow: the flow.
        radii: (3,) of the ellipsoid within which the smoke is before the flow winds it, scene
            units; noise takes parts of it away and adds nothing, so that it bounds the smoke.
        roughness: () how much noise takes away: 0 leaves a smooth ellipsoid.
        scale: () size of the largest billows, scene units.
        age: () frames for which the flow has wound the smoke at time 0.
        lattice: (L, L, L, 3) gradients of the noise, unit vectors, periodic.
    """

    flow: Flow
    radii: jax.Array
    roughness: jax.Array
    scale: jax.Array
    age: jax.Array
    lattice: jax.Array


def noise_lattice(seed: int) -> Float[np.ndarray, "l l l 3"]:
    """Random gradients of a periodic lattice, unit vectors."""
    vectors = np.random.default_rng(seed).normal(size=(LATTICE, LATTICE, LATTICE, 3))
    return (vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)).astype(np.float32)


def moved(
    flow: Flow, points: Float[Array, "... 3"], start: ArrayLike, end: ArrayLike
) -> Float[Array, "... 3"]:
    """Find where the flow carries points from one time to another; exact, in both directions.

    Args:
        flow: the flow.
        points: (..., 3) scene units, at time `start`.
        start: () frames.
        end: () frames, earlier or later.

    Returns:
        (..., 3) scene units.
    """
    x, y, z = jnp.moveaxis(points - flow.center - start * flow.drift, -1, 0)
    passed = jnp.subtract(end, start) / (1 + (x**2 + z**2) / flow.core**2)
    cosine, sine = jnp.cos(flow.spin * passed), jnp.sin(flow.spin * passed)
    turned = (cosine * x + sine * z, y + flow.rise * passed, cosine * z - sine * x)
    return jnp.stack(turned, axis=-1) + flow.center + end * flow.drift


def velocity(flow: Flow, points: Float[Array, "... 3"], time: ArrayLike) -> Float[Array, "... 3"]:
    """Velocity of the flow at points.

    Args:
        flow: the flow.
        points: (..., 3) scene units.
        time: () frames.

    Returns:
        (..., 3) scene units per frame.
    """
    x, _, z = jnp.moveaxis(points - flow.center - time * flow.drift, -1, 0)
    share = 1 / (1 + (x**2 + z**2) / flow.core**2)
    turn = (flow.spin * z, jnp.broadcast_to(flow.rise, x.shape), -flow.spin * x)
    return share[..., None] * jnp.stack(turn, axis=-1) + flow.drift


def density(puff: Puff, points: Float[Array, "... 3"], time: ArrayLike) -> Float[Array, "..."]:
    """Density of the smoke: that of the place from which the flow has brought it.

        d = smoothstep(clip((1 - |q / radii| - roughness n(q)) / soft edge))

    with q the point at time ``-age`` relative to the center of the puff then, and billowing
    noise n.

    Args:
        puff: the smoke.
        points: (..., 3) scene units.
        time: () frames.

    Returns:
        (...) 0 to 1; 0 outside of `bounds`.
    """
    flow, birth = puff.flow, -puff.age
    local = moved(flow, points, time, birth) - flow.center - birth * flow.drift
    inside = 1 - jnp.linalg.norm(local / puff.radii, axis=-1)
    level = inside - puff.roughness * _billows(puff.lattice, local / puff.scale)
    level = jnp.clip(level / SOFT_EDGE, 0, 1)
    return level**2 * (3 - 2 * level)


def bounds(puff: Puff, time: ArrayLike) -> tuple[Float[Array, " 3"], Float[Array, " 3"]]:
    """Find a box that holds all smoke.

    Args:
        puff: the smoke.
        time: () frames.

    Returns:
        Lowest and highest corner, (3,) scene units.
    """
    flow, radii = puff.flow, puff.radii
    wide = jnp.maximum(radii[0], radii[2])
    # The rise of the axis, and of the outermost smoke: everything else is in between.
    lift = flow.rise * (time + puff.age) / jnp.stack([1.0, 1 + (wide / flow.core) ** 2])
    low = jnp.stack([-wide, jnp.min(lift) - radii[1], -wide])
    high = jnp.stack([wide, jnp.max(lift) + radii[1], wide])
    middle = flow.center + time * flow.drift
    return middle + low, middle + high


def _billows(lattice: Array, points: Array) -> Array:
    """Sum of octaves of folded gradient noise [Perlin 1985], about 0 to 1."""
    total, weights = jnp.zeros(points.shape[:-1]), 0.0
    for octave in range(OCTAVES):
        weight = 0.55**octave
        # Octaves are shifted against each other: their lattice points must not coincide.
        noise = _gradient_noise(lattice, points * 2.03**octave + 5.3 * octave)
        total, weights = total + weight * jnp.abs(noise), weights + weight
    return jnp.clip(total / weights * BILLOW_CONTRAST, 0, 1)


def _gradient_noise(lattice: Array, points: Array) -> Array:
    """Zero at the lattice points, where it has the lattice's gradients; two derivatives."""
    cell = jnp.floor(points)
    rest = points - cell
    first = cell.astype(jnp.int32) % LATTICE
    pairs = [(first[..., axis], (first[..., axis] + 1) % LATTICE) for axis in range(3)]
    fade = rest**3 * (rest * (6 * rest - 15) + 10)
    total = jnp.zeros(points.shape[:-1])
    for corner in np.ndindex(2, 2, 2):
        gradient = lattice[tuple(pairs[axis][corner[axis]] for axis in range(3))]
        ramp = jnp.sum(gradient * (rest - jnp.array(corner)), axis=-1)
        for axis in range(3):
            ramp *= fade[..., axis] if corner[axis] else 1 - fade[..., axis]
        total += ramp
    return total
