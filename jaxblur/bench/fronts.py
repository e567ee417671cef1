"""Speed against error as points, front and table."""

import collections
import dataclasses
import math
import statistics
from collections.abc import Iterable, Sequence

from .._util.pareto import Measurement, pareto_front
from .cases import UNBLURRED, Case
from .results import Row

ERRORS = ("flip", "rmse")


@dataclasses.dataclass(frozen=True)
class Point:
    """A case with its time and errors on one scene, or pooled over several.

    Attributes:
        case: what was measured.
        ms: warm time; pooled by the geometric mean.
        ms_iqr: interquartile range; pooled as a share of the time, by the mean.
        psnr: dB where motion reaches (or on the whole frame, as asked for); pooled by the mean,
            like the others.
        ssim: of the same area.
        flip: of the same area.
        temporary_mb: peak of temporary buffers, the largest.
    """

    case: Case
    ms: float
    ms_iqr: float
    psnr: float
    ssim: float
    flip: float
    temporary_mb: float | None

    @property
    def rmse(self) -> float:
        """Root mean squared error of display values, from the PSNR."""
        return 10 ** (-self.psnr / 20)

    def measurement(self, error: str = "flip") -> Measurement:
        """The point as `jaxblur.show.pareto` draws it: an error over milliseconds.

        Args:
            error: ``flip`` or ``rmse``.

        Returns:
            The measurement, with the interquartile range of the time.
        """
        half = self.ms_iqr / 2
        return Measurement(
            label=self.case.label,
            time=self.ms,
            error=getattr(self, error),
            group=self.case.method,
            published=self.case.is_published,
            time_range=(max(self.ms - half, self.ms / 10), self.ms + half),
        )


def points(rows: Iterable[Row], area: str = "moving_") -> list[Point]:
    """Rows of one scene and size as points; those without error or time are left out.

    Args:
        rows: with different cases.
        area: ``moving_`` for the pixels that motion reaches, or empty for the whole frame.

    Returns:
        The points in the order of the rows.
    """
    found = []
    for row in rows:
        f = row.figures
        psnr, ssim, flip = (getattr(f, f"{area}{name}") for name in ("psnr", "ssim", "flip"))
        if f.ms and None not in (psnr, ssim, flip):
            found.append(Point(row.case, f.ms, f.ms_iqr or 0.0, psnr, ssim, flip, f.temporary_mb))
    return found


def pooled(groups: Sequence[Sequence[Point]]) -> list[Point]:
    """Points pooled over scenes; cases that some scene lacks are left out.

    Args:
        groups: points of each scene, all of one size.

    Returns:
        A point for each case that all scenes have.
    """
    by_case: dict[Case, list[Point]] = collections.defaultdict(list)
    for group in groups:
        for point in group:
            by_case[point.case].append(point)
    return [_pool(case, same) for case, same in by_case.items() if len(same) == len(groups)]


def _pool(case: Case, same: Sequence[Point]) -> Point:
    ms = statistics.geometric_mean(point.ms for point in same)
    spread = statistics.fmean(point.ms_iqr / point.ms for point in same)
    memory = [p.temporary_mb for p in same if p.temporary_mb is not None]
    return Point(
        case=case,
        ms=ms,
        ms_iqr=spread * ms,
        psnr=statistics.fmean(point.psnr for point in same),
        ssim=statistics.fmean(point.ssim for point in same),
        flip=statistics.fmean(point.flip for point in same),
        temporary_mb=max(memory, default=None),
    )


def by_scene(rows: Iterable[Row]) -> dict[tuple[str, str, str], list[Row]]:
    """Rows by scene, width and height, in the order of their first ones."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["scene"], row["width"], row["height"]), []).append(row)
    return groups


def front(found: Sequence[Point], error: str = "flip") -> list[Point]:
    """The points that none beats in time and error, from quick to exact.

    Args:
        found: points to choose from; those without blur, or without error, are left out.
        error: ``flip`` or ``rmse``.

    Returns:
        The front.
    """
    drawable = drawn(found, error)
    by_label = {p.case.label: p for p in drawable}
    return [by_label[m.label] for m in pareto_front([p.measurement(error) for p in drawable])]


def drawn(found: Sequence[Point], error: str = "flip") -> list[Point]:
    """The points that take time and have an error, so that logarithmic axes can show them."""
    return [p for p in found if p.case.method != UNBLURRED and 0 < getattr(p, error) < math.inf]


def front_table(title: str, found: Sequence[Point]) -> str:
    """The fronts as a Markdown table; the unblurred frame and published settings are added.

    Args:
        title: heading of the first column.
        found: points to choose from.

    Returns:
        Lines with a newline each; nothing if there are no points.
    """
    fronts = {error: [point.case for point in front(found, error)] for error in ERRORS}
    shown = [
        point
        for point in sorted(found, key=lambda point: point.ms)
        if any(point.case in cases for cases in fronts.values())
        or point.case.is_published
        or point.case.method == UNBLURRED
    ]
    if not shown:
        return ""
    heads = (title, "front of", "ms", "IQR ms", "FLIP", "PSNR dB", "SSIM", "temporaries MB")
    lines = [heads, ("---",) * len(heads)]
    lines += [_cells(p, [e for e, cases in fronts.items() if p.case in cases]) for p in shown]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _cells(point: Point, fronts: Sequence[str]) -> tuple[str, ...]:
    mark = " (published)" if point.case.is_published else ""
    return (
        f"{point.case.label}{mark}".replace("|", "\\|"),
        ", ".join(error.upper() for error in fronts),
        f"{point.ms:.3g}",
        f"{point.ms_iqr:.2g}",
        f"{point.flip:.4f}",
        f"{point.psnr:.2f}",
        f"{point.ssim:.4f}",
        "" if point.temporary_mb is None else f"{point.temporary_mb:.1f}",
    )


def report(rows: Sequence[Row]) -> str:
    """Fronts of every scene and size, then pooled over the scenes of a size, as Markdown.

    Args:
        rows: each case once on each scene.

    Returns:
        The text, empty if no row has an error.
    """
    sections, sizes = [], collections.defaultdict(list)
    for (scene, width, height), same in by_scene(rows).items():
        found = points(same)
        if table := front_table(f"{scene} {width}x{height}", found):
            sections.append(table)
            sizes[width, height].append(found)
    for (width, height), groups in sizes.items():
        if len(groups) > 1:
            title = f"mean of {len(groups)} scenes {width}x{height}"
            sections.append(front_table(title, pooled(groups)))
    return "\n".join(section for section in sections if section)
