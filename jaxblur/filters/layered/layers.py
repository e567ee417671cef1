"""Motion blur of layers: in every slice of time they are composited anew, front to back.

Blurred layers that are composited afterwards are right only where one of them rests: of two edges
that move together, each lets through half of what is behind it, and the background shines through.
Here a hole in one layer shows what is behind it at the same time, so that the background is given
where `layered` has to guess it.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from ...frame import Frame, check_frame, check_parameters
from ...kernels import At, Image, Outcome, each_pixel, sum_over
from ...noise import Noise
from ...settings import Settings, checked_settings
from ...shutter import Shutter, check_shutter_record
from ..builtin import check_layered
from ..parameters import LayeredParameters
from .filter import Others, check_frames, checked_neighbor, exposed, frames_of, passes_before
from .owners import RESTS
from .slices import (
    Images,
    Inputs,
    Plan,
    Sums,
    longest_motion,
    mean_of,
    slices_along,
    slices_at,
)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Layer:
    """A layer of `blur_layers`.

    Attributes:
        frame: its color is premultiplied, and the last channel is alpha: 0 nothing, 1 opaque.
        before: the layer in the frame before, or None; see `jaxblur.layered`.
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


def blend_pixel(at: At, images: Stack, inputs: Inputs, stack: StackPlan) -> Outcome:
    """The mean over the slices of time of the layers, composited.

        C = sum_k C_k T_k,   T_1 = 1,   T_(k+1) = T_k (1 - a_k)

    in each slice, with the layers from the front to the back. What is not known of a layer is left
    out of the mean, together with what would be seen through it.
    """
    plan, limit = stack.plan, None
    if plan.settings.spacing:
        motions = [longest_motion(at, layer, plan) for layer in images.layers]
        limit = slices_along(functools.reduce(jnp.maximum, motions), plan)
    slices = [slices_at(at, layer, inputs, plan, limit) for layer in images.layers]

    def slice_of_time(i: Int[Array, ""]) -> Sums:
        through = jnp.ones_like(images.sharp.here()[0])
        color, known = [jnp.zeros_like(through)] * images.sharp.channels, jnp.zeros_like(through)
        light = None
        for slice_at, holdout in zip(slices, stack.holdouts, strict=True):
            seen, share, light = slice_at(i)
            if light is not None:
                # It counts once, whatever the number of layers.
                seen, share = tuple(channel / light for channel in seen), share / light
            alpha = jnp.clip(seen[-1], 0, share)
            if not holdout:
                color = [a + through * b for a, b in zip(color, seen, strict=True)]
            known = known + through * alpha
            through = through * (share - alpha)
        known = known + through
        if light is not None:
            *color, known = [light * value for value in (*color, known)]
        if limit is not None:
            *color, known = [jnp.where(i < limit, value, 0) for value in (*color, known)]
        return Sums(tuple(color), known)

    sums = sum_over(plan.slices, slice_of_time, limit)
    states = [layer.states.here()[0] for layer in images.layers]
    state = functools.reduce(jnp.maximum, states)
    return Outcome(mean_of(sums, images.sharp.here()), where=state != RESTS)


def blur_layers(
    layers: Sequence[Frame | Layer],
    parameters: LayeredParameters | None = None,
    *,
    settings: Settings = Settings(radius=160, fetch="bilinear"),
    noise: Noise | None = None,
    shutter: ArrayLike = 0.5,
    exposure: Shutter | None = None,
) -> Float[Array, "height width channels"]:
    """Blur layers and composite them, at every time of the exposure.

    Each layer is blurred as by `layered`, from its own color, depth and velocity. Depths are
    compared within a layer only: the order of the layers is that of the argument.

    Args:
        layers: from the front to the back: frames of one size, (H, W, C) with premultiplied color
            and alpha as the last channel, or `Layer` for neighbors and holdouts. An opaque layer,
            as a clean plate, has an alpha of 1. Where alpha is 0, velocity should be 0 and depth
            infinite: motion there makes what is behind less certain at the border.
        parameters: of `layered`, for all layers; its defaults if None.
        settings: as `layered`. Time and memory are those of a frame times the number of layers.
        noise: as `layered`, shared by all layers.
        shutter: as `layered`.
        exposure: as `layered`.

    Returns:
        (H, W, C) color over nothing, premultiplied, alpha last. Differentiable as `layered` is.

    Raises:
        ValueError: there is no layer, shapes disagree, a layer has fewer than two channels or a
            mask, or another argument is not as `layered` takes it. That the last channel is alpha
            cannot be checked.
    """
    if isinstance(layers, Frame | Layer) or not len(layers):
        kind = type(layers).__name__
        raise ValueError(f"`layers` must be a sequence of frames, the front one first, got {kind}.")
    given = [Layer(layer) if isinstance(layer, Frame) else layer for layer in layers]
    for number, layer in enumerate(given):
        _check_layer(number, layer, given[0])
    parameters = LayeredParameters() if parameters is None else parameters
    check_parameters(parameters, LayeredParameters)
    settings = checked_settings(settings, Settings, "blur_layers")
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
    shape, expected = jnp.shape(layer.frame.color), jnp.shape(first.frame.color)
    if shape != expected:
        raise ValueError(f"`{name}` must have the shape of `layers[0]`, {expected}, got {shape}.")
    if len(shape) != 3 or shape[-1] < 2:
        raise ValueError(
            f"`{name}` must have color and, as its last channel, alpha: (H, W, C) with C of 2 or "
            f"more, got {shape}. An opaque layer has an alpha of 1."
        )
    for side in ("before", "after"):
        if (neighbor := getattr(layer, side)) is not None:
            checked_neighbor(neighbor, f"{name}.{side}", check_frame(layer.frame))
    if any(f is not None and f.valid is not None for f in (layer.frame, layer.before, layer.after)):
        raise ValueError(
            f"`{name}` must not have a mask (`Frame.valid`): in a layer, alpha says what is there."
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
