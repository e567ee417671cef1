"""Motion blur of layers: in every slice of time they are composited anew, front to back.

Blurred layers that are composited afterwards are right only where one of them rests: of two edges
that move together, each lets through half of what is behind it, and the background shines through.
Here a hole in one layer shows what is behind it at the same time, so that the background is given
where `layered` has to guess it.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import core
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from ...frame import Frame, check_frame, check_parameters
from ...kernels import At, Image, Outcome, each_pixel, sum_over
from ...noise import Noise
from ...settings import LayeredSettings, Settings, checked_settings
from ...shutter import Shutter, check_shutter_record
from .._arguments import refuse_nan_motion
from .._sampling import find_texel
from ..builtin import check_layered
from ..parameters import LayeredParameters
from .clock import time_of_light
from .filter import Others, check_frames, checked_neighbor, exposed, frames_of, passes_before
from .owners import RESTS
from .paths import Path
from .slices import (
    SMALLEST_WEIGHT,
    Images,
    Inputs,
    Plan,
    Sums,
    filled,
    longest_motion,
    mean_of,
    slices_along,
    slices_at,
)

_INSIDE = Settings(border="skip")

ALPHA_BEYOND = 0.1
"""How far alpha may lie outside 0..1: pixel filters with negative lobes leave such values."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Layer:
    """A layer of `blur_layers`.

    Attributes:
        frame: its color is premultiplied, and the last channel is alpha: 0 nothing, 1 opaque.
        before: the layer in the frame before, or None; see `jaxblur.layered`. It may have a mask.
        after: likewise in the frame after.
        holdout: whether the layer hides what is behind it without being seen, so that the result
            is transparent there.
    """

    frame: Frame
    before: Frame | None = None
    after: Frame | None = None
    holdout: bool = dataclasses.field(default=False, metadata={"static": True})


class Stack(NamedTuple):
    """Images that the program reads.

    Attributes:
        layers: of each layer, see `.slices.Images`; the front one first.
        sharp: (H, W, C) the layers at rest, composited.
    """

    layers: tuple[Images, ...]
    sharp: Image


class StackPlan(NamedTuple):
    """What is fixed when the program is traced.

    Attributes:
        plan: of every layer.
        holdouts: for each layer, whether it is one.
    """

    plan: Plan
    holdouts: tuple[bool, ...]


class StackSums(NamedTuple):
    """Sums over the slices of a pixel.

    Attributes:
        front: color of all layers but the last, composited.
        last: known color of the last layer, and its weight. Both are multiplied by how much the
            layers in front of it let through.
        rear: the part of `last` that is not in front of the pixel's own surface.
        through: how much of it is seen.
        counts: what the slices count.
    """

    front: tuple[Array, ...]
    last: Sums
    rear: Sums
    through: Array
    counts: Array


def blend_pixel(at: At, images: Stack, inputs: Inputs, stack: StackPlan) -> Outcome:
    """The mean over the slices of time of the layers, composited.

        C = sum_k C_k T_k,   T_1 = 1,   T_(k+1) = T_k (1 - a_k)

    in each slice, with the layers from the front to the back. Where a layer is not known, it is
    left out of the mean as far as it goes on there (see `goes_on`), and is transparent otherwise.
    The last layer has there the mean color of what is known of it, as in `layered`.
    """
    plan, limit = stack.plan, None
    if plan.settings.spacing:
        motions = [longest_motion(at, layer.paths, layer.owners, plan) for layer in images.layers]
        limit = slices_along(functools.reduce(jnp.maximum, motions), plan)
    slices = [slices_at(at, layer, inputs, plan, limit) for layer in images.layers]
    count = plan.slices if limit is None else limit

    def slice_of_time(i: Int[Array, ""]) -> StackSums:
        through = jnp.ones_like(images.sharp.here()[0])
        nothing = (jnp.zeros_like(through),) * images.sharp.channels
        front, light = nothing, None
        last = rear = Sums(nothing, jnp.zeros_like(through))
        counts = through
        for number, (slice_at, holdout) in enumerate(zip(slices, stack.holdouts, strict=True)):
            seen, share, behind, light = slice_at(i)
            if light is not None:
                # It counts once, whatever the number of layers.
                seen, share, behind = _times(1 / light, (seen, share, behind))
            if number == len(slices) - 1:
                last, rear = _times(through, (Sums(seen, share), behind))
                break
            color = nothing if holdout else tuple(through * channel for channel in seen)
            front = tuple(a + b for a, b in zip(front, color, strict=True))
            lost = (1 - share) * goes_on(at, images.layers[number], inputs, i, count)
            counts = counts - through * lost
            through = through * (1 - jnp.clip(seen[-1], 0, share) - lost)
        sums = StackSums(front, last, rear, through, counts)
        if light is not None:
            sums = _times(light, sums)
        if limit is not None:
            taken = i < limit
            sums = jax.tree.map(lambda value: jnp.where(taken, value, 0), sums)
        return sums

    sums = sum_over(plan.slices, slice_of_time, limit)
    color = blended(sums, images.layers[-1].color.here(), images.sharp.here(), stack.holdouts[-1])
    states = [layer.states.here()[0] for layer in images.layers]
    state = functools.reduce(jnp.maximum, states)
    return Outcome(color, where=state != RESTS)


