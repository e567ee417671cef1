"""The table that `jaxblur.check_gradient` returns: derivatives beside central differences."""

import dataclasses
import math

import numpy as np

from ..settings import Settings


@dataclasses.dataclass(frozen=True)
class GradientRow:
    """Derivative and difference by one quantity.

    Attributes:
        name: of the quantity.
        at: its value: of a parameter, or the factor of all velocities; 0 for other directions.
        reverse: derivative by reverse mode by a *relative* change, the mean over draws of noise.
        reverse_error: its standard error.
        forward: derivative by forward mode, or None where it was not asked for.
        difference: central difference, the mean over the same draws.
        difference_error: its standard error.
        ratio: reverse / difference; NaN where the difference is 0.
        ratio_error: its standard error, of the noise alone: where the picture jumps within the
            step, another step gives another difference.
        sensitivity: difference / loss: percent of the loss by a change of one percent.
        determined: whether the difference is at least 2 % of the largest one in the table, and
            five of its standard errors.
    """

    name: str
    at: float
    reverse: float
    reverse_error: float
    forward: float | None
    difference: float
    difference_error: float
    ratio: float
    ratio_error: float
    sensitivity: float
    determined: bool


@dataclasses.dataclass(frozen=True)
class GradientCheck:
    """The table of `check_gradient`; ``print`` shows it.

    Attributes:
        filter: its name.
        settings: of the filter.
        size: (height, width) of the frame.
        step: half the interval of the central differences, a relative change.
        draws: how many draws of noise every mean is over.
        loss: mean loss of the frame as given.
        rows: one for each quantity.
    """

    filter: str
    settings: Settings
    size: tuple[int, int]
    step: float
    draws: int
    loss: float
    rows: tuple[GradientRow, ...]

    def outside(self, low: float = 0.95, high: float = 1.05) -> tuple[GradientRow, ...]:
        """The determined rows whose ratio is not within a range.

        Args:
            low: lower end of the range.
            high: upper end.

        Returns:
            Those rows; none if derivative and difference agree.
        """
        return tuple(r for r in self.rows if r.determined and not low <= r.ratio <= high)

    def cosine(self, prefix: str) -> float:
        """Cosine between derivatives and differences of several quantities, as one vector.

        Args:
            prefix: the rows whose names begin so, such as ``twist``.

        Returns:
            1 if both point in one direction; NaN without such rows, or if one of the two is 0.
        """
        rows = [row for row in self.rows if row.name.startswith(prefix)]
        derivative = np.array([row.reverse for row in rows])
        difference = np.array([row.difference for row in rows])
        lengths = np.linalg.norm(derivative) * np.linalg.norm(difference)
        return float(derivative @ difference / lengths) if lengths > 0 else math.nan

    def __str__(self) -> str:
        height, width = self.size
        head = (
            f"{self.filter}, {width}x{height}, fetch {self.settings.fetch}: "
            f"derivatives of the loss {self.loss:.4g} by relative changes;\n"
            f"central differences at a step of {100 * self.step:g} %, means over {self.draws} "
            "draws of noise, with standard errors"
        )
        has_forward = any(row.forward is not None for row in self.rows)
        forward = ("forward",) if has_forward else ()
        columns = ("quantity", "at", "reverse", *forward, "difference", "ratio", "sensitivity", "")
        cells = [columns, *(_cells(row, has_forward) for row in self.rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = [
            "  ".join(
                cell.ljust(width) if k in (0, len(line) - 1) else cell.rjust(width)
                for k, (cell, width) in enumerate(zip(line, widths, strict=True))
            ).rstrip()
            for line in cells
        ]
        return "\n".join([head, *lines])


def _cells(row: GradientRow, has_forward: bool) -> tuple[str, ...]:
    forward = ("" if row.forward is None else f"{row.forward:.3g}",) if has_forward else ()
    return (
        row.name,
        f"{row.at:g}",
        f"{row.reverse:.3g} ± {row.reverse_error:.1g}",
        *forward,
        f"{row.difference:.3g} ± {row.difference_error:.1g}",
        f"{row.ratio:.3f} ± {row.ratio_error:.1g}",
        f"{row.sensitivity:.3g}",
        "" if row.determined else "not determined",
    )
