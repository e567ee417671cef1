"""A Fast and Stable Feature-Aware Motion Blur Filter [Guertin, McGuire, Nowrouzezahrai 2014]."""

import functools

import jax
import jax.numpy as jnp
from jax import lax

from ..frame import Frame, check_frame, check_parameters
from ..gathers import cond_of_values, everywhere, gather_samples, unchanged
from ..native import Stages
from ..noise import Noise, resolve_noise
from ..safe_math import safe_norm
from ..sampling import (
    channel,
    path_samples,
    read_color,
    read_position,
    read_row,
    sample_limit,
    tap_position,
)
from ..settings import GuertinSettings, Settings, checked_settings
from ..tiles import (
    dominant_velocity,
    own_tile,
    reachable_tiles,
    sample_tiles,
    shortening,
    stochastic_tile,
    tile_variance,
)
from ..weights import (
    SPEED_FLOOR,
    anything_moves,
    cone,
    cylinder,
    finite_depth,
    floored_speed,
    relative_closeness,
)
from .masking import append_mask, divide_by_mask
from .parameters import GuertinParameters as GuertinParameters
from .two_directions import follows_center, tile_choices, two_directions

PERPENDICULAR = 1e-6
"""Cosine of an angle that counts as a right one."""
MOTION = ("x", "y", "inverse_speed", "depth")
"""What is known of a pixel's motion, neighbors in memory."""
REC709_LUMA = (0.2126, 0.7152, 0.0722)


jax.tree_util.register_dataclass(GuertinParameters)


def _weight(distance, along_pixel, along_sample, sample, local):
    """Weight of one tap (pass 8 of the specification, Annexe I with departures 1 and 4).

    ``f cone(T, |vs|) wB + b cone(T, |vc|) wA + 2 cylinder(T, min(|vs|, |vc|)) max(wA, wB)``
    """
    in_front, behind = relative_closeness(sample["depth"], local["depth"], local["sharpness"])
    slower = jnp.maximum(sample["inverse_speed"], local["inverse_speed"])
    return (
        in_front * cone(distance, sample["inverse_speed"]) * along_sample
        + behind * cone(distance, local["inverse_speed"]) * along_pixel
        + 2 * cylinder(distance, slower) * jnp.maximum(along_pixel, along_sample)
    )


def _cosine(first, second, scale=1.0):
    """Cosine of the angle between two directions, without sign.

    Where they are perpendicular but for rounding, as the second direction of a still pixel is to
    all that moves with the dominant velocity, it is 0 and so is its derivative.
    """
    cosine = jnp.abs(first[0] * second[0] + first[1] * second[1]) * scale
    return jnp.where(cosine > PERPENDICULAR, cosine, 0)


def _alignment(second, direction, sample, local):
    """How well the pixel (wA) and the sample (wB) move along the direction of the tap."""
    along_pixel = jnp.where(second, 1, _cosine(local["center"], local["along"]))
    return along_pixel, _cosine((sample["x"], sample["y"]), direction, sample["inverse_speed"])


def _sample(size, settings, index, local, tables):
    """Weighted color, weight and count of a tap (passes 7 and 8)."""
    count = local.get("count", settings.samples)
    position = tap_position(index, count, local["jitter"])
    second = follows_center(index, settings, local.get("share"))
    direction = [
        jnp.where(second, *pair) for pair in zip(local["center"], local["along"], strict=True)
    ]
    along = position * local["reach"]
    texels = read_position(along * direction[0], along * direction[1], size, settings.border)
    read = dict(zip(MOTION, read_row(tables["motion"], texels.index, len(MOTION)), strict=True))
    alignment = (1, 1)
    if settings.direction_weights == "on":
        alignment = _alignment(second, direction, read, local)
    weight = _weight(jnp.abs(along), *alignment, read, local)
    counts = texels.counts & (index < count) if "count" in local else texels.counts
    weight = jnp.where(counts, weight, 0)
    colors = read_color(tables["color"], texels, size, settings.fetch)
    one, zero = jnp.ones((), weight.dtype), jnp.zeros((), weight.dtype)
    return (*(weight * color for color in colors), weight, jnp.where(counts, one, zero))


