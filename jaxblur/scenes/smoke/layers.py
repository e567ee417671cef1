"""Smoke in layers, with the thing in their midst."""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...frame import Frame
from .. import motion, rendering
from ..exposure import subpixel_offsets
from ..scene import Scene
from .bodies import bodies
from .frames import check_count
from .lighting import Marching
from .scene import SmokeScene
from .views import Ends, Lit, as_image, as_paths, frame_of, lit_smoke, marched, tracked
from .volume import Volume


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

    Smoke is divided by planes at right angles to the view: one through the middle of the thing,
    others so that each layer in front of that one has the same mass, and each layer behind it too.
    Where the thing is, its surface divides in place of the plane, so that the layers add up to the
    flat frame. What is behind it is rendered as if it were not there. A single layer of smoke has
    to be in front of the thing, and so ends there: what is behind it is lost.

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
    check_count("subpixels", subpixels)
    check_count("layers", layers)
    if scene.thing is not None and layers % 2 and layers > 1:
        raise ValueError(
            f"`layers` must be 1 or even, half of them in front of the thing, got {layers}."
        )
    lit = lit_smoke(scene, time, marching)
    slabs = _slabs(scene, lit.volume, time, layers)
    smoke = tuple(
        _smoke_layer(scene, lit, time, shutter, slab, size, subpixels, marching) for slab in slabs
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


class Slab(NamedTuple):
    """Smoke of one layer.

    Attributes:
        near: planar depth at which it begins, scene units.
        far: planar depth at which it ends.
        ends_at_thing: whether it also ends where the thing is.
        begins_at_thing: whether it begins where the thing is, if that is nearer than `near`.
    """

    near: float
    far: float
    ends_at_thing: bool = False
    begins_at_thing: bool = False


def _slabs(scene: SmokeScene, volume: Volume, time: float, layers: int) -> list[Slab]:
    """Divide the smoke by planes, of which the one through the thing bulges around it."""
    if layers == 1:
        return [Slab(0.0, np.inf, ends_at_thing=scene.thing is not None)]
    mass = np.asarray(jnp.mean(volume.corners, axis=-1)).ravel()
    index = np.stack(np.unravel_index(np.arange(mass.size), volume.gap.shape), axis=-1)
    places = np.asarray(volume.low) + (index + 0.5) * np.asarray(volume.spacing)
    rotation, eye = (
        np.asarray(a) for a in motion.transform(scene.camera.motion, jnp.float32(time))
    )
    depth = (places - eye) @ rotation[:, 2]
    if scene.thing is None:
        planes = [0.0, *_quantiles(depth, mass, layers), np.inf]
        return [Slab(*ends) for ends in itertools.pairwise(planes)]
    first = jax.tree.map(lambda leaf: leaf[0], scene.thing.world.motions)
    _, center = motion.transform(first, jnp.float32(time))
    split = float((np.asarray(center) - eye) @ rotation[:, 2])
    front, half = depth < split, layers // 2
    before = [0.0, *_quantiles(depth[front], mass[front], half), split]
    behind = [split, *_quantiles(depth[~front], mass[~front], half), np.inf]
    return [
        *(Slab(*ends, ends_at_thing=True) for ends in itertools.pairwise(before)),
        *(
            Slab(*ends, begins_at_thing=number == 0)
            for number, ends in enumerate(itertools.pairwise(behind))
        ),
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
    slab: Slab,
    size: tuple[int, int],
    subpixels: int,
    marching: Marching,
) -> Frame:
    """The smoke of a slab."""

    def ends(offset: np.ndarray) -> Ends:
        near, far = slab.near, slab.far
        if scene.thing is None or not (slab.ends_at_thing or slab.begins_at_thing):
            return near, far
        thing = bodies(scene.thing, time, offset, 1.0, size).depth
        if slab.ends_at_thing:
            return near, jnp.minimum(far, thing)
        return jnp.minimum(near, thing), far

    color = jnp.zeros((*size, 4))
    for offset in subpixel_offsets(subpixels):
        met = marched(scene, lit, time, offset, ends(offset), size, marching)
        rgba = jnp.concatenate([met.color, 1 - met.transmittance[None]])
        color = color + as_image(rgba, size) / subpixels
    met = tracked(scene, lit, time, shutter, ends(np.zeros(2)), size, marching)
    weight = 1 - met.transmittance
    means = jnp.where(weight > 0, met.sums / jnp.where(weight > 0, weight, 1.0), 0.0)
    return frame_of(color, means[0].reshape(size), as_paths(means[1:], size))


def _thing_layer(
    thing: Scene, time: float, shutter: float, size: tuple[int, int], subpixels: int
) -> Frame:
    """The thing alone: its color, premultiplied by the share of the pixel that it covers."""
    color = jnp.zeros((*size, 4))
    for offset in subpixel_offsets(subpixels):
        seen = bodies(thing, time, offset, subpixels**-0.5, size)
        rgba = jnp.concatenate([seen.color, jnp.ones((1, seen.depth.size))])
        color = color + as_image(rgba * jnp.isfinite(seen.depth), size) / subpixels
    sharp = rendering.render(thing, time, shutter, size, path=True, subpixels=1)
    assert sharp.path is not None
    hit = jnp.isfinite(sharp.depth)
    path = jnp.where(hit[..., None, None], sharp.path, 0.0)
    return frame_of(color, 1 / sharp.depth, path)
