"""Motion blur by slices of time: in each, what is in front at the pixel then.

The exposure is cut into slices. In a slice at time t, in [-1, 1], the surface point that has moved
to a pixel p was, in the sharp frame, at an s with ``s + t v(s) = p``. Three guesses are made for
it: along the pixel's own velocity, and along the two velocities that matter in the neighborhood
(`.reaching`). A guess whose own velocity carries it to p has landed; of those that have
landed, the nearest hides the others. Where none has landed, p's surface has moved away and what
it hid is not in the frame: the guess along the own velocity, if it lies behind, stands for it.
The result is the mean over the slices, so that an object covers a pixel for as long as it is there.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp

from ..frame import Frame, check_frame, check_parameters
from ..noise import Noise, resolve_noise
from ..safe_math import safe_norm
from ..sample_sums import Stages, gather_samples
from ..sampling import channel, color_table, read_color, read_nearest, read_position
from ..settings import Settings
from ..tiles import clamp_speed, own_tile
from ..weights import SPEED_FLOOR, finite_depth
from .masking import honoring_mask
from .reaching import fine_tile, reaching_pixels
from .silhouettes import purest_motion

GUESSES = 3

SMALLEST_WEIGHT = 1e-3
"""Slices of which less is known together do not count."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class LayeredParameters:
    """Parameters of the layered filter; floats, arrays or tracers.

    Attributes:
        front_sharpness: how strictly one depth is in front of another, per unit of log depth,
            > 0: 10 makes ten percent of depth a full step.
        landing_tolerance: how far in pixels a guess may miss the pixel and still have landed, > 0.
        own_tolerance: how unlike the pixel's velocity, as a share of it, that of a point of the
            same surface may be, > 0.
        surface_sharpness: how strictly depths of the same surface agree, per unit of log depth,
            > 0.
        bend: how much the way along the own velocity bends with the change of velocity along it,
            0 to 1: 0.5 is that of a motion whose velocities stay where they are in the image.
        jitter: share of a tap's stratum over which noise moves the tap, 0 to 1.
        distinct: pixels from which on another velocity counts as different from the own, > 0.
        thin_coverage: least share of its pixels that something one pixel wide covers, 0 to 1; 1
            takes its vectors as they are.
    """

    front_sharpness: float | jax.Array = 10.0
    landing_tolerance: float | jax.Array = 1.0
    own_tolerance: float | jax.Array = 0.35
    surface_sharpness: float | jax.Array = 20.0
    bend: float | jax.Array = 0.5
    jitter: float | jax.Array = 1.0
    distinct: float | jax.Array = 1.0
    thin_coverage: float | jax.Array = 0.5


def _times(index, count, jitter):
    """Times of the three guesses in slice i: thirds of the slice, the own guess in the middle.

    The other two change sides in the middle of the exposure, so that a reversed motion reads the
    same texels; in the middle slice of an odd number they join the own guess.
    """
    index = index.astype(jitter.dtype)
    center = 2 * (index + 0.5) - count
    side = jnp.sign(center)
    return [(center + (2 * (side * k + jitter)) / GUESSES) / count for k in (0, -1, 1)]


def _guess(size, settings, time, way, tables, local):
    """Read one guess: its texel, how surely it lands, its log depth, its color."""
    (x, y), (turn_x, turn_y), (bend_x, bend_y), own = way
    squared = time * time
    texels = read_position(
        squared * bend_x - time * x, squared * bend_y - time * y, size, settings.border
    )
    read = {name: read_nearest(plane, texels.index) for name, plane in tables["motion"].items()}
    apart_x, apart_y = read["x"] - x + time * turn_x, read["y"] - y + time * turn_y
    apart = jnp.square(apart_x) + jnp.square(apart_y)
    lands = jnp.clip(1.5 - squared * apart * local["inverse_tolerance"], 0, 1)
    depth_apart = jnp.abs(read["depth"] - local["depth"])
    same = jnp.clip(1.5 - apart * local["inverse_own"], 0, 1)
    same = same * jnp.clip(1.5 - local["surface_sharpness"] * depth_apart, 0, 1)
    lands = jnp.where(texels.counts, jnp.maximum(lands, own * same), 0)
    return texels, lands, read["depth"], read_color(tables["color"], texels, size, settings.fetch)


def _in_front(sharpness, nearer, farther):
    """How surely the first log depth is in front of the second, in [0, 1]."""
    return jnp.clip(sharpness * (farther - nearer), 0, 1)


