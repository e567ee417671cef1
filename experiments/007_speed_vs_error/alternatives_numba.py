"""guertin2014 as one would write it in numba: loops, parallel over rows, fastmath.

    pip install numba
    python -m experiments.007_speed_vs_error.alternatives_numba [--size WIDTHxHEIGHT]

The same algorithm as `jaxblur.guertin2014` (nearest fetch, two directions, even split), with the
same quantities precomputed for each pixel. Checks the result against the filter, then times both in
turn on a frame in which every tile moves.
"""

import numba  # pyright: ignore[reportMissingImports]
import numpy as np

from .alternatives import Inputs, check_and_time

ONE, TWO, THREE, HALF = np.float32(1), np.float32(2), np.float32(3), np.float32(0.5)
ZERO, TEN, CYLINDER_START = np.float32(0), np.float32(10), np.float32(9.5)
NEAREST, FARTHEST = np.float32(1e-9), np.float32(1e18)


@numba.njit(parallel=True, cache=True)
def _prepare(depth, velocity, radius):
    """Planes read by taps: clamped velocity, its speed, unit velocity, 1 / speed, depth."""
    height, width = depth.shape
    planes = np.empty((7, height, width), np.float32)
    for row in numba.prange(height):
        for column in range(width):
            x, y = velocity[row, column, 0], velocity[row, column, 1]
            speed = np.sqrt(x * x + y * y)
            if speed > radius:
                x, y, speed = x * radius / speed, y * radius / speed, radius
            inverse = ONE / max(speed, HALF)
            planes[0, row, column] = x
            planes[1, row, column] = y
            planes[2, row, column] = speed
            planes[3, row, column] = x * inverse
            planes[4, row, column] = y * inverse
            planes[5, row, column] = inverse
            planes[6, row, column] = min(max(depth[row, column], NEAREST), FARTHEST)
    return planes


