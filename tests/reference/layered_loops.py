"""The layered filter as plain loops in float64: slow, one pixel after the other.

Nothing is shared with jaxblur: what both get wrong, no test would see.
"""

import math

import numpy as np

AROUND = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]


def clip01(value):
    return min(max(value, 0.0), 1.0)


def log_depth(depth):
    return np.log(np.clip(depth.astype(np.float64), 1e-9, 1e18))


def motion_of(velocity, path, radius):
    """Per pixel: velocity x, y, and half the acceleration x, y; each within the radius."""
    motion = np.zeros((*velocity.shape[:2], 4))
    for at in np.ndindex(velocity.shape[:2]):
        motion[at][:2] = velocity[at]
        if path is not None:
            motion[at][:2] = (path[at][1] - path[at][0]) / 2
            motion[at][2:] = (path[at][1] + path[at][0]) / 2
            motion[at][2:] *= shortening(motion[at][2:], radius)
        motion[at] *= shortening(motion[at][:2], radius)
    return motion


def shortening(vector, radius):
    """What makes a vector no longer than the radius."""
    return min(1.0, radius / max(math.hypot(*vector), 1e-300))


def purest(motion, depth, separation, coverage):
    """Motion of the own side least like the other side; of thin things the slowest possible."""
    height, width = depth.shape
    out = np.empty_like(motion)
    for row, column in np.ndindex(depth.shape):
        near = [
            (min(max(row + a, 0), height - 1), min(max(column + b, 0), width - 1))
            for a, b in AROUND
        ]
        steps = [(depth[n] - depth[row, column]) * separation for n in near]
        other = [motion[n][:2] for n, step in zip(near, steps, strict=True) if abs(step) > 1]
        taken = motion[row, column].copy()
        if other:
            mean = np.mean(other, axis=0)
            for n, step in zip(near, steps, strict=True):
                farther = np.sum((motion[n][:2] - mean) ** 2) > np.sum((taken[:2] - mean) ** 2)
                if abs(step) <= 1 and farther:
                    taken = motion[n].copy()
            gap = taken[:2] - mean
            if sum(step > 1 for step in steps) >= 6 and gap @ gap > 0.25:
                share = -(taken[:2] @ gap) / (gap @ gap)
                taken[:2] += min(max(share, 0.0), 1 / coverage - 1) * gap
        out[row, column] = taken
    return out


def side_of_tiles(radius):
    if radius <= 8:
        return radius
    fitting = [s for s in range(5, 13) if radius % s == 0]
    return min(fitting, key=lambda s: (abs(s - 8), s)) if fitting else 8


def speed_of(vector, radius):
    """Norm, in which vectors that were clamped to one length tie."""
    speed = math.hypot(*vector)
    return radius if speed > radius * (1 - 1e-5) else speed


def lines_of(motion, size, radius):
    """The fastest pixel of every tile: (velocity, pixel), tiles in row-major order."""
    height, width = motion.shape[:2]
    lines = []
    for top in range(0, height, size):
        for left in range(0, width, size):
            tile = [
                (row, column)
                for row in range(top, min(top + size, height))
                for column in range(left, min(left + size, width))
            ]
            pixel = max(tile, key=lambda at: speed_of(motion[at][:2], radius))
            lines.append((motion[pixel][:2], pixel))
    return lines


def crossings(lines, speeds, grid, size):
    """For every tile the set of lines whose width covers it at one of the steps."""
    rows, columns = grid
    crossed = [set() for _ in range(rows * columns)]
    half = size / 2 - 0.25
    for number, (v, (row, column)) in enumerate(lines):
        steps = max(math.ceil(speeds[number] / size - 1e-3), 1)
        for step in range(-steps, steps + 1):
            t = step / steps
            for a in (-half, half):
                for b in (-half, half):
                    y = math.floor((row + 0.5 + t * v[1] + a) / size)
                    x = math.floor((column + 0.5 + t * v[0] + b) / size)
                    if 0 <= y < rows and 0 <= x < columns:
                        crossed[y * columns + x].add(number)
    return crossed


