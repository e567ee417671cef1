"""Frames with their truth: checked, named, hashed, and stacked by size."""

import dataclasses
import hashlib
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import metrics
from ..frame import Frame, check_frame
from .losses import Pixel, inner_pixels
from .objective import Batch


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
        frame = self.frame
        paths = [] if frame.path is None else [frame.path]
        for buffer in (frame.color, frame.depth, frame.velocity, *paths, self.truth):
            array = np.ascontiguousarray(buffer, np.float32)
            digest.update(repr(array.shape).encode())
            digest.update(array.tobytes())
        return digest.hexdigest()


def make_pairs(pairs: Sequence[tuple[Frame, Any]], names: Sequence[str] | None) -> list[Pair]:
    """Check pairs and keep the parts that the fit needs.

    Args:
        pairs: frames with their truth (H, W, C), linear light.
        names: one for each pair, or None for ``pair 0``, ``pair 1`` and so on.

    Returns:
        The pairs; alpha is dropped.

    Raises:
        ValueError: sizes or channels disagree, or a buffer holds NaN or infinity (depth may be
            ``+inf``).
    """
    names = [f"pair {index}" for index in range(len(pairs))] if names is None else list(names)
    if len(names) != len(pairs):
        raise ValueError(
            f"`names` must hold one name for each of the {len(pairs)} pairs, got {len(names)}."
        )
    return [_make_pair(name, *pair) for name, pair in zip(names, pairs, strict=True)]


def _make_pair(name: str, frame: Frame, truth: Any) -> Pair:
    frame = check_frame(frame)
    truth = jnp.asarray(truth, frame.color.dtype)
    if truth.ndim != 3 or truth.shape[:2] != frame.color.shape[:2]:
        raise ValueError(
            f"{name}: the truth must have shape (height, width, channels) like the frame "
            f"{frame.color.shape}, got {truth.shape}; render both with the same data window."
        )
    color, truth = _color_channels(frame.color), _color_channels(truth)
    if color.shape != truth.shape:
        raise ValueError(
            f"{name}: the frame has {color.shape[-1]} color channels, the truth "
            f"{truth.shape[-1]}; give both the same."
        )
    frame = dataclasses.replace(frame, color=color)
    buffers = {"color": color, "velocity": frame.velocity, "truth": truth}
    if frame.path is not None:
        buffers["path"] = frame.path.reshape(*color.shape[:2], -1)
    for what, buffer in buffers.items():
        _refuse_non_finite(name, what, np.isfinite(buffer).all(axis=-1))
    _refuse_non_finite(name, "depth", ~np.isnan(frame.depth) & ~np.isneginf(frame.depth))
    return Pair(name, frame, truth)


def _color_channels(image: jax.Array) -> jax.Array:
    return image[..., :3] if image.shape[-1] > 3 else image


def _refuse_non_finite(name: str, what: str, good: np.ndarray) -> None:
    if not good.all():
        row, column = np.argwhere(~good)[0]
        raise ValueError(
            f"{name}: {what} is NaN or infinite at {np.count_nonzero(~good)} pixels, the first at "
            f"row {row}, column {column}; repair the image, or leave the frame out."
        )


def pixel_weights(pairs: Sequence[Pair], mask: Any, pixel: Pixel) -> list[np.ndarray]:
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


def _masks(pairs: Sequence[Pair], mask: Any) -> list[np.ndarray]:
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
