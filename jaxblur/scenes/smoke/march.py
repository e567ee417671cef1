"""Ray marching of smoke: a validity mask, then the rays that meet smoke [Navarro 2012, 2.3].

Samples lie on shells around the eye, in the middle of steps of equal length. A segment of length D
with extinction k and albedo w has the opacity ``a = 1 - exp(-k D)`` and adds, front to back,

    T a (w sum_n p(cos theta_n) L_n tau_n + (1 - w) L_e),   then   T <- T (1 - a)

with the light L_n of the constellation, its transmittance tau_n up to the sample, marched too, the
phase function p and the emission L_e. This is eq. 2.4 with eq. 2.1's emission, eq. 2.5 integrated
over the segment, and in the other order, so that a ray ends where nothing behind is seen.

Rays are marched in blocks of neighbors: a block takes as many steps as its longest ray, and only
the blocks that hold rays of the mask are marched.
"""

import dataclasses
from collections.abc import Callable
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .environment import Lights
from .volume import Volume, crossing, read

Lighting = Literal["none", "primary", "shadows"]

DARK = 1e-4
"""Transmittance at which a ray ends."""
BLOCK, MASK_BLOCK = 128, 1024
TILE = 8
"""Pixels across a tile: the rays of a block are neighbors."""


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
        lighting: ``shadows``: light reaches the smoke through the smoke; ``primary``: unattenuated;
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
    lighting: Lighting = "shadows"
    distance_map: bool = True
    validity_mask: bool = True

    def __post_init__(self):
        if len(self.cells) != 3 or min(self.cells) < 3:
            raise ValueError(f"`cells` must be three numbers of at least 3, got {self.cells}.")
        for name in ("step", "shadow_step"):
            if not getattr(self, name) > 0:
                raise ValueError(f"`{name}` must be above 0 cells, got {getattr(self, name)}.")
        if self.lighting not in ("none", "primary", "shadows"):
            raise ValueError(
                f"`lighting` must be 'none', 'primary' or 'shadows', got {self.lighting!r}."
            )


class Rays(NamedTuple):
    """Rays of an image, P pixels in row-major order.

    Attributes:
        eye: (3,) scene units.
        direction: (3, P) unit vectors in the world.
        near: (P,) distance along the ray at which it begins, scene units.
        far: (P,) distance at which it ends, at a surface or at the end of a layer.
    """

    eye: jax.Array
    direction: jax.Array
    near: jax.Array
    far: jax.Array


class Marched(NamedTuple):
    """What rays have met, P of them.

    Attributes:
        color: (3, P) light toward the eye, premultiplied, linear.
        transmittance: (P,) share of the light from behind that is let through.
        sums: (M, P) what `track` gives at the samples, weighted by what each of them hides of the
            rest; the weights add up to ``1 - transmittance``.
    """

    color: jax.Array
    transmittance: jax.Array
    sums: jax.Array


Track = Callable[[Float[Array, "3 rays"]], Float[Array, "values rays"]]
"""Values of points in the world."""


class Steps(NamedTuple):
    """The part of each ray that is marched, P of them.

    Attributes:
        first: (P,) int, the first step.
        last: (P,) int, the step after the last.
        near: (P,) distance at which the ray begins, scene units.
        far: (P,) distance at which it ends.
        direction: (3, P) unit vectors.
    """

    first: jax.Array
    last: jax.Array
    near: jax.Array
    far: jax.Array
    direction: jax.Array


