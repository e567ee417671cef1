"""Motion blur by slices of time: in each, what is in front at the pixel then.

The exposure is cut into slices. In a slice at time t, in [-1, 1], the surface point that has moved
to a pixel p was, in the sharp frame, at an s with ``s + t v(s) = p``. Three guesses are made for
it: along the pixel's own velocity, and along the two velocities that matter in the neighborhood
(`.reaching`). A guess whose own velocity carries it to p has landed; of those that have
landed along different velocities, the nearest hides the others. Where none has landed, p's
surface has moved away and what it hid is not in the frame: the guess along the own velocity, if
it lies behind, stands for it. The result is the mean over the slices, so that an object covers a
pixel for as long as it is there.
"""

import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp

from ..frame import Frame, check_frame, check_parameters
from ..gathers import cond_of_values, gather_samples, unchanged
from ..native import Stages
from ..noise import Noise, resolve_noise
from ..safe_math import safe_norm
from ..sampling import (
    channel,
    path_samples,
    read_color,
    read_color_along,
    read_position,
    read_row,
    sample_limit,
)
from ..settings import Settings, checked_settings
from ..tiles import own_tile, shortening
from ..weights import SPEED_FLOOR, anything_moves
from .masking import honoring_mask
from .parameters import LayeredParameters as LayeredParameters
from .reaching import fine_tile, reaching_pixels
from .silhouettes import purest_motion, taken_from

GUESSES = 3

SMALLEST_WEIGHT = 1e-3
"""Slices of which less is known together do not count."""


jax.tree_util.register_dataclass(LayeredParameters)


def _times(index, count, jitter):
    """Times of the three guesses in slice i: thirds of the slice, the own guess in the middle.

    The other two change sides in the middle of the exposure, so that a reversed motion reads the
    same texels; in the middle slice of an odd number they join the own guess.
    """
    index = index.astype(jitter.dtype)
    center = 2 * (index + 0.5) - count
    side = jnp.sign(center)
    third, slice_length = 2 / GUESSES, 1 / count
    jitter = jitter * third * slice_length
    return [(center + side * k * third) * slice_length + jitter for k in (0, -1, 1)]


def _guess(size, border, interpolates, time, way, tables, local):
    """Read one guess: its texel, how surely it lands, its log depth, its color."""
    (x, y), (turn_x, turn_y), (bend_x, bend_y), own = way
    squared = time * time
    texels = read_position(squared * bend_x - time * x, squared * bend_y - time * y, size, border)
    read_x, read_y, depth = read_row(tables["motion"], texels.index, 4, 3)
    apart_x, apart_y = read_x - x + time * turn_x, read_y - y + time * turn_y
    apart = jnp.square(apart_x) + jnp.square(apart_y)
    # It lands if it hardly misses the pixel, or is of the pixel's surface: if neither its velocity
    # nor its depth differs. Where two of these are the same the derivative is that of one.
    hits = 1.5 - squared * apart * local["inverse_tolerance"]
    moves_alike = 1.5 * own - apart * local["inverse_own"]
    as_deep = 1.5 * own - jnp.abs(depth - local["depth"]) * local["surface_sharpness"]
    same = jnp.where(moves_alike < as_deep, moves_alike, as_deep)
    lands = jnp.clip(jnp.where(hits > same, hits, same), 0, 1)
    lands = jnp.where(texels.counts, lands, 0)
    if interpolates:
        color = read_color_along(tables["color"], texels, size, jnp.abs(x) >= jnp.abs(y))
    else:
        color = read_color(tables["color"], texels, size, "nearest")
    return texels, lands, depth, color


def _visible(lands, depths, own, sharpness):
    """Share of each landed guess in what is seen, and the share that none of them fills.

    Guesses along one velocity, as far as they are that, are of other times, and do not hide each
    other.
    """
    shares = list(lands)
    for j, k in itertools.combinations(range(len(lands)), 2):
        # How surely j is in front of k, or k of j. Equal depths differ by 0, whatever is rounded.
        order = jnp.clip(sharpness * (depths[k] - depths[j]), -1, 1)
        order = (1 - own[j] * own[k]) * order
        behind = jnp.maximum(order, 0)
        shares[k] = shares[k] * (1 - lands[j] * behind)
        shares[j] = shares[j] * (1 - lands[k] * (behind - order))
    empty = functools.reduce(jnp.multiply, [1 - landed for landed in lands])
    total = functools.reduce(jnp.add, shares)
    filled = (1 - empty) / jnp.maximum(total, 1e-6)
    return [share * filled for share in shares], empty


