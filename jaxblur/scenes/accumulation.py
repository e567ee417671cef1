"""Ground truth: the mean of sharp renders over the exposure [Korein and Badler 1983]."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .raster import Capacity, enough
from .rendering import check_size, fits, needed_capacity, sample_color, subpixel_offsets
from .scene import Scene, World
from .shutter import ShutterFunction, exposure_center, exposure_positions, shutter_curve

SAMPLE_BLOCK = 1024


class Exposure(NamedTuple):
    """When and where within the pixel each sample is taken.

    Arrays are padded, so that the number of samples does not recompile anything.

    Attributes:
        times: (N,) frames.
        offsets: (N, 2) x and y from the pixel center, pixels.
        count: () samples in use.
        curve: (K,) transmission from opening to closing, used with a rolling shutter only.
        center: () frames, middle of the exposure of the middle of the image.
        shutter: () frames.
        readout: () frames between the exposures of the upper and the lower edge of the image.
    """

    times: jax.Array
    offsets: jax.Array
    count: jax.Array
    curve: jax.Array
    center: jax.Array
    shutter: jax.Array
    readout: jax.Array


def accumulate(
    scene: Scene,
    time: float = 0.0,
    shutter: float = 0.5,
    samples: int = 256,
    size: tuple[int, int] = (180, 320),
    shutter_function: ShutterFunction = "box",
    *,
    placement: str = "centered",
    readout: float = 0.0,
) -> Float[Array, "height width 3"]:
    """Render the true motion-blurred image.

    The mean of `samples` sharp images with one ray per pixel. Sample i stands for the i-th of
    equal shares of the light that the shutter lets through, and its ray goes through the i-th
    point of the R2 sequence in the pixel, so that the result is antialiased too. Samples are
    added up one after the other; memory does not depend on their number.

    With a rolling shutter the rows are exposed one after the other: the exposure of the row at
    height y (0 top, 1 bottom) is later by ``readout (y - 1/2)``. All rows share the samples,
    weighted by their own curve, so there are ``1 + |readout|/shutter`` times as many of them.

    Args:
        scene: what to render.
        time: frames.
        shutter: frames that the shutter is open; 0 gives the sharp image.
        samples: number of samples that each row gets.
        size: (height, width) in pixels.
        shutter_function: "box", "trapezoid", "triangle", "gaussian" or a sampled curve; see
            `shutter_curve`.
        placement: the exposure is "centered" on `time`, as frames are, or it is "leading" (the
            shutter opens at `time`) or "trailing" (it closes then).
        readout: frames that the rolling shutter takes from the upper to the lower edge of the
            image; negative rolls upward, 0 is a global shutter.

    Returns:
        (H, W, 3) linear light, float32.

    Raises:
        ValueError: an argument is out of range, or a rolling shutter has no exposure time.

    Source: Korein and Badler 1983; shutter models after Navarro 2012, section 4.3.8.
    """
    check_size(size)
    if samples < 1:
        raise ValueError(f"`samples` must be at least 1, got {samples}.")
    if not shutter >= 0:
        raise ValueError(f"`shutter` must not be negative, got {shutter}.")
    if readout and not shutter:
        raise ValueError("`shutter` must be positive where `readout` is not 0, got 0.")
    center = exposure_center(time, shutter, placement)
    curve = shutter_curve(shutter_function)
    exposure = _exposure(center, shutter, samples, curve, readout)
    ends = np.asarray(exposure.times)[[0, int(exposure.count) // 2, int(exposure.count) - 1]]
    capacity = needed_capacity(scene.world, ends.tolist(), size)
    while True:
        total, need = _accumulate(scene.world, exposure, size, capacity, bool(readout))
        if fits(need, capacity):
            return total
        capacity = enough(*need.tolist())


def _exposure(
    center: float, shutter: float, samples: int, curve: np.ndarray, readout: float
) -> Exposure:
    if readout:
        samples = int(np.ceil(samples * (1 + abs(readout) / shutter)))
        whole = shutter + abs(readout)
        times = center + whole * ((np.arange(samples) + 0.5) / samples - 0.5)
    else:
        times = center + shutter * exposure_positions(curve, samples)
    padding = -samples % SAMPLE_BLOCK
    return Exposure(
        jnp.asarray(np.pad(times, (0, padding), mode="edge"), jnp.float32),
        jnp.pad(subpixel_offsets(samples), ((0, padding), (0, 0))),
        jnp.int32(samples),
        jnp.asarray(curve, jnp.float32),
        jnp.float32(center),
        jnp.float32(shutter),
        jnp.float32(readout),
    )


def row_weights(exposure: Exposure, time: Float[Array, ""], height: int) -> Float[Array, " height"]:
    """Light that a rolling shutter lets through to each row at one time.

    Args:
        exposure: of the image.
        time: () frames.
        height: number of rows.

    Returns:
        (H,) the curve at the row's own position in its exposure, 0 outside.
    """
    rows = (jnp.arange(height) + 0.5) / height - 0.5
    position = (time - exposure.center - exposure.readout * rows) / exposure.shutter + 0.5
    grid = jnp.linspace(0.0, 1.0, exposure.curve.shape[0])
    return jnp.interp(position, grid, exposure.curve, left=0.0, right=0.0)


@functools.partial(jax.jit, static_argnames=("size", "capacity", "rolling"))
def _accumulate(
    world: World, exposure: Exposure, size: tuple[int, int], capacity: Capacity, rolling: bool
) -> tuple[jax.Array, jax.Array]:
    """Give the weighted mean, and the capacity needed; stop early once it is exceeded."""
    footprint = jax.lax.rsqrt(exposure.count.astype(jnp.float32))
    limit = jnp.array([capacity.rows, capacity.fragments])

    def unfinished(state: tuple[jax.Array, ...]) -> jax.Array:
        i, _, _, need = state
        return (i < exposure.count) & jnp.all(need <= limit)

    def add(state: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        i, total, weights, need = state
        time = exposure.times[i]
        color, count = sample_color(world, time, exposure.offsets[i], footprint, size, capacity)
        weight = row_weights(exposure, time, size[0]) if rolling else jnp.ones(size[0])
        total = total + weight[:, None, None] * color
        return i + 1, total, weights + weight, jnp.maximum(need, count)

    start = (jnp.int32(0), jnp.zeros((*size, 3)), jnp.zeros(size[0]), jnp.zeros(2, jnp.int32))
    _, total, weights, need = jax.lax.while_loop(unfinished, add, start)
    return total / jnp.maximum(weights, 1e-20)[:, None, None], need
