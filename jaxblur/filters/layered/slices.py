"""Motion blur by slices of time: in each, the nearest surface that covers the pixel.

The exposure is cut into slices. Who is in front at a pixel is known at some times of the exposure:
every pixel has been drawn there along its path (`.owners`). A slice takes the owners at the times
before and after it. Along the path of each it guesses which point has moved to the pixel at a time
inside the slice. A guess has landed if that point's own path carries it to the pixel; of landed
guesses along different paths the nearest hides the other. Where none has landed, the surface is
not in the frame, and `.background` stands for it. The result is the mean over the slices, so that
an object covers a pixel for as long as it is there.
"""

import dataclasses
import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import core
from jax.typing import ArrayLike
from jaxtyping import Array, Int

from ...frame import Frame, check_frame, check_frame_type, check_parameters, register_record
from ...kernels import At, Image, Outcome, cond_of_values, each_pixel, sum_over, unchanged
from ...noise import Noise, resolve_noise
from ...settings import Settings, checked_settings
from .._arguments import takes
from .._masking import append_mask, divide_by_mask
from .._sampling import find_texel, path_samples, read_color, read_color_along
from .._weights import SPEED_FLOOR, anything_moves
from ..builtin import LAYERED_SLICE, check_layered
from ..parameters import LayeredParameters
from . import background
from .neighbors import Neighbor, neighbor_of
from .owners import Coding, intervals_of, moves, owners_of, read_owner, time_of
from .paths import Path, paths_of

register_record(LayeredParameters)

SMALLEST_WEIGHT = 1e-3
"""Pixels whose slices together weigh less keep their color."""


class Images(NamedTuple):
    """Images of pass L5.

    Attributes:
        color: (H, W, C).
        paths: (H, W, 5), see `.paths.Path`.
        owners: (T H, W, 1), see `.owners.owners_of`.
        background: (H, W, C + 1), see `.background.background_of`.
        noise: (H, W, 1) in [-1, 1).
    """

    color: Image
    paths: Image
    owners: Image
    background: Image
    noise: Image


class Guess(NamedTuple):
    """A guess at the surface point that covers the pixel.

    Attributes:
        way: the path that it was guessed along.
        lands: how surely its own path carries it to the pixel, 0 to 1.
        depth: its log depth.
        color: its color.
    """

    way: Path
    lands: Array
    depth: Array
    color: tuple[Array, ...]


class Sums(NamedTuple):
    """Sums over the slices of a pixel."""

    color: tuple[Array, ...]
    weight: Array


class Plan(NamedTuple):
    """What is fixed when the program is traced.

    Attributes:
        settings: of the filter.
        slices: number of slices.
        intervals: between the times at which owners are known.
        coding: of the owners.
    """

    settings: Settings
    slices: int
    intervals: int
    coding: Coding