def _slice(size, settings, count, index, local, tables):
    """Color and weight of one slice of the exposure."""
    count = local.get("count", count)
    times = _times(index, count, local["jitter"])
    # Interpolating the other guesses too gains 0.1 dB and takes a fifth more time.
    interpolates = (settings.fetch == "bilinear", False, False)
    ways = _ways(local)
    guesses = [
        _guess(size, settings.border, mixes, time, way, tables, local)
        for mixes, time, way in zip(interpolates, times, ways, strict=True)
    ]
    texels, lands, depths, colors = zip(*guesses, strict=True)
    sharpness = local["front_sharpness"]
    shares, empty = _visible(lands, depths, [way[-1] for way in ways], sharpness)
    behind = jnp.clip(sharpness * (depths[0] - local["depth"]), 0, 1)
    shares[0] = shares[0] + empty * jnp.where(texels[0].counts, behind, 0)
    if "count" in local:
        shares = [jnp.where(index < count, share, 0) for share in shares]
    weight = functools.reduce(jnp.add, shares)
    mixed = [
        functools.reduce(
            jnp.add, [share * color for share, color in zip(shares, channel, strict=True)]
        )
        for channel in zip(*colors, strict=True)
    ]
    return (*mixed, weight)


def _half_acceleration(size, radius, taken, tables):
    """Half the acceleration of the path that a pixel's motion is from, x, y."""
    across, down = taken_from(taken)
    index = read_position(across, down, size, "clamp").index
    opening_x, opening_y, closing_x, closing_y = read_row(tables["path"], index, 4)
    x, y = (opening_x + closing_x) / 2, (opening_y + closing_y) / 2
    # No longer than the radius, so that taps have a farthest place, and shorter by as much as the
    # velocity is.
    speed = safe_norm((closing_x - opening_x) / 2, (closing_y - opening_y) / 2)
    shorter = shortening(speed, radius) * shortening(safe_norm(x, y), radius)
    return [x * shorter, y * shorter]


def _reaching_velocities(motion, settings):
    """The two velocities that matter in each fine tile, (rows, columns, 4); 0 for none."""
    pixels = reaching_pixels(motion, settings.radius, settings.backend)
    vectors = motion.reshape(-1, motion.shape[-1])[pixels, :2]
    vectors = jnp.where((pixels >= 0)[..., None], vectors, 0)
    return jnp.concatenate(list(vectors), axis=-1)


def _turn(size, motion, local, tables):
    """Change of velocity along the own way, (v . grad) v; 0 beyond the ends of the surface."""
    x, y, own_depth, _ = motion
    squared = jnp.square(x) + jnp.square(y)

    def change(side):
        index = read_position(side * x, side * y, size, "clamp").index
        near_x, near_y, depth = read_row(tables["motion"], index, 4, 3)
        near_x, near_y = near_x - x, near_y - y
        depth_apart = jnp.abs(depth - own_depth) * local["surface_sharpness"]
        alike = (jnp.square(near_x) + jnp.square(near_y) < squared / 4) & (depth_apart < 1)
        return jnp.where(alike, near_x, 0), jnp.where(alike, near_y, 0), alike

    ahead, back = change(0.5), change(-0.5)
    scale = jnp.where(ahead[2] & back[2], 1, 2).astype(x.dtype)
    return scale * (ahead[0] - back[0]), scale * (ahead[1] - back[1])


def _others(x, y, velocities, local):
    """For both velocities of the tile: x, y, and how surely it is no other than the own one."""
    others = []
    for other_x, other_y in (velocities[:2], velocities[2:]):
        apart = jnp.square(other_x - x) + jnp.square(other_y - y)
        differs = jnp.clip(apart * (2 / jnp.square(local["distinct"])) - 1, 0, 1)
        exists = (other_x != 0) | (other_y != 0)
        differs = jnp.where(exists, differs, 0)
        others.append((x + differs * (other_x - x), y + differs * (other_y - y), 1 - differs))
    return others


def _ways(local):
    """The three ways to guess along: velocity, turn, bend and share of "own" of each.

    A point s gets to p at time t if ``s + t v(s) + t^2 a(s) = p``, a being half its acceleration;
    to second order ``s = p - t v + t^2 ((v . grad) v - a)``. Where no path tells a, velocities
    are taken to stay where they are in the image, and a is half the turn.
    """
    turn, half = local["turn"], local["half"]
    if half:
        bend = [part - other for part, other in zip(turn, half, strict=True)]
    else:
        bend = [local["bend"] * part for part in turn]
    ways = [(local["velocity"], turn, bend, 1.0)]
    for x, y, own in local["others"]:
        ways.append(((x, y), [own * part for part in turn], [own * part for part in bend], own))
    return ways