def _own_motion(radius, local, *_):
    """What is known of a pixel's motion, clamped to the radius."""
    shorter = shortening(local["speed"], radius)
    speed = jnp.minimum(local["speed"], radius)
    x, y = (channel(local["velocity"], k) * shorter for k in range(2))
    return [x, y, 1 / floored_speed(speed), finite_depth(local["depth"])]


def _buffers(frame, speed, tiles, noise, parameters, settings):
    """Local values and tables of the gather."""
    planes = {"speed": speed[..., None], "depth": frame.depth[..., None]}
    planes["velocity"] = frame.velocity
    stages = everywhere(functools.partial(_own_motion, settings.radius))
    motion = gather_samples(stages, 0, frame.velocity, planes, {}, settings.backend)
    local = {
        "motion": motion,
        "color": frame.color,
        "jitter": parameters.eta * parameters.phi / settings.samples,
        "gamma": parameters.gamma,
        "kappa": parameters.kappa,
        "sharpness": parameters.depth_sharpness,
    }
    if noise is not None or settings.noise != "none":
        noise = resolve_noise(noise, settings.noise, *frame.depth.shape)
        local["noise"] = noise.tap.astype(frame.color.dtype)[..., None]
        local["tile_noise"], local["tau"] = noise.tile, lax.stop_gradient(parameters.tau)
    if settings.split == "variance":
        share = sample_tiles(tile_variance(tiles), settings.radius, *frame.depth.shape)
        local["share"] = share[..., None]
    images = {"motion": motion, "dominant": tiles, "color": frame.color}
    return local, {name: image.reshape(-1) for name, image in images.items()}


def _read_dominant(settings, local, tables):
    """Dominant velocity of the tile that a pixel reads (pass 4)."""
    if settings.tile_choice == "expected":
        tile = local["tile"]
    elif settings.tile_choice == "stochastic" and "noise" in local:
        tile = stochastic_tile(local["tile_noise"], local["tau"], settings.radius)
    else:
        tile = own_tile(local["motion"].shape, settings.radius)
    return read_row(tables["dominant"], tile, 2)


def _is_moving(settings, local, tables):
    """Whether anything moves where a pixel looks, and the dominant velocity there."""
    dominant = _read_dominant(settings, local, tables)
    reach = safe_norm(*dominant)
    return reach > SPEED_FLOOR, (dominant, reach)


def _prepare_pixel(settings, local, tables, found):
    """Directions and reach of a pixel (passes 5 and 6); the rest of what its taps need."""
    dominant, reach = found
    motion = {name: channel(local["motion"], k) for k, name in enumerate(MOTION)}
    velocity, inverse_speed = (motion["x"], motion["y"]), motion["inverse_speed"]
    along, center = two_directions(velocity, inverse_speed, dominant, local["gamma"])
    kept = ("sharpness", "kappa", "share")
    needed = {name: local[name] for name in kept if name in local} | {
        "inverse_speed": inverse_speed,
        "depth": motion["depth"],
        "along": along,
        "center": center,
        "reach": reach,
        "jitter": local["noise"] * local["jitter"] if "noise" in local else jnp.zeros_like(reach),
    }
    return needed | path_samples(reach, settings)


def _finish_pixel(sums, prepared, local):
    """Mix of the color gathered and the pixel's own (passes 9 and 10)."""
    *colors, weight, count = sums
    center_weight = count * prepared["inverse_speed"] / prepared["kappa"]
    sharp = (prepared["reach"] <= SPEED_FLOOR) | (count == 0)
    inverse = 1 / jnp.where(sharp, 1, weight + center_weight)
    share = center_weight * inverse
    own = [channel(local["color"], k) for k in range(len(colors))]
    return tuple(
        jnp.where(sharp, mine, color * inverse + share * mine)
        for color, mine in zip(colors, own, strict=True)
    )