def blur_pixel(at: At, images: Images, parameters: LayeredParameters, plan: Plan) -> Outcome:
    """Pass L5: the mean over the slices of time."""
    settings, intervals = plan.settings, plan.intervals
    own = Path(*images.paths.here())
    height, width = jnp.asarray(images.paths.height), jnp.asarray(images.paths.width)
    # Nothing to do where the pixel rests and nothing that moves is drawn at any time.
    marks = [images.owners.read(k * height + at.row, at.column)[0] for k in range(intervals + 1)]
    reached = functools.reduce(jnp.logical_or, [mark != 0 for mark in marks])

    slices = dataclasses.replace(settings, samples=plan.slices)
    limit = None
    if settings.spacing:
        longest = own.x**2 + own.y**2
        for k in range(intervals + 1):
            owner = read_owner(at, images.owners, jnp.int32(k), own, plan.coding, (height, width))
            x, y = images.paths.read_texel(owner.texel, 2)
            longest = jnp.maximum(longest, x**2 + y**2)
        limit = path_samples(jnp.sqrt(longest), slices)
    count = plan.slices if limit is None else limit

    (noise,) = images.noise.here()
    jitter = noise * parameters.jitter / 2
    inverse_tolerance = 1 / jnp.square(parameters.landing_tolerance)
    *behind, known = images.background.here()

    def make_guess(time: Array, index: Array) -> Guess:
        owner = read_owner(at, images.owners, index, own, plan.coding, (height, width))
        way = Path(*images.paths.read_texel(owner.texel))
        # The owner is at the pixel at its own time. From there the point that is at the pixel at
        # another time is found along its velocity, which is exact where the surface turns or moves.
        own_time = time_of(index, intervals, own.x)
        squared = own_time * own_time
        offset_x = -time * way.x - squared * way.bend_x
        offset_y = -time * way.y - squared * way.bend_y
        texel = find_texel(at, offset_x, offset_y, images.color, settings)
        x, y, depth = images.paths.read_texel(texel.number, 3)
        point = Path(x, y, depth, way.bend_x, way.bend_y)
        # It lands if it hardly misses the pixel, or is of the owner's surface: if neither its
        # velocity nor its depth differs. Where two of these are equal the derivative is that of
        # one. What bends its path is nearly what bends the owner's.
        there_x, there_y = point.at(time)
        miss = jnp.square(offset_x + there_x) + jnp.square(offset_y + there_y)
        apart = jnp.square(point.x - way.x) + jnp.square(point.y - way.y)
        speed = jnp.square(way.x) + jnp.square(way.y)
        alike = jnp.square(parameters.own_tolerance) * (speed + SPEED_FLOOR**2)
        hits = 1.5 - miss * inverse_tolerance
        moves_alike = 1.5 - apart / alike
        as_deep = 1.5 - jnp.abs(point.log_depth - way.log_depth) * parameters.surface_sharpness
        same = jnp.where(moves_alike < as_deep, moves_alike, as_deep)
        lands = jnp.clip(jnp.where(hits > same, hits, same), 0, 1)
        lands = jnp.where(texel.counts & owner.exists, lands, 0)
        if settings.fetch == "bilinear":
            along_x = jnp.abs(way.x) >= jnp.abs(way.y)
            color = read_color_along(images.color, texel, along_x)
        else:
            color = read_color(images.color, texel, "nearest")
        return Guess(way, lands, point.log_depth, color)

    def slice_of_time(i: Int[Array, ""]) -> Sums:
        # The owners before and after the slice, each for a time in its own half of it.
        first = ((2 * i + 1).astype(own.x.dtype) * (intervals / 2) / count).astype(jnp.int32)
        center = (2 * i + 1).astype(own.x.dtype) - count
        before, after = (
            make_guess((center + side / 2 + jitter) / count, first + k)
            for side, k in ((-1, 0), (1, 1))
        )
        # The nearer one hides the other, as far as they move apart.
        shares, empty = visible_shares(before, after, parameters)
        if limit is not None:
            *shares, empty = [jnp.where(i < count, share, 0) for share in (*shares, empty)]
        color = [
            shares[0] * a + shares[1] * b + empty * c
            for a, b, c in zip(before.color, after.color, behind, strict=True)
        ]
        return Sums(tuple(color), shares[0] + shares[1] + empty * known)

    sums = sum_over(plan.slices, slice_of_time, limit)
    # The mean, or the pixel's own color where nothing is known.
    blurs = sums.weight > SMALLEST_WEIGHT
    inverse = 1 / jnp.where(blurs, sums.weight, 1)
    blurred = [
        jnp.where(blurs, color * inverse, kept)
        for kept, color in zip(images.color.here(), sums.color, strict=True)
    ]
    return Outcome(tuple(blurred), where=reached | moves(own))


def visible_shares(
    first: Guess, second: Guess, parameters: LayeredParameters
) -> tuple[list[Array], Array]:
    """Share of each landed guess in the visible color, and the share that neither fills.

    Guesses along one path are of other times and do not hide each other, in so far as the
    velocity is one.
    """
    apart = jnp.square(first.way.x - second.way.x) + jnp.square(first.way.y - second.way.y)
    differ = jnp.clip(apart * (2 / jnp.square(parameters.distinct)) - 1, 0, 1)
    # How surely the first is in front, or the second. Equal depths differ by 0.
    order = differ * jnp.clip(parameters.front_sharpness * (second.depth - first.depth), -1, 1)
    behind = jnp.maximum(order, 0)
    shares = [
        first.lands * (1 - second.lands * (behind - order)),
        second.lands * (1 - first.lands * behind),
    ]
    empty = (1 - first.lands) * (1 - second.lands)
    filled = (1 - empty) / jnp.maximum(shares[0] + shares[1], 1e-6)
    return [share * filled for share in shares], empty


class Others(NamedTuple):
    """What else `layered` may be given.

    Attributes:
        before: the frame before, or None.
        after: the frame after, or None.
        shutter: exposure in frames.
        hidden: see `layered_with_hidden`.
    """

    before: Frame | None
    after: Frame | None
    shutter: jax.Array
    hidden: jax.Array | None


