"""The layered filter as plain loops in float64: slow, one pixel after the other.

Nothing is shared with jaxblur: what both get wrong, no test would see.
"""

import math

import numpy as np

DISTANCES = (1, 2, 3, 4, 6, 8, 11, 16)
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


def share_of_nearer(color, nearer, row, column, offset):
    """How much of a pixel's color is that of a nearer neighbor at an offset."""

    def there(steps):
        y, x = row + steps * offset[0], column + steps * offset[1]
        if 0 <= y < color.shape[0] and 0 <= x < color.shape[1]:
            return (y, x), nearer[y, x]
        return (row, column), False

    (inner, beyond_is_nearer), (beside, _), (outer, blocked) = there(2), there(1), there(-1)
    gap = color[inner if beyond_is_nearer else beside] - color[outer]
    if blocked or not gap @ gap > 0:
        return 0.0
    return (color[row, column] - color[outer]) @ gap / (gap @ gap)


def purest(motion, depth, color, separation, coverage):
    """Motion of the own side least like the other side; of thin things the slowest possible.

    Returns the motion, and the depth of the side that it is of.
    """
    height, width = depth.shape
    out, sides = np.empty_like(motion), depth.copy()
    for row, column in np.ndindex(depth.shape):
        near = [
            (min(max(row + a, 0), height - 1), min(max(column + b, 0), width - 1))
            for a, b in AROUND
        ]
        own, taken = depth[row, column], motion[row, column].copy()
        inside = [n == (row + a, column + b) for n, (a, b) in zip(near, AROUND, strict=True)]
        nearest = min((k for k in range(8) if inside[k]), key=[depth[n] for n in near].__getitem__)
        if own - depth[near[nearest]] > 1 / separation:
            nearer = depth < own - 1 / separation
            share = share_of_nearer(color, nearer, row, column, AROUND[nearest])
            if share > 0.02:
                own, taken = depth[near[nearest]], motion[near[nearest]].copy()
        steps = [(depth[n] - own) * separation for n in near]
        other = [motion[n][:2] for n, step in zip(near, steps, strict=True) if abs(step) > 1]
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
        out[row, column], sides[row, column] = taken, own
    return out, sides


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


def paths_of(motion, depth, parameters, radius, curved):
    """Velocity and bend of every pixel, within the radius together."""
    paths = motion.copy()
    for row, column in np.ndindex(depth.shape):
        if not curved and motion[row, column][:2] @ motion[row, column][:2] > 0.25:
            turn = turn_of(motion, depth, row, column, parameters["surface_sharpness"])
            paths[row, column, 2:] = parameters["bend"] * turn
        speed, bend = (math.hypot(*part) for part in np.split(paths[row, column], 2))
        if bend > radius - speed:
            paths[row, column, 2:] *= (radius - speed) / bend
    return paths


def place_at(path, t):
    return t * path[:2] + t * t * path[2:]


def moves(path):
    return math.hypot(*path[:2]) > 0.5 or math.hypot(*path[2:]) > 0.5


def level_of(depth, radius):
    """Depths are told apart by levels, as many as a mark has room for."""
    levels = min(2 ** (31 - 2 * int(2 * radius).bit_length()), 2**23)
    doublings = depth / math.log(2) + 10
    share = np.interp(-doublings, [-70, -32, 0, 20], [0, 0.05, 0.95, 1])
    return min(max(math.floor(share * levels), 1), levels - 1)


class NominalClock:
    """A box from -1 to 1 for all rows."""

    reach = 1.0

    def __init__(self, intervals):
        self.intervals = intervals

    def of_owners(self, k, row):
        return 2 * k / self.intervals - 1

    def drawn(self, k, path, row):
        return self.of_owners(k, row)

    def of_light(self, light, row):
        return light


