"""Determine the convention of motion vectors by measurement.

Each candidate (pair of channels, signs of x and y, unit, span) predicts the position of every point
of a frame in the next one. The next frame is read at these positions and compared with the frame:
under the right candidate the two agree on moving pixels.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .guess import find_channels
from .presets import PRESETS, Preset, Scale, VectorPair

if TYPE_CHECKING:
    from jaxtyping import Float

# Units of raw values: the name that users see, and the corresponding `Preset.scale`.
UNITS: dict[str, Scale] = {
    "px": "pixels",
    "uv": "size",
    "ndc": "half-size",
    "displace": "max-displace",
}
# Largest number of pixels to compare; more take longer and do not change the ranking.
SAMPLE_LIMIT = 40_000
# Raw value of no motion where vectors are encoded in 0..1.
CENTER = 0.5
# Limit of the difference of one pixel, because occlusion and new highlights make a few huge.
ERROR_CAP = 0.5
# Candidates are equally good if their errors differ by less than this share of the error that the
# best one removes.
TIE = 0.02
# The best candidate explains the motion if it leaves at most this share of the difference.
EXPLAINED = 0.8
_MEANING = {
    "sign_x": "the sign of x",
    "sign_y": "the sign of y",
    "unit": "the unit",
    "offset": "the offset",
    "span": "the span",
}


@dataclasses.dataclass(frozen=True)
class Candidate:
    """One convention that was tried: ``forward = sign * (raw - offset) * unit / span``.

    Attributes:
        channels: names of the x and y channel.
        sign_x: factor that makes the first component point forward in time, to the right.
        sign_y: factor that makes the second point forward in time, down.
        unit: "px", "uv" (fraction of the picture), "ndc" (-1..1 over the picture) or "displace"
            (-1..1 over the largest displacement, if it is given).
        offset: raw value of no motion.
        span: length of time the vectors cover, frames: 1, or the exposure.
        error: mean absolute difference on moving pixels, after x/(1+x); lower is better. Where the
            candidate points outside the picture, the difference without motion is used.
        presets: presets that decode such channels in the same way.
    """

    channels: tuple[str, str]
    sign_x: int
    sign_y: int
    unit: str
    offset: float
    span: float
    error: float
    presets: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Ranking:
    """All candidates, the best first.

    Attributes:
        candidates: sorted by error.
        still_error: the same error without motion; if the best candidate is not clearly below it,
            no candidate is right.
        moving_share: share of pixels with motion, 0..1.
    """

    candidates: tuple[Candidate, ...]
    still_error: float
    moving_share: float

    @property
    def is_explained(self) -> bool:
        """Whether the best candidate brings the frames together."""
        return self.candidates[0].error <= EXPLAINED * self.still_error

    @property
    def undecided(self) -> tuple[str, ...]:
        """Properties that these frames leave open: equally good candidates differ in them."""
        best = self.candidates[0]
        most = best.error + TIE * max(self.still_error - best.error, 0)
        as_good = [c for c in self.candidates if c.channels == best.channels and c.error <= most]
        return tuple(
            words
            for name, words in _MEANING.items()
            if len({getattr(candidate, name) for candidate in as_good}) > 1
        )


def rank_conventions(
    frame_color: Float[np.ndarray, "height width channels"],
    next_color: Float[np.ndarray, "height width channels"],
    raw_vectors: Float[np.ndarray, "height width components"],
    channels: Sequence[str] | None = None,
    *,
    shutter: float = 0.5,
    size: tuple[int, int] | None = None,
    max_displace: float | None = None,
) -> Ranking:
    """Rank sign, unit, span and channel pair of motion vectors by warping the next frame back.

    Candidates that move every point alike, such as "uv" over a frame and "ndc" over half of one,
    are one: the one that a preset has, or that spans a frame, with the presets of all.

    Args:
        frame_color: (H, W, C) linear light, the frame that the vectors belong to.
        next_color: (H, W, C) the following frame.
        raw_vectors: (H, W, 2 or 4) vectors as stored: x and y of each pair.
        channels: names of the components; "0", "1", ... if None.
        shutter: exposure in frames, the second span that is tried.
        size: (height, width) of the full picture, if the arrays are a part of it.
        max_displace: displacement in pixels of a full-range vector, for renderers that scale so.

    Returns:
        The ranking.

    Raises:
        ValueError: shapes do not fit, the exposure or the displacement is not positive, or nothing
            moves.

    Source: the photometric error of optical flow; candidates from the table of presets.
    """
    names = _checked(frame_color, next_color, raw_vectors, channels, shutter)
    rows, columns, share = _moving(raw_vectors)
    now, following = compressed(frame_color)[rows, columns], compressed(next_color)
    still = differences(now, following, rows, columns, np.zeros((len(rows), 2)))
    if max_displace is not None and not 0 < max_displace < math.inf:
        raise ValueError(f"`max_displace` must be above 0, got {max_displace}.")
    size = size or (frame_color.shape[0], frame_color.shape[1])
    candidates: dict[tuple[Any, ...], Candidate] = {}
    for options in _options(names, shutter, max_displace is not None):
        pair, sign_x, sign_y, unit, offset, span = options
        factor = np.array([sign_x, sign_y]) * _unit_pixels(unit, size, max_displace) / span
        if offset:
            factor = factor * 2
        pair_names = (names[2 * pair], names[2 * pair + 1])
        presets = _presets(pair_names, sign_x, sign_y, unit, offset, span)
        mapping = (pair, offset, *np.round(factor, 9))
        if (same := candidates.get(mapping)) is not None:
            both = tuple(dict.fromkeys(same.presets + presets))
            named = {} if same.presets or not presets else {"unit": unit, "span": span}
            candidates[mapping] = dataclasses.replace(same, presets=both, **named)
            continue
        raw = raw_vectors[rows, columns, 2 * pair : 2 * pair + 2].astype(np.float64)
        found = differences(now, following, rows, columns, (raw - offset) * factor)
        error = float(np.mean(np.where(np.isnan(found), still, found)))
        candidates[mapping] = Candidate(
            pair_names, sign_x, sign_y, unit, offset, span, error, presets
        )
    ranked = sorted(candidates.values(), key=lambda candidate: candidate.error)
    return Ranking(tuple(ranked), float(np.mean(still)), share)


def _checked(
    frame_color: np.ndarray,
    next_color: np.ndarray,
    raw_vectors: np.ndarray,
    channels: Sequence[str] | None,
    shutter: float,
) -> list[str]:
    if frame_color.shape != next_color.shape or frame_color.ndim != 3:
        raise ValueError(
            "`frame_color` and `next_color` must have one shape (height, width, channels), got "
            f"{frame_color.shape} and {next_color.shape}."
        )
    count = raw_vectors.shape[-1]
    if raw_vectors.shape[:2] != frame_color.shape[:2] or count % 2 or count == 0:
        raise ValueError(
            f"`raw_vectors` must have shape {frame_color.shape[:2]} and pairs of components, got "
            f"{raw_vectors.shape}."
        )
    if not (math.isfinite(shutter) and shutter > 0):
        raise ValueError(f"`shutter` must be above 0, got {shutter}.")
    names = [str(i) for i in range(count)] if channels is None else list(channels)
    if len(names) != count:
        raise ValueError(f"`channels` must name {count} components, got {len(names)}.")
    return names


def _moving(raw: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Pick pixels whose vectors differ from rest: rows, columns, and their share."""
    rest = CENTER if _share_near(raw, CENTER) > _share_near(raw, 0.0) else 0.0
    length = np.linalg.norm(np.where(np.isfinite(raw), raw, rest) - rest, axis=-1)
    moving = np.isfinite(raw).all(axis=-1) & (length > 0.05 * np.percentile(length, 99.9))
    rows, columns = np.nonzero(moving)
    if not rows.size:
        raise ValueError("nothing moves: all vectors are zero or not finite.")
    step = -(-rows.size // SAMPLE_LIMIT)
    return rows[::step], columns[::step], float(moving.mean())


def _share_near(raw: np.ndarray, value: float) -> float:
    return float(np.mean(np.abs(raw - value) < 0.02))


def _options(
    names: Sequence[str], shutter: float, displace: bool
) -> Iterator[tuple[int, int, int, str, float, float]]:
    """Yield pair, sign of x, sign of y, unit, offset and span of every candidate."""
    spans = sorted({1.0, shutter}, reverse=True)
    signs = itertools.product((1, -1), (1, -1))
    units = [unit for unit in UNITS if displace or unit != "displace"]
    # Encoded values may leave 0..1 where things are faster than what they were scaled for.
    decodings = [(unit, 0.0) for unit in units]
    decodings += [(unit, CENTER) for unit in units if unit != "px"]
    pairs = range(len(names) // 2)
    # Spans outermost: of equal mappings the one over a full frame comes first.
    for span, pair, (sign_x, sign_y), (unit, offset) in itertools.product(
        spans, pairs, signs, decodings
    ):
        yield pair, sign_x, sign_y, unit, offset, span


def _unit_pixels(unit: str, size: tuple[int, int], displace: float | None) -> np.ndarray:
    height, width = size
    pixels = {"px": (1, 1), "uv": (width, height), "ndc": (width / 2, height / 2)}
    return np.array(pixels.get(unit, (displace, displace)), dtype=float)


def compressed(color: np.ndarray) -> np.ndarray:
    """Compress light to 0..1, so that highlights do not dominate.

    Args:
        color: (H, W, C) linear light.

    Returns:
        (H, W, C) float32 x/(1+x).
    """
    light = np.maximum(np.nan_to_num(color.astype(np.float32), posinf=1e6), 0)
    return light / (1 + light)


def differences(
    now: np.ndarray, following: np.ndarray, rows: np.ndarray, columns: np.ndarray, to: np.ndarray
) -> np.ndarray:
    """Compare pixels with their predicted positions in another frame, read bilinearly.

    Args:
        now: (N, C) the pixels, as `compressed`.
        following: (H, W, C) the other frame, as `compressed`.
        rows: (N,) of the pixels.
        columns: (N,) of the pixels.
        to: (N, 2) their displacements, pixels, x right, y down.

    Returns:
        (N,) mean absolute differences; NaN where a point leaves the image.
    """
    height, width, _ = following.shape
    y, x = rows + to[:, 1], columns + to[:, 0]
    # The edge of the image is half a pixel beyond the outermost pixel centers.
    inside = (y >= -0.5) & (y <= height - 0.5) & (x >= -0.5) & (x <= width - 0.5)
    y, x = np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)
    top, left = np.floor(y).astype(int), np.floor(x).astype(int)
    bottom, right = np.minimum(top + 1, height - 1), np.minimum(left + 1, width - 1)
    down, across = (y - top)[:, None], (x - left)[:, None]
    upper = following[top, left] * (1 - across) + following[top, right] * across
    lower = following[bottom, left] * (1 - across) + following[bottom, right] * across
    warped = upper * (1 - down) + lower * down
    difference = np.mean(np.minimum(np.abs(warped - now), ERROR_CAP), axis=-1)
    return np.where(inside, difference, np.nan)


def _presets(
    names: tuple[str, str], sign_x: int, sign_y: int, unit: str, offset: float, span: float
) -> tuple[str, ...]:
    """List presets with this meaning: those that name these channels, else all with one pair."""

    def same_meaning(preset: Preset, pair: VectorPair) -> bool:
        return (
            preset.scale == UNITS[unit]
            and preset.offset == offset
            and (preset.span == "frame") == (span == 1)
            and (pair.time * pair.sign_x, pair.time * pair.sign_y) == (sign_x, sign_y)
        )

    matches = {
        (preset.name, _is_called(pair, names), len(layout))
        for preset in PRESETS.values()
        for layout in preset.layouts
        for pair in layout
        if same_meaning(preset, pair)
    }
    by_name = [name for name in PRESETS if any(m[0] == name and m[1] for m in matches)]
    return tuple(by_name or [name for name in PRESETS if (name, False, 1) in matches])


def _is_called(pair: VectorPair, names: tuple[str, str]) -> bool:
    return bool(find_channels(pair.x, names[:1]) and find_channels(pair.y, names[1:]))