def march(
    volume: Volume,
    medium: Medium,
    lights: Lights,
    rays: Rays,
    size: tuple[int, int],
    marching: Marching,
    track: Track | None = None,
) -> Marched:
    """March the rays of an image through a volume; to be called under jit.

    Args:
        volume: the voxels.
        medium: what they do with light.
        lights: the constellation.
        rays: one for each pixel.
        size: static (height, width) of the image.
        marching: static.
        track: values whose means are wanted, or None.

    Returns:
        Light, transmittance and sums of what was tracked.

    Source: Navarro 2012, sections 2.2.2 and 2.3, with the phase function of Henyey and Greenstein
    1941 in place of the isotropic one.
    """
    step = marching.step * volume.spacing[0]
    steps = steps_of(volume, rays, step)
    order, meeting = tile_order(size), jnp.int32(len(steps.first))
    if marching.validity_mask:
        first = first_with_smoke(volume, rays.eye, steps, step, order, marching)
        meets = first < steps.last
        steps = steps._replace(first=first)
        # The rays that meet smoke come first, still tile by tile.
        order = order[jnp.argsort(~meets[order], stable=True)]
        meeting = jnp.sum(meets)

    def block(part: Steps) -> Array:
        marched = _march_block(volume, medium, lights, rays.eye, part, step, marching, track)
        return jnp.concatenate([marched.color, marched.transmittance[None], marched.sums])

    empty = Marched(jnp.zeros(3), jnp.ones(1), jnp.zeros(_tracked(track)))
    found = _in_blocks(block, steps, order, meeting, BLOCK, jnp.concatenate(empty))
    return Marched(found[:3], found[3], found[4:])


def steps_of(volume: Volume, rays: Rays, step: Float[Array, ""]) -> Steps:
    """The steps of rays between the walls of the volume's box."""
    enter, leave = crossing(volume, rays.eye[:, None], rays.direction)
    near, far = jnp.maximum(rays.near, enter), jnp.minimum(rays.far, leave)
    far = jnp.maximum(far, near)
    first = jnp.floor(near / step).astype(jnp.int32)
    last = jnp.where(far > near, jnp.ceil(far / step).astype(jnp.int32), first)
    return Steps(first, last, near, far, rays.direction)


def first_with_smoke(
    volume: Volume,
    eye: Float[Array, " 3"],
    steps: Steps,
    step: Float[Array, ""],
    order: Int[Array, " rays"],
    marching: Marching,
) -> Int[Array, " rays"]:
    """The validity mask: the first step of each ray that meets smoke [section 2.3.2].

    The thesis marches back to front, and its first step is the farthest.

    Args:
        volume: the voxels.
        eye: (3,) scene units.
        steps: of the rays.
        step: () scene units.
        order: (P,) the rays, neighbors together.
        marching: static; its distance map serves here too.

    Returns:
        (P,) the step; ``steps.last`` where there is no smoke.
    """

    def block(part: Steps) -> Array:
        def searching(state: tuple[Array, Array]) -> Array:
            i, found = state
            return jnp.any((i < part.last) & ~found)

        def search(state: tuple[Array, Array]) -> tuple[Array, Array]:
            i, found = state
            value, gap = read(volume, eye[:, None] + (i + 0.5) * step * part.direction)
            found = found | ((value > 0) & (i < part.last))
            return jnp.where(found, i, i + _stride(gap, step, marching)), found

        start = part.first, jnp.zeros(part.first.shape, bool)
        i, found = jax.lax.while_loop(searching, search, start)
        return jnp.where(found, i, part.last)[None].astype(jnp.float32)

    count = jnp.int32(len(steps.first))
    found = _in_blocks(block, steps, order, count, MASK_BLOCK, jnp.zeros(1))
    return found[0].astype(jnp.int32)


def phase(cosine: Float[Array, "*n"], anisotropy: Float[Array, ""]) -> Float[Array, "*n"]:
    """The phase function of Henyey and Greenstein; its integral over the sphere is 1.

        p(c) = (1 - g^2) / (4 pi (1 + g^2 - 2 g c)^(3/2))

    Args:
        cosine: (...) of the angle between the directions before and after the scattering.
        anisotropy: () g.

    Returns:
        (...) per steradian.
    """
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
        value, gap = read(volume, origin + (i + 0.5) * step * direction)
        length = jnp.clip(leave - i * step, 0, step)
        passed = passed + jnp.where((i < count) & (passed < most), value * length, 0.0)
        return i + _stride(gap, step, marching), passed

    start = jnp.zeros(count.shape, jnp.int32), jnp.zeros(count.shape)
    _, passed = jax.lax.while_loop(going, go, start)
    return jnp.exp(-extinction * passed)