def tile_velocities(motion, depth, size, radius):
    """Two velocities, or zeros, for every tile in row-major order."""
    height, width = depth.shape
    grid = -(-height // size), -(-width // size)
    lines = lines_of(motion, size, radius)
    speeds = [speed_of(v, radius) for v, _ in lines]
    levels = (2**31 - 1) // (math.ceil(7680 / size) * math.ceil(4320 / size)) - 1
    found = []
    for number, crossed in enumerate(crossings(lines, speeds, grid, size)):
        top, left = (number // grid[1]) * size, (number % grid[1]) * size
        farthest = depth[top : top + size, left : left + size].max()
        crossed = [k for k in crossed if speeds[k] > 0.5]
        front = {k: farthest - depth[lines[k][1]] > 0.05 for k in crossed}
        if not crossed:
            found.append((np.zeros(2), np.zeros(2)))
            continue
        first = max(crossed, key=lambda k: (front[k], speeds[k], -k))
        apart = {k: math.hypot(*(lines[k][0] - lines[first][0])) for k in crossed}
        level = {
            k: math.floor(min(min(speeds[k], apart[k]) / radius, 1) * levels)
            // (1 if front[k] else 20)
            for k in crossed
        }
        rest = [k for k in crossed if apart[k] > 1]
        second = max(rest, key=lambda k: (level[k], speeds[k], -k), default=None)
        second = np.zeros(2) if second is None else lines[second][0]
        found.append((lines[first][0], second))
    return found


def at_texel(row, column, x, y, shape, border):
    """Nearest texel to an offset position, and whether it counts."""
    down, right = row + math.floor(y + 0.5), column + math.floor(x + 0.5)
    inside = 0 <= down < shape[0] and 0 <= right < shape[1]
    where = min(max(down, 0), shape[0] - 1), min(max(right, 0), shape[1] - 1)
    return where, inside or border == "clamp"


def between(image, y, x, axis):
    """Linear along one axis (0 down, 1 right), the nearest texel along the other."""
    place = [y, x]
    place[1 - axis] = math.floor(place[1 - axis] + 0.5)
    first = math.floor(place[axis])
    share = place[axis] - first

    def texel(k):
        where = [int(place[0]), int(place[1])]
        where[axis] = first + k
        return image[tuple(np.clip(where, 0, np.array(image.shape[:2]) - 1))]

    return texel(0) * (1 - share) + texel(1) * share


def turn_of(motion, depth, row, column, sharpness):
    """Change of velocity along the velocity, from half of it ahead and behind."""
    v, changes = motion[row, column][:2], []
    for side in (0.5, -0.5):
        where, _ = at_texel(row, column, side * v[0], side * v[1], depth.shape, "clamp")
        change = motion[where][:2] - v
        alike = change @ change < (v @ v) / 4
        if alike and abs(depth[where] - depth[row, column]) * sharpness < 1:
            changes.append(2 * change * np.sign(side))
    return np.mean(changes, axis=0) if changes else np.zeros(2)


def ways_of(motion, depth, candidates, row, column, parameters, curved):
    """Velocity, turn, bend and share of own of the three guesses."""
    v = motion[row, column][:2]
    turn = turn_of(motion, depth, row, column, parameters["surface_sharpness"])
    bend = turn - motion[row, column][2:] if curved else parameters["bend"] * turn
    ways = [(v, turn, bend, 1.0)]
    for u in candidates:
        differs = 0.0
        if (u != 0).any():
            differs = clip01(2 * ((u - v) @ (u - v)) / parameters["distinct"] ** 2 - 1)
        ways.append(
            (v + differs * (u - v), (1 - differs) * turn, (1 - differs) * bend, 1 - differs)
        )
    return ways


def layered_pixel(color, depth, motion, ways, row, column, tap, parameters, settings):
    count = settings["samples"] // 3
    here, v = depth[row, column], ways[0][0]
    total, weights = np.zeros(color.shape[2]), 0.0
    for i in range(count):
        middle = 2 * i + 1 - count
        guesses = []
        for k, (u, turn, bend, own) in enumerate(ways):
            place = (0, -1, 1)[k] * np.sign(middle)
            t = (middle + 2 * (place + tap * parameters["jitter"] / 2) / 3) / count
            x, y = t * t * bend - t * u
            where, counts = at_texel(row, column, x, y, depth.shape, settings["border"])
            miss = motion[where][:2] - u + t * turn
            misses = t * t * (miss @ miss) / parameters["landing_tolerance"] ** 2
            differs = max(
                (miss @ miss) / (parameters["own_tolerance"] ** 2 * (v @ v + 0.25)),
                parameters["surface_sharpness"] * abs(depth[where] - here),
            )
            differs += 1.5 * (1 - own)
            lands = clip01(1.5 - min(misses, differs)) if counts else 0.0
            if k == 0 and settings["fetch"] == "bilinear":
                seen = between(color, row + y, column + x, 1 if abs(u[0]) >= abs(u[1]) else 0)
            else:
                seen = color[where]
            guesses.append((lands, depth[where], seen, counts))
        shares = [
            lands
            * math.prod(
                1
                - other
                * (1 - ways[j][3] * ways[k][3])
                * clip01(parameters["front_sharpness"] * (z - nearer))
                for j, (other, nearer, _, _) in enumerate(guesses)
                if j != k
            )
            for k, (lands, z, _, _) in enumerate(guesses)
        ]
        empty = math.prod(1 - lands for lands, *_ in guesses)
        shares = [share * (1 - empty) / max(sum(shares), 1e-6) for share in shares]
        if guesses[0][3]:
            shares[0] += empty * clip01(parameters["front_sharpness"] * (guesses[0][1] - here))
        total += sum(share * guess[2] for share, guess in zip(shares, guesses, strict=True))
        weights += sum(shares)
    return total / weights if weights > 1e-3 else color[row, column]


def layered(color, depth, velocity, parameters, settings, tap, path=None):
    """The filter; parameters and settings as dicts."""
    color, z = color.astype(np.float64), log_depth(depth)
    motion = motion_of(velocity.astype(np.float64), path, settings["radius"])
    motion = purest(motion, z, parameters["surface_sharpness"], parameters["thin_coverage"])
    size = side_of_tiles(settings["radius"])
    tiles, columns = (
        tile_velocities(motion, z, size, settings["radius"]),
        -(-depth.shape[1] // size),
    )
    out = color.copy()
    for row, column in np.ndindex(depth.shape):
        candidates = tiles[(row // size) * columns + column // size]
        ways = ways_of(motion, z, candidates, row, column, parameters, path is not None)
        moves = math.hypot(*ways[0][0]) > 0.5 or any(own < 1 for *_, own in ways[1:])
        if moves:
            out[row, column] = layered_pixel(
                color, z, motion, ways, row, column, tap[row, column], parameters, settings
            )
    return out