def _blur(
    settings: Settings,
    frame: Frame,
    parameters: LayeredParameters,
    noise: Noise | None,
    others: Others,
    _: Array,
) -> jax.Array:
    """The image."""
    height, width = frame.depth.shape
    noise = resolve_noise(noise, settings.noise, height, width)
    slices = settings.samples // LAYERED_SLICE
    intervals = intervals_of(slices)
    coding = Coding.of(settings.radius)
    paths = paths_of(frame, parameters, settings)
    owners = Image(owners_of(paths, intervals, settings))
    color, paths = Image(frame.color), Image(paths)
    neighbors, times = _neighbors(others)
    hidden = others.hidden
    found = background.background_of(
        background.Images(
            color,
            paths,
            owners,
            neighbors,
            None if hidden is None else Image(hidden.reshape(-1, *hidden.shape[2:])),
        ),
        background.Inputs(parameters, times),
        background.Plan(settings, intervals, coding),
    )
    tap = Image(noise.tap.astype(frame.color.dtype))
    return each_pixel(
        blur_pixel,
        (height, width),
        Images(color, paths, owners, Image(found), tap),
        parameters,
        Plan(settings, slices, intervals, coding),
        kept=frame.color,
        backend=settings.backend,
    )


def _neighbors(others: Others) -> tuple[tuple[Neighbor, ...], tuple[Array, ...]]:
    """The neighbors that are given, and their times in half exposures."""
    given = [(frame, side) for frame, side in ((others.before, 1), (others.after, -1)) if frame]
    neighbors = tuple(neighbor_of(frame, side, others.shutter) for frame, side in given)
    return neighbors, tuple(-side * 2 / others.shutter for _, side in given)


def _keep(frame: Frame, *others: Any) -> jax.Array:
    """The same where nothing moves."""
    return unchanged(frame.color, others[-1])


@functools.partial(jax.jit, static_argnames=("settings",))
def _layered(
    frame: Frame,
    parameters: LayeredParameters,
    noise: Noise | None,
    others: Others,
    settings: Settings,
) -> jax.Array:
    check_parameters(parameters, LayeredParameters)
    frame, mask = check_frame(frame), frame.valid
    if mask is not None:
        # The frame keeps its mask, for colors that are compared.
        frame = append_mask(frame).replace(valid=mask)
    parameters = jax.tree.map(lambda p: jnp.asarray(p, frame.color.dtype), parameters)
    vectors = frame.velocity if frame.path is None else frame.path
    anything = anything_moves(vectors)
    blurred = cond_of_values(
        *(anything, functools.partial(_blur, settings), _keep),
        (frame, parameters, noise, others, anything),
    )
    return blurred if mask is None else divide_by_mask(blurred)


@takes(LayeredParameters, Settings, more=("before", "after", "shutter"))
def layered(
    frame: Frame,
    parameters: LayeredParameters,
    *,
    settings: Settings = Settings(radius=160, fetch="bilinear"),
    noise: Noise | None = None,
    before: Frame | None = None,
    after: Frame | None = None,
    shutter: ArrayLike = 0.5,
) -> jax.Array:
    """Blur by slices of time.

    Source: this project; forward warping with a depth test finds what is in front, iterative image
    warping (Bowles et al. 2012) what is at the pixel.

    Args:
        frame: color (H, W, C), depth (H, W), velocity (H, W, 2) half-spread in pixels; a path, if
            there is one, is followed instead of the velocity, whose derivative is 0 then.
        parameters: see `LayeredParameters`.
        settings: samples (three to a slice, the rest left over), radius, spacing, border, fetch,
            noise and backend. ``bilinear`` mixes the two texels next to a guess, along the axis
            that its path follows more. ``blend`` mixes what a slice adds for the four texels next
            to a guess, one guess at a time, the others at their nearest texel.
        noise: replaces the built-in noise; only ``tap`` is used.
        before: the frame before, sharp, of the same size and channels, with the motion of an
            exposure as long as that of ``frame``. It shows some of what ``frame`` hides.
        after: likewise the frame after.
        shutter: length of the exposure in frames, by which neighbors are related to it. Not used
            without them.

    Returns:
        (H, W, C) blurred color, within the range of the colors read; pixels that nothing reaches
        are returned bit for bit. Differentiable in every input, but for the number of slices, for
        what is in front, and for which surface a hidden color is taken from.

    Raises:
        ValueError: shapes or dtypes disagree, there are fewer than three samples, the radius is
            above 4095, a parameter is not a scalar, the shutter is not above 0, or the settings are
            those of another filter.
    """
    others = Others(before, after, _exposure(shutter), None)
    return _checked(frame, parameters, noise, others, settings)