def _stride(gap: Array, step: Array, marching: Marching) -> Array:
    """Steps to the next sample: as many as the distance map shows to be empty, at least one."""
    if not marching.distance_map:
        return jnp.ones(gap.shape, jnp.int32)
    # Volumes without any smoke have infinite gaps.
    return jnp.clip(jnp.floor(gap / step), 1, 1 << 20).astype(jnp.int32)


def _march_block(
    volume: Volume,
    medium: Medium,
    lights: Lights,
    eye: Array,
    part: Steps,
    step: Array,
    marching: Marching,
    track: Track | None,
) -> Marched:
    """March the rays of a block until all have ended."""
    scattered = phase(lights.toward @ part.direction, medium.anisotropy)
    glow = ((1 - medium.albedo) * medium.emission)[:, None]

    def going(state: tuple[Array, Marched]) -> Array:
        i, met = state
        return jnp.any((i < part.last) & (met.transmittance > DARK))

    def go(state: tuple[Array, Marched]) -> tuple[Array, Marched]:
        i, met = state
        active = (i < part.last) & (met.transmittance > DARK)
        points = eye[:, None] + (i + 0.5) * step * part.direction
        value, gap = read(volume, points)
        begin = i * step
        length = jnp.minimum(begin + step, part.far) - jnp.maximum(begin, part.near)
        thickness = medium.extinction * value * jnp.maximum(length, 0)
        weight = jnp.where(active, -jnp.expm1(-thickness) * met.transmittance, 0.0)
        lit = active & (value > 0) if marching.distance_map else active
        if marching.lighting == "none":
            light = jnp.ones((3, 1))
        else:
            arriving = scattered
            if marching.lighting == "shadows":
                arriving = arriving * light_transmittance(
                    volume, points, lights.toward, medium.extinction, lit, marching
                )
            light = lights.power.T @ arriving
        color = met.color + weight * (medium.albedo[:, None] * light + glow)
        sums = met.sums if track is None else met.sums + weight * track(points)
        met = Marched(color, met.transmittance - weight, sums)
        return i + _stride(gap, step, marching), met

    count = part.first.shape[0]
    start = Marched(jnp.zeros((3, count)), jnp.ones(count), jnp.zeros((_tracked(track), count)))
    return jax.lax.while_loop(going, go, (part.first, start))[1]


def _tracked(track: Track | None) -> int:
    """Number of values that are tracked."""
    if track is None:
        return 0
    return jax.eval_shape(track, jax.ShapeDtypeStruct((3, 1), jnp.float32)).shape[0]


def _in_blocks(
    function: Callable[[Steps], Array],
    steps: Steps,
    order: Array,
    count: Array,
    width: int,
    empty: Array,
) -> Array:
    """Apply a function to the first `count` rays of an order, in blocks.

    Args:
        function: from the steps of `width` rays to (M, width) values.
        steps: of all rays.
        order: (P,) the rays.
        count: () how many of them are of interest.
        width: static, of a block.
        empty: (M,) values of the other rays.

    Returns:
        (M, P) values, by ray.
    """
    total = order.shape[0]
    padded = jnp.pad(order, (0, -total % width))

    def one(i: Array, found: Array) -> Array:
        chosen = jax.lax.dynamic_slice(padded, (i * width,), (width,))
        part = jax.tree.map(lambda values: values[..., chosen], steps)
        # The last block is filled up with rays that have no steps.
        inside = i * width + jnp.arange(width) < count
        part = part._replace(last=jnp.where(inside, part.last, part.first))
        return jax.lax.dynamic_update_slice(found, function(part), (0, i * width))

    start = jnp.broadcast_to(empty[:, None], (len(empty), len(padded)))
    found = jax.lax.fori_loop(0, (count + width - 1) // width, one, start)
    return jnp.zeros((len(empty), total)).at[:, order].set(found[:, :total])


def tile_order(size: tuple[int, int]) -> Int[Array, " pixels"]:
    """The pixels of an image in row-major order, rearranged tile by tile."""
    rows, columns = np.divmod(np.arange(size[0] * size[1]), size[1])
    keys = (columns % TILE, rows % TILE, columns // TILE, rows // TILE)
    return jnp.asarray(np.lexsort(keys), jnp.int32)
