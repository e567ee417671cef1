"""The filters as plain NumPy loops in float64: slow, literal readings of the specification.

Nothing is shared with jaxblur, not even constants: what both get wrong, no test would see.
"""

import math

import numpy as np


def clamp(velocity, radius):
    """Clamped velocity. Its norms are r but for rounding, so `norm` below rounds them away."""
    out = velocity.astype(np.float64).copy()
    for row, column in np.ndindex(out.shape[:2]):
        speed = math.hypot(*out[row, column])
        if speed > radius:
            out[row, column] *= radius / speed
    return out


def norm(vector):
    """Norm in which vectors that were clamped to one length tie, as they do in real numbers."""
    return round(math.hypot(*vector), 12)


def tile_max(velocity, radius):
    height, width = velocity.shape[:2]
    tiles = np.zeros((-(-height // radius), -(-width // radius), 2))
    for tile_row, tile_column in np.ndindex(tiles.shape[:2]):
        best = -1.0
        for row in range(tile_row * radius, min(height, (tile_row + 1) * radius)):
            for column in range(tile_column * radius, min(width, (tile_column + 1) * radius)):
                speed = norm(velocity[row, column])
                if speed > best:
                    best, tiles[tile_row, tile_column] = speed, velocity[row, column]
    return tiles


def neighbor_max(tiles, diagonal_rule=True):
    rows, columns = tiles.shape[:2]
    out = tiles.copy()
    for row, column in np.ndindex(rows, columns):
        best = norm(tiles[row, column])
        for oy in (-1, 0, 1):
            for ox in (-1, 0, 1):
                y, x = row + oy, column + ox
                if (ox == oy == 0) or not (0 <= y < rows and 0 <= x < columns):
                    continue
                vx, vy = tiles[y, x]
                if diagonal_rule and ox != 0 and oy != 0 and vx * vy * ox * oy <= 0:
                    continue
                if norm(tiles[y, x]) > best:
                    best, out[row, column] = norm(tiles[y, x]), tiles[y, x]
    return out


def tile_variance(tiles):
    rows, columns = tiles.shape[:2]
    out = np.zeros((rows, columns))
    for row, column in np.ndindex(rows, columns):
        dots = []
        for y in range(max(0, row - 1), min(rows, row + 2)):
            for x in range(max(0, column - 1), min(columns, column + 2)):
                a, b = tiles[row, column], tiles[y, x]
                lengths = math.hypot(*a) * math.hypot(*b)
                dots.append(abs(a @ b) / lengths if lengths > 0 else 1.0)
        out[row, column] = 1 - sum(dots) / len(dots)
    return out


def bilinear(image, x, y):
    height, width = image.shape[:2]
    left, top = math.floor(x), math.floor(y)
    total = 0.0
    for dy, weight_y in ((0, 1 - (y - top)), (1, y - top)):
        for dx, weight_x in ((0, 1 - (x - left)), (1, x - left)):
            row = min(max(top + dy, 0), height - 1)
            column = min(max(left + dx, 0), width - 1)
            total = total + weight_x * weight_y * image[row, column]
    return total


def cone(distance, length):
    return min(max(1 - distance / length, 0), 1)


def cylinder(distance, length):
    t = min(max((distance - 0.95 * length) / (0.1 * length), 0), 1)
    return 1 - t * t * (3 - 2 * t)


def closer(a, b, sharpness):
    if a == b:
        return 1.0
    if math.isinf(a):
        return 0.0 if sharpness > 0 else 1.0
    if math.isinf(b):
        return 1.0
    return min(max(1 - sharpness * (a - b) / min(a, b), 0), 1)


def soft_depth(a, b, extent):
    if a == b:
        return 1.0
    return min(max(1 - (a - b) / extent, 0), 1)


def floored(vector):
    return max(math.hypot(*vector), 0.5)


def chosen_tile(row, column, xi, tau, radius, rows, columns):
    own = (row // radius, column // radius)
    x = (column % radius + 0.5) / radius + tau * xi[0]
    y = (row % radius + 0.5) / radius + tau * xi[1]
    step_x, step_y = math.floor(x), math.floor(y)
    if (step_x != 0) == (step_y != 0):
        return own
    neighbor = (own[0] + step_y, own[1] + step_x)
    inside = 0 <= neighbor[0] < rows and 0 <= neighbor[1] < columns
    return neighbor if inside else own


def reachable(row, column, tau, radius, rows, columns):
    """(probability, tile) of each outcome of the stochastic lookup."""
    tile_row, tile_column = row // radius, column // radius
    chances = []
    for position, step_of in ((column, lambda s: (0, s)), (row, lambda s: (s, 0))):
        u = (position % radius + 0.5) / radius
        step, distance = (-1, u) if u < 0.5 else (1, 1 - u)
        chances.append((max(0.0, 0.5 - distance / tau) if tau > 0 else 0.0, step_of(step)))
    (w_x, step_x), (w_y, step_y) = chances
    outcomes, own = [], 1.0
    for probability, (dy, dx) in ((w_x * (1 - w_y), step_x), (w_y * (1 - w_x), step_y)):
        tile = (tile_row + dy, tile_column + dx)
        if 0 <= tile[0] < rows and 0 <= tile[1] < columns:
            outcomes.append((probability, tile))
            own -= probability
    return [*outcomes, (own, (tile_row, tile_column))]


def read_tap(position, shape, border):
    """Nearest texel of a tap and whether it counts."""
    height, width = shape
    column, row = math.floor(position[0] + 0.5), math.floor(position[1] + 0.5)
    inside = 0 <= column < width and 0 <= row < height
    texel = (min(max(row, 0), height - 1), min(max(column, 0), width - 1))
    return texel, inside or border == "clamp"


def guertin_directions(own, vmax, gamma):
    """Unit vectors of the dominant velocity and of the center direction."""
    speed = math.hypot(*own)
    along = vmax / math.hypot(*vmax)
    across = np.array([-along[1], along[0]])
    if vmax[0] * own[1] < vmax[1] * own[0]:  # across @ own < 0, exact where own is vmax
        across = -across
    a = min(max((speed - 0.5) / gamma, 0), 1)
    center = (1 - a) * across + (a * own / speed if a > 0 else 0)
    return along, center / math.hypot(*center)


def guertin_weight(distance, along_pixel, along_sample, sample, own, closeness):
    """Weight of a tap; closeness is that of the sample before the pixel, and the reverse."""
    front, behind = closeness
    weight = front * cone(distance, floored(sample)) * along_sample
    weight += behind * cone(distance, floored(own)) * along_pixel
    slower = min(floored(sample), floored(own))
    return weight + 2 * cylinder(distance, slower) * max(along_pixel, along_sample)


def guertin_pixel(color, depth, velocity, vmax, row, column, tap, parameters, settings, to_center):
    """One output pixel; `to_center[i]` says which taps follow the center direction."""
    reach = math.hypot(*vmax)
    if reach <= 0.5:
        return color[row, column]
    n = settings["samples"]
    own = velocity[row, column]
    along, center = guertin_directions(own, vmax, parameters["gamma"])
    total, weights, counted = 0.0, 0.0, 0
    for i in range(n):
        j = tap * parameters["eta"] * parameters["phi"] / n
        t = -1 + 2 * (i + 1 + j) / (n + 1)
        direction = center if to_center[i] else along
        position = np.array([column, row]) + t * reach * direction
        texel, counts = read_tap(position, depth.shape, settings["border"])
        if not counts:
            continue
        counted += 1
        sample = velocity[texel]
        distance = abs(t) * reach
        w_a = abs(center @ direction)
        w_b = abs(sample @ direction) / floored(sample)
        if settings["direction_weights"] == "off":
            w_a = w_b = 1
        k = parameters["depth_sharpness"]
        front = closer(depth[texel], depth[row, column], k)
        behind = closer(depth[row, column], depth[texel], k)
        weight = guertin_weight(distance, w_a, w_b, sample, own, (front, behind))
        if settings["fetch"] == "bilinear":
            value = bilinear(color, *position)
        else:
            value = color[texel]
        total = total + weight * value
        weights += weight
    if counted == 0:
        return color[row, column]
    center_weight = counted / (parameters["kappa"] * floored(own))
    return (total + center_weight * color[row, column]) / (weights + center_weight)


def second_direction(settings, share):
    """Which of the taps follow the center direction."""
    n = settings["samples"]
    if settings["directions"] == "one":
        return [False] * n
    if settings["split"] == "even":
        return [i % 2 == 1 for i in range(n)]
    taps = round(share * n)
    return [(i + 1) * taps // n > i * taps // n for i in range(n)]


def guertin2014(color, depth, velocity, parameters, settings, tap, tile):
    """The whole filter; `settings` is a dict with the fields of jaxblur.Settings."""
    color, depth = color.astype(np.float64), depth.astype(np.float64)
    radius, height, width = settings["radius"], *depth.shape
    velocity = clamp(velocity, radius)
    tiles = neighbor_max(tile_max(velocity, radius), settings["diagonal_tiles"] == "reaching")
    rows, columns = tiles.shape[:2]
    variance = tile_variance(tiles)
    out = np.zeros_like(color)

    def pixel(row, column, which):
        share = bilinear(variance, (column + 0.5) / radius - 0.5, (row + 0.5) / radius - 0.5)
        return guertin_pixel(
            color,
            depth,
            velocity,
            tiles[which],
            row,
            column,
            tap[row, column],
            parameters,
            settings,
            second_direction(settings, share),
        )

    for row, column in np.ndindex(height, width):
        where = (row, column)
        if settings["tile_choice"] == "expected":
            for chance, which in reachable(*where, parameters["tau"], radius, rows, columns):
                out[where] += chance * pixel(*where, which)
        else:
            tau = parameters["tau"] if settings["tile_choice"] == "stochastic" else 0.0
            which = chosen_tile(*where, tile[where], tau, radius, rows, columns)
            out[where] = pixel(*where, which)
    return out


def mcguire2012(color, depth, velocity, extent, settings, tap):
    color, depth = color.astype(np.float64), depth.astype(np.float64)
    radius, n = settings["radius"], settings["samples"]
    velocity = clamp(velocity, radius)
    tiles = neighbor_max(tile_max(velocity, radius), diagonal_rule=False)
    out = color.copy()
    for row, column in np.ndindex(depth.shape):
        vmax = tiles[row // radius, column // radius]
        if math.hypot(*vmax) <= 0.5:
            continue
        own = floored(velocity[row, column])
        weights = 1 / own
        total = color[row, column] / own
        for i in range(n):
            if i == (n - 1) // 2:
                continue
            t = -1 + 2 * (i + tap[row, column] / 2 + 1) / (n + 1)
            offset = t * vmax
            texel, counts = read_tap(
                np.array([column, row]) + offset, depth.shape, settings["border"]
            )
            if not counts:
                continue
            rounded = np.floor(np.array([column, row]) + offset + 0.5) - np.array([column, row])
            distance = math.hypot(*(offset if settings["fetch"] == "bilinear" else rounded))
            other = floored(velocity[texel])
            front = soft_depth(depth[texel], depth[row, column], extent)
            behind = soft_depth(depth[row, column], depth[texel], extent)
            weight = front * cone(distance, other) + behind * cone(distance, own)
            weight += 2 * cylinder(distance, other) * cylinder(distance, own)
            if settings["fetch"] == "bilinear":
                value = bilinear(color, column + offset[0], row + offset[1])
            else:
                value = color[texel]
            total = total + weight * value
            weights += weight
        out[row, column] = total / weights
    return out


def pixel_velocity(color, velocity, settings, tap):
    color, n = color.astype(np.float64), settings["samples"]
    velocity = clamp(velocity, settings["radius"])
    out = color.copy()
    for row, column in np.ndindex(velocity.shape[:2]):
        own = velocity[row, column]
        if math.hypot(*own) <= 0.5:
            continue
        total, counted = 0.0, 0
        for i in range(n):
            t = -1 + 2 * (i + tap[row, column] / 2 + 1) / (n + 1)
            position = np.array([column, row]) + t * own
            texel, counts = read_tap(position, velocity.shape[:2], settings["border"])
            if counts:
                value = (
                    bilinear(color, *position) if settings["fetch"] == "bilinear" else color[texel]
                )
                total, counted = total + value, counted + 1
        out[row, column] = total / counted if counted else color[row, column]
    return out