class Clock:
    """Any shutter: times are where shares of the light have come in."""

    CELLS = 256

    def __init__(self, intervals, shutter, height):
        self.known = {}
        self.curve = np.asarray(shutter["curve"], np.float64)
        open_, close = shutter["open"], shutter["close"]
        ends = [open_ + (close - open_) * self.share_of_time(share) for share in (0.0, 1.0)]
        self.reach = max(abs(end) for end in ends) + abs(shutter["readout"]) / 2
        self.intervals, self.height = intervals, height
        self.open, self.length = open_ / self.reach, (close - open_) / self.reach
        self.readout = shutter["readout"] / self.reach

    def light_until(self, share):
        """The integral of the curve, in units of the distance between two of its points."""
        place = share * (len(self.curve) - 1)
        first = min(int(place), len(self.curve) - 2)
        whole = sum((self.curve[k] + self.curve[k + 1]) / 2 for k in range(first))
        part = place - first
        middle = self.curve[first] + part / 2 * (self.curve[first + 1] - self.curve[first])
        return whole + part * middle

    def share_of_time(self, light):
        """By bisection; the last such time, or the first one for all of the light."""
        if light in self.known:
            return self.known[light]
        total, low, high = self.light_until(1.0), 0.0, 1.0
        for _ in range(100):
            middle = (low + high) / 2
            here = self.light_until(middle)
            if here < light * total or (here == light * total and light < 1):
                low = middle
            else:
                high = middle
        self.known[light] = (low + high) / 2
        return self.known[light]

    def later(self, row):
        return self.readout * ((row + 0.5) / self.height - 0.5)

    def of_owners(self, k, row):
        return self.open + self.length * self.share_of_time(k / self.intervals) + self.later(row)

    def drawn(self, k, path, row):
        """The time t of the row where the point is at t, by bisection."""
        start = self.of_owners(k, row)
        low, high = -1.5, 1.5
        rate = self.readout / self.height
        for _ in range(100):
            middle = (low + high) / 2
            if middle - start - rate * (middle * path[1] + middle**2 * path[3]) < 0:
                low = middle
            else:
                high = middle
        return min(max((low + high) / 2, -1.0), 1.0)

    def of_light(self, light, row):
        place = (light + 1) * self.CELLS / 2
        cell = min(max(math.floor(place), 0), self.CELLS - 1)
        first, middle, last = (self.share_of_time((cell + k) / self.CELLS) for k in (0, 0.5, 1))
        points = np.linspace(0, 1, len(self.curve))
        here = np.interp(middle, points, self.curve)
        length = self.light_until(1.0) / (len(self.curve) - 1) / self.CELLS / here
        length = min(last - first, length)
        share = middle + length * (place - cell - 0.5)
        return self.open + self.length * share + self.later(row)


def owners_of(paths, depth, radius, clock):
    """The owner of every pixel at every time, None where there is none."""
    height, width = depth.shape
    owners = []
    for k in range(clock.intervals + 1):
        found = {}
        for row, column in np.ndindex(depth.shape):
            if not moves(paths[row, column]):
                continue
            t = clock.drawn(k, paths[row, column], row)
            right, down = (math.floor(part + 0.5) for part in place_at(paths[row, column], t))
            at = row + down, column + right
            if 0 <= at[0] < height and 0 <= at[1] < width:
                mark = level_of(depth[row, column], radius), down, right
                found[at] = max(found.get(at, mark), mark)
        image = {}
        for at in np.ndindex(depth.shape):
            mark = found.get(at)
            rests = not moves(paths[at])
            if rests and (mark is None or mark[0] <= level_of(depth[at], radius)):
                image[at] = at
            elif mark is not None:
                image[at] = at[0] - mark[1], at[1] - mark[2]
        owners.append(image)
    return owners


def background_of(color, paths, depth, owners, place, parameters, clock):
    """What shows where there is no owner: a color times how much of it is known, and that."""
    row, column = place
    own, z = paths[row, column], depth[row, column]
    missing = [k for k, image in enumerate(owners) if (row, column) not in image]
    total, share = np.zeros(color.shape[2]), 0.0
    for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        for distance in DISTANCES:
            at = row + down * distance, column + right * distance
            inside = 0 <= at[0] < depth.shape[0] and 0 <= at[1] < depth.shape[1]
            if inside and depth[at] > z + 1 / parameters["surface_sharpness"]:
                seen = []
                for t in (-2 / 3, 0, 2 / 3):
                    x, y = np.array([right, down]) * distance + t * paths[at][:2]
                    where, counts = at_texel(row, column, x, y, depth.shape, "skip")
                    if counts and depth[where] > z + 1 / parameters["surface_sharpness"]:
                        seen.append(color[where])
                total += np.mean(seen, axis=0) / distance**2
                share += 1 / distance**2
                break
    exists = [True, *((row, column) in image for image in owners), True]
    gaps = [k for k in missing if not exists[k] or not exists[k + 2] or k in (0, len(owners) - 1)]
    if share == 0 or not gaps:
        return np.zeros(color.shape[2]), 0.0
    known = 0.0
    for k in missing:
        t = clock.of_owners(k, row)
        x, y = t * t * own[2:] - t * own[:2]
        where, counts = at_texel(row, column, x, y, depth.shape, "skip")
        known += counts * clip01(parameters["front_sharpness"] * (depth[where] - z))
    known /= len(missing)
    return known * total / share, known


