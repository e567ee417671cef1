"""A small frame with its expected output, so that a port can test itself."""

import jax
import numpy as np

from ..frame import Frame
from ..noise import make_noise
from .graph import Graph

HEIGHT, WIDTH = 48, 64

TOLERANCE, SHARE = 1e-4, 0.999
"""Largest difference from the expected output, and the share of pixels that must keep it. A tap
that falls between two texels may take the other one, by one rounding."""

FAR = 1e18
"""Depth of the sky. Infinity would mean the same, but shaders may not count on it."""


def reference_planes(graph: Graph) -> dict[str, np.ndarray]:
    """The buffers of the reference frame by name: a turning wheel and a bar pass before a wall.

    Their speeds have four digits: at round ones samples without noise lie exactly between two
    texels, where rounding decides which of the two a port reads.

    Args:
        graph: the filter.

    Returns:
        float32 arrays (H, W, channels): color, depth and velocity, and what else the filter reads.
    """
    row, column = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    tone = np.arange(graph.channels) / 3
    checker = ((row // 6 + column // 6) % 2)[..., None]
    color = 0.15 + 0.5 * checker + 0.2 * np.sin(column[..., None] / 9 + 2 * tone)
    depth = np.where(row < 9, FAR, 8 - row / 12)
    velocity = np.zeros((HEIGHT, WIDTH, 2))
    velocity[..., 0] = np.where(row < 9, 0.0, 1.4731)

    x, y = column - 22, row - 26
    wheel = x * x + y * y < 12**2
    spokes = (np.cos(5 * np.arctan2(y, x))[..., None] + 1) * (0.4 + 0.3 * tone)
    color = np.where(wheel[..., None], spokes, color)
    depth = np.where(wheel, 3.0, depth)
    velocity = np.where(
        wheel[..., None], np.stack([-0.3517 * y + 3.0413, 0.3517 * x], -1), velocity
    )

    bar = (column > 40) & (column < 47)
    color = np.where(bar[..., None], 1.2 - 0.4 * tone, color)
    depth = np.where(bar, 2.0, depth)
    velocity = np.where(bar[..., None], [7.0319, -2.9873], velocity)
    # Values that half floats hold, so that the EXR file has the same ones.
    color = np.float16(color)
    noise = make_noise("halton", HEIGHT, WIDTH)
    planes = {
        "color": color,
        "depth": depth,
        "velocity": velocity,
        "path": np.concatenate([-velocity + 0.2, velocity + 0.2], axis=-1),
        "noise_tap": noise.tap,
        "noise_tile": noise.tile,
    }
    wanted = {"color": graph.channels, "depth": 1, "velocity": 2}
    wanted |= {buffer.name: buffer.channels for buffer in graph.inputs}
    return {
        name: np.asarray(planes[name], np.float32).reshape(HEIGHT, WIDTH, channels)
        for name, channels in wanted.items()
    }


def frame_of(planes: dict[str, np.ndarray]) -> Frame:
    """The frame of some buffers, each (H, W, channels)."""
    height, width = planes["color"].shape[:2]
    path = None
    if "path" in planes:
        path = planes["path"].reshape(height, width, 2, 2)
    return Frame(planes["color"], planes["depth"][..., 0], planes["velocity"], path)


def expected_of(graph: Graph, planes: dict[str, np.ndarray]) -> np.ndarray:
    """The filter's result by JAX.

    Args:
        graph: the filter.
        planes: its buffers by name, (H, W, channels) each.

    Returns:
        (H, W, C) float32.
    """
    frame = frame_of(planes)
    # Built-in noise is the same here and in the port, and `halton` is that of the planes.
    parameters = graph.filter.make_parameters(**graph.parameters)
    result = graph.filter.call(frame, parameters, settings=graph.settings)
    return np.asarray(jax.device_get(result), np.float32)
