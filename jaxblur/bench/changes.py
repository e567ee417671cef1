"""Compare two files of results: find cases that became slower, larger or worse.

For each case that both files hold, the ratio of the times is

    ratio = (new ms / new calibration ms) / (old ms / old calibration ms),

where the calibration is a fixed piece of work that ran in the same rounds, so that a machine that
is busier today does not count. Its noise is the standard error of its logarithm: that of a median
of n times is ``0.93 IQR / (median sqrt(n))``, taken for all four, with `FLOOR` for what differs
between two runs of the same program. A case is **slower** if the ratio exceeds ``1 + tolerance`` by
more than three standard errors, and quicker likewise. It is **larger** if its temporary buffers
grew by more than the tolerance, and **worse** if the PSNR where motion reaches fell by more than
0.1 dB.
"""

import dataclasses
import math
from collections.abc import Sequence

from .cases import UNBLURRED
from .results import Figures, Row, latest

ERRORS = 3.0
"""Standard errors beyond the tolerance."""
FLOOR = 0.02
"""Standard error of the logarithm of a ratio between two runs of the same program, besides the
spread within a run: other addresses, other pages."""
PSNR_STEP = 0.1
_MEDIAN_ERROR = 0.93
"""1.2533 / 1.349: standard error of a median in interquartile ranges, over sqrt(n)."""


@dataclasses.dataclass(frozen=True)
class Change:
    """How a case differs between two files.

    Attributes:
        row: the newer measurement.
        ratio: of the times, above 1 is slower now.
        noise: standard error of the logarithm of the ratio.
        memory_ratio: of the temporary buffers, None where one side does not know.
        psnr_change: dB, negative is worse now, None where one side does not know.
        verdict: ``slower``, ``larger``, ``worse`` (several joined by "+"), ``quicker`` or ``same``.
    """

    row: Row
    ratio: float
    noise: float
    memory_ratio: float | None
    psnr_change: float | None
    verdict: str

    @property
    def is_regression(self) -> bool:
        """Whether something became slower, larger or worse."""
        return self.verdict not in ("quicker", "same")


def compare(old: Sequence[Row], new: Sequence[Row], tolerance: float = 0.1) -> list[Change]:
    """Compare the cases that two files share, by the rule of the module's docstring.

    Args:
        old: rows of the older file.
        new: rows of the newer file; the last of equal cases counts, here and there.
        tolerance: share by which time and memory may grow, >= 0.

    Returns:
        A change for each case that both hold with a time, in the order of the newer file.

    Raises:
        ValueError: the tolerance is negative.
    """
    if not tolerance >= 0:
        raise ValueError(f"`tolerance` must be at least 0, got {tolerance}.")
    before = {row.identity: row for row in latest(old) if row.figures.ms}
    return [
        _change(before[row.identity].figures, row, tolerance)
        for row in latest(new)
        if row.identity in before and row.figures.ms and row["method"] != UNBLURRED
    ]


def _change(old: Figures, row: Row, tolerance: float) -> Change:
    new = row.figures
    ratio = _calibrated(new) / _calibrated(old)
    noise = math.sqrt(FLOOR**2 + _variance(new) + _variance(old))
    memory = new.temporary_mb / old.temporary_mb if new.temporary_mb and old.temporary_mb else None
    psnr = None
    if new.moving_psnr is not None and old.moving_psnr is not None:
        equal = new.moving_psnr == old.moving_psnr
        psnr = 0.0 if equal else new.moving_psnr - old.moving_psnr
    allowed = math.log1p(tolerance)
    verdicts = [
        *["slower"] * (math.log(ratio) - ERRORS * noise > allowed),
        *["larger"] * (memory is not None and memory > 1 + tolerance),
        *["worse"] * (psnr is not None and psnr < -PSNR_STEP),
    ]
    otherwise = "quicker" if math.log(ratio) + ERRORS * noise < -allowed else "same"
    return Change(row, ratio, noise, memory, psnr, "+".join(verdicts) or otherwise)


def _calibrated(figures: Figures) -> float:
    """Time in units of the calibration, in ms where there was none."""
    assert figures.ms is not None
    return figures.ms / (figures.calibration_ms or 1.0)


def _variance(figures: Figures) -> float:
    """Variance of the logarithm of a calibrated time."""
    rounds = figures.rounds or 1.0
    pairs = (
        (figures.ms, figures.ms_iqr),
        (figures.calibration_ms, figures.calibration_ms_iqr),
    )
    shares = [_MEDIAN_ERROR * spread / median for median, spread in pairs if median and spread]
    return sum(share**2 for share in shares) / rounds