def _times(factor: Array, values: Any) -> Any:
    return jax.tree.map(lambda value: factor * value, values)


def blended(
    sums: StackSums, last: Sequence[Array], sharp: Sequence[Array], holdout: bool
) -> tuple[Array, ...]:
    """The mean color of the slices, or the sharp one where nothing is known.

    Args:
        sums: of the pixel.
        last: color of the last layer, which it has where nothing is known of it.
        sharp: the layers at rest, composited.
        holdout: whether the last layer is one.
    """
    counts = sums.counts > SMALLEST_WEIGHT
    inverse = 1 / jnp.where(counts, sums.counts, 1)
    through = jnp.zeros_like(sums.through) if holdout else sums.through
    behind = mean_of(filled(sums.last, sums.rear, sums.through), last)
    return tuple(
        jnp.where(counts, (a + through * b) * inverse, kept)
        for a, b, kept in zip(sums.front, behind, sharp, strict=True)
    )


def goes_on(at: At, images: Images, inputs: Inputs, slice: Array, count: Array | int) -> Array:
    """How surely a pixel of a layer stays covered in a slice in which nothing is known of it.

    Its own motion leads back to where it would have come from. Where that is in the frame, farther
    away, and transparent, the pixel is uncovered then. Else something is there that the frame does
    not show, because it is outside or hidden, and it is taken to cover what the pixel covers.

    Args:
        at: the pixel.
        images: of the layer.
        inputs: scalars.
        slice: its number.
        count: of slices.

    Returns:
        0 to 1, at most the alpha of the pixel.
    """
    own, alpha = Path(*images.paths.here()), images.color.here()[-1]
    light = (2 * slice + 1).astype(own.x.dtype) / count - 1
    time, _ = time_of_light(light, at.row, images.clock, inputs.span)
    squared = time * time
    x, y = squared * own.bend_x - time * own.x, squared * own.bend_y - time * own.y
    texel = find_texel(at, x, y, images.paths, _INSIDE, held=True)
    depth = images.paths.read_texel(texel.number, 3)[2]
    behind = jnp.clip(inputs.parameters.front_sharpness * (depth - own.log_depth), 0, 1)
    there = jnp.clip(images.color.read_texel(texel.number)[-1], 0, 1)
    uncovered = jnp.where(texel.counts, behind * (1 - there), 0)
    return (1 - uncovered) * jnp.clip(alpha, 0, 1)


def blur_layers(
    layers: Sequence[Frame | Layer],
    parameters: LayeredParameters | None = None,
    *,
    settings: Settings = LayeredSettings(),
    noise: Noise | None = None,
    shutter: ArrayLike = 0.5,
    exposure: Shutter | None = None,
) -> Float[Array, "height width channels"]:
    """Blur layers and composite them, at every time of the exposure.

    Each layer is blurred as by `layered`, from its own color, depth and velocity. Depths are
    compared within a layer only: the order of the layers is that of the argument.

    Args:
        layers: from the front to the back: frames of one size, (H, W, C) with premultiplied color
            and alpha as the last channel, or `Layer` for neighbors and holdouts. C is 2 for gray
            and alpha, 4 for red, green, blue and alpha, or more if there are passes before alpha.
            An opaque layer, as a clean plate, has an alpha of 1.
        parameters: of `layered`, for all layers; its defaults if None.
        settings: as `layered`. Time and memory are those of a frame times the number of layers.
        noise: as `layered`, shared by all layers.
        shutter: as `layered`.
        exposure: as `layered`.

    Returns:
        (H, W, C) color over nothing, premultiplied, alpha last. Differentiable as `layered` is.
        Where a layer is not known at some time, it is transparent, so that an empty layer changes
        nothing, whatever its velocity. But a thing that the border of the frame cuts, or another
        thing of its layer, is taken to go on there as it looks beside it, and the last layer is
        completed as `layered` completes a frame.

    Raises:
        ValueError: there is no layer, shapes disagree, a layer has one channel or three, or a mask,
            or alpha is not within 0..1, or another argument is not as `layered` takes it. The
            values of traced arrays are not looked at.
    """
    if isinstance(layers, Frame | Layer):
        kind = type(layers).__name__
        raise ValueError(f"`layers` must be a sequence of frames, the front one first, got {kind}.")
    if not len(layers):
        raise ValueError("`layers` must hold at least one layer, the front one first, got none.")
    given = [Layer(layer) if isinstance(layer, Frame) else layer for layer in layers]
    for number, layer in enumerate(given):
        _check_layer(number, layer, given[0])
    parameters = LayeredParameters() if parameters is None else parameters
    check_parameters(parameters, LayeredParameters)
    settings = checked_settings(settings, LayeredSettings, "blur_layers")
    check_layered(settings)
    if exposure is not None:
        check_shutter_record(exposure)
    holdouts = tuple(layer.holdout for layer in given)
    frames = tuple(dataclasses.replace(layer, holdout=False) for layer in given)
    length = frames_of(shutter)
    if any(layer.before is not None or layer.after is not None for layer in given):
        check_frames(length)
    return _blended(
        frames,
        parameters,
        noise,
        length,
        exposure,
        settings=settings,
        holdouts=holdouts,
    )


