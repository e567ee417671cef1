"""The posts as plain NumPy loops in float64: slow, literal readings of what was published.

Nothing is shared with jaxblur, not even constants: what both get wrong, no test would see.
"""

import itertools
import math

import numpy as np


def luma_of(image):
    image = np.asarray(image, float)
    if image.ndim == 3:
        image = image @ [0.2126, 0.7152, 0.0722] if image.shape[2] == 3 else image[..., 0]
    image = np.maximum(image, 0)
    return np.sqrt(image / (1 + image) + 1 / 1024) - 1 / 32


def clamped(plane, row, column):
    height, width = plane.shape[:2]
    return plane[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]


FXAA_STEPS = {
    12: [1.0, 1.5, 2.0, 4.0, 12.0],
    29: [1.0, 1.5] + [2.0] * 8 + [4.0, 8.0],
    39: [1.0] * 5 + [1.5] + [2.0] * 4 + [4.0, 8.0],
}


def bilinear(plane, row, column):
    """A texture as a graphics processor samples it, at a place in pixels."""
    top, left = math.floor(row), math.floor(column)
    down, across = row - top, column - left
    corners = [[clamped(plane, top + i, left + j) for j in (0, 1)] for i in (0, 1)]
    upper = corners[0][0] * (1 - across) + corners[0][1] * across
    lower = corners[1][0] * (1 - across) + corners[1][1] * across
    return upper * (1 - down) + lower * down


def fxaa(image, hint=None, subpixel=0.75, threshold=0.166, threshold_min=0.0833, quality=39):
    image = np.asarray(image, float)
    luma = luma_of(image if hint is None else hint)
    out = image.copy()
    for y, x in np.ndindex(luma.shape):
        m = luma[y, x]
        n, s = clamped(luma, y - 1, x), clamped(luma, y + 1, x)
        w, e = clamped(luma, y, x - 1), clamped(luma, y, x + 1)
        contrast = max(m, n, s, w, e) - min(m, n, s, w, e)
        if contrast < max(threshold_min, threshold * max(m, n, s, w, e)):
            continue
        nw, ne = clamped(luma, y - 1, x - 1), clamped(luma, y - 1, x + 1)
        sw, se = clamped(luma, y + 1, x - 1), clamped(luma, y + 1, x + 1)
        edge_horizontal = abs(nw + sw - 2 * w) + 2 * abs(n + s - 2 * m) + abs(ne + se - 2 * e)
        edge_vertical = abs(nw + ne - 2 * n) + 2 * abs(w + e - 2 * m) + abs(sw + se - 2 * s)
        # Both may be equal but for rounding: then it is horizontal.
        horizontal = edge_horizontal >= edge_vertical * 0.9999
        first, second = (n, s) if horizontal else (w, e)
        side = -1 if abs(first - m) >= abs(second - m) else 1
        mean = ((first if side < 0 else second) + m) / 2
        enough = max(abs(first - m), abs(second - m)) / 4
        ends = []
        for direction in (-1, 1):
            distance = 0.0
            steps = FXAA_STEPS[quality]
            done = False
            for step in steps[:-1]:
                distance += step
                # Halfway between the two sides, where sampling takes the mean of both.
                if horizontal:
                    place = (y + 0.5 * side, x + direction * distance)
                else:
                    place = (y + direction * distance, x + 0.5 * side)
                end = bilinear(luma, *place) - mean
                done = abs(end) >= enough
                if done:
                    break
            ends.append((distance if done else distance + steps[-1], end))
        (left, left_end), (right, right_end) = ends
        nearer, end = (left, left_end) if left < right else (right, right_end)
        good = (end < 0) != (m - mean < 0)
        offset = 0.5 - nearer / (left + right) if good else 0.0
        lone = abs((2 * (n + s + w + e) + nw + ne + sw + se) / 12 - m) / contrast
        lone = min(lone, 1.0)
        offset = max(offset, subpixel * (lone * lone * (3 - 2 * lone)) ** 2)
        other = clamped(image, y + side, x) if horizontal else clamped(image, y, x + side)
        out[y, x] = image[y, x] + offset * (other - image[y, x])
    return out


def polyline_area(points, start, end):
    """Areas above and below zero under a line through points, between two places."""
    places = sorted({start, end, *(x for x, _ in points if start < x < end)})
    above = below = 0.0
    for left, right in itertools.pairwise(places):
        across, up = np.asarray(points, float).T
        heights = [np.interp(x, across, up) for x in (left, right)]
        cuts = [(left, heights[0]), (right, heights[1])]
        if heights[0] * heights[1] < 0:
            cuts.insert(1, (left + (right - left) * heights[0] / (heights[0] - heights[1]), 0.0))
        for (x0, y0), (x1, y1) in itertools.pairwise(cuts):
            area = (x1 - x0) * (y0 + y1) / 2
            above, below = above + max(area, 0), below + max(-area, 0)
    return above, below


def mlaa_edges(image, threshold=0.1):
    """Edges at the top and at the left of each pixel."""
    luma = luma_of(image)
    top, left = np.zeros(luma.shape, bool), np.zeros(luma.shape, bool)
    top[1:] = np.abs(np.diff(luma, axis=0)) >= threshold
    left[:, 1:] = np.abs(np.diff(luma, axis=1)) >= threshold
    return top, left


