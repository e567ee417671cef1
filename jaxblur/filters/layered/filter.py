"""The filter `layered`: its passes in their order, and its arguments."""

import dataclasses
import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import core
from jax.typing import ArrayLike
from jaxtyping import Array

from ...frame import Frame, check_frame, check_frame_type, check_parameters, register_record
from ...kernels import Image, cond_of_values, each_pixel, unchanged
from ...lens import Lens
from ...noise import Noise, resolve_noise
from ...optics import check_lens_record
from ...settings import LayeredSettings, Settings, checked_settings
from ...shutter import Shutter, check_shutter_record
from .._arguments import refuse_nan_motion, takes
from .._masking import append_mask, divide_by_mask
from .._weights import SPEED_FLOOR, anything_moves, finite_depth
from ..builtin import LAYERED_SLICE, check_layered
from ..parameters import LayeredParameters
from . import background, holes, views
from .aperture import Aperture, maps_through_lens, points_of, with_discs
from .clock import Clock, clock_of, scaled
from .five_places import through_five_places
from .neighbors import Neighbor, neighbor_of
from .owners import Coding, maps_of, owners_of, states_of
from .paths import paths_of
from .slices import Images, Inputs, Plan, blur_pixel

register_record(LayeredParameters)


class Others(NamedTuple):
    """What else `layered` may be given.

    Attributes:
        before: the frame before, or None.
        after: the frame after, or None.
        shutter: exposure in frames.
        hidden: see `layered_with_hidden`.
        exposure: when light comes in; None for the nominal shutter.
        lens: None for a pinhole.
    """

    before: Frame | None
    after: Frame | None
    shutter: jax.Array
    hidden: jax.Array | None
    exposure: Shutter | Clock | None = None
    lens: Lens | None = None


def passes_before(
    settings: Settings,
    frame: Frame,
    parameters: LayeredParameters,
    noise: Noise | None,
    others: Others,
) -> tuple[Images, Inputs, Plan]:
    """What pass L5 reads: passes L0 to L4.

    Args:
        settings: of the filter.
        frame: checked; velocities are in units of the longest time of the exposure.
        parameters: arrays.
        noise: as `layered`.
        others: with a `Clock`, if there is an exposure.

    Returns:
        Images, scalars, and what is fixed.
    """
    height, width = frame.depth.shape
    noise = resolve_noise(noise, settings.noise, height, width)
    slices = settings.samples // LAYERED_SLICE
    maps = maps_of(slices)
    coding = Coding.of(settings.radius)
    paths = _paths(frame, parameters, settings, others)
    clock = others.exposure if isinstance(others.exposure, Clock) else None
    times, span = (None, None) if clock is None else (clock.times(), clock.span)
    owners = Image(owners_of(paths, maps, settings, clock))
    color, paths = Image(frame.color), Image(paths)
    states = Image(states_of(owners, paths, maps, settings))
    neighbors, their_times = _neighbors(others, frame, settings)
    hidden = others.hidden
    found = background.known_colors(
        background.background_of_pixel,
        background.Images(
            color,
            paths,
            owners,
            states,
            neighbors,
            None if hidden is None else Image(hidden.reshape(-1, *hidden.shape[2:])),
            times,
        ),
        background.Inputs(parameters, their_times, span),
        background.Plan(settings, maps, coding),
    )
    tap = Image(noise.tap.astype(frame.color.dtype))
    images = Images(color, paths, owners, states, Image(found), tap, times)
    return images, Inputs(parameters, span), Plan(settings, slices, maps, coding)


def _blur(
    settings: Settings,
    frame: Frame,
    parameters: LayeredParameters,
    noise: Noise | None,
    others: Others,
    _: Array,
) -> jax.Array:
    """The image without a lens."""
    frame, parameters, others = _in_units(frame, parameters, others, settings)
    images, inputs, plan = passes_before(settings, frame, parameters, noise, others)
    height, width = frame.depth.shape
    return each_pixel(
        blur_pixel,
        (height, width),
        images,
        inputs,
        plan,
        kept=frame.color,
        backend=settings.backend,
    )


def _blur_through_lens(
    settings: Settings,
    frame: Frame,
    parameters: LayeredParameters,
    noise: Noise | None,
    others: Others,
    _: Array,
) -> jax.Array:
    """The image of motion and defocus at once."""
    frame, parameters, others = _in_units(frame, parameters, others, settings)
    (height, width), dtype = frame.depth.shape, frame.color.dtype
    assert others.lens is not None
    aperture = _aperture(others.lens, frame, settings)
    noise = resolve_noise(noise, settings.noise, height, width)
    maps, coding = maps_through_lens(settings.samples), Coding.of(settings.radius)
    paths = with_discs(_paths(frame, parameters, settings, others), aperture, settings)
    clock = others.exposure if isinstance(others.exposure, Clock) else None
    times, span = (None, None) if clock is None else (clock.times(), clock.span)
    points = Image(points_of(maps, dtype))
    owners = Image(owners_of(paths, maps, settings, clock, points))
    color, paths = Image(frame.color), Image(paths)
    states = Image(states_of(owners, paths, maps, settings))
    neighbors, their_times = _neighbors(others, frame, settings)
    found = background.known_colors(
        holes.hole_of_pixel,
        holes.Images(color, paths, owners, states, points, neighbors, times),
        holes.Inputs(parameters, aperture, their_times, span),
        background.Plan(settings, maps, coding),
    )
    turns = Image(jnp.concatenate([noise.tap[..., None], noise.tile], axis=-1).astype(dtype))
    images = views.Images(color, paths, owners, states, Image(found), turns, points, times)
    plan = Plan(settings, settings.samples, maps, coding)
    return each_pixel(
        views.view_pixel,
        (height, width),
        images,
        Inputs(parameters, span),
        plan,
        kept=frame.color,
        backend=settings.backend,
    )