def _check_layer(number: int, layer: Layer, first: Layer) -> None:
    """Reject what cannot be a layer."""
    name = f"layers[{number}]"
    if not isinstance(layer, Layer):
        kind = type(layer).__name__
        raise ValueError(f"`{name}` must be a jaxblur.Frame or a jaxblur.Layer, got {kind}.")
    if not isinstance(layer.frame, Frame):
        kind = type(layer.frame).__name__
        raise ValueError(f"`{name}.frame` must be a jaxblur.Frame, got {kind}.")
    shape, expected = jnp.shape(layer.frame.color), jnp.shape(first.frame.color)
    if len(shape) != 3 or shape[-1] in (1, 3):
        raise ValueError(
            f"`{name}` must have color and, as its last channel, alpha: (H, W, C) with C of 2, 4 "
            f"or more, got {shape}. {_ADD_ALPHA}"
        )
    if shape != expected:
        raise ValueError(f"`{name}` must have the shape of `layers[0]`, {expected}, got {shape}.")
    _check_alpha(name, layer.frame)
    try:
        refuse_nan_motion(layer.frame)
    except ValueError as error:
        raise ValueError(str(error).replace("`frame.", f"`{name}.frame.")) from error
    for side in ("before", "after"):
        if (neighbor := getattr(layer, side)) is not None:
            checked_neighbor(neighbor, f"{name}.{side}", check_frame(layer.frame))
    if layer.frame.valid is not None:
        raise ValueError(
            f"`{name}` must not have a mask (`Frame.valid`): in a layer, alpha says what is there."
        )


_ADD_ALPHA = (
    "To an opaque layer add an alpha of 1: `frame.replace(color=jnp.concatenate([frame.color, "
    "jnp.ones_like(frame.color[..., :1])], axis=-1))`."
)


def _check_alpha(name: str, frame: Frame) -> None:
    """Reject a last channel that cannot be alpha; a traced one is not looked at."""
    if isinstance(frame.color, core.Tracer):
        return
    # Values are known here, also while something else is traced.
    with jax.ensure_compile_time_eval():
        alpha = jnp.asarray(frame.color)[..., -1]
        lowest, highest = float(alpha.min()), float(alpha.max())
    if lowest < -ALPHA_BEYOND or highest > 1 + ALPHA_BEYOND:
        raise ValueError(
            f"`{name}` must have alpha, 0 to 1, as its last channel, got values from {lowest:g} to "
            f"{highest:g}. {_ADD_ALPHA}"
        )


@functools.partial(jax.jit, static_argnames=("settings", "holdouts"))
def _blended(
    layers: tuple[Layer, ...],
    parameters: LayeredParameters,
    noise: Noise | None,
    shutter: Array,
    exposure: Shutter | None,
    *,
    settings: Settings,
    holdouts: tuple[bool, ...],
) -> jax.Array:
    frames = [check_frame(layer.frame) for layer in layers]
    dtype = functools.reduce(jnp.promote_types, (frame.color.dtype for frame in frames))
    parameters = jax.tree.map(lambda p: jnp.asarray(p, dtype), parameters)
    sharp = jnp.zeros(frames[0].color.shape, dtype)
    through = jnp.ones_like(sharp[..., -1:])
    for frame, holdout in zip(frames, holdouts, strict=True):
        sharp = sharp if holdout else sharp + through * frame.color
        through = through * (1 - jnp.clip(frame.color[..., -1:], 0, 1))
    images, inputs, plan = [], None, None
    for layer, frame in zip(layers, frames, strict=True):
        before, after = (None if f is None else check_frame(f) for f in (layer.before, layer.after))
        others = Others(before, after, shutter, None)
        of_layer = parameters
        if exposure is not None:
            frame, of_layer, others = exposed(frame, parameters, others, exposure, settings)
        image, inputs, plan = passes_before(settings, frame, of_layer, noise, others)
        images.append(image)
    assert inputs is not None and plan is not None
    height, width = frames[0].depth.shape
    return each_pixel(
        blend_pixel,
        (height, width),
        Stack(tuple(images), Image(sharp)),
        inputs,
        StackPlan(plan, holdouts),
        kept=sharp,
        backend=settings.backend,
    )
