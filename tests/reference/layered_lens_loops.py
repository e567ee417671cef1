"""The layered filter through a lens as plain loops in float64: slow, one pixel after the other.

Nothing is shared with jaxblur: what both get wrong, no test would see.
"""

import math

import numpy as np

from .layered_loops import (
    DISTANCES,
    at_texel,
    clip01,
    level_of,
    log_depth,
    motion_of,
    moves,
    paths_of,
    place_at,
    purest,
)


def halton(number, base):
    """The digits of a number, mirrored at the point."""
    value, unit = 0.0, 1.0
    while number:
        number, digit = divmod(number, base)
        unit /= base
        value += digit * unit
    return value


def points_of(count):
    """Where on the unit disc the maps lie: one point for each ring and each sector."""
    ranks = [np.argsort(np.argsort([halton(k, base) for k in range(count)])) for base in (2, 3)]
    areas, turns = (np.array(ranks) + 0.5) / count
    points = np.sqrt(areas) * np.exp(2j * math.pi * turns)
    points = np.stack([points.real, points.imag], axis=-1)
    points -= points.mean(axis=0)
    return points / max(1.0, np.linalg.norm(points, axis=1).max())


def in_cell(point, turn, number, count, jitter):
    """The point of a sample near that of its map."""
    shift = (turn + number / 2 + 0.5) % 1 - 0.5
    return point + 0.5 * math.sqrt(math.pi / count) * jitter * shift


def owners_of(paths, discs, depth, radius, count, points):
    """In every map the owner of every pixel; those without one are missing."""
    height, width = depth.shape
    maps = []
    for k in range(count):
        t, found = (2 * k + 1 - count) / count, {}
        for row, column in np.ndindex(depth.shape):
            x, y = place_at(paths[row, column], t) + discs[row, column] * points[k]
            if not (moves(paths[row, column]) or abs(discs[row, column]) > 0.5):
                x, y = 0, 0
            right, down = math.floor(x + 0.5), math.floor(y + 0.5)
            at = row + down, column + right
            if 0 <= at[0] < height and 0 <= at[1] < width:
                mark = level_of(depth[row, column], radius), down, right
                found[at] = max(found.get(at, mark), mark)
        owners = {at: (at[0] - mark[1], at[1] - mark[2]) for at, mark in found.items()}
        for at, mark in found.items():
            rests = not (moves(paths[at]) or abs(discs[at]) > 0.5)
            if rests and mark[0] <= level_of(depth[at], radius):
                owners[at] = at
        maps.append(owners)
    return maps


def beside(color, depth, owners, at, sharpness):
    """The color of the deepest owners around a hole; None where there are none."""
    found = []
    for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        for distance in DISTANCES:
            owner = owners.get((at[0] + distance * down, at[1] + distance * right))
            if owner is not None:
                found.append((depth[owner], distance, color[owner]))
                break
    if not found:
        return None
    deepest = max(z for z, _, _ in found)
    weights = [clip01(2 - sharpness * (deepest - z)) / distance**2 for z, distance, _ in found]
    colors = [seen for _, _, seen in found]
    return np.average(colors, axis=0, weights=weights)


def bilinear(image, y, x):
    top, left = math.floor(y), math.floor(x)
    total = 0
    for row, down in ((top, top + 1 - y), (top + 1, y - top)):
        for column, right in ((left, left + 1 - x), (left + 1, x - left)):
            at = np.clip((row, column), 0, np.array(image.shape[:2]) - 1)
            total = total + down * right * image[tuple(at)]
    return total


def layered_through_lens(color, depth, velocity, parameters, settings, noise, lens):
    """The filter; a lens as the radius of discs at infinity, pixels, and the depth in focus."""
    (tap, tile), (infinity, focus) = noise, lens
    radius, samples = settings["radius"], settings["samples"]
    color, z = color.astype(np.float64), log_depth(depth)
    sharpness, coverage = parameters["surface_sharpness"], parameters["thin_coverage"]
    motion = motion_of(velocity.astype(np.float64), None, radius)
    motion, z = purest(motion, z, color, sharpness, coverage)
    paths = paths_of(motion, z, parameters, radius, False)
    left = radius - np.hypot(*np.moveaxis(paths[..., :2], -1, 0))
    left = np.maximum(left - np.hypot(*np.moveaxis(paths[..., 2:], -1, 0)), 0)
    discs = infinity * (1 - focus / np.exp(z))
    # Bilinear reading widens a disc by a variance of 1/6, which is 4/6 of squared radius.
    discs = np.clip(discs**3 / (discs**2 + 1 / 3), -left, left)
    count = -(-samples // -(-samples // 64))
    points = points_of(count)
    maps = owners_of(paths, discs, z, radius, count, points)
    out = color.copy()
    for at in np.ndindex(depth.shape):
        rests = not moves(paths[at]) and abs(discs[at]) <= 0.5
        if rests and all(owners.get(at) == at for owners in maps):
            continue
        missing = [owners for owners in maps if at not in owners]
        fills = [beside(color, z, owners, at, sharpness) for owners in missing]
        fills = [np.zeros(color.shape[2]) if fill is None else fill for fill in fills]
        known = np.mean([1.0 * fill.any() for fill in fills]) if fills else 0.0
        behind = np.mean(fills, axis=0) if fills else 0.0
        total, weights = 0.0, 0.0
        for i in range(samples):
            index = int((2 * i + 1) * count / 2 / samples)
            owner = maps[index].get(at)
            if owner is None:
                total, weights = total + behind, weights + known
                continue
            t = (2 * i + 1 - samples + tap[at] * parameters["jitter"]) / samples
            own_t = (2 * index + 1 - count) / count
            point = in_cell(points[index], tile[at], i, count, parameters["jitter"])
            way = paths[owner]
            x, y = -t * way[:2] - own_t**2 * way[2:] - discs[owner] * point
            where, counts = at_texel(at[0], at[1], x, y, depth.shape, settings["border"])
            there = t * paths[where][:2] + t * t * way[2:] + discs[where] * point
            miss, apart = there + np.array([x, y]), paths[where][:2] - way[:2]
            speed = parameters["own_tolerance"] ** 2 * (way[:2] @ way[:2] + 0.25)
            differs = max((apart @ apart) / speed, sharpness * abs(z[where] - z[owner]))
            misses = (miss @ miss) / parameters["landing_tolerance"] ** 2
            lands = counts * clip01(1.5 - min(misses, differs))
            seen = bilinear(color, at[0] + y, at[1] + x)
            total = total + lands * seen + (1 - lands) * color[owner]
            weights += 1
        if weights > 1e-3:
            out[at] = total / weights
    return out
