"""Marching through the pixels of a scene's camera, from one planar depth to another."""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...frame import Frame
from .. import motion
from ..motion import Camera
from ..raster import rays
from ..scene import NEAR
from .environment import Lights
from .lighting import Marching, Medium, light_of_corners
from .march import Marched, Rays, Track, march
from .puff import Flow, moved
from .scene import SmokeScene
from .volume import Volume, smoke_at


class Lit(NamedTuple):
    """Smoke at one time.

    Attributes:
        volume: the voxels.
        light: at the corners of their cells, or None.
    """

    volume: Volume
    light: jax.Array | None


def lit_smoke(scene: SmokeScene, time: float, marching: Marching) -> Lit:
    """Bake the smoke of one time.

    Args:
        scene: the scene.
        time: frames.
        marching: its cells; light is found where it is ``cached``.

    Returns:
        Voxels and light.
    """
    moment = jnp.float32(time)
    volume = smoke_at(scene.puff, moment, marching.cells)
    if marching.lighting != "cached":
        return Lit(volume, None)
    _, eye = motion.transform(scene.camera.motion, moment)
    return Lit(volume, _light(volume, scene.medium, scene.lights, eye, marching))


_light = jax.jit(light_of_corners, static_argnames="marching")


Ends = tuple[float | Array, float | Array]
"""Planar depths between which smoke is marched: scene units, for all pixels or (P,)."""


def marched(
    scene: SmokeScene,
    lit: Lit,
    time: float,
    offset: np.ndarray,
    ends: Ends,
    size: tuple[int, int],
    marching: Marching,
) -> Marched:
    """March through all pixels.

    Args:
        scene: the scene.
        lit: its smoke at `time`.
        time: frames.
        offset: (2,) x and y of the rays from the pixel centers, pixels.
        ends: see `Ends`.
        size: (height, width).
        marching: how.

    Returns:
        Light and transmittance, by pixel in row-major order.
    """
    near, far = (
        jnp.broadcast_to(jnp.asarray(e, jnp.float32).ravel(), size[0] * size[1]) for e in ends
    )
    where = jnp.asarray(offset, jnp.float32)
    moment = jnp.float32(time)
    arguments = (lit, scene.medium, scene.lights, scene.camera, moment, where, near, far)
    return _march(*arguments, None, None, size, marching)


def tracked(
    scene: SmokeScene,
    lit: Lit,
    time: float,
    shutter: float,
    ends: Ends,
    size: tuple[int, int],
    marching: Marching,
) -> Marched:
    """March through pixel centers without light, for means of 1/depth and of the path.

    Args:
        scene: the scene.
        lit: its smoke at `time`.
        time: frames.
        shutter: exposure time in frames.
        ends: see `Ends`.
        size: (height, width).
        marching: how.

    Returns:
        Transmittance; sums of 1/depth, and of x and y at opening and at closing in pixels.
    """
    near, far = (
        jnp.broadcast_to(jnp.asarray(e, jnp.float32).ravel(), size[0] * size[1]) for e in ends
    )
    unlit = dataclasses.replace(marching, lighting="none")
    moment, times = jnp.float32(time), jnp.float32(time) + jnp.array([-0.5, 0.5]) * shutter
    arguments = (lit, scene.medium, scene.lights, scene.camera, moment, jnp.zeros(2), near, far)
    return _march(*arguments, scene.puff.flow, times, size, unlit)


@functools.partial(jax.jit, static_argnames=("size", "marching"))
def _march(
    lit: Lit,
    medium: Medium,
    lights: Lights,
    camera: Camera,
    time: Array,
    offset: Array,
    near: Array,
    far: Array,
    flow: Flow | None,
    times: Array | None,
    size: tuple[int, int],
    marching: Marching,
) -> Marched:
    """March between planar depths; with a flow, track 1/depth and displacements."""
    focal = camera.focal * size[1]
    rotation, eye = motion.transform(camera.motion, time)
    ray = rays(focal, offset, size)
    length = jnp.linalg.norm(ray, axis=0)
    world = Rays(eye, rotation @ ray / length, near * length, far * length)
    track = None if flow is None or times is None else tracker(flow, camera, time, times, size)
    return march(lit.volume, medium, lights, world, size, marching, light=lit.light, track=track)


def tracker(
    flow: Flow, camera: Camera, time: Array, times: Float[Array, " t"], size: tuple[int, int]
) -> Track:
    """What is tracked along a ray: 1/depth, and displacements in the image until other times.

    Args:
        flow: carries the smoke.
        camera: the camera.
        time: () frames, of the ray.
        times: (T,) frames.
        size: static (height, width) in pixels.

    Returns:
        A function from points (3, B) to values (1 + 2 T, B): x and y in pixels, time by time.
    """
    focal = camera.focal * size[1]

    def seen(points: Array, moment: Array) -> tuple[Array, Array]:
        rotation, eye = motion.transform(camera.motion, moment)
        x, y, depth = rotation.T @ (points - eye[:, None])
        depth = jnp.maximum(depth, NEAR)
        return focal * jnp.stack([x, y]) / depth, depth

    def track(points: Array) -> Array:
        place, depth = seen(points, time)

        def shift(moment: Array) -> Array:
            return seen(moved(flow, points.T, time, moment).T, moment)[0] - place

        shifts = jax.vmap(shift)(times)
        return jnp.concatenate([1 / depth[None], shifts.reshape(-1, points.shape[1])])

    return track


def as_image(values: Array, size: tuple[int, int]) -> Array:
    """From (C, P) to (H, W, C)."""
    return values.T.reshape(*size, -1)


def as_paths(values: Array, size: tuple[int, int]) -> Array:
    """From x and y at opening and closing (4, P) to (H, W, 2, 2)."""
    return values.T.reshape(*size, 2, 2)


def frame_of(color: Array, inverse_depth: Array, path: Array) -> Frame:
    """A frame whose velocity is that of its path."""
    return Frame(color, 1 / inverse_depth, (path[..., 1, :] - path[..., 0, :]) / 2, path)
