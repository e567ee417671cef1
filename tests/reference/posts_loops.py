"""The posts as plain NumPy loops in float64: slow, literal readings of what was published.

Nothing is shared with jaxblur, not even constants: what both get wrong, no test would see.
"""

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