def _reconstruct(frame, local, tables, settings):
    """Gather along the two directions of every pixel, for one choice of tile (passes 4 to 10)."""
    stages = Stages(
        moving=functools.partial(_is_moving, settings),
        prepare=functools.partial(_prepare_pixel, settings),
        sample=functools.partial(_sample, frame.depth.shape, settings),
        finish=_finish_pixel,
        limit=sample_limit(settings),
    )
    return gather_samples(stages, settings.samples, frame.color, local, tables, settings.backend)


def _checked(frame: Frame, parameters: GuertinParameters) -> tuple[Frame, GuertinParameters]:
    """Frame and parameters in one dtype."""
    check_parameters(parameters, GuertinParameters)
    frame = check_frame(frame)
    return frame, jax.tree.map(lambda p: jnp.asarray(p, frame.color.dtype), parameters)


def prepare_frame(
    frame: Frame, parameters: GuertinParameters, settings: GuertinSettings
) -> tuple[Frame, GuertinParameters, jax.Array, jax.Array]:
    """Check the inputs and find the dominant velocities (passes 1 to 3).

    Args:
        frame: as `guertin2014`.
        parameters: as `guertin2014`.
        settings: its radius and diagonal tiles are used.

    Returns:
        Frame and parameters in one dtype, (H, W) speed in pixels, not clamped, and (TH, TW, 2)
        dominant velocity of the neighborhood of each tile.

    Raises:
        ValueError: shapes disagree.
    """
    frame, parameters = _checked(frame, parameters)
    speed = safe_norm(frame.velocity[..., 0], frame.velocity[..., 1])
    tiles = dominant_velocity(frame.velocity, speed, settings.radius, settings.diagonal_tiles)
    return frame, parameters, speed, tiles


def _blur_all(settings, frame, noise, parameters, _anything):
    """The image for each choice of tile, (K, H, W, C)."""
    frame, parameters, speed, tiles = prepare_frame(frame, parameters, settings)
    local, tables = _buffers(frame, speed, tiles, noise, parameters, settings)
    if settings.tile_choice != "expected":
        return _reconstruct(frame, local, tables, settings)[None]
    tau = jnp.asarray(parameters.tau)
    indices, _ = reachable_tiles(frame.depth.shape, settings.radius, tau)
    return lax.map(
        lambda tile: _reconstruct(frame, local | {"tile": tile[..., None]}, tables, settings),
        indices,
    )


def _keep(count, frame, *others):
    """The same where nothing moves."""
    color = unchanged(frame.color, others[-1])
    return jnp.broadcast_to(color, (count, *color.shape))


@functools.partial(jax.jit, static_argnames=("settings",))
def guertin2014(
    frame: Frame,
    parameters: GuertinParameters,
    *,
    settings: Settings = GuertinSettings(),
    noise: Noise | None = None,
) -> jax.Array:
    """Blur along two directions with feature-aware weights.

    Half of the taps follow the dominant velocity of the neighborhood, half the pixel's own
    velocity (or the perpendicular of the dominant one where the pixel is still), all with reach
    ``||vmax||``. The weight of a tap is

    ``f cone(T, |vs|) wB + b cone(T, |vc|) wA + 2 cylinder(T, min(|vs|, |vc|)) max(wA, wB)``

    and the pixel itself weighs ``N / (kappa |vc|)``.

    Source: Guertin et al. 2014, chapter 3 and Annexe I, with departures 1 to 5.

    Args:
        frame: color (H, W, C), depth (H, W), velocity (H, W, 2) half-spread in pixels.
        parameters: kappa, gamma, tau, eta, phi, depth_sharpness.
        settings: samples, radius, border, fetch, tile choice, split and noise.
        noise: replaces the built-in noise.

    Returns:
        (H, W, C) blurred color, within the range of the colors gathered; pixels whose
        neighborhood moves by half a pixel or less are returned bit for bit. Differentiable in
        every input; tau needs ``tile_choice="expected"``; gamma, phi and velocity move the taps,
        which changes the colors that are read under ``fetch="bilinear"`` only.

    Raises:
        ValueError: shapes disagree.
    """
    colors, chances = tile_outcomes(frame, parameters, settings=settings, noise=noise)
    # As differences from the own tile, so that pixels that nothing reaches keep their bits.
    own = colors[0]
    if len(colors) == 1:
        return own
    return own + jnp.sum(chances[1:, ..., None] * (colors[1:] - own), axis=0)


