"""Ray marching of smoke: a validity mask, then the rays that meet smoke [Navarro 2012, 2.3].

Samples lie on shells around the eye, in the middle of steps of equal length, of which only the part
within the volume and in front of bodies counts. A segment of length D
with extinction k and albedo w has the opacity ``a = 1 - exp(-k D)`` and adds, front to back,

    T a (w sum_n p(cos theta_n) L_n tau_n + (1 - w) L_e),   then   T <- T (1 - a)

with the light L_n of the constellation, its transmittance tau_n up to the sample, marched too, the
phase function p and the emission L_e. This is eq. 2.4 with eq. 2.1's emission, eq. 2.5 integrated
over the segment, and in the other order, so that a ray ends where nothing behind is seen.

Rays are marched in blocks of neighbors: a block takes as many steps as its longest ray, and only
the blocks that hold rays of the mask are marched.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .blocks import in_blocks, tile_order, wanted_first
from .environment import Lights
from .lighting import DARK, Marching, Medium, arriving_light, stride
from .volume import Volume, crossing, read, read_light

BLOCK, MASK_BLOCK = 128, 1024
"""Rays that are marched at once, and rays whose first step is searched at once."""


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

Source = Callable[[Array, Array, Array], Array]
"""Light by `.lighting.arriving_light`, of points, directions, and whether they are lit."""


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
    *,
    light: Float[Array, "x y z 24"] | None = None,
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
        light: at the corners of the cells, for ``cached`` lighting.
        track: values whose means are wanted, or None.

    Returns:
        Light, transmittance and sums of what was tracked.

    Source: Navarro 2012, sections 2.2.2 and 2.3, with the phase function of Henyey and Greenstein
    1941 in place of the isotropic one.
    """
    step = marching.step * volume.spacing[0]
    steps = steps_of(volume, rays, step)
    order, count = tile_order(size), jnp.int32(len(steps.first))
    if marching.validity_mask:
        first = first_with_smoke(volume, rays.eye, steps, step, order, marching)
        steps = steps._replace(first=first)
        order, count = wanted_first(order, first < steps.last)

    def source(points: Array, direction: Array, lit: Array) -> Array:
        if marching.lighting == "cached" and light is not None:
            return read_light(volume, light, points)
        return arriving_light(volume, medium, lights, points, direction, lit, marching)

    def block(part: Steps, inside: Array) -> Array:
        part = part._replace(last=jnp.where(inside, part.last, part.first))
        marched = _march_block(volume, medium, source, rays.eye, part, step, marching, track)
        return jnp.concatenate([marched.color, marched.transmittance[None], marched.sums])

    empty = Marched(jnp.zeros(3), jnp.ones(1), jnp.zeros(_tracked(track)))
    found = in_blocks(block, steps, order, count, BLOCK, jnp.concatenate(empty))
    return Marched(found[:3], found[3], found[4:])


def steps_of(volume: Volume, rays: Rays, step: Float[Array, ""]) -> Steps:
    """The steps of rays between the walls of the volume's box."""
    enter, leave = crossing(volume, rays.eye[:, None], rays.direction)
    near, far = jnp.maximum(rays.near, enter), jnp.minimum(rays.far, leave)
    far = jnp.maximum(far, near)
    first = jnp.floor(near / step).astype(jnp.int32)
    last = jnp.where(far > near, jnp.ceil(far / step).astype(jnp.int32), first)
    return Steps(first, last, near, far, rays.direction)


def segment(
    steps: Steps, i: Int[Array, " rays"], step: Float[Array, ""]
) -> tuple[Float[Array, " rays"], Float[Array, " rays"]]:
    """Middle and length of step i of each ray, as far as it lies between the ray's ends."""
    begin = jnp.maximum(i * step, steps.near)
    end = jnp.minimum((i + 1) * step, steps.far)
    return (begin + end) / 2, jnp.maximum(end - begin, 0)


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

    def block(part: Steps, inside: Array) -> Array:
        part = part._replace(last=jnp.where(inside, part.last, part.first))

        def searching(state: tuple[Array, Array]) -> Array:
            i, found = state
            return jnp.any((i < part.last) & ~found)

        def search(state: tuple[Array, Array]) -> tuple[Array, Array]:
            i, found = state
            middle, _ = segment(part, i, step)
            value, gap = read(volume, eye[:, None] + middle * part.direction)
            found = found | ((value > 0) & (i < part.last))
            return jnp.where(found, i, i + stride(gap, step, marching)), found

        start = part.first, jnp.zeros(part.first.shape, bool)
        i, found = jax.lax.while_loop(searching, search, start)
        return jnp.where(found, i, part.last)[None].astype(jnp.float32)

    count = jnp.int32(len(steps.first))
    found = in_blocks(block, steps, order, count, MASK_BLOCK, jnp.zeros(1))
    return found[0].astype(jnp.int32)


def _march_block(
    volume: Volume,
    medium: Medium,
    source: Source,
    eye: Array,
    part: Steps,
    step: Array,
    marching: Marching,
    track: Track | None,
) -> Marched:
    """March the rays of a block until all have ended."""

    def going(state: tuple[Array, Marched]) -> Array:
        i, met = state
        return jnp.any((i < part.last) & (met.transmittance > DARK))

    def go(state: tuple[Array, Marched]) -> tuple[Array, Marched]:
        i, met = state
        active = (i < part.last) & (met.transmittance > DARK)
        middle, length = segment(part, i, step)
        points = eye[:, None] + middle * part.direction
        value, gap = read(volume, points)
        thickness = medium.extinction * value * length
        weight = jnp.where(active, -jnp.expm1(-thickness) * met.transmittance, 0.0)
        lit = active & (value > 0) if marching.distance_map else active
        color = met.color + weight * source(points, part.direction, lit)
        sums = met.sums if track is None else met.sums + weight * track(points)
        met = Marched(color, met.transmittance - weight, sums)
        return i + stride(gap, step, marching), met

    count = part.first.shape[0]
    start = Marched(jnp.zeros((3, count)), jnp.ones(count), jnp.zeros((_tracked(track), count)))
    return jax.lax.while_loop(going, go, (part.first, start))[1]


def _tracked(track: Track | None) -> int:
    """Number of values that are tracked."""
    if track is None:
        return 0
    return jax.eval_shape(track, jax.ShapeDtypeStruct((3, 1), jnp.float32)).shape[0]
