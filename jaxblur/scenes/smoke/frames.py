"""Sharp frames of smoke and bodies, and their truth."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...frame import Frame
from .. import rendering
from ..exposure import subpixel_offsets
from ..shutter import ShutterFunction, exposure_center, exposure_positions, shutter_curve
from .bodies import Bodies, bodies
from .lighting import Marching
from .scene import SmokeScene
from .views import as_image, as_paths, frame_of, lit_smoke, marched, tracked


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
    check_count("samples", samples)
    center = exposure_center(time, shutter, placement)
    times = center + shutter * exposure_positions(shutter_curve(shutter_function), samples)
    return mean_image(scene, times, size, marching)


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
    check_count("subpixels", subpixels)
    color = mean_image(scene, np.full(subpixels, time), size, marching)
    surface = rendering.render(scene.surroundings, time, shutter, size, path=True, subpixels=1)
    if scene.thing is not None:
        thing = rendering.render(scene.thing, time, shutter, size, path=True, subpixels=1)
        surface = _nearer(thing, surface)
    lit = lit_smoke(scene, time, marching)
    met = tracked(scene, lit, time, shutter, (0.0, surface.depth), size, marching)
    through = met.transmittance.reshape(size)
    assert surface.path is not None
    inverse = met.sums[0].reshape(size) + through / surface.depth
    path = as_paths(met.sums[1:], size) + through[..., None, None] * surface.path
    return frame_of(color, inverse, path)


def check_count(name: str, count: int) -> None:
    """Reject a count below 1."""
    if count < 1:
        raise ValueError(f"`{name}` must be at least 1, got {count}.")


def mean_image(
    scene: SmokeScene, times: np.ndarray, size: tuple[int, int], marching: Marching
) -> Float[Array, "height width 3"]:
    """The mean of sharp images, one for each time, each with one ray per pixel."""
    total, lit, last = jnp.zeros((*size, 3)), None, None
    footprint = len(times) ** -0.5
    for time, offset in zip(times, subpixel_offsets(len(times)), strict=True):
        if lit is None or time != last:
            lit, last = lit_smoke(scene, time, marching), time
        seen = bodies(scene.surroundings, time, offset, footprint, size)
        if scene.thing is not None:
            thing = bodies(scene.thing, time, offset, footprint, size)
            nearer = thing.depth < seen.depth
            seen = Bodies(*(jnp.where(nearer, a, b) for a, b in zip(thing, seen, strict=True)))
        met = marched(scene, lit, time, offset, (0.0, seen.depth), size, marching)
        total = total + as_image(met.color + met.transmittance * seen.color, size)
    return total / len(times)


def _nearer(front: Frame, back: Frame) -> Frame:
    nearer = front.depth < back.depth

    def choose(a: Array, b: Array) -> Array:
        return jnp.where(nearer.reshape(*nearer.shape, *[1] * (a.ndim - 2)), a, b)

    return jax.tree.map(choose, front, back)
