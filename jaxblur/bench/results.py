"""Rows of results and the CSV file that holds them: resumable, and complete at all times.

A setting that a method does not have is an empty cell; one that is newer than the file, and so has
no column, takes its default.
"""

import csv
import dataclasses
import functools
import hashlib
import io
import math
import pathlib
from collections.abc import Iterable, Sequence
from typing import Any

from .._util.atomic import replacing
from .._util.small_files import read_text
from ..settings import GuertinSettings
from .cases import AUTO, RENDERERS, UNBLURRED, Case, filter_of, names_of_settings, usual_settings
from .subjects import Subject

_PACKAGE = pathlib.Path(__file__).parents[1]
_NOT_MEASURED = {"bench", "cli", "exr", "fitting", "report", "sequence", "show", "vectors"}
_SOURCES = {".py", ".cc", ".h"}
_WRITTEN = "give a file that `jaxblur bench` wrote."
SETTINGS = tuple(field.name for field in dataclasses.fields(GuertinSettings))
"""Columns: the settings that every filter has, and those of guertin2014."""
POSITIVE = ("ms", "cpu_ms", "calibration_ms", "rounds")
"""Figures that others are divided by."""
_NUMBERS = {"samples": int, "radius": int, "spacing": float, "temperature": float}
SUBJECT_COLUMNS = ("scene", "width", "height", "shutter", "source")
IDENTITY_COLUMNS = (*SUBJECT_COLUMNS, "method", *SETTINGS)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Figures:
    """What was measured; None where it does not apply.

    Attributes:
        radius_px: radius that ``auto`` came to, in pixels.
        ms: median warm time.
        ms_iqr: interquartile range of the warm times.
        cpu_ms: median processor time over all threads.
        cpu_ms_iqr: interquartile range of the processor times.
        rounds: number of times that count.
        calibration_ms: median time of `calibration` in the same rounds.
        calibration_ms_iqr: its interquartile range.
        compile_s: tracing and compiling, seconds; for renderers what the first run took more.
        temporary_mb: peak of the temporary buffers by the compiler's account, 10^6 bytes.
        resident_mb: most memory that the whole process held while the method ran, 10^6 bytes.
        psnr: dB, whole frame, display values.
        ssim: whole frame.
        flip: whole frame.
        moving_psnr: over the pixels that motion reaches.
        moving_ssim: over the same.
        moving_flip: over the same.
        load: of the machine, mean number of running processes in the last minute.
    """

    radius_px: float | None = None
    ms: float | None = None
    ms_iqr: float | None = None
    cpu_ms: float | None = None
    cpu_ms_iqr: float | None = None
    rounds: float | None = None
    calibration_ms: float | None = None
    calibration_ms_iqr: float | None = None
    compile_s: float | None = None
    temporary_mb: float | None = None
    resident_mb: float | None = None
    psnr: float | None = None
    ssim: float | None = None
    flip: float | None = None
    moving_psnr: float | None = None
    moving_ssim: float | None = None
    moving_flip: float | None = None
    load: float | None = None


FIGURE_COLUMNS = tuple(field.name for field in dataclasses.fields(Figures))
COLUMNS = (*IDENTITY_COLUMNS, "code", "machine", *FIGURE_COLUMNS)


@dataclasses.dataclass(frozen=True)
class Row:
    """One line of the file.

    Attributes:
        identity: texts by `IDENTITY_COLUMNS`: what was measured.
        code: digest of the code that was measured, see `code_digest`.
        machine: version of jax, kind of device and number of processors.
        figures: the results.
    """

    identity: tuple[str, ...]
    code: str
    machine: str
    figures: Figures

    def __getitem__(self, column: str) -> str:
        """A text of the identity by its column."""
        return self.identity[IDENTITY_COLUMNS.index(column)]

    @property
    def key(self) -> tuple[str, ...]:
        """Equal for measurements of the same thing, which need not be repeated."""
        return (*self.identity, self.code, self.machine)

    @property
    def case(self) -> Case:
        """The case that was measured.

        Raises:
            ValueError: the method or a setting no longer exists.
        """
        texts = {name: text for name in SETTINGS if (text := self[name])}
        automatic = texts.get("radius") == AUTO
        if automatic:
            del texts["radius"]
        values: dict[str, Any] = {n: _NUMBERS.get(n, str)(text) for n, text in texts.items()}
        kind = type(usual_settings(self["method"]))
        return Case(self["method"], kind(**values), automatic)


