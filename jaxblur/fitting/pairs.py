"""Frames with their truth: checked, named, hashed, and stacked by size."""

import dataclasses
import hashlib
import os
from collections.abc import Iterable, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from .. import metrics
from ..frame import Frame, check_frame_type, without_alpha
from .losses import Pixel, inner_pixels
from .objective import Batch

Mask = Literal["moving"] | Sequence[ArrayLike] | None
"""Pixels that count: all, those that motion reaches, or (H, W) booleans for each pair."""


@dataclasses.dataclass(frozen=True)
class Pair:
    """A sharp frame and its true blurred image.

    Attributes:
        name: for messages and reports.
        frame: the sharp frame, color channels alone.
        truth: (H, W, C) linear light, color channels alone.
    """

    name: str
    frame: Frame
    truth: jax.Array

    def sha256(self) -> str:
        """Hash every buffer that the fit sees, with its shape."""
        digest = hashlib.sha256()
        named = {name: buffer for name, buffer in vars(self.frame).items() if buffer is not None}
        for name, buffer in (named | {"truth": self.truth}).items():
            array = np.ascontiguousarray(buffer, np.float32)
            digest.update(repr((name, array.shape)).encode())
            digest.update(array.tobytes())
        return digest.hexdigest()


def make_pairs(
    pairs: Sequence[Pair | tuple[Frame, ArrayLike]], names: Sequence[str] | None = None
) -> list[Pair]:
    """Check pairs and keep the parts that the fit needs.

    Args:
        pairs: frames with their truth (H, W, C), linear light; a `Pair` is taken as it is.
        names: one for each pair, or None for ``pair 0``, ``pair 1`` and so on, and for the names
            that a `Pair` has.

    Returns:
        The pairs; alpha is dropped.

    Raises:
        ValueError: an entry is no frame with its truth, sizes or channels disagree, or a buffer
            holds NaN or infinity (depth may be ``+inf``).
    """
    if isinstance(pairs, Frame | Pair | type | str) or not isinstance(pairs, Iterable):
        raise ValueError(f"`pairs` must be a list of (frame, truth), got {_kind(pairs)}.")
    if len(pairs) == 2 and isinstance(pairs[0], Frame) and _is_array(pairs[1]):
        raise ValueError("`pairs` must be a list of (frame, truth), got one pair; pass [pair].")
    if names is not None and len(names) != len(pairs):
        raise ValueError(
            f"`names` must hold one name for each of the {len(pairs)} pairs, got {len(names)}."
        )
    return [
        _checked(index, pair, None if names is None else names[index])
        for index, pair in enumerate(pairs)
    ]


def _checked(index: int, pair: Any, name: str | None) -> Pair:
    """A pair as it is, or from a tuple of frame and truth."""
    if isinstance(pair, Pair):
        return pair if name is None else dataclasses.replace(pair, name=name)
    argument = f"pairs[{index}]"
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise ValueError(f"`{argument}` must be (frame, truth), got {_kind(pair)}.")
    frame, truth = pair
    if isinstance(truth, Frame) and not isinstance(frame, Frame):
        raise ValueError(f"`{argument}` must be (frame, truth), got (truth, frame); swap the two.")
    check_frame_type(frame, f"{argument}[0]")
    if not _is_array(truth):
        remedy = "; read the file: jaxblur.exr.read_image(path)"
        is_path = isinstance(truth, str | os.PathLike)
        raise ValueError(
            f"`{argument}[1]` must be the true image, (height, width, channels), got "
            f"{_kind(truth)}{remedy if is_path else ''}."
        )
    return _make_pair(f"pair {index}" if name is None else name, frame, truth)


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray | jax.Array | list | tuple)


def _kind(value: Any) -> str:
    """What something is, for a message."""
    if isinstance(value, type):
        return f"the class {value.__name__} itself"
    if isinstance(value, Frame):
        return "a Frame without its truth"
    entries = f" of {len(value)}" if isinstance(value, tuple | list) else ""
    return f"{type(value).__name__}{entries}"


