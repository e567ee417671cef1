"""Test whether the vectors of a frame keep a convention, rule by rule.

The rules are those of ``jaxblur/vectors/README.md``. Each is measured on two consecutive frames (on
three for vectors to both sides): a point moves by its vector to where the other frame shows it.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Literal

import numpy as np

from .convert import Displacements
from .rank import SAMPLE_LIMIT, compressed, differences
from .span import Error, best_scale

if TYPE_CHECKING:
    from jaxtyping import Float

Outcome = Literal["holds", "fails", "undecided"]

LEFT = 0.8
"""Vectors explain the motion if they leave at most this share of the difference."""
CLEAR = 0.02
"""Two directions are told apart if their errors differ by this share of the difference."""
LENGTH = 0.05
"""Largest error of the length of vectors, as a share of it."""
AT_REST = 0.02
"""Longest vector at rest, pixels per frame."""
MIXED = 0.1
"""Largest share of the pixels at the borders of motion that may be mixed of two surfaces."""
ENOUGH = 50
"""Fewest pixels from which a rule is decided."""


Found = tuple[str, Outcome, str]
"""Rule, outcome and words."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """What was found of one rule.

    Attributes:
        rule: its number and name, such as "V2 right".
        side: "next" or "previous": the frame to which the vectors lead.
        outcome: "holds", "fails" or "undecided": the frames do not show it.
        found: the measurement in words, and the likely cause if the rule fails.
    """

    rule: str
    side: str
    outcome: Outcome
    found: str

    @property
    def required(self) -> bool:
        """Whether vectors that fail the rule do not keep the convention; V6 is advice."""
        return not self.rule.startswith("V6")


def check_convention(
    color: Float[np.ndarray, "height width channels"],
    displacements: Displacements,
    following: Float[np.ndarray, "height width channels"] | None = None,
    previous: Float[np.ndarray, "height width channels"] | None = None,
    depth: Float[np.ndarray, "height width"] | None = None,
) -> tuple[Finding, ...]:
    """Test vectors, decoded by a convention, against the frames beside theirs.

    Args:
        color: (H, W, C) linear light, the frame that the vectors belong to.
        displacements: as `to_displacements` decodes them: pixels per frame, x right, y down.
        following: (H, W, C) the next frame.
        previous: (H, W, C) the frame before.
        depth: (H, W) positive distance, +inf for background, to test rule V7.

    Returns:
        The findings, in the order of the rules; those of the next frame before those of the
        previous one.

    Raises:
        ValueError: no side has both vectors and a frame, or shapes disagree.
    """
    sides = {
        "next": (displacements.next, following),
        "previous": (displacements.previous, previous),
    }
    given = {name: (d, c) for name, (d, c) in sides.items() if d is not None and c is not None}
    if not given:
        raise ValueError("`following` or `previous` must be given, on a side that vectors lead to.")
    for name, (motion, other) in given.items():
        if motion.shape != (*color.shape[:2], 2) or other.shape != color.shape:
            raise ValueError(
                f"the frame {color.shape}, the {name} frame {other.shape} and its vectors "
                f"{motion.shape} must have one size, and the frames the same channels."
            )
    findings: list[Finding] = []
    for name, (motion, other) in given.items():
        findings += _side(name, motion, color, other, depth)
    for name, (motion, other) in sides.items():
        if motion is not None and other is None:
            findings.append(Finding("V1 to V7", name, "undecided", f"give the {name} frame too"))
    return tuple(findings)


def _side(
    name: str, motion: np.ndarray, color: np.ndarray, other: np.ndarray, depth: np.ndarray | None
) -> list[Finding]:
    """All rules for the vectors to one side."""
    findings: list[Finding] = []

    def add(found: Found) -> None:
        rule, outcome, words = found
        findings.append(Finding(rule, name, outcome, words))

    bad = int(np.count_nonzero(~np.isfinite(motion).all(axis=-1)))
    add(("V1 finite", "fails" if bad else "holds", f"{bad} pixels hold NaN or infinity"))
    motion = np.where(np.isfinite(motion), motion, 0)
    here, there = compressed(color), compressed(other)
    lengths = np.linalg.norm(motion, axis=-1)
    moving = lengths > max(0.25, 0.05 * float(np.percentile(lengths, 99.9)))
    if np.count_nonzero(moving) < ENOUGH:
        words = f"fewer than {ENOUGH} pixels move by a quarter of a pixel or more"
        add(("V2 to V7", "undecided", words))
        return findings
    rows, columns = (index[:: -(-len(index) // SAMPLE_LIMIT)] for index in np.nonzero(moving))
    taken = motion[rows, columns].astype(np.float64)
    now = here[rows, columns]
    still = differences(now, there, rows, columns, np.zeros_like(taken))

    def error(vectors: np.ndarray) -> float:
        found = differences(now, there, rows, columns, vectors)
        return float(np.mean(np.where(np.isnan(found), still, found)))

    rest = float(np.mean(still))
    scale = best_scale(taken, error)
    left = error(taken * scale)
    crossed = error(taken[:, ::-1] * best_scale(taken[:, ::-1], error))
    if left > LEFT * rest or crossed < left - CLEAR * (rest - left):
        # What agrees in no direction and at no length says nothing about either.
        add(_disagreement(left, crossed, rest))
        scale = np.ones(2)
    else:
        for axis, rule in enumerate(("V2 right", "V3 down")):
            add(_direction(rule, axis, taken, scale, error, rest))
        add(_length(taken, scale, error, rest))
    add(_at_rest(motion, here, there))
    add(_one_surface(motion))
    if depth is not None:
        add(_in_front(motion * scale, depth, here, there))
    return findings


def _disagreement(left: float, crossed: float, rest: float) -> Found:
    """V4 of vectors that explain the motion less than the same with x and y exchanged, or not."""
    if crossed < min(left, LEFT * rest):
        words = f"with x and y exchanged the frames agree better (error {crossed:.4f}, else "
        words += f"{left:.4f} of {rest:.4f} at rest): likely channels in another order"
    else:
        words = f"in no direction and at no length do the frames agree (error {left:.4f} of "
        words += f"{rest:.4f} at rest): likely frames that are not beside each other, or channels "
        words += "of something else"
    return "V4 length", "fails", words


def _direction(
    rule: str, axis: int, vectors: np.ndarray, scale: np.ndarray, error: Error, rest: float
) -> Found:
    """V2 and V3: the vectors point right and down, and not the other way."""
    letter, flipped = "xy"[axis], scale * np.where(np.arange(2) == axis, -1, 1)
    best, worse = error(vectors * scale), error(vectors * flipped)
    own, other = (best, worse) if scale[axis] > 0 else (worse, best)
    words = f"error {own:.4f}, with {letter} reversed {other:.4f}, at rest {rest:.4f}"
    if worse - best <= CLEAR * (rest - best):
        return rule, "undecided", words
    if scale[axis] > 0:
        return rule, "holds", words
    if np.all(scale < 0):
        return (
            rule,
            "fails",
            (
                f"{words}: x and y both point the other way: likely frames are exchanged, or the "
                "vectors lead to the other neighbor"
            ),
        )
    return rule, "fails", f"{words}: {letter} points the other way"


def _length(vectors: np.ndarray, scale: np.ndarray, error: Error, rest: float) -> Found:
    """V4: as long as the motion over one frame, in the direction that agrees best."""
    best, left = abs(float(scale[0])), error(vectors * scale)
    words = f"{best:.2f} times as long agrees best; error {left:.4f} of {rest:.4f}"
    if abs(best - 1) <= LENGTH:
        return "V4 length", "holds", words
    frames = round(best)
    if frames > 1 and abs(best - frames) <= LENGTH * frames:
        words += f": likely frames are left out (the other one is {frames} away)"
        return "V4 length", "fails", f"{words}, or another unit"
    return "V4 length", "fails", f"{words}: another unit, or another span of time"


def _at_rest(motion: np.ndarray, here: np.ndarray, there: np.ndarray) -> Found:
    """V5: what is at rest has a vector of 0."""
    same = np.abs(here - there).max(axis=-1) < 1e-3
    slow = motion[same & (np.linalg.norm(motion, axis=-1) < 1)]
    if len(slow) < ENOUGH:
        return "V5 rest", "undecided", "nothing is at rest"
    x, y = np.median(slow, axis=0)
    words = f"{x:+.3f}, {y:+.3f} pixels in the median of {len(slow)} pixels at rest"
    if max(abs(x), abs(y)) <= AT_REST:
        return "V5 rest", "holds", words
    return "V5 rest", "fails", f"{words}: another offset"


def _one_surface(motion: np.ndarray) -> Found:
    """V6: a pixel has the vector of one surface, not a mean over its samples."""
    edges = mixed = 0
    for axis in (0, 1):
        length = motion.shape[axis] - 4
        far_before, before, here, after, far_after = (
            np.take(motion, range(first, first + length), axis).astype(np.float64)
            for first in range(5)
        )
        step = after - before
        squared = np.sum(step * step, axis=-1)
        # Over a slope, as of ground near the camera, the outer two differ by twice as much.
        outer = np.linalg.norm(far_after - far_before, axis=-1)
        edge = (squared > 4) & (outer < 1.75 * np.sqrt(squared))
        share = np.sum((here - before) * step, axis=-1) / np.where(edge, squared, 1)
        off = np.linalg.norm(here - before - share[..., None] * step, axis=-1)
        between = edge & (np.abs(share - 0.5) < 0.35) & (off < 0.2 * np.sqrt(squared))
        edges += int(np.count_nonzero(edge))
        mixed += int(np.count_nonzero(between))
    if edges < ENOUGH:
        return "V6 one surface", "undecided", "no two motions meet"
    words = f"{100 * mixed / edges:.1f} % of {edges} pixels at borders of motion are mixed"
    if mixed <= MIXED * edges:
        return "V6 one surface", "holds", words
    return "V6 one surface", "fails", f"{words}: render vectors unfiltered (closest)"


def _in_front(motion: np.ndarray, depth: np.ndarray, here: np.ndarray, there: np.ndarray) -> Found:
    """V7: of two points that move to one pixel, the nearer one is seen there."""
    height, width = depth.shape
    rows, columns = np.mgrid[:height, :width]
    to_row = np.rint(rows + motion[..., 1]).astype(int)
    to_column = np.rint(columns + motion[..., 0]).astype(int)
    inside = (to_row >= 0) & (to_row < height) & (to_column >= 0) & (to_column < width)
    target = (to_row * width + to_column)[inside]
    distance, light = depth[inside], here[inside]
    order = np.lexsort((distance, target))
    target, distance, light = target[order], distance[order], light[order]
    # The nearest point of a pixel and the one that it hides.
    first = np.r_[True, target[1:] != target[:-1]]
    near = np.nonzero(first[:-1] & ~first[1:])[0]
    near = near[distance[near + 1] > 1.05 * distance[near]]
    seen = there.reshape(-1, there.shape[-1])[target[near]]
    of_near = np.abs(light[near] - seen).mean(axis=-1)
    of_far = np.abs(light[near + 1] - seen).mean(axis=-1)
    told = np.abs(of_near - of_far) > 0.02
    count = int(np.count_nonzero(told))
    if count < ENOUGH:
        return "V7 in front", "undecided", "nothing passes in front of another surface"
    share = float(np.mean(of_near[told] < of_far[told]))
    words = f"the nearer of two points is seen in {100 * share:.0f} % of {count} pixels"
    if share >= 0.6:
        return "V7 in front", "holds", words
    cause = ": likely depth of another kind, such as -z or 1/z"
    return "V7 in front", "fails" if share <= 0.4 else "undecided", f"{words}{cause}"
