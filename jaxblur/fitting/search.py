"""Search over the settings that have no derivative: number of samples, and radius."""

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import Literal

import jax
import numpy as np
from jax.typing import ArrayLike

from ..filters.registry import FilterInfo, Parameters, filter_info
from ..frame import Frame
from ..settings import Settings, checked_settings
from ..vectors import speed_statistics
from .evaluation import display_error
from .pairs import Pair, make_pairs


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A setting that was measured.

    Attributes:
        samples: taps per pixel.
        radius: longest half-spread, pixels.
        error: mean squared error after the display transform, over pairs and noise.
        psnr: the same in dB.
        milliseconds: to blur one frame, compiled; the median over repeats, mean over the pairs.
    """

    samples: int
    radius: int
    error: float
    psnr: float
    milliseconds: float


@dataclasses.dataclass(frozen=True)
class SettingsSearch:
    """Result of a search.

    Attributes:
        candidates: all settings measured, the fastest first.
        choice: the settings chosen.
        reason: why it was chosen, in words.
    """

    candidates: tuple[Candidate, ...]
    choice: Settings
    reason: str


def search_settings(
    filter: str | Callable[..., jax.Array],
    pairs: Sequence[Pair | tuple[Frame, ArrayLike]],
    parameters: Parameters | None = None,
    *,
    samples: Sequence[int] = (9, 15, 25, 35),
    radius: Sequence[int | Literal["auto"]] = ("auto",),
    settings: Settings | None = None,
    budget_ms: float | None = None,
    tolerance: float | None = None,
    key: jax.Array | None = None,
    noise_draws: int = 2,
    repeats: int = 3,
) -> SettingsSearch:
    """Measure error and time over a grid of settings, and choose.

    With a budget the choice is the setting of least error within it; with a tolerance it is the
    fastest setting whose error exceeds the least one by no more than that share. Times are
    measured on this machine, under its present load.

    Args:
        filter: the name of a registered filter, or its function.
        pairs: frames with truth (H, W, C).
        parameters: of the filter; its defaults if None.
        samples: numbers to try.
        radius: radii to try; ``auto`` is the largest speed of all frames, rounded up.
        settings: the other settings; the defaults of the filter if None.
        budget_ms: time for a frame in milliseconds.
        tolerance: share by which the error may exceed the least one, such as 0.05.
        key: seed of the noise.
        noise_draws: draws that the error is averaged over.
        repeats: timed runs after the first.

    Returns:
        The measurements and the choice.

    Raises:
        ValueError: not exactly one of budget and tolerance is given, nothing fits the budget, or
            an argument is wrong.
    """
    if (budget_ms is None) == (tolerance is None):
        raise ValueError("give either `budget_ms` or `tolerance`.")
    info = filter_info(filter)
    parameters = info.checked_parameters(parameters)
    base = info.settings if settings is None else settings
    base = checked_settings(base, info.kind, info.name)
    key = jax.random.key(0) if key is None else key
    checked = make_pairs(pairs, None)
    radii = [_automatic(checked) if r == "auto" else r for r in radius]
    tried = {}
    for count, reach in sorted({(n, r) for n in samples for r in radii}):
        chosen = dataclasses.replace(base, samples=count, radius=reach)
        error = display_error(info.name, parameters, checked, chosen, key, noise_draws)
        took = _milliseconds(info, parameters, checked, chosen, repeats)
        psnr = -10 * math.log10(error) if error > 0 else math.inf
        tried[chosen] = Candidate(count, reach, error, psnr, took)
    choice, reason = _choose(tried, budget_ms, tolerance)
    ranked = sorted(tried.values(), key=lambda candidate: candidate.milliseconds)
    return SettingsSearch(tuple(ranked), choice, reason)


def _automatic(pairs: Sequence[Pair]) -> int:
    speeds = [speed_statistics(np.asarray(pair.frame.velocity)) for pair in pairs]
    return max(speed.suggested_radius for speed in speeds)


def _milliseconds(
    info: FilterInfo,
    parameters: Parameters | None,
    pairs: Sequence[Pair],
    settings: Settings,
    repeats: int,
) -> float:
    blur = info.call
    medians = []
    for pair in pairs:
        blur(pair.frame, parameters, settings=settings).block_until_ready()
        times = []
        for _ in range(repeats):
            started = time.perf_counter()
            blur(pair.frame, parameters, settings=settings).block_until_ready()
            times.append(time.perf_counter() - started)
        medians.append(np.median(times))
    return float(1000 * np.mean(medians))


def _choose(
    tried: dict[Settings, Candidate], budget_ms: float | None, tolerance: float | None
) -> tuple[Settings, str]:
    if budget_ms is not None:
        allowed = {s: c for s, c in tried.items() if c.milliseconds <= budget_ms}
        if not allowed:
            fastest = min(candidate.milliseconds for candidate in tried.values())
            raise ValueError(
                f"`budget_ms` must allow at least one of the settings, got {budget_ms:g}; the "
                f"fastest takes {fastest:.3g} ms: try fewer `samples`."
            )
        choice = min(allowed, key=lambda s: (allowed[s].error, allowed[s].milliseconds))
        return choice, f"least error of those within {budget_ms:g} ms"
    assert tolerance is not None
    limit = (1 + tolerance) * min(candidate.error for candidate in tried.values())
    allowed = {s: c for s, c in tried.items() if c.error <= limit}
    choice = min(allowed, key=lambda s: (allowed[s].milliseconds, allowed[s].error))
    return choice, f"fastest of those within {100 * tolerance:g} % of the least error"
