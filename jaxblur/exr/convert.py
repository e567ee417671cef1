"""Stored values as a frame has them: linear light, positive distance, half-spread in pixels."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from jaxblur import srgb, vectors
from jaxblur._util.errors import JaxblurIOError, JaxblurIOWarning, PathLike

from .checks import refuse, refuse_or_zero
from .choose import ColorGroup
from .color import INTEGERS
from .listing import FileInfo

if TYPE_CHECKING:
    from jaxtyping import Float

SKY = {"z": np.inf, "-z": -np.inf, "1/z": 0, "-1/z": 0, "normalized-near1": 0, "flat": np.inf}
"""What stands for the sky in each kind of depth."""
DEPTH_KINDS = tuple(SKY)
"""What a file may store as depth: `read_frame` converts each to distance."""

PIXELS_AT_ONCE = 8192
"""Pixels whose vectors are converted together: they stay in the processor's cache."""

# Renderers that cannot write infinity store 1e10 or 1e30 for the sky.
SKY_DEPTH = 1e9


def as_light(
    info: FileInfo, group: ColorGroup, color: np.ndarray, nonfinite: str
) -> tuple[np.ndarray, np.ndarray]:
    """Stored color as linear light, and a mask of unknown pixels; integer files hold sRGB."""
    for index, name in enumerate(group.channels):
        if info.channel(name).type in INTEGERS and name != group.alpha:
            color[..., index] = srgb.decode(color[..., index])
    return refuse_or_zero(info.path, group.channels, color, nonfinite)


def depth_kind_of(depth: str, guess: vectors.Guess, channel: str, path: PathLike) -> str:
    """Resolve "auto"; warn if it means anything but plain distance."""
    if depth != "auto":
        return depth
    kind = guess.preset.depth
    if kind == "1/z" and channel == "Z":
        # OpenEXR reserves the plain name Z for distance; inverse depth is in a named layer.
        return "z"
    if kind != "z":
        warnings.warn(
            f"{path}: depth is read as {kind}, as {guess.preset.name} usually writes it; pass "
            f"depth='{kind}' or depth='z' to choose explicitly.",
            JaxblurIOWarning,
            stacklevel=3,
        )
    return kind


def to_distance(
    raw: Float[np.ndarray, "height width"], kind: str, path: PathLike, channel: str
) -> Float[np.ndarray, "height width"]:
    """Convert stored depth to positive distance, with +inf for the background.

    A pixel is background if its value is not finite, 1e9 or more, or 0 (for every kind of depth).

    Args:
        raw: (H, W) as stored.
        kind: "z", "-z", "1/z" or "normalized-near1", as in `read_buffers`.
        path: file, for messages.
        channel: channel, for messages.

    Returns:
        (H, W) float32, positive, +inf for background.

    Raises:
        JaxblurIOError: values contradict the kind of depth.
    """
    values = -raw if kind.startswith("-") else raw
    hit = np.isfinite(values) & (values < SKY_DEPTH) & (values != 0)
    refuse(hit & (values < 0), path, channel, "negative", _NEGATIVE_DEPTH[kind])
    if kind == "normalized-near1":
        refuse(hit & (values > 1), path, channel, "above 1", "pass depth='z' if it is a distance.")
        distance = 2 - values
    elif kind in ("1/z", "-1/z"):
        far = (values >= SKY_DEPTH) & np.isfinite(values)
        refuse(far, path, channel, "1e9 or more", "pass depth='z', this is not an inverse.")
        with np.errstate(over="ignore"):
            distance = 1 / np.where(hit, values, np.float32(1))
    else:
        distance = values
    return np.where(hit, distance, np.inf).astype(np.float32)


_NEGATIVE_DEPTH = {
    "z": "pass depth='-z' if the camera looks along -z, or render depth again.",
    "-z": "pass depth='z', distances are positive here.",
    "1/z": "pass depth='-1/z' if the camera looks along -z, or render depth again.",
    "-1/z": "pass depth='1/z', inverse distances are positive here.",
    "normalized-near1": "pass depth='z' or depth='-z', values must lie in 0..1.",
}


def half_spread(
    info: FileInfo,
    guess: vectors.Guess,
    raw: np.ndarray,
    still: np.ndarray,
    alpha: np.ndarray | None,
    shutter: float,
    scale: dict[str, float | None],
) -> tuple[np.ndarray, np.ndarray | None]:
    """Compute the velocity and, if known, the path.

    Args:
        info: listing of the file with the vectors.
        guess: their convention.
        raw: (H, W, 2 or 4) vectors as stored, or some rows of them.
        still: (H, W) True where the vector is unknown and counts as at rest.
        alpha: (H, W) coverage, or None.
        shutter: exposure in frames.
        scale: ``max_displace`` and ``file_shutter``, as in `read_buffers`.

    Returns:
        (H, W, 2) half-spread, and (H, W, 2, 2) or None, as in `Buffers`.

    Raises:
        JaxblurIOError: the convention needs an argument that was not given.
    """
    *_, width, height = info.parts[info.channel(guess.channels[0]).part].display_window
    velocity = np.empty((*still.shape, 2), np.float32)
    curve = np.empty((*still.shape, 2, 2), np.float32) if len(guess.layout) == 2 else None
    rows = max(1, PIXELS_AT_ONCE // max(1, still.shape[1]))
    for row in range(0, len(still), rows):
        block = np.s_[row : row + rows]
        # Damaged values may overflow here; `check_speed` or the caller's statistics report them.
        with np.errstate(invalid="ignore", over="ignore"):
            try:
                displacements = vectors.to_displacements(
                    raw[block],
                    guess,
                    size=(height, width),
                    alpha=None if alpha is None else alpha[block],
                    **scale,
                )
            except ValueError as error:
                raise JaxblurIOError(info.path, str(error)) from error
            mean, ends = vectors.to_half_spread(displacements, shutter)
        velocity[block] = _stopped(mean, still[block])
        if curve is not None and ends is not None:
            curve[block] = _stopped(ends, still[block])
    return velocity, curve


def _stopped(motion: np.ndarray, still: np.ndarray) -> np.ndarray:
    """Set unknown velocities or paths to 0, because the raw value of rest may differ from 0."""
    if not still.any():
        return motion
    return np.where(still.reshape(*still.shape, *(1,) * (motion.ndim - 2)), np.float32(0), motion)
