"""Measure the time that motion vectors cover, and what they explain, from two frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from .rank import EXPLAINED, SAMPLE_LIMIT, compressed, differences

if TYPE_CHECKING:
    from jaxtyping import Float

Error = Callable[[np.ndarray], float]
"""Error of vectors (N, 2)."""

ENOUGH = 50
"""Fewest moving pixels from which a span is measured."""


def best_scale(vectors: np.ndarray, error: Error) -> np.ndarray:
    """The factors of x and y, of one length but of any sign, with which the frames agree best.

    Args:
        vectors: (N, 2) displacements, pixels.
        error: of such vectors.

    Returns:
        (2,) the factors; their length is between 1/8 and 8, and known to 1.5 percent.
    """
    signs = np.array([(1, 1), (-1, 1), (1, -1), (-1, -1)])
    tried = [factor * sign for factor in 2.0 ** np.arange(-3, 3.01, 0.5) for sign in signs]
    best = min(tried, key=lambda scale: error(vectors * scale))
    for step in (0.25, 0.1, 0.04, 0.015):
        tried = [best * (1 + step * k) for k in (0, -2, -1, 1, 2)]
        best = min(tried, key=lambda scale: error(vectors * scale))
    return best


def measure_span(
    color: Float[np.ndarray, "height width channels"],
    following: Float[np.ndarray, "height width channels"],
    motion: Float[np.ndarray, "height width 2"],
) -> float | None:
    """Measure the span of vectors whose unit is known: ``span = 1 / scale``.

    ``scale`` is the factor with which the vectors bring the next frame back best, of either sign in
    x and y.

    Args:
        color: (H, W, C) linear light, the frame that the vectors belong to.
        following: (H, W, C) the next frame.
        motion: (H, W, 2) vectors in pixels, over the unknown span.

    Returns:
        The span in frames, from 1/8 to 8; None if the frames agree at no length, or hardly anything
        moves.
    """
    moving = _moving(color, following, motion)
    if moving is None:
        return None
    taken, difference_left = moving
    scale = best_scale(taken, difference_left)
    return 1 / abs(float(scale[0])) if difference_left(taken * scale) <= EXPLAINED else None


def difference_left(
    color: Float[np.ndarray, "height width channels"],
    following: Float[np.ndarray, "height width channels"],
    motion: Float[np.ndarray, "height width 2"],
) -> float | None:
    """Measure how much of the difference of two frames vectors leave, on the pixels that move.

    Args:
        color: (H, W, C) linear light, the frame that the vectors belong to.
        following: (H, W, C) the next frame.
        motion: (H, W, 2) displacements to the next frame, pixels, x right, y down.

    Returns:
        The difference after the next frame is warped back, as a share of that without motion: 0 for
        vectors that explain all of it, 1 for those that explain nothing, more for wrong ones. None
        if hardly anything moves.
    """
    moving = _moving(color, following, motion)
    return None if moving is None else moving[1](moving[0])


def _moving(
    color: np.ndarray, following: np.ndarray, motion: np.ndarray
) -> tuple[np.ndarray, Error] | None:
    """The vectors of moving pixels, and the error of other ones there, as `difference_left`."""
    motion = np.where(np.isfinite(motion), motion, 0)
    lengths = np.linalg.norm(motion, axis=-1)
    moving = lengths > 0.05 * float(np.percentile(lengths, 99.9))
    if np.count_nonzero(moving) < ENOUGH:
        return None
    rows, columns = (index[:: -(-len(index) // SAMPLE_LIMIT)] for index in np.nonzero(moving))
    taken = motion[rows, columns].astype(np.float64)
    now, there = compressed(color)[rows, columns], compressed(following)
    still = differences(now, there, rows, columns, np.zeros_like(taken))
    if not still.any():
        return None

    def error(vectors: np.ndarray) -> float:
        found = differences(now, there, rows, columns, vectors)
        return float(np.mean(np.where(np.isnan(found), still, found)) / np.mean(still))

    return taken, error