def layered_with_hidden(
    frame: Frame,
    parameters: LayeredParameters,
    hidden: ArrayLike | None,
    *,
    settings: Settings = Settings(radius=160, fetch="bilinear"),
    noise: Noise | None = None,
) -> jax.Array:
    """`layered`, given the colors of surfaces that the frame does not show.

    A hook for experiments: how much of the error is due to hidden background.

    Args:
        frame: as `layered`, without a mask.
        parameters: as `layered`.
        hidden: (T, H, W, C) color of the visible surface at T times spread evenly over the
            exposure, used where no guess lands; NaN where unknown. None for `layered` itself.
        settings: as `layered`; no spacing.
        noise: as `layered`.

    Returns:
        As `layered`.

    Raises:
        ValueError: as `layered`, or the hidden colors have another shape, or there is a spacing or
            a mask beside them.
    """
    if hidden is not None:
        hidden, expected = jnp.asarray(hidden), jnp.shape(frame.color)
        if hidden.ndim != 4 or hidden.shape[1:] != expected:
            raise ValueError(f"`hidden` must have shape (T, *{expected}), got {hidden.shape}.")
        if settings.spacing or frame.valid is not None:
            raise ValueError("`hidden` works without `settings.spacing` and `frame.valid` only.")
    others = Others(None, None, jnp.float32(1), hidden)
    return _checked(frame, parameters, noise, others, settings)


def _checked_neighbor(neighbor: Frame, name: str, frame: Frame) -> Frame:
    """A neighbor as `check_frame` returns it, of the size, channels and dtype of the frame."""
    check_frame_type(neighbor, name)
    if jnp.shape(neighbor.color) != frame.color.shape:
        raise ValueError(
            f"`{name}` must have the shape of `frame`, {frame.color.shape}, got "
            f"{jnp.shape(neighbor.color)}."
        )
    try:
        checked = check_frame(neighbor)
    except ValueError as error:
        raise ValueError(str(error).replace("`frame.", f"`{name}.")) from error
    if checked.color.dtype != frame.color.dtype:
        raise ValueError(
            f"`{name}` must have the dtype of `frame`, {frame.color.dtype}, got "
            f"{checked.color.dtype}; convert all buffers to one."
        )
    return checked


def _exposure(shutter: ArrayLike) -> jax.Array:
    """The shutter as an array."""
    try:
        exposure = jnp.asarray(shutter)
    except (TypeError, ValueError) as error:
        raise ValueError(f"`shutter` must be a number of frames, got {shutter!r}.") from error
    if exposure.shape or jnp.iscomplexobj(exposure):
        kind = f"{exposure.dtype} of shape {exposure.shape}"
        raise ValueError(f"`shutter` must be a number of frames, got {kind}.")
    return exposure


def _check_shutter(shutter: jax.Array) -> None:
    """Reject an exposure that relates no frame to the next; a traced one is not looked at."""
    if not isinstance(shutter, core.Tracer) and not 0 < float(shutter) < math.inf:
        raise ValueError(
            f"`shutter` must be above 0 frames where neighbors are given, got {shutter}."
        )


def _checked(
    frame: Frame,
    parameters: LayeredParameters,
    noise: Noise | None,
    others: Others,
    settings: Settings,
) -> jax.Array:
    """Check what jit does not see, and give all frames a mask if one has one."""
    settings = checked_settings(settings, Settings, "layered")
    check_layered(settings)
    given = {name: getattr(others, name) for name in ("before", "after")}
    given = {name: neighbor for name, neighbor in given.items() if neighbor is not None}
    if given:
        frame = check_frame(frame)
        _check_shutter(others.shutter)
        given = {name: _checked_neighbor(given[name], name, frame) for name in given}
    if any(f.valid is not None for f in given.values()) or (given and frame.valid is not None):
        everything = jnp.ones(frame.depth.shape, bool)

        def masked(frame: Frame) -> Frame:
            return frame if frame.valid is not None else frame.replace(valid=everything)

        frame, given = masked(frame), {k: append_mask(masked(f)) for k, f in given.items()}
    others = others._replace(**given)
    return _layered(frame, parameters, noise, others, settings=settings)
