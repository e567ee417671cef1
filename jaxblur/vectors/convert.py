"""Convert raw vectors to displacements, and displacements to half-spreads and paths."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from .guess import Guess
from .presets import Preset

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclasses.dataclass(frozen=True)
class Displacements:
    """Previous and next position of each pixel's surface point, relative to the current one.

    Attributes:
        previous: (H, W, 2) pixels, x right, y down, one frame earlier; None if unknown.
        next: (H, W, 2) the same, one frame later; None if unknown.
    """

    previous: Float[np.ndarray, "height width 2"] | None
    next: Float[np.ndarray, "height width 2"] | None


def to_displacements(
    raw: Float[np.ndarray, "height width channels"],
    guess: Guess,
    *,
    size: tuple[int, int],
    max_displace: float | None = None,
    file_shutter: float | None = None,
    alpha: Float[np.ndarray, "height width"] | None = None,
) -> Displacements:
    """Decode raw vectors: ``sign * (raw - offset) * gain * scale / span``.

    Args:
        raw: (H, W, 2 or 4) values of ``guess.channels`` as stored.
        guess: the convention and its layout.
        size: (height, width) of the full picture, pixels.
        max_displace: displacement in pixels of a full-range value (scale "max-displace").
        file_shutter: exposure of the render that wrote the vectors, frames (span "shutter").
        alpha: (H, W) coverage, for vectors that were multiplied by it.

    Returns:
        Displacements over one full frame, float32 pixels, x right, y down.

    Raises:
        ValueError: the convention needs an argument that was not given.
    """
    preset = guess.preset
    if preset.premultiplied:
        raw = _unpremultiply(raw, alpha, preset)
    scale = _scale(preset, size, max_displace) * preset.gain / _span(preset, file_shutter)
    sides: dict[int, np.ndarray] = {}
    for index, pair in enumerate(guess.layout):
        values = _pair_of(raw, index) - np.float32(preset.offset)
        factor = np.array([pair.sign_x, pair.sign_y]) * scale
        sides[pair.time] = _by_pairs(values, factor.astype(np.float32))
    return Displacements(sides.get(-1), sides.get(1))


def _pair_of(image: np.ndarray, index: int) -> np.ndarray:
    """Channels 2 k and 2 k + 1 of (H, W, C), as (H, W, 2) of its own.

    NumPy copies pairs of numbers slowly, and complex numbers fast.
    """
    if image.dtype == np.float32 and image.shape[-1] % 2 == 0 and image.flags.c_contiguous:
        pair = np.ascontiguousarray(image.view(np.complex64)[..., index])
        return pair.view(np.float32).reshape(*pair.shape, 2)
    return image[..., 2 * index : 2 * index + 2]


def _by_pairs(values: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """``values * factor`` for (H, W, 2) and (2,), row by row: NumPy's loops over two are slow."""
    height, width, _ = values.shape
    return (values.reshape(height, -1) * np.tile(factor, width)).reshape(values.shape)


def to_half_spread(
    displacements: Displacements, shutter: float
) -> tuple[Float[np.ndarray, "height width 2"], Float[np.ndarray, "height width 2 2"] | None]:
    """Turn displacements per frame into the half-spread and, with both sides, the path.

    ``velocity = shutter/2 * displacement``, as the published filters define it. With both sides, a
    at t = -1 and b at t = 1, the displacement is (b - a)/2, and the path passes through both: with
    l = (b - a)/2, c = (a + b)/2, and c split into c1 along l and c2 across it, it is the arc

        x(t) = l sin(w t)/sin(w) + c2 (1 - cos(w t))/(1 - cos(w)) + c1 t^2,  tan(w/2) = |c2|/|l|,

    evaluated at t = -shutter/2 and +shutter/2. For a point on a turning wheel it is the circle,
    which the straight displacement cuts short; if c2 = 0, it is the parabola of an accelerated
    point.

    Args:
        displacements: as `to_displacements` returns them.
        shutter: exposure in frames.

    Returns:
        velocity (H, W, 2) in pixels, x right, y down, and path (H, W, 2, 2): displacement at
        shutter opening and closing, or None where only one side is known.

    Raises:
        ValueError: ``shutter`` is negative or not finite, or there are no displacements.
    """
    check_shutter(shutter, "shutter")
    previous, following = displacements.previous, displacements.next
    half = np.float32(shutter / 2)
    if previous is not None and following is not None:
        return half * (following - previous) / 2, _arc(previous, following, shutter / 2)
    if following is not None:
        return half * following, None
    if previous is not None:
        return -half * previous, None
    raise ValueError("`displacements` must hold the previous or the next side, got neither.")


_WIDEST = 2 / 3 * np.pi
"""Radians per frame. For a larger angle the direction of the rotation is ambiguous."""