def _visible(lands, depths, sharpness):
    """Share of each landed guess in what is seen, and the share that none of them fills."""
    shares = []
    for k, (own, depth) in enumerate(zip(lands, depths, strict=True)):
        for j, (other, other_depth) in enumerate(zip(lands, depths, strict=True)):
            if j != k:
                own = own * (1 - other * _in_front(sharpness, other_depth, depth))
        shares.append(own)
    empty = functools.reduce(jnp.multiply, [1 - landed for landed in lands])
    total = functools.reduce(jnp.add, shares)
    filled = (1 - empty) / jnp.maximum(total, 1e-6)
    return [share * filled for share in shares], empty


def _slice(size, settings, count, index, local, tables):
    """Color and weight of one slice of the exposure."""
    times = _times(index, count, local["jitter"])
    # Bilinear reading of the other guesses too gains 0.1 dB and takes a fifth more time.
    nearest = dataclasses.replace(settings, fetch="nearest")
    guesses = [
        _guess(size, reading, time, way, tables, local)
        for reading, time, way in zip(
            (settings, nearest, nearest), times, local["ways"], strict=True
        )
    ]
    texels, lands, depths, colors = zip(*guesses, strict=True)
    sharpness = local["front_sharpness"]
    shares, empty = _visible(lands, depths, sharpness)
    behind = _in_front(sharpness, local["depth"], depths[0])
    shares[0] = shares[0] + empty * jnp.where(texels[0].counts, behind, 0)
    weight = functools.reduce(jnp.add, shares)
    mixed = [
        functools.reduce(
            jnp.add, [share * color for share, color in zip(shares, channel, strict=True)]
        )
        for channel in zip(*colors, strict=True)
    ]
    return (*mixed, weight)


def _motion(frame, parameters, settings, log_depth):
    """Velocity x, y, speed, and half the acceleration x, y of every pixel; that needs a path."""
    motion = frame.velocity
    if frame.path is not None:
        opening, closing = frame.path[..., 0, :], frame.path[..., 1, :]
        # What bends is as long as the radius at the most, so that taps have a farthest place.
        half, _ = clamp_speed((opening + closing) / 2, settings.radius)
        motion = jnp.concatenate([(closing - opening) / 2, half], axis=-1)
    longest = jnp.asarray(settings.radius, motion.dtype)
    speed = safe_norm(motion[..., 0], motion[..., 1])
    motion = motion * (longest / jnp.maximum(speed, longest))[..., None]
    separation, coverage = parameters.surface_sharpness, parameters.thin_coverage
    x, y, *half = purest_motion(motion, log_depth, separation, coverage, settings.backend)
    speed = safe_norm(x, y)
    # Clamped vectors tie in a tile maximum, whatever rounding made of them.
    return x, y, jnp.where(speed > longest * (1 - 1e-5), longest, speed), half


def _turn(size, local, tables):
    """Change of velocity along the own way, (v . grad) v; 0 beyond the ends of the surface."""
    x, y = local["velocity"]
    squared = jnp.square(x) + jnp.square(y)

    def change(side):
        index = read_position(side * x, side * y, size, "clamp").index
        near = {name: read_nearest(plane, index) for name, plane in tables["motion"].items()}
        near_x, near_y = near["x"] - x, near["y"] - y
        depth_apart = jnp.abs(near["depth"] - local["depth"]) * local["surface_sharpness"]
        alike = (jnp.square(near_x) + jnp.square(near_y) < squared / 4) & (depth_apart < 1)
        return jnp.where(alike, near_x, 0), jnp.where(alike, near_y, 0), alike.astype(x.dtype)

    ahead, back = change(0.5), change(-0.5)
    scale = 2 / jnp.maximum(ahead[2] + back[2], 1)
    return scale * (ahead[0] - back[0]), scale * (ahead[1] - back[1])


def _others(local, tables):
    """For both velocities of the tile: x, y, and how surely it is no other than the own one."""
    x, y = local["velocity"]
    others = []
    for table in tables["tiles"]:
        other_x, other_y = (read_nearest(table, 2 * local["tile"] + axis) for axis in (0, 1))
        apart = jnp.square(other_x - x) + jnp.square(other_y - y)
        differs = jnp.clip(2 * apart / jnp.square(local["distinct"]) - 1, 0, 1)
        exists = (other_x != 0) | (other_y != 0)
        differs = jnp.where(exists, differs, 0)
        others.append((x + differs * (other_x - x), y + differs * (other_y - y), 1 - differs))
    return others


def _ways(local, turn, others):
    """The three ways to guess along: velocity, turn, bend and share of "own" of each.

    A point s gets to p at time t if ``s + t v(s) + t^2 a(s) = p``, a being half its acceleration;
    to second order ``s = p - t v + t^2 ((v . grad) v - a)``. Where no path tells a, velocities
    are taken to stay where they are in the image, and a is half the turn.
    """
    if local["half"]:
        bend = [part - half for part, half in zip(turn, local["half"], strict=True)]
    else:
        bend = [local["bend"] * part for part in turn]
    ways = [(local["velocity"], turn, bend, 1)]
    for x, y, own in others:
        ways.append(((x, y), [own * part for part in turn], [own * part for part in bend], own))
    return ways


