"""A filter over several frames: `blur_batch` for each of them, `blur_subframes` for their mean."""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from .filters._arguments import refuse_nan_motion_of_any, refuse_out_of_range
from .filters.registry import FilterInfo, Parameters, filter_info
from .frame import Frame, check_frame_type
from .noise import Noise
from .settings import Settings, checked_settings

FRAME_AXES = {"color": 4, "depth": 3, "velocity": 4, "path": 5, "valid": 3, "guide": 4}
NOISE_AXES = {"tap": 3, "tile": 4}


def blur_batch(
    filter: str | Callable[..., jax.Array],
    frames: Frame | Sequence[Frame],
    parameters: Parameters | None = None,
    *,
    settings: Settings | None = None,
    noise: Noise | None = None,
    chunk: int = 1,
) -> Float[Array, "frames height width channels"]:
    """Blur frames of one size, stacked on a leading axis or one after the other.

    ``vmap`` inside a chunk, ``lax.map`` from chunk to chunk, so that one chunk is in work at a
    time. Memory besides the stacked frames and results, for guertin2014 on three channels, as XLA
    accounts for it on a CPU (experiments/009_throughput): 70 bytes a pixel of one frame with one
    frame a chunk, 200 with two. The reverse derivative in the parameters keeps intermediate values
    of *every* frame: for a batch of four 420 bytes a pixel of one frame with one frame a chunk, 760
    with two. On a CPU one frame already uses all cores, and a larger chunk gains nothing.

    Args:
        filter: the name of a registered filter, or its function.
        frames: a `Frame` whose buffers have a leading axis of F frames: color (F, H, W, C),
            depth (F, H, W), velocity (F, H, W, 2), as ``jax.tree.map(stack, *frames)`` makes it;
            or a sequence of frames, of which some may have a path or a mask and others not:
            each of these kinds is compiled and run as a batch of its own.
        parameters: of the filter, the same for all frames; its defaults if None.
        settings: of the filter; its defaults if None.
        noise: replaces the built-in noise: of one frame, used for all, or with a leading axis
            of F frames.
        chunk: frames that are blurred together; the last chunk may hold fewer.

    Returns:
        (F, H, W, C): the result of the filter for each frame, equal to the loop over frames up
        to the rounding of float32 (the bits depend on how XLA fuses). Differentiable as the
        filter is.

    Raises:
        ValueError: an argument is wrong, or shapes disagree.
    """
    info = filter_info(filter)
    chosen = info.checked_parameters(parameters)
    options = {"info": info, "settings": settings_of(info, settings), "chunk": chunk}

    def blur(frames: Frame, noise: Noise | None) -> jax.Array:
        check_batch(frames, chosen, noise, chunk)
        return _blur_batch(frames, chosen, noise, **options)

    return blur(frames, noise) if isinstance(frames, Frame) else _by_kind(blur, frames, noise)


def blur_subframes(
    filter: str | Callable[..., jax.Array],
    frames: Frame | Sequence[Frame],
    parameters: Parameters | None = None,
    *,
    settings: Settings | None = None,
    noise: Noise | None = None,
) -> Float[Array, "height width channels"]:
    """Blur K sharp frames from inside one exposure, and take the mean.

    Frame k is the image at the center of the k-th of K equal parts of the exposure, with the motion
    during this part: with vectors in pixels per frame, ``read_frame(path, shutter=shutter / K)``.
    The more frames, the less each has to guess. A filter that takes neighbors sees the sub-frames
    before and after. Time and memory are those of K frames.

    Args:
        filter: the name of a registered filter, or its function.
        frames: the frames in the order of time: a sequence of frames of one size, or a `Frame`
            whose buffers have a leading axis of K frames.
        parameters: of the filter; its defaults if None.
        settings: of the filter, for each sub-frame; its defaults if None.
        noise: replaces the built-in noise; of one frame, used for all.

    Returns:
        (H, W, C): the mean of the results. Differentiable as the filter is.

    Raises:
        ValueError: an argument is wrong, or shapes disagree.
    """
    info = filter_info(filter)
    if isinstance(frames, Frame):
        check_batch(frames, None, None, 1)
        stacked = frames
        parts = [jax.tree.map(lambda b, k=k: b[k], stacked) for k in range(len(stacked.color))]
    else:
        _check_sequence(frames, None)
        parts = list(frames)
    call: Any = info.call
    options = {"settings": settings_of(info, settings), "noise": noise}
    parameters = info.checked_parameters(parameters)
    images = []
    for before, part, after in zip([None, *parts], parts, [*parts[1:], None], strict=False):
        near = {"before": before, "after": after, "shutter": 1.0} if info.takes_neighbors else {}
        images.append(call(part, parameters, **options, **near))
    return sum(images[1:], images[0]) / len(images)