def _paths(
    frame: Frame, parameters: LayeredParameters, settings: Settings, others: Others
) -> jax.Array:
    """The path of every pixel, to which neighbors contribute."""
    near = others.before, others.after
    frame = through_five_places(frame, *near, others.shutter, settings.backend)
    return paths_of(frame, parameters, settings)


def _aperture(lens: Lens, frame: Frame, settings: Settings) -> Aperture:
    """The lens in pixels."""
    lens = jax.tree.map(lambda value: jnp.asarray(value, frame.color.dtype), lens)
    width = frame.depth.shape[1]
    infinity, focus = lens.radius_at_infinity(width), lens.focus
    return Aperture.of(jnp.asarray(infinity), jnp.asarray(focus), settings.fetch)


def _neighbors(
    others: Others, blurred: Frame, settings: Settings
) -> tuple[tuple[Neighbor, ...], tuple[Array, ...]]:
    """The neighbors that are given, and their times in half exposures."""
    given = [(frame, side) for frame, side in ((others.before, 1), (others.after, -1)) if frame]
    neighbors = tuple(
        neighbor_of(frame, side, others.shutter, blurred, settings.backend) for frame, side in given
    )
    return neighbors, tuple(-side * 2 / others.shutter for _, side in given)


def exposed(
    frame: Frame,
    parameters: LayeredParameters,
    others: Others,
    exposure: Shutter,
    settings: Settings,
) -> tuple[Frame, LayeredParameters, Others]:
    """The inputs in units of the longest time at which light comes in, see `.clock`."""
    maps = maps_of(settings.samples // LAYERED_SLICE)
    if others.lens is not None:
        maps = maps_through_lens(settings.samples)
    clock, reach = clock_of(exposure, maps, frame.depth.shape[0], frame.color.dtype)
    near = {
        side: None if (neighbor := getattr(others, side)) is None else scaled(neighbor, reach)
        for side in ("before", "after")
    }
    others = others._replace(**near, shutter=others.shutter * reach, exposure=clock)
    # Parameters are relative to the velocities that the frame has.
    parameters = dataclasses.replace(parameters, distinct=parameters.distinct * reach)
    return scaled(frame, reach), parameters, others


def _in_units(
    frame: Frame, parameters: LayeredParameters, others: Others, settings: Settings
) -> tuple[Frame, LayeredParameters, Others]:
    """The inputs of a shutter as `exposed` gives them; without one the same."""
    if isinstance(others.exposure, Shutter):
        return exposed(frame, parameters, others, others.exposure, settings)
    return frame, parameters, others


def _without_lens(
    settings: Settings,
    frame: Frame,
    parameters: LayeredParameters,
    noise: Noise | None,
    others: Others,
    spreads: Array,
) -> jax.Array:
    """The image where the lens spreads no pixel beyond itself."""
    return _blur(settings, frame, parameters, noise, others._replace(lens=None), spreads)


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
    if others.lens is not None:
        discs = _aperture(others.lens, frame, settings).disc(jnp.log(finite_depth(frame.depth)))
        spreads = jnp.any(jnp.abs(discs) > SPEED_FLOOR)
        usual, other = _blur_through_lens, functools.partial(_without_lens, settings)
        operands = (frame, parameters, noise, others, spreads)
    else:
        frame, parameters, others = _in_units(frame, parameters, others, settings)
        vectors = frame.velocity if frame.path is None else frame.path
        usual, other = _blur, _keep
        operands = (frame, parameters, noise, others, anything_moves(vectors))
    blurred = cond_of_values(operands[-1], functools.partial(usual, settings), other, operands)
    return blurred if mask is None else divide_by_mask(blurred)


@takes(LayeredParameters, LayeredSettings, more=("before", "after", "shutter", "exposure", "lens"))
def layered(
    frame: Frame,
    parameters: LayeredParameters,
    *,
    settings: Settings = LayeredSettings(),
    noise: Noise | None = None,
    before: Frame | None = None,
    after: Frame | None = None,
    shutter: ArrayLike = 0.5,
    exposure: Shutter | None = None,
    lens: Lens | None = None,
) -> jax.Array:
    """Blur by slices of time.

    Source: this project; forward warping with a depth test finds what is in front, iterative image
    warping (Bowles et al. 2012) what is at the pixel.

    Args:
        frame: color (H, W, C), depth (H, W), velocity (H, W, 2) half-spread in pixels; a path, if
            there is one, is followed instead of the velocity, whose derivative is 0 then.
        parameters: see `LayeredParameters`.
        settings: see `LayeredSettings`; three samples to a slice, the rest left over. ``bilinear``
            mixes the two texels next to a guess, along the axis that its path follows more.
            ``blend`` mixes what a slice adds for the four texels next to a guess, one guess at a
            time, the others at their nearest texel.
        noise: replaces the built-in noise; only ``tap`` is used without a lens.
        before: the frame before, sharp, of the same size and channels, with the motion of an
            exposure as long as that of ``frame``. It shows some of what ``frame`` hides; its masked
            pixels show nothing.
        after: likewise the frame after.
        shutter: length of the exposure in frames, by which neighbors are related to it. Not used
            without them.
        exposure: when the shutter opens and closes, its curve, and its rolling, in half exposures
            of the frame's velocity; None for a box from -1 to 1. The radius limits the displacement
            up to the longest time from 0 at which light comes in: a frame that is exposed from 0
            to 2 needs twice the radius.
        lens: blurs what it has out of focus too: each sample sees the frame at a time and from a
            point of the lens. Every sample then counts for itself, not three to a slice. Where no
            disc of the frame is above half a pixel the result is that without a lens, bit for bit.
            None for a pinhole. The radius limits the sum of motion and disc; both fields of
            ``noise`` are used.

    Returns:
        (H, W, C) blurred color, within the range of the colors read; pixels that nothing reaches
        are returned bit for bit. Differentiable in every input, with outlines that move, but for
        the number of slices, for which of two depths is in front, and for which surface a hidden
        color is taken from.

    Raises:
        ValueError: shapes or dtypes disagree, there are fewer than three samples, the radius is
            above 4095, a parameter is not a scalar, the shutter is not above 0, the settings are
            those of another filter, or the exposure or the lens is none.
    """
    if exposure is not None:
        check_shutter_record(exposure)
    if lens is not None:
        check_lens_record(lens)
    others = Others(before, after, frames_of(shutter), None, exposure, lens)
    return _checked(frame, parameters, noise, others, settings)


def layered_with_hidden(
    frame: Frame,
    parameters: LayeredParameters,
    hidden: ArrayLike | None,
    *,
    settings: Settings = LayeredSettings(),
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


def checked_neighbor(neighbor: Frame, name: str, frame: Frame) -> Frame:
    """A neighbor as `check_frame` returns it, of the size, channels and dtype of the frame.

    Args:
        neighbor: it.
        name: of the argument.
        frame: checked.

    Returns:
        The neighbor.

    Raises:
        ValueError: it is no frame, shapes or dtypes disagree, or depth or motion is NaN.
    """
    check_frame_type(neighbor, name)
    if jnp.shape(neighbor.color) != frame.color.shape:
        raise ValueError(
            f"`{name}` must have the shape of `frame`, {frame.color.shape}, got "
            f"{jnp.shape(neighbor.color)}."
        )
    try:
        checked = check_frame(neighbor)
        refuse_nan_motion(neighbor)
    except ValueError as error:
        raise ValueError(str(error).replace("`frame.", f"`{name}.")) from error
    if checked.color.dtype != frame.color.dtype:
        raise ValueError(
            f"`{name}` must have the dtype of `frame`, {frame.color.dtype}, got "
            f"{checked.color.dtype}; convert all buffers to one."
        )
    return checked


def frames_of(shutter: ArrayLike) -> jax.Array:
    """The length of an exposure in frames as an array.

    Args:
        shutter: a number.

    Returns:
        It.

    Raises:
        ValueError: it is none.
    """
    try:
        frames = jnp.asarray(shutter)
    except (TypeError, ValueError) as error:
        raise ValueError(f"`shutter` must be a number of frames, got {shutter!r}.") from error
    if frames.shape or jnp.iscomplexobj(frames):
        kind = f"{frames.dtype} of shape {frames.shape}"
        raise ValueError(f"`shutter` must be a number of frames, got {kind}.")
    return frames


def check_frames(shutter: jax.Array) -> None:
    """Reject an exposure that relates no frame to the next; a traced one is not looked at.

    Args:
        shutter: its length in frames.

    Raises:
        ValueError: it is not above 0.
    """
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
    """Check what jit does not see, and give neighbors of a masked frame a channel for its mask."""
    settings = checked_settings(settings, LayeredSettings, "layered")
    check_layered(settings)
    given = {name: getattr(others, name) for name in ("before", "after")}
    given = {name: neighbor for name, neighbor in given.items() if neighbor is not None}
    if given:
        frame = check_frame(frame)
        check_frames(others.shutter)
        given = {name: checked_neighbor(given[name], name, frame) for name in given}
    if frame.valid is not None:
        # All colors have the channels of the frame, whose mask becomes one of them.
        everything = jnp.ones(frame.depth.shape, bool)
        given = {
            name: append_mask(one.replace(valid=everything)).replace(valid=one.valid)
            for name, one in given.items()
        }
    others = others._replace(**given)
    return _layered(frame, parameters, noise, others, settings=settings)