def _arc(
    previous: Float[np.ndarray, "height width 2"],
    following: Float[np.ndarray, "height width 2"],
    half: float,
) -> Float[np.ndarray, "height width 2 2"]:
    """Compute the displacements at the times -half and half on the arc of `to_half_spread`."""
    line, along, across, ratio = _parts(previous, following)
    tangent, bend = _scales(2 * np.arctan(ratio), half)
    end, sagitta = tangent * line, bend * across + np.float32(half**2) * along
    return _beside(sagitta - end, sagitta + end)


def _beside(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Two arrays of vectors (H, W, 2) as (H, W, 2, 2), copied as complex numbers."""
    pair = np.result_type(first, np.complex64)
    vectors = [np.ascontiguousarray(one).view(pair)[..., 0] for one in (first, second)]
    return np.stack(vectors, axis=-1).view(first.dtype).reshape(*first.shape[:-1], 2, 2)


def from_path(path: Float[np.ndarray, "height width 2 2"], shutter: float) -> Displacements:
    """Find the displacements over full frames whose path is the given one; see `to_half_spread`.

    Args:
        path: displacement at shutter opening and closing in pixels.
        shutter: exposure in frames, > 0.

    Returns:
        Displacements to both sides.
    """
    half = shutter / 2
    line, along, across, ratio = _parts(path[..., 0, :], path[..., 1, :])
    tangent, bend = _scales(2 * np.arctan(ratio) / half, half)
    line, rest = line / tangent, across / bend + along / np.float32(half**2)
    return Displacements(rest - line, rest + line)


def _parts(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, ...]:
    """Split two ends into half the chord, the rest along and across it, and their ratio."""
    line, rest = (last - first) / 2, (last + first) / 2
    squared = _dot(line, line)
    along = _dot(line, rest) / np.where(squared > 0, squared, 1) * line
    across = rest - along
    # A point that returns to its old position has no chord: the widest angle.
    steep = np.sqrt(_dot(across, across))
    ratio = steep / np.sqrt(np.where(squared > 0, squared, 1))
    # Of the type of the vectors: NumPy's sines of float64 take ten times as long.
    widest = np.where(steep > 0, ratio.dtype.type(np.inf), 0)
    return line, along, across, np.where(squared > 0, ratio, widest)


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Product of vectors, (H, W, 1); NumPy's sums over so short an axis are slow."""
    return first[..., :1] * second[..., :1] + first[..., 1:] * second[..., 1:]


def _scales(angle: np.ndarray, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute the factors for chord and sagitta of an arc when the angle shrinks by ``half``."""
    # Below 1e-3 the parabola is equal in float32, and there is no division by zero.
    curved = angle > 1e-3
    tangent, bend = (np.full(angle.shape, scale, np.float32) for scale in (half, half**2))
    angle = np.minimum(angle[curved], angle.dtype.type(_WIDEST))
    tangent[curved] = np.sin(half * angle) / np.sin(angle)
    bend[curved] = (np.sin(half * angle / 2) / np.sin(angle / 2)) ** 2
    return tangent, bend


def check_shutter(shutter: float, argument: str) -> None:
    """Check that an exposure is finite and not negative.

    Args:
        shutter: exposure in frames.
        argument: its name in the message.

    Raises:
        ValueError: the value is negative or not finite.
    """
    if not (np.isfinite(shutter) and shutter >= 0):
        raise ValueError(f"`{argument}` must be a fraction of a frame, 0 or more; got {shutter}.")


def _scale(preset: Preset, size: tuple[int, int], max_displace: float | None) -> np.ndarray:
    """Return the size of one unit of x and y in pixels."""
    height, width = size
    if preset.scale == "max-displace":
        if max_displace is None or not max_displace > 0:
            raise ValueError(
                f"preset `{preset.name}` needs `max_displace`, the displacement in pixels of a "
                f"full-range value; got {max_displace}."
            )
        return np.array([max_displace, max_displace])
    factors = {"pixels": (1, 1), "size": (width, height), "half-size": (width / 2, height / 2)}
    return np.array(factors[preset.scale], dtype=float)


def _span(preset: Preset, file_shutter: float | None) -> float:
    if preset.span == "frame":
        return 1.0
    if file_shutter is None or not file_shutter > 0:
        raise ValueError(
            f"preset `{preset.name}` stores motion over the shutter of its render: give that "
            f"exposure in frames as `file_shutter`; got {file_shutter}."
        )
    return file_shutter


def _unpremultiply(raw: np.ndarray, alpha: np.ndarray | None, preset: Preset) -> np.ndarray:
    if alpha is None:
        raise ValueError(
            f"preset `{preset.name}` stores vectors times alpha, and there is no alpha channel; "
            "use preset `ndc` if they are not multiplied."
        )
    covered = alpha > 0
    return np.where(covered, 1 / np.where(covered, alpha, 1), 0)[..., None] * raw