def settings_of(info: FilterInfo, settings: Settings | None) -> Settings:
    """Settings as a filter takes them; None stands for its defaults.

    Args:
        info: the filter.
        settings: of the filter, or None.

    Raises:
        ValueError: they are those of another filter.
    """
    if settings is None:
        return info.settings
    return checked_settings(settings, info.kind, info.name)


def _by_kind(
    blur: Callable[[Frame, Noise | None], jax.Array], frames: Sequence[Frame], noise: Noise | None
) -> jax.Array:
    """Blur the frames that have a path, a mask, both or neither as a batch each; in their order."""
    _check_sequence(frames, noise)
    own_noise = noise is not None and has_frame_axis(noise)
    kinds: dict[Any, list[int]] = {}
    for number, frame in enumerate(frames):
        kinds.setdefault(jax.tree.structure(frame), []).append(number)
    images = []
    for numbers in kinds.values():
        batch = jax.tree.map(lambda *buffers: jnp.stack(buffers), *(frames[n] for n in numbers))
        chosen = jnp.asarray(numbers)
        own = jax.tree.map(lambda values, of=chosen: values[of], noise) if own_noise else noise
        images.append(blur(batch, own))
    places = np.argsort([number for numbers in kinds.values() for number in numbers])
    return jnp.concatenate(images)[places]


@functools.partial(jax.jit, static_argnames=("info", "settings", "chunk"))
def _blur_batch(
    frames: Frame,
    parameters: Parameters | None,
    noise: Noise | None,
    *,
    info: FilterInfo,
    settings: Settings,
    chunk: int,
) -> jax.Array:
    batched_noise = noise is not None and has_frame_axis(noise)

    def blur(each: tuple[Frame, Noise | None]) -> jax.Array:
        frame, own = each
        chosen = own if batched_noise else noise
        return info.call(frame, parameters, settings=settings, noise=chosen)

    # A chunk of one by plain `map`: inside `vmap` the filter cannot leave out what does not move.
    return lax.map(
        blur, (frames, noise if batched_noise else None), batch_size=None if chunk == 1 else chunk
    )


def has_frame_axis(noise: Noise) -> bool:
    """Whether each frame has noise of its own, in place of one for all."""
    return jnp.ndim(noise.tap) == NOISE_AXES["tap"]


def _check_sequence(frames: Sequence[Frame], noise: Noise | None) -> None:
    if isinstance(frames, Iterator):
        raise ValueError(
            f"`frames` must be a list of frames, got {type(frames).__name__}; pass list(frames)."
        )
    if isinstance(frames, type | str) or not isinstance(frames, Sequence):
        check_frame_type(frames, "frames")
    for number, frame in enumerate(frames):
        check_frame_type(frame, f"frames[{number}]")
    sizes = {jnp.shape(frame.color): number for number, frame in reversed([*enumerate(frames)])}
    if len(sizes) != 1:
        listing = ", ".join(f"{size} from number {number}" for size, number in sizes.items())
        raise ValueError(
            f"`frames` must be one or more frames of one size, got {listing or 'none'}; blur the "
            "frames of each size in a call of its own."
        )
    if noise is not None and has_frame_axis(noise) and len(noise.tap) != len(frames):
        raise ValueError(
            f"`noise` must be of one frame or of all {len(frames)}, got {len(noise.tap)}."
        )


def check_batch(
    frames: Frame, parameters: Parameters | None, noise: Noise | None, chunk: int
) -> None:
    """Reject a batch that no filter can blur.

    Args:
        frames: see `blur_batch`.
        parameters: of the filter.
        noise: see `blur_batch`.
        chunk: see `blur_batch`.

    Raises:
        ValueError: shapes disagree, a parameter is out of range, or depth or motion is NaN.
    """
    if isinstance(chunk, bool) or not isinstance(chunk, int) or chunk < 1:
        raise ValueError(f"`chunk` must be a whole number from 1, got {chunk!r}.")
    counts = {}
    for name, axes in FRAME_AXES.items():
        buffer = getattr(frames, name)
        if buffer is None:
            continue
        if jnp.ndim(buffer) != axes:
            raise ValueError(
                f"`frames.{name}` must have {axes} axes, the first of frames, got shape "
                f"{jnp.shape(buffer)}; stack the frames: jax.tree.map(lambda *b: jnp.stack(b), "
                "*frames)."
            )
        counts[f"frames.{name}"] = len(buffer)
    if noise is not None and has_frame_axis(noise):
        counts |= {f"noise.{name}": len(getattr(noise, name)) for name in NOISE_AXES}
    if len(set(counts.values())) != 1 or 0 in counts.values():
        listing = ", ".join(f"`{name}` {count}" for name, count in counts.items())
        raise ValueError(f"`frames` must hold one or more frames in every buffer, got {listing}.")
    refuse_out_of_range(parameters)
    refuse_nan_motion_of_any(frames)