def guess(color, paths, depth, owner, at, times, parameters, settings):
    """How surely a guess lands, its depth and color, and the way that it was made along."""
    t, own_time = times
    way = paths[at if owner is None else owner]
    x, y = -t * way[:2] - own_time**2 * way[2:]
    where, counts = at_texel(at[0], at[1], x, y, depth.shape, settings["border"])
    miss = np.array([x, y]) + t * paths[where][:2] + t * t * way[2:]
    apart = paths[where][:2] - way[:2]
    differs = max(
        (apart @ apart) / (parameters["own_tolerance"] ** 2 * (way[:2] @ way[:2] + 0.25)),
        parameters["surface_sharpness"] * abs(depth[where] - depth[at if owner is None else owner]),
    )
    misses = (miss @ miss) / parameters["landing_tolerance"] ** 2
    lands = clip01(1.5 - min(misses, differs)) if counts and owner is not None else 0.0
    if settings["fetch"] == "bilinear":
        seen = between(color, at[0] + y, at[1] + x, 1 if abs(way[0]) >= abs(way[1]) else 0)
    else:
        seen = color[where]
    return lands, depth[where], seen, way


def layered_pixel(color, paths, depth, owners, at, tap, parameters, settings, clock):
    count, intervals = settings["samples"] // 3, len(owners) - 1
    behind, known = background_of(color, paths, depth, owners, at, parameters, clock)
    total, weights = np.zeros(color.shape[2]), 0.0
    rear, rear_weights = np.zeros(color.shape[2]), 0.0
    for i in range(count):
        first = int((2 * i + 1) * (intervals / 2) / count)
        pair = []
        for k, side in enumerate((-0.5, 0.5)):
            light = (2 * i + 1 - count + side + tap * parameters["jitter"] / 2) / count
            times = clock.of_light(light, at[0]), clock.of_owners(first + k, at[0])
            owner = owners[first + k].get(at)
            pair.append(guess(color, paths, depth, owner, at, times, parameters, settings))
        (lands, z, seen, way), (other_lands, other_z, other_seen, other_way) = pair
        apart = way[:2] - other_way[:2]
        differ = clip01(2 * (apart @ apart) / parameters["distinct"] ** 2 - 1)
        hidden = differ * clip01(parameters["front_sharpness"] * (z - other_z))
        other_hidden = differ * clip01(parameters["front_sharpness"] * (other_z - z))
        shares = lands * (1 - other_lands * hidden), other_lands * (1 - lands * other_hidden)
        empty = (1 - lands) * (1 - other_lands)
        filled = (1 - empty) / max(sum(shares), 1e-6)
        shares = filled * shares[0], filled * shares[1]
        total += shares[0] * seen + shares[1] * other_seen + empty * behind
        weights += sum(shares) + empty * known
        nearer = (depth[at] - np.array([z, other_z])) * parameters["surface_sharpness"]
        shares = shares * np.clip(1.5 - nearer, 0, 1)
        rear += shares[0] * seen + shares[1] * other_seen + empty * behind
        rear_weights += sum(shares) + empty * known
    share = (count - weights) / max(rear_weights, 0.5)
    total, weights = total + share * rear, weights + share * rear_weights
    return total / weights if weights > 1e-3 else color[at]


def layered(color, depth, velocity, parameters, settings, tap, path=None, shutter=None):
    """The filter; parameters, settings and a shutter as dicts.

    A path is continued as a parabola, which a shutter longer than the nominal one shows.
    """
    intervals = min(settings["samples"] // 3, 15)
    if shutter is None:
        clock = NominalClock(intervals)
    else:
        clock = Clock(intervals, shutter, len(depth))
        parameters = parameters | {"distinct": parameters["distinct"] * clock.reach}
        velocity = velocity * clock.reach
        if path is not None:
            middle, half = (path[:, :, 1] + path[:, :, 0]) / 2, (path[:, :, 1] - path[:, :, 0]) / 2
            middle, half = middle * clock.reach**2, half * clock.reach
            path = np.stack([middle - half, middle + half], axis=2)
    color, z, radius = color.astype(np.float64), log_depth(depth), settings["radius"]
    motion = motion_of(velocity.astype(np.float64), path, radius)
    sharpness, coverage = parameters["surface_sharpness"], parameters["thin_coverage"]
    motion, z = purest(motion, z, color, sharpness, coverage)
    paths = paths_of(motion, z, parameters, radius, path is not None)
    owners = owners_of(paths, z, radius, clock)
    out = color.copy()
    for at in np.ndindex(depth.shape):
        drawn = any(image.get(at, at) != at for image in owners)
        if drawn or moves(paths[at]):
            out[at] = layered_pixel(
                color, paths, z, owners, at, tap[at], parameters, settings, clock
            )
    return out
