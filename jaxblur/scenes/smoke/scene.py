"""Frames, layers and truth of smoke with bodies before, in and behind it."""

import dataclasses
import functools
import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...frame import Frame
from .. import motion, rendering
from ..exposure import subpixel_offsets
from ..motion import Camera
from ..raster import rays
from ..scene import NEAR, Scene
from ..shutter import ShutterFunction, exposure_center, exposure_positions, shutter_curve
from .bodies import Bodies, bodies
from .environment import Lights
from .lighting import Marching, Medium, light_of_corners
from .march import Marched, Rays, Track, march
from .puff import Flow, Puff, moved
from .volume import Volume, smoke_at


@dataclasses.dataclass(frozen=True)
class SmokeScene:
    """Smoke, a thing in the midst of it, and what is around both.

    Bodies neither shade the smoke nor are shaded by it, as they cast no shadows on each other. A
    body that passes through does not stir the smoke.

    Attributes:
        name: name of the scene.
        puff: the smoke.
        medium: what it does with light.
        lights: what lights it.
        surroundings: bodies behind the smoke, with the camera.
        thing: bodies that the smoke surrounds, with the same camera and light; or None. The origin
            of the first one is where smoke is divided into that in front of it and that behind.
    """

    name: str
    puff: Puff
    medium: Medium
    lights: Lights
    surroundings: Scene
    thing: Scene | None = None

    @property
    def camera(self) -> Camera:
        """The camera."""
        return self.surroundings.world.camera


class SmokeLayers(NamedTuple):
    """A picture in layers: premultiplied RGBA frames, with paths.

    Attributes:
        before: smoke in front of the thing, the front one first.
        thing: the thing, or None.
        behind: smoke behind the thing, the front one first.
        surroundings: opaque.
    """

    before: tuple[Frame, ...]
    thing: Frame | None
    behind: tuple[Frame, ...]
    surroundings: Frame

    @property
    def frames(self) -> list[Frame]:
        """All layers from the front to the back, as `jaxblur.blur_layers` takes them."""
        thing = [] if self.thing is None else [self.thing]
        return [*self.before, *thing, *self.behind, self.surroundings]


def accumulate_smoke(
    scene: SmokeScene,
    time: float = 0.0,
    shutter: float = 0.5,
    samples: int = 64,
    size: tuple[int, int] = (180, 320),
    shutter_function: ShutterFunction = "box",
    *,
    placement: str = "centered",
    marching: Marching = Marching(),
) -> Float[Array, "height width 3"]:
    """Render the true motion-blurred image of smoke and bodies.

    The mean of `samples` sharp images, each with the smoke and the bodies of its own time: the
    smoke is marched as far as the bodies that are in it then. Times and rays are those of
    `jaxblur.scenes.accumulate`.

    Args:
        scene: scene to render.
        time: frames.
        shutter: exposure time in frames; 0 gives the sharp image.
        samples: number of sharp images.
        size: (height, width) in pixels.
        shutter_function: see `jaxblur.scenes.accumulate`.
        placement: likewise.
        marching: how the rays are marched.

    Returns:
        (H, W, 3) linear light, float32.

    Raises:
        ValueError: an argument is out of range.
    """
    rendering.check_exposure(shutter, size)
    _check_samples("samples", samples)
    center = exposure_center(time, shutter, placement)
    times = center + shutter * exposure_positions(shutter_curve(shutter_function), samples)
    return _mean_image(scene, times, size, marching)


def render_smoke(
    scene: SmokeScene,
    time: float = 0.0,
    shutter: float = 0.5,
    size: tuple[int, int] = (180, 320),
    *,
    subpixels: int = rendering.SUBPIXELS,
    marching: Marching = Marching(),
) -> Frame:
    """Render a sharp, flat frame, with one depth and one motion for each pixel.

    Where smoke and a surface are seen in one pixel, motion is the mean of theirs, weighted by what
    each contributes to the coverage; depth likewise the mean in 1/depth, so that sky counts as 0.

    Args:
        scene: scene to render.
        time: frames; the center of the exposure.
        shutter: exposure time in frames.
        size: (height, width) in pixels.
        subpixels: number of positions within a pixel for color.
        marching: how the rays are marched.

    Returns:
        Color (H, W, 3), depth (H, W), velocity (H, W, 2) half-spread in pixels and path
        (H, W, 2, 2) in pixels; float32.

    Raises:
        ValueError: an argument is out of range.
    """
    rendering.check_exposure(shutter, size)
    _check_samples("subpixels", subpixels)
    color = _mean_image(scene, np.full(subpixels, time), size, marching)
    surface = rendering.render(scene.surroundings, time, shutter, size, path=True, subpixels=1)
    if scene.thing is not None:
        thing = rendering.render(scene.thing, time, shutter, size, path=True, subpixels=1)
        surface = _nearer(thing, surface)
    lit = _lit(scene, time, marching)
    met = _tracked(scene, lit, time, shutter, (0.0, surface.depth), size, marching)
    through = met.transmittance.reshape(size)
    assert surface.path is not None
    inverse = met.sums[0].reshape(size) + through / surface.depth
    path = _paths(met.sums[1:], size) + through[..., None, None] * surface.path
    return _frame(color, inverse, path)