def _make_pair(name: str, frame: Frame, truth: Any) -> Pair:
    frame, truth = without_alpha(frame, truth, f"{name}: the truth")
    buffers = {"color": frame.color, "velocity": frame.velocity, "truth": truth}
    if frame.path is not None:
        buffers["path"] = frame.path.reshape(*truth.shape[:2], -1)
    for what, buffer in buffers.items():
        good = np.isfinite(buffer).all(axis=-1)
        if what == "color" and frame.valid is not None:
            # What a mask leaves out may be anything.
            good = good | (np.asarray(frame.valid) == 0)
        _refuse_non_finite(name, what, good)
    _refuse_non_finite(name, "depth", ~np.isnan(frame.depth) & ~np.isneginf(frame.depth))
    return Pair(name, frame, truth)


def _refuse_non_finite(name: str, what: str, good: np.ndarray) -> None:
    if not good.all():
        row, column = np.argwhere(~good)[0]
        raise ValueError(
            f"{name}: {what} is NaN or infinite at {np.count_nonzero(~good)} pixels, the first at "
            f"row {row}, column {column}; repair the image, mask such pixels with "
            'jaxblur.finite_frame(frame, "ignore")[0], or leave the frame out.'
        )


def pixel_weights(pairs: Sequence[Pair], mask: Mask, pixel: Pixel) -> list[np.ndarray]:
    """Weight of each pixel: equal for all pairs, and within a pair for all pixels of its mask.

    Args:
        pairs: the pairs.
        mask: None for all pixels, ``moving`` for those that motion reaches, or one (H, W) array
            of booleans for each pair.
        pixel: pixel loss, which may not be defined near the border.

    Returns:
        (H, W) weights for each pair; all together sum to 1.

    Raises:
        ValueError: the mask is something else, of another size, or selects no pixel.
    """
    weights = []
    for pair, chosen in zip(pairs, _masks(pairs, mask), strict=True):
        size = pair.truth.shape[0], pair.truth.shape[1]
        if chosen.shape != size or chosen.dtype != bool:
            raise ValueError(
                f"`mask` for {pair.name} must be booleans of shape {size}, got {chosen.dtype} of "
                f"shape {chosen.shape}."
            )
        counts = chosen & inner_pixels(pixel, size)
        if not counts.any():
            raise ValueError(f"`mask` selects no pixel of {pair.name}; leave the frame out.")
        weights.append(counts / (counts.sum() * len(pairs)))
    return weights


def _masks(pairs: Sequence[Pair], mask: Mask) -> list[np.ndarray]:
    if mask is None:
        return [np.ones(pair.truth.shape[:2], bool) for pair in pairs]
    if isinstance(mask, str):
        if mask != "moving":
            raise ValueError(f"`mask` must be None, 'moving' or arrays, got {mask!r}.")
        return [metrics.motion_footprint(pair.frame) for pair in pairs]
    masks = [np.asarray(one) for one in mask]
    if len(masks) != len(pairs):
        raise ValueError(
            f"`mask` must hold one array for each of the {len(pairs)} training pairs, got "
            f"{len(masks)}."
        )
    return masks


def make_batches(pairs: Sequence[Pair], weights: Sequence[np.ndarray]) -> tuple[Batch, ...]:
    """Stack pairs of one size and with the same buffers, so that each kind compiles once.

    Args:
        pairs: the pairs.
        weights: from `pixel_weights`.

    Returns:
        One batch for each kind.
    """
    kinds: dict[Any, list[Batch]] = {}
    for index, (pair, weight) in enumerate(zip(pairs, weights, strict=True)):
        # The dtype of the color, for float64 fits too.
        share = jnp.asarray(weight, pair.truth.dtype)
        batch = Batch(pair.frame, pair.truth, share, jnp.asarray(index))
        kind = pair.truth.shape, jax.tree.structure(batch)
        kinds.setdefault(kind, []).append(batch)
    return tuple(jax.tree.map(lambda *leaves: jnp.stack(leaves), *same) for same in kinds.values())
