"""Where motion reaches, so that blur can differ from the sharp frame."""

import numpy as np
from jaxtyping import Bool

from ..frame import Frame


def motion_footprint(
    frame: Frame, threshold: float = 0.5, margin: int = 2
) -> Bool[np.ndarray, "height width"]:
    """Find the pixels that motion reaches: those where blur can differ from the sharp frame.

    Every pixel whose path leads more than ``threshold`` away from it marks the pixels under its
    path (``frame.path`` if present, else p - velocity .. p + velocity); the result is grown by
    ``margin``. Runs in NumPy; not differentiable.

    Args:
        frame: one frame; only velocity and path are read.
        threshold: pixels; slower points mark nothing.
        margin: number of times that the footprint grows by the four neighbors of its pixels.

    Returns:
        (H, W) True where motion reaches.
    """
    velocity = np.asarray(frame.velocity)
    path = np.stack([-velocity, velocity], axis=2) if frame.path is None else np.asarray(frame.path)
    reach = np.linalg.norm(path, axis=-1).max(axis=-1)
    footprint = _sweep(path, reach > threshold, float(reach.max()))
    for _ in range(margin):
        padded = np.pad(footprint, 1)
        footprint = (
            footprint | padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:]
        )
    return footprint


def _sweep(path: np.ndarray, moving: np.ndarray, reach: float) -> np.ndarray:
    """Mark the pixels under the paths of the moving pixels, in steps of at most half a pixel."""
    height, width = moving.shape
    start = np.argwhere(moving)
    ends = path[moving]
    swept = np.zeros_like(moving)
    for share in np.linspace(0.0, 1.0, int(np.ceil(2 * reach)) + 1):
        for end in (0, 1):
            row, column = np.floor(start + share * ends[:, end, ::-1] + 0.5).astype(int).T
            inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            swept[row[inside], column[inside]] = True
    return swept