def identity(subject: Subject, case: Case) -> tuple[str, ...]:
    """Texts by `IDENTITY_COLUMNS`; settings that the method does not have are empty.

    Raises:
        ValueError: the case changes a setting that has no column: only the settings that every
            filter has, and those of guertin2014, have one.
    """
    height, width = subject.size
    texts = {
        "scene": subject.name,
        "width": str(width),
        "height": str(height),
        "shutter": f"{subject.shutter:g}",
        "source": subject.source,
        "method": case.method,
    }
    usual = usual_settings(case.method)
    for name in names_of_settings(case.method):
        value = getattr(case.settings, name)
        if name in SETTINGS:
            texts[name] = str(value)
        elif value != getattr(usual, name):
            raise ValueError(
                f"`case` must leave `{name}` at its default, {getattr(usual, name)!r}: results "
                "have no column for it; register a second filter with that default."
            )
    if case.has_settings and case.auto_radius:
        texts["radius"] = AUTO
    return tuple(texts.get(column, "") for column in IDENTITY_COLUMNS)


@functools.cache
def code_digest() -> str:
    """Eight hexadecimal digits that change with the code of filters, scenes or metrics."""
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*")):
        home = path.relative_to(_PACKAGE).parts[0]
        if path.suffix in _SOURCES and home not in _NOT_MEASURED:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:8]


def read_rows(path: pathlib.Path) -> list[Row]:
    """Read a file of results; missing columns are filled in, unknown ones are left out.

    A missing column of a setting is newer than the file: its rows were measured with the default.
    Version 0.1 filled in the settings of guertin2014 for every filter; they are left out for the
    others, which ignored them.

    Args:
        path: of the CSV file.

    Returns:
        The rows in their order.

    Raises:
        ValueError: it is no such file, or a figure is not a number.
        JaxblurIOError: it cannot be read as text.
    """
    reader = csv.DictReader(io.StringIO(read_text(path, _WRITTEN), newline=""))
    try:
        missing = {"scene", "method", "ms"} - set(reader.fieldnames or ())
        if missing:
            raise ValueError(f"{path}: has no column {', '.join(sorted(missing))}; {_WRITTEN}")
        return [_parse(path, reader.line_num, record) for record in reader]
    except csv.Error as error:
        raise ValueError(f"{path}: is not a table ({error}); {_WRITTEN}") from error


def _parse(path: pathlib.Path, line: int, record: dict[str, Any]) -> Row:
    try:
        figures = {n: float(text) for n in FIGURE_COLUMNS if (text := record.get(n))}
        for name, value in figures.items():
            if math.isnan(value) or (name in POSITIVE and not 0 < value < math.inf):
                raise ValueError(f"{name} must be a number above 0, got {value:g}")
    except ValueError as error:
        raise ValueError(f"{path}: line {line}: {error}; remove the line.") from error
    texts = {column: record.get(column) or "" for column in IDENTITY_COLUMNS}
    method = texts["method"]
    if filter_of(method) is not None or method in (*RENDERERS, UNBLURRED):
        known, usual = names_of_settings(method), usual_settings(method)
        for name in SETTINGS:
            if name not in known:
                texts[name] = ""
            elif name not in record:
                texts[name] = str(getattr(usual, name))
    code, machine = record.get("code") or "", record.get("machine") or ""
    return Row(tuple(texts.values()), code, machine, Figures(**figures))


def write_rows(path: pathlib.Path, rows: Iterable[Row]) -> None:
    """Write a complete file of results, or none: an interruption leaves the older one.

    Args:
        path: of the CSV file; replaced if it exists.
        rows: what to write.

    Raises:
        JaxblurIOError: the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        figures = (getattr(row.figures, name) for name in FIGURE_COLUMNS)
        writer.writerow((*row.identity, row.code, row.machine, *map(_cell, figures)))
    with replacing(path) as temporary:
        pathlib.Path(temporary).write_text(text.getvalue(), encoding="utf-8")


def _cell(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"


def latest(rows: Sequence[Row]) -> list[Row]:
    """The last row of each measurement, whatever the code.

    Args:
        rows: in the order of the file.

    Returns:
        One row for each identity.
    """
    return list({row.identity: row for row in rows}.values())