def mlaa_shares(lines, crossings, search):
    """Shares above and below each edge of `lines`, which run along rows."""
    height, width = lines.shape
    crossing = np.zeros((height + 1, width + 1), bool)
    crossing[1:, :width] = crossings
    above, below = np.zeros(lines.shape), np.zeros(lines.shape)
    for y, x in zip(*np.nonzero(lines), strict=True):
        left = right = 0
        while left < search and x - left - 1 >= 0 and lines[y, x - left - 1]:
            left += 1
        while right < search and x + right + 1 < width and lines[y, x + right + 1]:
            right += 1
        heights = []
        for place in (x - left, x + right + 1):
            # Row y of `crossing` is the row above the line.
            up, down = crossing[y, place], crossing[y + 1, place]
            heights.append(0.0 if up == down else 0.5 if up else -0.5)
        length = left + right + 1
        points = [(0.0, heights[0]), (length / 2, 0.0), (float(length), heights[1])]
        above[y, x], below[y, x] = polyline_area(points, float(left), left + 1.0)
    return above, below


def mlaa(image, threshold=0.1, search=12, edges=None):
    image = np.asarray(image, float)
    edges = mlaa_edges(image, threshold) if edges is None else edges
    top, left = np.asarray(edges[0]), np.asarray(edges[1])
    above, below = mlaa_shares(top, left, search)
    shares = mlaa_shares(left.T, top.T, search)
    before, after = shares[0].T, shares[1].T
    height, width = len(top), top.shape[-1]
    out = image.copy()
    for y, x in np.ndindex(top.shape):
        mixes = [(below[y, x], y - 1, x), (after[y, x], y, x - 1)]
        if y + 1 < height:
            mixes.append((above[y + 1, x], y + 1, x))
        if x + 1 < width:
            mixes.append((before[y, x + 1], y, x + 1))
        mixes = [(share, image[i, j]) for share, i, j in mixes if share > 0]
        if mixes:
            total = sum(share for share, _ in mixes)
            own = image[y, x]
            out[y, x] = sum(a * ((1 - a) * own + a * other) for a, other in mixes) / total
    return out


def defocus(color, depth, disc, tap, samples, radius, extent):
    """Two layers of a gather; `disc` is the signed radius of each pixel's disc."""
    color, depth, tap = (np.asarray(values, float) for values in (color, depth, tap))
    disc = np.clip(disc, -radius, radius)
    height, width = depth.shape
    out = color.copy()

    def inside(away, size):
        return min(max(size - away + 0.5, 0.0), 1.0)

    for y, x in np.ndindex(depth.shape):
        tile_row, tile_column = y // radius, x // radius
        rows = slice(max(tile_row - 1, 0) * radius, (tile_row + 2) * radius)
        columns = slice(max(tile_column - 1, 0) * radius, (tile_column + 2) * radius)
        near, own = max(0.0, np.max(-disc[rows, columns])), abs(disc[y, x])
        if max(near, own) <= 0.5:
            continue
        first = 0 if near <= 0.5 else samples // 2 if own > 0.5 else samples
        front, back = np.zeros(color.shape[2]), color[y, x].copy()
        coverage, weight = 0.0, 1.0
        for i in range(samples):
            in_own = i >= first
            number, count = (i - first, samples - first) if in_own else (i, first)
            size = (own if in_own else near) + 0.5
            angle = i * math.pi * (3 - math.sqrt(5)) + math.pi * tap[y, x]
            distance = size * math.sqrt((number + 0.5) / count)
            right = math.floor(distance * math.cos(angle) + 0.5)
            down = math.floor(distance * math.sin(angle) + 0.5)
            row, column = y + down, x + right
            if right == down == 0 or not (0 <= row < height and 0 <= column < width):
                continue
            away, area = math.hypot(right, down), math.pi * size**2 / count
            nearer = 1 / depth[row, column] - 1 / depth[y, x]
            largest = max(1 / depth[row, column], 1 / depth[y, x])
            nearer = min(max(nearer / largest / extent, 0.0), 1.0) if largest > 0 else 0.0
            if in_own == (disc[row, column] >= 0):
                other = abs(disc[row, column])
                light = nearer * area * inside(away, other)
                light /= max(math.pi * (other**2 + 1 / 12), 1.0)
                front, coverage = front + light * color[row, column], coverage + light
            if in_own:
                share = (1 - nearer) * area * inside(away, own)
                back, weight = back + share * color[row, column], weight + share
        covered = min(coverage, 1.0)
        out[y, x] = (1 - covered) * back / weight
        if coverage > 0:
            out[y, x] += covered * front / coverage
    return out


def reblur(image, frame, parameters):
    """The mean of three pixels along the motion, pixel by pixel."""
    image = np.asarray(image, float)
    velocity, depth = np.asarray(frame.velocity, float), np.asarray(frame.depth, float)
    height, width = depth.shape
    out = image.copy()
    for y, x in np.ndindex(height, width):
        own = velocity[y, x]
        speed = np.hypot(*own)
        if speed <= parameters.shortest:
            continue
        total, mixed = 1.0, image[y, x].copy()
        for side in (-1, 1):
            across, down = side * own / speed
            row, column = y + int(np.floor(down + 0.5)), x + int(np.floor(across + 0.5))
            if not (0 <= row < height and 0 <= column < width):
                continue
            depths = sorted((depth[y, x], depth[row, column]))
            if depths[0] < (1 - parameters.surface) * depths[1]:
                continue
            if np.hypot(*(velocity[row, column] - own)) > parameters.alike * speed:
                continue
            top, left = int(np.floor(down)), int(np.floor(across))
            light = np.zeros(image.shape[2])
            for i, j in itertools.product((0, 1), (0, 1)):
                share = abs(1 - i - (down - top)) * abs(1 - j - (across - left))
                at = np.clip(y + top + i, 0, height - 1), np.clip(x + left + j, 0, width - 1)
                light += share * image[at]
            apart = np.abs(np.sqrt(light) - np.sqrt(image[y, x])).max() / parameters.noise
            weight = np.exp(-(apart**2))
            mixed, total = mixed + weight * light, total + weight
        out[y, x] = mixed / total
    return out
