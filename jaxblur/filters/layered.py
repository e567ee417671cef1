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
from jax import lax

from ..frame import Frame, check_frame, check_parameters
from ..noise import Noise, resolve_noise
from ..safe_math import safe_norm
from ..sample_sums import sum_samples
from ..sampling import color_table, read_color, read_nearest, read_position
from ..settings import Settings
from ..tiles import clamp_speed
from ..weights import finite_depth
from .masking import honoring_mask
from .reaching import SLOWEST, fine_tile, reaching_pixels
from .silhouettes import purest_neighbor

GUESSES = 3


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
    """

    front_sharpness: float | jax.Array = 10.0
    landing_tolerance: float | jax.Array = 1.0
    own_tolerance: float | jax.Array = 0.35
    surface_sharpness: float | jax.Array = 20.0
    bend: float | jax.Array = 0.5
    jitter: float | jax.Array = 1.0
    distinct: float | jax.Array = 1.0


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
    guesses = [
        _guess(size, settings, time, way, tables, local)
        for time, way in zip(times, local["ways"], strict=True)
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


def _once(moves, function, planes, *more):
    """Apply a function to planes where anything moves at all, else give its first ones back.

    XLA would compute what leads to a read again for each of the reads; it does not look into
    conditionals.
    """
    return lax.cond(moves, function, lambda planes, *_: list(planes), list(planes), *more)


def _purest(planes, log_depth, sharpness):
    """The planes of a motion, at silhouettes read where the motion is least mixed."""
    index = purest_neighbor(planes[0], planes[1], log_depth, sharpness)
    return [read_nearest(plane.reshape(-1), index) for plane in planes]


def _turn(velocity, log_depth, sharpness):
    """Change of velocity along the own way, (v . grad) v; 0 beyond the ends of the surface."""
    x, y = velocity
    squared = jnp.square(x) + jnp.square(y)
    planes = [plane.reshape(-1) for plane in (x, y, log_depth)]

    def change(side):
        texels = read_position(side * x[..., None], side * y[..., None], x.shape, "clamp")
        near_x, near_y, near_depth = (read_nearest(p, texels.index)[..., 0] for p in planes)
        near_x, near_y = near_x - x, near_y - y
        alike = jnp.square(near_x) + jnp.square(near_y) < 0.25 * squared
        alike = alike & (jnp.abs(near_depth - log_depth) * sharpness < 1)
        return jnp.where(alike, near_x, 0), jnp.where(alike, near_y, 0), jnp.where(alike, 0.5, 0)

    ahead, back = change(0.5), change(-0.5)
    scale = 1 / jnp.maximum(ahead[2] + back[2], 0.5)
    return [scale * (ahead[0] - back[0]), scale * (ahead[1] - back[1])]


def _motion(frame, parameters, settings, log_depth):
    """Velocity, turn and bend of the own way of every pixel, each as x and y.

    A point s gets to p at time t if ``s + t v(s) + t^2 a(s) = p``, a being half its acceleration;
    to second order ``s = p - t v + t^2 ((v . grad) v - a)``. Where no path tells a, velocities
    are taken to stay where they are in the image, and a is half the turn.
    """
    velocity, sharpness = frame.velocity, parameters.surface_sharpness
    if frame.path is not None:
        velocity = (frame.path[..., 1, :] - frame.path[..., 0, :]) / 2
    velocity, _ = clamp_speed(velocity, settings.radius)
    planes = [velocity[..., 0], velocity[..., 1]]
    if frame.path is not None:
        planes += [(frame.path[..., 0, axis] + frame.path[..., 1, axis]) / 2 for axis in (0, 1)]
    moves = jnp.any(planes[0] != 0) | jnp.any(planes[1] != 0)
    x, y, *half = _once(moves, _purest, planes, log_depth, sharpness)
    turn = _once(moves, _turn, (x, y), log_depth, sharpness)
    bend = tuple(
        component - half[axis] if half else parameters.bend * component
        for axis, component in enumerate(turn)
    )
    return (x, y), tuple(turn), bend


def _ways(motion, pixels, size, parameters):
    """The three ways to guess along: velocity, turn, bend and share of "own" of each."""
    (x, y), *curves = motion
    height, width = x.shape
    ways = [(*motion, jnp.ones_like(x))]
    for grid in pixels:
        pixel = jnp.maximum(grid, 0)
        exists, other_x, other_y = (
            jnp.repeat(jnp.repeat(plane, size, axis=0), size, axis=1)[:height, :width]
            for plane in (grid >= 0, x.reshape(-1)[pixel], y.reshape(-1)[pixel])
        )
        apart = jnp.square(other_x - x) + jnp.square(other_y - y)
        differs = jnp.clip(2 * apart / jnp.square(parameters.distinct) - 1, 0, 1)
        differs = jnp.where(exists, differs, 0)
        own = 1 - differs
        way = (x + differs * (other_x - x), y + differs * (other_y - y))
        ways.append((way, *(tuple(own * part for part in parts) for parts in curves), own))
    return jax.tree.map(lambda plane: plane[..., None], ways)


@honoring_mask
@functools.partial(jax.jit, static_argnames=("settings",))
def layered(
    frame: Frame,
    parameters: LayeredParameters,
    *,
    settings: Settings = Settings(),
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
    shape = frame.depth.shape
    noise = resolve_noise(noise, settings.noise, *shape)
    parameters = jax.tree.map(lambda p: jnp.asarray(p, frame.color.dtype), parameters)
    log_depth = jnp.log(finite_depth(frame.depth))
    motion = _motion(frame, parameters, settings, log_depth)
    x, y = motion[0]
    speed = safe_norm(x, y)
    size = fine_tile(settings.radius)
    tiles = reaching_pixels(x, y, speed, log_depth, size)
    ways = _ways(motion, tiles, size, parameters)
    own_tolerance = jnp.square(parameters.own_tolerance) * (jnp.square(speed) + 0.01)
    local = {
        "ways": ways,
        "depth": log_depth[..., None],
        "jitter": noise.tap.astype(frame.color.dtype)[..., None] * (parameters.jitter / 2),
        "inverse_own": 1 / own_tolerance[..., None],
        "inverse_tolerance": 1 / jnp.square(parameters.landing_tolerance),
        "surface_sharpness": parameters.surface_sharpness,
        "front_sharpness": parameters.front_sharpness,
    }
    read = {"x": x, "y": y, "depth": log_depth}
    tables = {
        "motion": {name: plane.reshape(-1) for name, plane in read.items()},
        "color": color_table(frame.color),
    }
    moving = (speed > SLOWEST) | (ways[1][-1][..., 0] < 1) | (ways[2][-1][..., 0] < 1)
    count = settings.samples // GUESSES
    sample = functools.partial(_slice, shape, settings, count)
    *colors, weight = sum_samples(sample, count, moving, local, tables, settings.backend)
    blurs = moving & (weight > 1e-3)
    mean = jnp.stack(colors, axis=-1) / jnp.where(blurs, weight, 1)[..., None]
    return jnp.where(blurs[..., None], mean, frame.color)