def _is_moving(settings, local, tables):
    """Whether a pixel moves, or anything reaches its tile; its motion, and what reaches it."""
    motion = [channel(local["motion"], k) for k in range(4)]
    tile = own_tile(local["motion"].shape, fine_tile(settings.radius))
    velocities = read_row(tables["others"], tile, 4)
    reached = functools.reduce(jnp.logical_or, [part != 0 for part in velocities])
    squared = jnp.square(motion[0]) + jnp.square(motion[1])
    return reached | (squared > SPEED_FLOOR**2), (motion, velocities)


def _path_slices(squared, others, settings):
    """How many slices the longest of the three paths takes."""
    for x, y, _ in others:
        squared = jnp.maximum(squared, jnp.square(x) + jnp.square(y))
    slices = dataclasses.replace(settings, samples=settings.samples // GUESSES)
    return path_samples(jnp.sqrt(squared), slices)


def _prepare(size, settings, local, tables, found):
    """What the slices of a pixel use as it is."""
    (x, y, depth, taken), velocities = found
    half = ()
    if "path" in tables:
        half = _half_acceleration(size, settings.radius, taken, tables)
    others = _others(x, y, velocities, local)
    squared = jnp.square(x) + jnp.square(y)
    tolerance = jnp.square(local["own_tolerance"]) * (squared + SPEED_FLOOR**2)
    moving = squared > SPEED_FLOOR**2
    for _, _, own in others:
        moving = moving | (own < 1)
    kept = ("front_sharpness", "surface_sharpness", "bend")
    needed = {
        "velocity": (x, y),
        "turn": _turn(size, found[0], local, tables),
        "half": half,
        "others": others,
        "depth": depth,
        "moving": moving.astype(x.dtype),
        "inverse_own": 1 / tolerance,
        "inverse_tolerance": 1 / jnp.square(local["landing_tolerance"]),
        "jitter": local["noise"] * local["jitter"] / 2,
    } | {name: local[name] for name in kept}
    return needed | _path_slices(squared, others, settings)


def _finish(sums, prepared, local):
    """The mean over the slices, and the color itself where nothing moves or nothing is seen."""
    *colors, weight = sums
    blurs = (prepared["moving"] > 0) & (weight > SMALLEST_WEIGHT)
    inverse = 1 / jnp.where(blurs, weight, 1)
    return tuple(
        jnp.where(blurs, color * inverse, channel(local["color"], k))
        for k, color in enumerate(colors)
    )


def _blur(settings, frame, parameters, noise, _anything):
    """The image."""
    shape = frame.depth.shape
    noise = resolve_noise(noise, settings.noise, *shape)
    motion = purest_motion(
        *(frame, settings.radius, parameters.surface_sharpness, parameters.thin_coverage),
        settings.backend,
    )
    local = vars(parameters) | {
        "motion": motion,
        "color": frame.color,
        "noise": noise.tap.astype(frame.color.dtype)[..., None],
    }
    images = {
        "motion": motion,
        "color": frame.color,
        "others": _reaching_velocities(motion, settings),
    }
    if frame.path is not None:
        images["path"] = frame.path
    tables = {name: image.reshape(-1) for name, image in images.items()}
    count = settings.samples // GUESSES
    stages = Stages(
        moving=functools.partial(_is_moving, settings),
        prepare=functools.partial(_prepare, shape, settings),
        sample=functools.partial(_slice, shape, settings, count),
        finish=_finish,
        limit=sample_limit(settings),
    )
    return gather_samples(stages, count, frame.color, local, tables, settings.backend)


def _keep(frame, *others):
    """The same where nothing moves."""
    return unchanged(frame.color, others[-1])


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
        frame: color (H, W, C), depth (H, W), velocity (H, W, 2) half-spread in pixels; a path, if
            there is one, is followed instead of the velocity, whose derivative is 0 then.
        parameters: see `LayeredParameters`.
        settings: samples (three to a slice, the rest left over), radius, spacing, border, fetch,
            noise, backend; the others are not used. ``bilinear`` mixes the two texels next to the
            guess along the own velocity, along the axis that it follows more; the other guesses
            read the nearest texel.
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
    settings = checked_settings(settings, Settings, "layered")
    check_parameters(parameters, LayeredParameters)
    if settings.samples < GUESSES:
        raise ValueError(f"`samples` must be at least {GUESSES}, got {settings.samples}.")
    frame = check_frame(frame)
    parameters = jax.tree.map(lambda p: jnp.asarray(p, frame.color.dtype), parameters)
    vectors = frame.velocity if frame.path is None else frame.path
    anything = anything_moves(vectors)
    return cond_of_values(
        *(anything, functools.partial(_blur, settings), _keep),
        (frame, parameters, noise, anything),
    )
