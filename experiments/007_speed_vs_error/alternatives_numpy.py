"""guertin2014 as one would write it in NumPy: whole images, one sample after the other.

    python -m experiments.007_speed_vs_error.alternatives_numpy [--size WIDTHxHEIGHT]

The same algorithm as `jaxblur.guertin2014` (nearest fetch, two directions, even split). The
functions take the array library as an argument, since PyTorch has most functions under the same
names.
"""

from typing import Any

import numpy as np

from .alternatives import Inputs, check_and_time

RING = [(ox, oy) for oy in (-1, 0, 1) for ox in (-1, 0, 1) if (ox, oy) != (0, 0)]


def unit(xp: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """The vectors scaled to length 1; 0 stays 0."""
    norm = xp.sqrt(x * x + y * y)
    norm = xp.where(norm > 0, norm, 1)
    return x / norm, y / norm


def tile_max(xp: Any, x: Any, y: Any, speed: Any, radius: int) -> tuple[Any, Any, Any]:
    """The fastest velocity of each tile and its speed."""
    height, width = speed.shape
    rows, columns = -(-height // radius), -(-width // radius)

    def tiled(plane: Any, fill: float) -> Any:
        padded = xp.full((rows * radius, columns * radius), fill, dtype=plane.dtype)
        padded[:height, :width] = plane
        blocks = padded.reshape(rows, radius, columns, radius).swapaxes(1, 2)
        return blocks.reshape(rows * columns, radius * radius)

    best = tiled(speed, -1.0).argmax(1)[:, None]
    planes = ((x, 0.0), (y, 0.0), (speed, -1.0))
    tiles = (xp.take_along_axis(tiled(p, f), best, 1)[:, 0] for p, f in planes)
    vx, vy, norm = (tile.reshape(rows, columns) for tile in tiles)
    return vx, vy, norm


def neighbor_max(xp: Any, tiles: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
    """The fastest velocity of each ring; diagonal tiles count if they can reach the center."""
    rows, columns = tiles[2].shape
    dominant = tiles
    slope = xp.sign(tiles[0]) * xp.sign(tiles[1])
    for ox, oy in RING:
        counted = tiles[2]
        if ox * oy:
            counted = xp.where(slope * (ox * oy) > 0, counted, -1)
        there = slice(max(oy, 0), rows + min(oy, 0)), slice(max(ox, 0), columns + min(ox, 0))
        here = slice(max(-oy, 0), rows + min(-oy, 0)), slice(max(-ox, 0), columns + min(-ox, 0))
        faster = xp.zeros((rows, columns), dtype=bool)
        faster[here] = counted[there] > dominant[2][here]
        moved = [xp.zeros_like(tile) for tile in tiles]
        for target, tile in zip(moved, tiles, strict=True):
            target[here] = tile[there]
        dominant = tuple(xp.where(faster, m, d) for m, d in zip(moved, dominant, strict=True))
    vx, vy, norm = dominant
    return vx, vy, norm


def chosen_tile(xp: Any, tile_noise: Any, tau: Any, radius: int, shape: tuple[int, int]) -> Any:
    """Flat index of the tile that each pixel reads."""
    height, width = tile_noise.shape[:2]
    row, column = xp.arange(height)[:, None], xp.arange(width)[None, :]
    moved_x = (column % radius + 0.5) / radius + tau * tile_noise[..., 0]
    moved_y = (row % radius + 0.5) / radius + tau * tile_noise[..., 1]
    step_x = xp.where(moved_x < 0, -1, xp.where(moved_x >= 1, 1, 0))
    step_y = xp.where(moved_y < 0, -1, xp.where(moved_y >= 1, 1, 0))
    r, c = row // radius + step_y, column // radius + step_x
    inside = (r >= 0) & (r < shape[0]) & (c >= 0) & (c < shape[1])
    leaves = ((step_x == 0) != (step_y == 0)) & inside
    own = (row // radius) * shape[1] + column // radius
    return xp.where(leaves, r * shape[1] + c, own)


def directions(xp: Any, x: Any, y: Any, speed: Any, dominant: tuple[Any, Any], gamma: Any) -> Any:
    """Unit vectors of the dominant and the center direction."""
    along_x, along_y = unit(xp, *dominant)
    side = 1 - 2 * (along_x * y < along_y * x) * xp.ones_like(x)
    share = xp.clip((speed - 0.5) / gamma, 0, 1)
    own_x, own_y = unit(xp, x, y)
    center = unit(
        xp,
        share * own_x - (1 - share) * side * along_y,
        share * own_y + (1 - share) * side * along_x,
    )
    return (along_x, along_y), center


def weight(xp: Any, distance: Any, alignment: Any, inverse: Any, separation: Any) -> Any:
    """Weight of a tap (Annexe I)."""
    along_pixel, along_sample = alignment
    inverse_pixel, inverse_sample = inverse
    ramp = xp.clip(10 * distance * xp.maximum(inverse_pixel, inverse_sample) - 9.5, 0, 1)
    together = 1 - ramp * ramp * (3 - 2 * ramp)
    in_front, behind = 1 - xp.clip(separation, 0, 1), 1 + xp.clip(separation, -1, 0)
    return (
        in_front * xp.clip(1 - distance * inverse_sample, 0, 1) * along_sample
        + behind * xp.clip(1 - distance * inverse_pixel, 0, 1) * along_pixel
        + 2 * together * xp.maximum(along_pixel, along_sample)
    )


def clamped(xp: Any, velocity: Any, radius: int) -> tuple[Any, Any, Any]:
    """Velocity clamped to the length of the radius, and its speed."""
    x, y = velocity[..., 0], velocity[..., 1]
    speed = xp.sqrt(x * x + y * y)
    scale = radius / xp.clip(speed, radius, None)
    return x * scale, y * scale, speed * scale


def texel(xp: Any, distance: Any, along: tuple[Any, Any], shape: tuple[int, int]) -> Any:
    """Flat index of the nearest texel of a tap, and whether it lies in the image."""
    height, width = shape
    row, column = xp.arange(height)[:, None], xp.arange(width)[None, :]
    px = column + xp.asarray(xp.floor(distance * along[0] + 0.5), dtype=xp.int64)
    py = row + xp.asarray(xp.floor(distance * along[1] + 0.5), dtype=xp.int64)
    inside = (px >= 0) & (px < width) & (py >= 0) & (py < height)
    return xp.clip(py, 0, height - 1) * width + xp.clip(px, 0, width - 1), inside


def guertin2014(inputs: Inputs, xp: Any = np) -> Any:
    """The whole filter.

    Args:
        inputs: frame, noise, parameters and settings, with arrays of the library.
        xp: the array library.

    Returns:
        (H, W, 3) linear light.
    """
    kappa, gamma, tau, spread, sharpness = inputs.scalars()
    radius, samples = inputs.radius, inputs.samples
    x, y, speed = clamped(xp, inputs.velocity, radius)
    inverse = 1 / xp.clip(speed, 0.5, None)
    depth = xp.clip(inputs.depth, 1e-9, 1e18)
    tiles = neighbor_max(xp, tile_max(xp, x, y, speed, radius))
    tile = chosen_tile(xp, inputs.tile, tau, radius, tiles[2].shape)
    dominant = tiles[0].reshape(-1)[tile], tiles[1].reshape(-1)[tile]
    reach = tiles[2].reshape(-1)[tile]
    (along_x, along_y), (center_x, center_y) = directions(xp, x, y, speed, dominant, gamma)
    across = xp.abs(center_x * along_x + center_y * along_y)
    planes = [p.reshape(-1) for p in (x * inverse, y * inverse, inverse, depth)]
    colors = [xp.ascontiguousarray(inputs.color[..., k]).reshape(-1) for k in range(3)]
    total, counted = xp.zeros_like(depth), xp.zeros_like(depth)
    summed = [xp.zeros_like(depth) for _ in colors]
    for sample in range(samples):
        second = sample % 2 == 1
        along = center_x if second else along_x, center_y if second else along_y
        t = reach * (2 * (sample + 1 + inputs.tap * spread) / (samples + 1) - 1)
        index, inside = texel(xp, t, along, depth.shape)
        vx, vy, inverse_sample, there = (xp.take(plane, index) for plane in planes)
        own = xp.ones_like(across) if second else across
        w = weight(
            xp,
            xp.abs(t),
            (own, xp.abs(vx * along[0] + vy * along[1])),
            (inverse, inverse_sample),
            sharpness * (there - depth) / xp.minimum(there, depth),
        )
        w = xp.where(inside, w, 0)
        for channel, color in zip(summed, colors, strict=True):
            channel += w * xp.take(color, index)
        total += w
        counted += inside
    center = counted * inverse / kappa
    blurred = xp.stack(summed, -1) + center[..., None] * inputs.color
    blurred = blurred / (total + center)[..., None]
    return xp.where((reach <= 0.5)[..., None], inputs.color, blurred)


if __name__ == "__main__":
    check_and_time("NumPy", guertin2014)