@functools.partial(jax.jit, static_argnames=("settings",))
def tile_outcomes(
    frame: Frame,
    parameters: GuertinParameters,
    *,
    settings: Settings = GuertinSettings(),
    noise: Noise | None = None,
) -> tuple[jax.Array, jax.Array]:
    """What `guertin2014` gives for each choice of tile, and how probable each choice is.

    With ``tile_choice="expected"`` these are all outcomes of ``stochastic``, so that any
    expectation over the tile jitter can be had exactly: the mean image is ``sum_k P_k c_k``, the
    expected squared error ``sum_k P_k |c_k - truth|^2``. Otherwise there is one outcome.

    Args:
        frame: as `guertin2014`.
        parameters: as `guertin2014`.
        settings: as `guertin2014`.
        noise: as `guertin2014`.

    Returns:
        Colors (K, H, W, C) and probabilities (K, H, W) that sum to 1 over K; K is 3 for
        ``expected`` (own tile, neighbor along x, neighbor along y), else 1.

    Raises:
        ValueError: shapes disagree.
    """
    settings = checked_settings(settings, GuertinSettings, "guertin2014")
    masked = frame.valid is not None
    frame = append_mask(frame) if masked else frame
    frame, parameters = _checked(frame, parameters)
    anything = anything_moves(frame.velocity)

    if settings.tile_choice == "expected":
        tau = jnp.asarray(parameters.tau)
        _, chances = reachable_tiles(frame.depth.shape, settings.radius, tau)
    else:
        chances = jnp.ones((1, *frame.depth.shape), frame.color.dtype)
    colors = cond_of_values(
        *(anything, functools.partial(_blur_all, settings), functools.partial(_keep, len(chances))),
        (frame, noise, parameters, anything),
    )
    return (divide_by_mask(colors) if masked else colors), chances


@functools.partial(jax.jit, static_argnames=("settings",))
def luma_hint(
    frame: Frame,
    parameters: GuertinParameters,
    *,
    settings: Settings = GuertinSettings(),
    noise: Noise | None = None,
) -> jax.Array:
    """Luma plane for FXAA that marks every blurred pixel as an edge.

    ``(x + y) & 1`` where `guertin2014` blurs, the luma of the color elsewhere: the antialiasing
    then smooths what noise the taps left, and nothing else.

    Source: Guertin et al. 2014, section 3.4.5; luma is that of Rec. 709, or the first channel of
    an image with fewer than three.

    Args:
        frame: as `guertin2014`.
        parameters: as `guertin2014`.
        settings: as `guertin2014`.
        noise: as `guertin2014`.

    Returns:
        (H, W): 0 or 1 at blurred pixels, linear luma elsewhere.

    Raises:
        ValueError: shapes disagree.
    """
    settings = checked_settings(settings, GuertinSettings, "guertin2014")
    frame, parameters, _, tiles = prepare_frame(frame, parameters, settings)
    height, width = frame.depth.shape
    noise = resolve_noise(noise, settings.noise, height, width)
    indices, chances = tile_choices((height, width), jnp.asarray(parameters.tau), settings, noise)
    reach = safe_norm(tiles[..., 0], tiles[..., 1]).reshape(-1)[indices]
    blurred = jnp.any((reach > SPEED_FLOOR) & (chances > 0), axis=0)
    checker = (jnp.arange(height)[:, None] + jnp.arange(width)) % 2
    weights = jnp.asarray(REC709_LUMA if frame.color.shape[-1] >= 3 else (1.0,), frame.color.dtype)
    luma = jnp.sum(frame.color[..., : len(weights)] * weights, axis=-1)
    return jnp.where(blurred, checker.astype(luma.dtype), luma)