def _is_moving(local, tables):
    """Whether a pixel moves, or anything reaches its tile."""
    return local["moving"]


def _prepare(size, local, tables):
    """What the slices of a pixel use as it is."""
    others = _others(local, tables)
    x, y = local["velocity"]
    squared = jnp.square(x) + jnp.square(y)
    tolerance = jnp.square(local["own_tolerance"]) * (squared + SPEED_FLOOR**2)
    moving = squared > SPEED_FLOOR**2
    for _, _, own in others:
        moving = moving | (own < 1)
    return {
        "ways": _ways(local, _turn(size, local, tables), others),
        "moving": moving,
        "inverse_own": 1 / tolerance,
        "inverse_tolerance": 1 / jnp.square(local["landing_tolerance"]),
        "jitter": local["noise"] * local["jitter"] / 2,
    } | {name: local[name] for name in ("depth", "front_sharpness", "surface_sharpness")}


def _finish(sums, prepared, local):
    """The mean over the slices, and the color itself where nothing moves or nothing is seen."""
    *colors, weight = sums
    blurs = prepared["moving"] & (weight > SMALLEST_WEIGHT)
    weight = jnp.where(blurs, weight, 1)
    return tuple(
        jnp.where(blurs, color / weight, channel(local["color"], k))
        for k, color in enumerate(colors)
    )


@functools.partial(jax.jit, static_argnames=("settings",))
@honoring_mask
def layered(
    frame: Frame,
    parameters: LayeredParameters,
    *,
    settings: Settings = Settings(radius=160, fetch="bilinear"),
    noise: Noise | None = None,
) -> jax.Array:
    """Blur by slices of time.

    Args:
        frame: color (H, W, C), depth (H, W), velocity (H, W, 2) half-spread in pixels.
        parameters: see `LayeredParameters`.
        settings: samples (three to a slice, the rest left over), radius, border, fetch, noise,
            backend; the others are not used.
        noise: replaces the built-in noise; only ``tap`` is used.

    Returns:
        (H, W, C) blurred color, within the range of the colors read; pixels that nothing reaches
        are returned bit for bit. Differentiable in every input; what moves the taps changes the
        colors that are read under ``fetch="bilinear"`` only.

    Raises:
        ValueError: shapes disagree, or there are fewer than three samples.

    Source: this project; iterative image warping (Bowles et al. 2012) per time slice, with the
    neighborhood velocities of McGuire et al. 2012 drawn as lines.
    """
    check_parameters(parameters, LayeredParameters)
    if settings.samples < GUESSES:
        raise ValueError(f"`samples` must be at least {GUESSES}, got {settings.samples}.")
    frame = check_frame(frame)
    height, width = shape = frame.depth.shape
    noise = resolve_noise(noise, settings.noise, height, width)
    parameters = jax.tree.map(lambda p: jnp.asarray(p, frame.color.dtype), parameters)
    log_depth = jnp.log(finite_depth(frame.depth))
    x, y, speed, half = _motion(frame, parameters, settings, log_depth)
    tile_size = fine_tile(settings.radius)
    pixels = reaching_pixels(x, y, speed, log_depth, settings.radius)
    exists, tile = pixels >= 0, own_tile(height, width, tile_size)[..., 0]
    vectors = jnp.stack([x.reshape(-1)[pixels], y.reshape(-1)[pixels]], axis=-1)
    vectors = jnp.where(exists[..., None], vectors, 0)
    read = {"x": x, "y": y, "depth": log_depth}
    tables = {
        "motion": {name: plane.reshape(-1) for name, plane in read.items()},
        "tiles": [grid.reshape(-1) for grid in vectors],
        "color": color_table(frame.color),
    }
    planes = {
        "velocity": (x, y),
        "half": half,
        "depth": log_depth,
        "tile": tile,
        "noise": noise.tap.astype(frame.color.dtype),
        "moving": (speed > SPEED_FLOOR) | jnp.any(exists, axis=0).reshape(-1)[tile],
    }
    local = jax.tree.map(lambda plane: plane[..., None], planes) | vars(parameters)
    local["color"] = frame.color
    count = settings.samples // GUESSES
    stages = Stages(
        moving=_is_moving,
        prepare=functools.partial(_prepare, shape),
        sample=functools.partial(_slice, shape, settings, count),
        finish=_finish,
    )
    return gather_samples(stages, count, frame.color, local, tables, settings.backend)