def smoke_layers(
    scene: SmokeScene,
    time: float = 0.0,
    shutter: float = 0.5,
    size: tuple[int, int] = (180, 320),
    *,
    layers: int = 2,
    subpixels: int = rendering.SUBPIXELS,
    marching: Marching = Marching(),
) -> SmokeLayers:
    """Render a sharp frame in layers of emission and transmittance, each with its own motion.

    Smoke is divided by planes at right angles to the view: one through the thing, others so that
    each layer in front of it has the same mass, and each layer behind it too. A layer is rendered
    as if nothing hid it. A single layer ends at the thing, since it has to be in front of it: what
    it would show behind is not known.

    Args:
        scene: scene to render.
        time: frames; the center of the exposure.
        shutter: exposure time in frames.
        size: (height, width) in pixels.
        layers: number of layers of smoke: 1, or an even number. Without a thing, any number.
        subpixels: number of positions within a pixel for color and alpha.
        marching: how the rays are marched.

    Returns:
        The layers: color (H, W, 4) premultiplied, depth (H, W) the mean in 1/depth, velocity
        (H, W, 2) half-spread in pixels, path (H, W, 2, 2) in pixels; float32.

    Raises:
        ValueError: an argument is out of range.
    """
    rendering.check_exposure(shutter, size)
    _check_samples("subpixels", subpixels)
    _check_samples("layers", layers)
    if scene.thing is not None and layers % 2 and layers > 1:
        raise ValueError(
            f"`layers` must be 1 or even, half of them in front of the thing, got {layers}."
        )
    lit = _lit(scene, time, marching)
    held_out = scene.thing if layers == 1 else None
    planes = _planes(scene, lit.volume, time, layers)
    smoke = tuple(
        _smoke_layer(scene, lit, time, shutter, ends, held_out, size, subpixels, marching)
        for ends in itertools.pairwise(planes)
    )
    options = {"path": True, "subpixels": subpixels}
    behind = rendering.render(scene.surroundings, time, shutter, size, **options)
    opaque = jnp.concatenate([behind.color, jnp.ones((*size, 1))], axis=-1)
    surroundings = behind.replace(color=opaque)
    if scene.thing is None:
        return SmokeLayers(smoke, None, (), surroundings)
    half = max(layers // 2, 1)
    thing = _thing_layer(scene.thing, time, shutter, size, subpixels)
    return SmokeLayers(smoke[:half], thing, smoke[half:], surroundings)


def _check_samples(name: str, count: int) -> None:
    if count < 1:
        raise ValueError(f"`{name}` must be at least 1, got {count}.")


class Lit(NamedTuple):
    """Smoke at one time.

    Attributes:
        volume: the voxels.
        light: at the corners of their cells, or None.
    """

    volume: Volume
    light: jax.Array | None


def _lit(scene: SmokeScene, time: float, marching: Marching) -> Lit:
    """Voxels, and where light is cached that too."""
    moment = jnp.float32(time)
    volume = smoke_at(scene.puff, moment, marching.cells)
    if marching.lighting != "cached":
        return Lit(volume, None)
    _, eye = motion.transform(scene.camera.motion, moment)
    return Lit(volume, _light(volume, scene.medium, scene.lights, eye, marching))


_light = jax.jit(light_of_corners, static_argnames="marching")


def _mean_image(
    scene: SmokeScene, times: np.ndarray, size: tuple[int, int], marching: Marching
) -> Float[Array, "height width 3"]:
    """The mean of sharp images, one for each time, each with one ray per pixel."""
    total, lit, last = jnp.zeros((*size, 3)), None, None
    footprint = len(times) ** -0.5
    for time, offset in zip(times, subpixel_offsets(len(times)), strict=True):
        if lit is None or time != last:
            lit, last = _lit(scene, time, marching), time
        seen = bodies(scene.surroundings, time, offset, footprint, size)
        if scene.thing is not None:
            thing = bodies(scene.thing, time, offset, footprint, size)
            nearer = thing.depth < seen.depth
            seen = Bodies(*(jnp.where(nearer, a, b) for a, b in zip(thing, seen, strict=True)))
        met = _marched(scene, lit, time, offset, (0.0, seen.depth), size, marching)
        total = total + _image(met.color + met.transmittance * seen.color, size)
    return total / len(times)


def _image(values: Array, size: tuple[int, int]) -> Array:
    return values.T.reshape(*size, -1)


Ends = tuple[float | Array, float | Array]
"""Planar depths between which smoke is marched: scene units, for all pixels or (P,)."""


def _marched(
    scene: SmokeScene,
    lit: Lit,
    time: float,
    offset: np.ndarray,
    ends: Ends,
    size: tuple[int, int],
    marching: Marching,
) -> Marched:
    near, far = (
        jnp.broadcast_to(jnp.asarray(e, jnp.float32).ravel(), size[0] * size[1]) for e in ends
    )
    where = jnp.asarray(offset, jnp.float32)
    moment = jnp.float32(time)
    arguments = (lit, scene.medium, scene.lights, scene.camera, moment, where, near, far)
    return _march(*arguments, None, None, size, marching)


def _tracked(
    scene: SmokeScene,
    lit: Lit,
    time: float,
    shutter: float,
    ends: Ends,
    size: tuple[int, int],
    marching: Marching,
) -> Marched:
    """March through pixel centers; the sums are of 1/depth and of the path, without light."""
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
    return march(*(lit.volume, medium, lights, world, size, marching), light=lit.light, track=track)


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


def _paths(values: Array, size: tuple[int, int]) -> Array:
    """From x and y at opening and closing (4, P) to (H, W, 2, 2)."""
    return values.T.reshape(*size, 2, 2)


def _frame(color: Array, inverse_depth: Array, path: Array) -> Frame:
    return Frame(color, 1 / inverse_depth, (path[..., 1, :] - path[..., 0, :]) / 2, path)


def _nearer(front: Frame, back: Frame) -> Frame:
    nearer = front.depth < back.depth

    def choose(a: Array, b: Array) -> Array:
        return jnp.where(nearer.reshape(*nearer.shape, *[1] * (a.ndim - 2)), a, b)

    return jax.tree.map(choose, front, back)


def _planes(scene: SmokeScene, volume: Volume, time: float, layers: int) -> list[float]:
    """Planar depths between the layers, with those before and behind all smoke."""
    if layers == 1:
        return [0.0, np.inf]
    mass = np.asarray(jnp.mean(volume.corners, axis=-1)).ravel()
    index = np.stack(np.unravel_index(np.arange(mass.size), volume.gap.shape), axis=-1)
    places = np.asarray(volume.low) + (index + 0.5) * np.asarray(volume.spacing)
    rotation, eye = (
        np.asarray(a) for a in motion.transform(scene.camera.motion, jnp.float32(time))
    )
    depth = (places - eye) @ rotation[:, 2]
    if scene.thing is None:
        return [0.0, *_quantiles(depth, mass, layers), np.inf]
    first = jax.tree.map(lambda leaf: leaf[0], scene.thing.world.motions)
    _, center = motion.transform(first, jnp.float32(time))
    split = float((np.asarray(center) - eye) @ rotation[:, 2])
    front, half = depth < split, layers // 2
    return [
        0.0,
        *_quantiles(depth[front], mass[front], half),
        split,
        *_quantiles(depth[~front], mass[~front], half),
        np.inf,
    ]


def _quantiles(depth: np.ndarray, mass: np.ndarray, parts: int) -> list[float]:
    """Depths that divide mass into equal parts."""
    if parts == 1:
        return []
    order = np.argsort(depth)
    if not mass.sum() > 0:
        return list(np.quantile(depth, np.arange(1, parts) / parts))
    reached = np.cumsum(mass[order]) / mass.sum()
    at = np.searchsorted(reached, np.arange(1, parts) / parts)
    return [float(d) for d in depth[order][at]]


def _smoke_layer(
    scene: SmokeScene,
    lit: Lit,
    time: float,
    shutter: float,
    ends: tuple[float, float],
    held_out: Scene | None,
    size: tuple[int, int],
    subpixels: int,
    marching: Marching,
) -> Frame:
    """The smoke between two depths, and in front of what holds it out."""

    def until(offset: np.ndarray) -> Ends:
        if held_out is None:
            return ends
        return ends[0], bodies(held_out, time, offset, 1.0, size).depth

    color = jnp.zeros((*size, 4))
    for offset in subpixel_offsets(subpixels):
        met = _marched(scene, lit, time, offset, until(offset), size, marching)
        rgba = jnp.concatenate([met.color, 1 - met.transmittance[None]])
        color = color + _image(rgba, size) / subpixels
    met = _tracked(scene, lit, time, shutter, until(np.zeros(2)), size, marching)
    weight = 1 - met.transmittance
    means = jnp.where(weight > 0, met.sums / jnp.where(weight > 0, weight, 1.0), 0.0)
    return _frame(color, means[0].reshape(size), _paths(means[1:], size))


def _thing_layer(
    thing: Scene, time: float, shutter: float, size: tuple[int, int], subpixels: int
) -> Frame:
    """The thing alone: its color, premultiplied by the share of the pixel that it covers."""
    color = jnp.zeros((*size, 4))
    for offset in subpixel_offsets(subpixels):
        seen = bodies(thing, time, offset, subpixels**-0.5, size)
        rgba = jnp.concatenate([seen.color, jnp.ones((1, seen.depth.size))])
        color = color + _image(rgba * jnp.isfinite(seen.depth), size) / subpixels
    sharp = rendering.render(thing, time, shutter, size, path=True, subpixels=1)
    assert sharp.path is not None
    hit = jnp.isfinite(sharp.depth)
    path = jnp.where(hit[..., None, None], sharp.path, 0.0)
    return _frame(color, 1 / sharp.depth, path)
