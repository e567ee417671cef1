"""`plan`: the cheapest filter that is expected to do for a frame, and why.

The loss of a filter against the full one on a frame is predicted from statistics of the frame by a
linear rule for each candidate and number of samples,

    loss = c0 + c1 angular_variance + c2 layered_tiles + c3 log2(fast_speed)        [dB]

with constants from experiments/005_what_a_scene_needs, stored in ``constants.json`` with
the command that made them, the scenes, and the error of the rule on scenes left out. A loss is a
difference of PSNR over the pixels that motion reaches, after the display transform, against
`layered` at 35 samples. A rule that gives less than 0 counts as 0: beyond the scenes that it was
derived from it is a guess, and no gain is promised on a guess. A second rule of the same form
predicts the loss in JOD, what viewers of a clip would see of it.
"""

import dataclasses
import functools
import importlib.resources
import json
import math
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from ..filters.registry import Parameters, filter_info
from ..frame import Frame, check_frame_type
from ..settings import Settings
from .statistics import FrameStatistics, frame_statistics

DEFAULT_TOLERANCE = 0.5
PERCEPTUAL_TOLERANCE = 0.1
"""JOD; pairs of clips that viewers told apart by their noise differ by more, experiment 003."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """A filter with settings and parameters for a frame, and the reason for the choice.

    Attributes:
        filter: a key of `jaxblur.FILTERS`.
        settings: of the run.
        parameters: of the filter, None if it has none.
        summary: the choice and its rule in a few words, the same for all frames of that choice.
        reason: why, in one sentence with the statistics of the frame.
        loss: expected loss in dB against the full filter, at least 0.
        spread: standard error of that expectation on scenes that it was not derived from, dB.
        jod_loss: expected loss in JOD against the full filter, at least 0.
        jod_spread: its standard error, JOD.
        milliseconds: expected time on the machine that the constants were measured on, divided by
            `machine_speed` of `plan`.
    """

    filter: str
    settings: Settings
    parameters: Parameters | None
    summary: str
    reason: str
    loss: float
    spread: float
    jod_loss: float
    jod_spread: float
    milliseconds: float

    def __call__(self, frame: Frame) -> jax.Array:
        """Blur a frame as planned: (H, W, C) linear light."""
        return filter_info(self.filter).call(frame, self.parameters, settings=self.settings)


@dataclasses.dataclass(frozen=True)
class _Candidate:
    label: str
    record: Mapping[str, Any]
    loss: float
    spread: float
    jod_loss: float
    jod_spread: float
    milliseconds: float

    @property
    def safe_loss(self) -> float:
        return self.loss + self.spread

    def is_within(self, tolerance_db: float | None, tolerance_jod: float | None) -> bool:
        in_decibels = tolerance_db is None or self.safe_loss <= tolerance_db
        return in_decibels and (
            tolerance_jod is None or self.jod_loss + self.jod_spread <= tolerance_jod
        )


@functools.cache
def constants() -> dict[str, Any]:
    """The constants of the rules, and where they come from.

    Returns:
        ``command``, ``scenes``, ``machine``, and ``candidates`` by label.
    """
    text = importlib.resources.files("jaxblur.planning").joinpath("constants.json").read_text()
    return json.loads(text)


def plan(
    frame_or_statistics: Frame | FrameStatistics,
    budget_ms: float | None = None,
    tolerance_db: float | None = None,
    *,
    tolerance_jod: float | None = None,
    machine_speed: float = 1.0,
) -> Plan:
    """Choose filter, settings and parameters for a frame from its statistics alone.

    With a tolerance: the fastest candidate whose expected loss, plus the standard error of that
    expectation, is within it; with two, in dB and in JOD, within both. With a budget alone: the
    candidate of least expected loss in dB that is fast enough. With budget and tolerance: the
    fastest within both. With neither the tolerance is 0.5 dB.

    Args:
        frame_or_statistics: a frame, or its `frame_statistics`.
        budget_ms: time for the frame in milliseconds.
        tolerance_db: PSNR that may be lost against the full filter, over what moves, >= 0 dB.
        tolerance_jod: quality that clips may lose against the full filter, >= 0 JOD;
            `jaxblur.planning.PERCEPTUAL_TOLERANCE` is what viewers did not see.
        machine_speed: how many times as fast this machine is as that of the constants.

    Returns:
        The plan; call it with the frame.

    Raises:
        ValueError: an argument is out of range, or no candidate fits budget and tolerance.

    Examples:
        >>> still = FrameStatistics(100, 0.0, 0.0, 5, 0.0, 0.0, 0.0)
        >>> plan(still).filter
        'pixel_velocity'
    """
    _check_limits(budget_ms, tolerance_db, tolerance_jod, machine_speed)
    statistics = frame_or_statistics
    if not isinstance(statistics, FrameStatistics):
        check_frame_type(statistics, "frame_or_statistics")
        statistics = frame_statistics(statistics)
    candidates = _predict(statistics, machine_speed)
    if not statistics.moves:
        return _nothing_moves(statistics, candidates)
    if budget_ms is None and tolerance_db is None and tolerance_jod is None:
        tolerance_db = DEFAULT_TOLERANCE
    allowed = [
        candidate
        for candidate in candidates
        if (budget_ms is None or candidate.milliseconds <= budget_ms)
        and candidate.is_within(tolerance_db, tolerance_jod)
    ]
    tolerances = {"dB": tolerance_db, "JOD": tolerance_jod}
    within = " and ".join(
        f"{value:g} {unit}" for unit, value in tolerances.items() if value is not None
    )
    if not allowed:
        kept = [c for c in candidates if c.is_within(tolerance_db, tolerance_jod)]
        raise ValueError(_refusal(candidates, kept, budget_ms, within))
    if not within:
        chosen = min(allowed, key=lambda c: (c.safe_loss, c.milliseconds))
        why = f"the least expected loss of those within {budget_ms:g} ms"
    else:
        chosen = min(allowed, key=lambda c: (c.milliseconds, c.safe_loss))
        why = f"the fastest expected to stay within {within}"
    return _make_plan(chosen, statistics, why, _reason(chosen, statistics))


def _check_limits(
    budget_ms: float | None,
    tolerance_db: float | None,
    tolerance_jod: float | None,
    machine_speed: float,
) -> None:
    if budget_ms is not None and not budget_ms > 0:
        raise ValueError(f"`budget_ms` must be above 0, got {budget_ms:g}.")
    for name, tolerance in (("tolerance_db", tolerance_db), ("tolerance_jod", tolerance_jod)):
        if tolerance is not None and not tolerance >= 0:
            raise ValueError(f"`{name}` must be at least 0, got {tolerance:g}.")
    if not 0 < machine_speed < math.inf:
        raise ValueError(f"`machine_speed` must be a number above 0, got {machine_speed:g}.")


def _predict(statistics: FrameStatistics, machine_speed: float) -> list[_Candidate]:
    megapixels = statistics.pixels / 1e6
    return [
        _Candidate(
            label,
            record,
            max(0.0, float(np.dot(record["loss"], statistics.features))),
            record["spread"],
            max(0.0, float(np.dot(record["jod"], statistics.features))),
            record["jod_spread"],
            record["milliseconds_per_megapixel"] * megapixels / machine_speed,
        )
        for label, record in constants()["candidates"].items()
    ]


def _nothing_moves(statistics: FrameStatistics, candidates: list[_Candidate]) -> Plan:
    fastest = min(candidates, key=lambda candidate: candidate.milliseconds)
    still = dataclasses.replace(fastest, loss=0.0, spread=0.0, jod_loss=0.0, jod_spread=0.0)
    reason = "every filter returns the frame as it is, and this one is the fastest."
    return _make_plan(still, statistics, "nothing moves by more than half a pixel", reason)


def _make_plan(chosen: _Candidate, statistics: FrameStatistics, why: str, more: str) -> Plan:
    info = filter_info(chosen.record["filter"])
    settings = info.kind(**chosen.record["settings"], radius=statistics.radius)
    parameters = info.make_parameters(**chosen.record["parameters"])
    summary = f"{chosen.label}: {why}"
    return Plan(
        info.name,
        settings,
        parameters,
        summary,
        f"{summary}; {more}",
        chosen.loss,
        chosen.spread,
        chosen.jod_loss,
        chosen.jod_spread,
        chosen.milliseconds,
    )


def _reason(chosen: _Candidate, statistics: FrameStatistics) -> str:
    return (
        f"expected loss {chosen.loss:.2f} ± {chosen.spread:.2f} dB and "
        f"{chosen.jod_loss:.2f} ± {chosen.jod_spread:.2f} JOD against the full filter, "
        f"{chosen.milliseconds:.0f} ms, since speeds reach "
        f"{statistics.fast_speed:.1f} px, the angular variance is "
        f"{statistics.angular_variance:.2f}, and {100 * statistics.layered_tiles:.0f} % of the "
        "moving tiles hold layers that move apart."
    )


def _refusal(
    candidates: list[_Candidate], kept: list[_Candidate], budget_ms: float | None, within: str
) -> str:
    """Why no candidate will do: the time that the fastest of those within the tolerance needs."""
    least = min(c.milliseconds for c in (kept if within else candidates))
    if not within:
        return (
            f"`budget_ms` must be at least {least:.3g} for this frame, got {budget_ms:g}; blur a "
            "smaller frame, or pass `machine_speed`."
        )
    return (
        f"`budget_ms` must be at least {least:.3g} ms to stay within {within}, got {budget_ms:g}; "
        "allow a larger tolerance, or plan by the budget alone (on the command line --plan auto)."
    )
