"""How time grows: power laws fitted to rows."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from .results import Row

FACTORS: Mapping[str, Callable[[Row], float]] = {
    "pixels": lambda row: float(row["width"]) * float(row["height"]),
    "samples": lambda row: float(row["samples"]),
    "radius": lambda row: row.figures.radius_px or math.nan,
}


@dataclasses.dataclass(frozen=True)
class PowerLaw:
    """``time = scale * prod_k factor_k ** exponent_k``.

    Attributes:
        exponents: by name of the factor; factors that did not vary are missing.
        errors: half widths of their 95 % confidence intervals.
        residual: standard deviation of the logarithm of the time about the law.
        rows: number of rows.
    """

    exponents: dict[str, float]
    errors: dict[str, float]
    residual: float
    rows: int


def fit_power_law(rows: Iterable[Row], figure: str = "ms") -> PowerLaw:
    """Fit the growth of time with pixels, samples and radius by least squares of logarithms.

    Each scene has a scale of its own; the exponents are shared.

    Args:
        rows: of one method, with the same other settings.
        figure: ``ms``, or ``cpu_ms`` for the time of the processor, which another program's load
            touches less.

    Returns:
        The law.

    Raises:
        ValueError: there are fewer rows than what is fitted.
    """
    from scipy import stats

    measured = [row for row in rows if getattr(row.figures, figure)]
    logarithms = {
        name: np.log([factor(row) for row in measured]) for name, factor in FACTORS.items()
    }
    varying = {name: v for name, v in logarithms.items() if len(set(v.tolist())) > 1}
    scenes = sorted({row["scene"] for row in measured})
    own_scale = [[row["scene"] == scene for scene in scenes] for row in measured]
    freedom = len(measured) - len(varying) - len(scenes)
    if freedom < 1:
        raise ValueError(
            f"`rows` must number at least {len(measured) - freedom + 1} to fit "
            f"{', '.join(varying) or 'nothing'}, got {len(measured)}."
        )
    design = np.column_stack([*varying.values(), np.array(own_scale, float)])
    target = np.log([getattr(row.figures, figure) for row in measured])
    solution, *_ = np.linalg.lstsq(design, target, rcond=None)
    variance = float(np.sum(np.square(target - design @ solution))) / freedom
    covariance = variance * np.linalg.pinv(design.T @ design)
    width = stats.t.ppf(0.975, freedom) * np.sqrt(np.diag(covariance))
    return PowerLaw(
        exponents=dict(zip(varying, solution.tolist(), strict=False)),
        errors=dict(zip(varying, width.tolist(), strict=False)),
        residual=math.sqrt(variance),
        rows=len(measured),
    )