@numba.njit(parallel=True, cache=True)
def _tile_max(planes, radius):
    """The fastest velocity of each tile, the first in row-major order at a tie."""
    _, height, width = planes.shape
    rows, columns = -(-height // radius), -(-width // radius)
    tiles = np.zeros((rows, columns, 3), np.float32)
    for tile in numba.prange(rows * columns):
        tile_row, tile_column = tile // columns, tile % columns
        best = -ONE
        for row in range(tile_row * radius, min(height, (tile_row + 1) * radius)):
            for column in range(tile_column * radius, min(width, (tile_column + 1) * radius)):
                if planes[2, row, column] > best:
                    best = planes[2, row, column]
                    for k in range(3):
                        tiles[tile_row, tile_column, k] = planes[k, row, column]
    return tiles


@numba.njit(cache=True)
def _neighbor_max(tiles):
    """The fastest velocity of each ring; diagonal tiles count if they can reach the center."""
    rows, columns, _ = tiles.shape
    dominant = tiles.copy()
    for row in range(rows):
        for column in range(columns):
            for oy in range(-1, 2):
                for ox in range(-1, 2):
                    r, c = row + oy, column + ox
                    if r < 0 or r >= rows or c < 0 or c >= columns:
                        continue
                    slope = np.sign(tiles[r, c, 0]) * np.sign(tiles[r, c, 1])
                    if ox * oy != 0 and slope * ox * oy <= 0:
                        continue
                    if tiles[r, c, 2] > dominant[row, column, 2]:
                        dominant[row, column] = tiles[r, c]
    return dominant


@numba.njit(inline="always")
def _step(size, index, radius, jitter):
    """Offset, -1, 0 or 1, to the tile along one axis that the jittered lookup falls into."""
    local = (np.float32(index % radius) + HALF) / np.float32(radius) + jitter
    return -1 if local < ZERO else (1 if local >= ONE else 0)


@numba.njit(inline="always")
def _tile(row, column, radius, shape, jitter_x, jitter_y):
    """The tile that a pixel reads."""
    tile_row, tile_column = row // radius, column // radius
    step_x = _step(shape[1], column, radius, jitter_x)
    step_y = _step(shape[0], row, radius, jitter_y)
    if (step_x == 0) != (step_y == 0):
        r, c = tile_row + step_y, tile_column + step_x
        if 0 <= r < shape[0] and 0 <= c < shape[1]:
            return r, c
    return tile_row, tile_column


@numba.njit(inline="always")
def _unit(x, y):
    """The vector scaled to length 1; 0 stays 0."""
    norm = np.sqrt(x * x + y * y)
    return (x / norm, y / norm) if norm > ZERO else (ZERO, ZERO)


@numba.njit(inline="always")
def _center_direction(x, y, speed, along_x, along_y, gamma):
    """The pixel's own direction, turned toward the dominant one's perpendicular if it is slow."""
    side = -ONE if along_x * y < along_y * x else ONE
    share = min(max((speed - HALF) / gamma, ZERO), ONE)
    own_x, own_y = _unit(x, y)
    return _unit(
        share * own_x - (ONE - share) * side * along_y,
        share * own_y + (ONE - share) * side * along_x,
    )


@numba.njit(inline="always", fastmath=True)
def _clip(value):
    """Clip to the range from 0 to 1."""
    return min(max(value, ZERO), ONE)


@numba.njit(inline="always", fastmath=True)
def _weight(distance, along_pixel, along_sample, inverse_pixel, inverse_sample, separation):
    """Weight of a tap (Annexe I); the relative separation in depth is within -1 .. 1."""
    in_front, behind = ONE - max(separation, ZERO), ONE + min(separation, ZERO)
    ramp = _clip(TEN * distance * max(inverse_pixel, inverse_sample) - CYLINDER_START)
    together = ONE - ramp * ramp * (THREE - TWO * ramp)
    return (
        in_front * _clip(ONE - distance * inverse_sample) * along_sample
        + behind * _clip(ONE - distance * inverse_pixel) * along_pixel
        + TWO * together * max(along_pixel, along_sample)
    )


@numba.njit(inline="always", fastmath=True)
def _gather_taps(color, planes, along, center, reach, shifts, row, column):
    """Sums over the taps of a pixel that lie in the image: weighted color, weight, number."""
    height, width, _ = color.shape
    samples, start, sharpness = shifts
    step = TWO / np.float32(samples + 1)
    across = abs(center[0] * along[0] + center[1] * along[1])
    inverse, depth = planes[5, row, column], planes[6, row, column]
    red = green = blue = total = counted = ZERO
    for sample in range(samples):
        t = reach * ((np.float32(sample) + start) * step - ONE)
        second = sample % 2 == 1
        direction_x = center[0] if second else along[0]
        direction_y = center[1] if second else along[1]
        px = column + np.int32(np.floor(t * direction_x + HALF))
        py = row + np.int32(np.floor(t * direction_y + HALF))
        if px < 0 or px >= width or py < 0 or py >= height:
            continue
        sample_depth = planes[6, py, px]
        separation = sharpness * (sample_depth - depth) / min(sample_depth, depth)
        weight = _weight(
            abs(t),
            ONE if second else across,
            abs(planes[3, py, px] * direction_x + planes[4, py, px] * direction_y),
            inverse,
            planes[5, py, px],
            min(max(separation, -ONE), ONE),
        )
        red += weight * color[py, px, 0]
        green += weight * color[py, px, 1]
        blue += weight * color[py, px, 2]
        total += weight
        counted += ONE
    return red, green, blue, total, counted


@numba.njit(parallel=True, fastmath=True, cache=True)
def _gather(color, planes, tiles, tap, tile_noise, samples, radius, parameters):
    """Blur every pixel along its two directions; taps outside the image have no weight."""
    kappa, gamma, tau, spread, sharpness = parameters
    height, width, _ = color.shape
    blurred = np.empty_like(color)
    for row in numba.prange(height):
        for column in range(width):
            jitter = tau * tile_noise[row, column, 0], tau * tile_noise[row, column, 1]
            r, c = _tile(row, column, radius, tiles.shape, jitter[0], jitter[1])
            reach = tiles[r, c, 2]
            if reach <= HALF:
                blurred[row, column] = color[row, column]
                continue
            along = tiles[r, c, 0] / reach, tiles[r, c, 1] / reach
            x, y, speed = planes[0, row, column], planes[1, row, column], planes[2, row, column]
            center = _center_direction(x, y, speed, along[0], along[1], gamma)
            shifts = samples, ONE + tap[row, column] * spread, sharpness
            red, green, blue, total, counted = _gather_taps(
                color, planes, along, center, reach, shifts, row, column
            )
            own = counted * planes[5, row, column] / kappa
            blurred[row, column, 0] = (red + own * color[row, column, 0]) / (total + own)
            blurred[row, column, 1] = (green + own * color[row, column, 1]) / (total + own)
            blurred[row, column, 2] = (blue + own * color[row, column, 2]) / (total + own)
    return blurred


def guertin2014(inputs: Inputs) -> np.ndarray:
    """The whole filter: planes, tile maxima, gather.

    Args:
        inputs: frame, noise, parameters and settings as NumPy arrays and numbers.

    Returns:
        (H, W, 3) linear light.
    """
    planes = _prepare(inputs.depth, inputs.velocity, np.float32(inputs.radius))
    tiles = _neighbor_max(_tile_max(planes, inputs.radius))
    return _gather(
        inputs.color,
        planes,
        tiles,
        inputs.tap,
        inputs.tile,
        inputs.samples,
        inputs.radius,
        inputs.scalars(),
    )


if __name__ == "__main__":
    check_and_time("numba", guertin2014)
