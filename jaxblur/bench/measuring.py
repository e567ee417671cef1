"""Measure cases on a subject: time, memory, error."""

import dataclasses
import logging
import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool

from .. import metrics, scenes
from ..filters.registry import FILTERS
from ..settings import Settings
from ..vectors import speed_statistics
from .cases import UNBLURRED, Case
from .memory import peak_resident_megabytes
from .programs import Program, Programs, machine, parameter_leaves
from .results import Figures, Row, code_digest, identity
from .subjects import Loaded, Subject
from .timing import Timing, calibration, time_in_turn

LOG = logging.getLogger("jaxblur")
CALIBRATION = "calibration"

Run = Callable[[], Any]
Method = Callable[[Subject, Settings], Run]


@dataclasses.dataclass(frozen=True)
class _Prepared:
    """A case ready to run."""

    case: Case
    run: Run
    program: Program | None
    radius: int | None


def measure(
    subject: Subject,
    cases: Sequence[Case],
    programs: Programs,
    repeats: int = 9,
    limit: float = 60.0,
    others: Mapping[str, Method] | None = None,
) -> list[Row]:
    """Measure some cases in turn on one subject.

    Cases that share a program are timed once. Those that a filter refuses are left out, with a
    log record that says why.

    Args:
        subject: the frame.
        cases: timed in rounds, one after the other.
        programs: what is compiled already; what is compiled here joins.
        repeats: number of rounds.
        limit: seconds after which no further round starts.
        others: methods besides filters, renderers and the unblurred frame, by name: functions of
            subject and settings that give a function without arguments, which gives an image.

    Returns:
        A row for each case that could run.

    Raises:
        ValueError: a case has an unknown method.
    """
    others = others or {}
    _check_methods(cases, others)
    prepared = [p for case in cases if (p := _prepare(subject, case, programs, others))]
    loaded = subject.load()
    first = {_same(p): p for p in reversed(prepared)}
    measured = {key: _look(p, loaded) for key, p in first.items()}
    runs = {key: p.run for key, p in first.items()} | {CALIBRATION: calibration()}
    times = time_in_turn(runs, repeats, limit)
    rows = []
    for p in prepared:
        figures = _timed(measured[_same(p)], p, times[_same(p)], times[CALIBRATION])
        rows.append(Row(identity(subject, p.case), code_digest(), machine(), figures))
    return rows


def _check_methods(cases: Sequence[Case], others: Mapping[str, Method]) -> None:
    known = (*FILTERS, *_OTHERS, *others)
    for case in cases:
        if case.method not in known:
            raise ValueError(f"`method` must be one of {', '.join(known)}, got {case.method!r}.")


def _same(prepared: _Prepared) -> Any:
    """Equal for cases that are one program on one frame."""
    return prepared.case if prepared.program is None else id(prepared.program)


def _prepare(
    subject: Subject, case: Case, programs: Programs, others: Mapping[str, Method]
) -> _Prepared | None:
    """Compile what must be; None for what cannot run, with a log record."""
    loaded, settings = subject.load(), case.settings
    if case.auto_radius:
        radius = speed_statistics(np.asarray(loaded.frame.velocity)).suggested_radius
        settings = dataclasses.replace(settings, radius=radius)
    radius = settings.radius if case.has_settings else None
    try:
        if case.method in FILTERS:
            program = programs.get(case.method, settings, loaded.frame)
            return _Prepared(case, _filter_run(case.method, program, loaded), program, radius)
        run = (_OTHERS | dict(others))[case.method](subject, settings)
    except ValueError as error:
        LOG.warning("%s on %s: left out: %s", case.label, subject.name, error)
        return None
    return _Prepared(case, run, None, radius)


def _filter_run(method: str, program: Program, loaded: Loaded) -> Run:
    parameters = parameter_leaves(method)
    return lambda: program.compiled(parameters, loaded.frame).block_until_ready()


def _unblurred(subject: Subject, settings: Settings) -> Run:
    color = subject.load().frame.color
    return lambda: color


def _renderer(subject: Subject, render: Callable[..., Any], **samples: int) -> Run:
    """A renderer on the scene of a subject.

    Raises:
        ValueError: the subject has none.
    """
    scene = subject.load().scene
    if scene is None:
        raise ValueError(f"`subject` must be a scene of the catalogue, got {subject.name!r}.")
    arguments = {"shutter": subject.shutter, "size": subject.size} | samples
    return lambda: jax.block_until_ready(render(scene, **arguments))


_OTHERS: dict[str, Method] = {
    UNBLURRED: _unblurred,
    "accumulate": lambda s, n: _renderer(s, scenes.accumulate, samples=n.samples),
    "stochastic": lambda s, n: _renderer(s, scenes.stochastic, samples=n.samples),
    "motion_paths": lambda s, n: _renderer(s, scenes.motion_paths, spatial_samples=n.samples),
}


def _look(prepared: _Prepared, loaded: Loaded) -> Figures:
    """Compile time, memory and error of one case."""
    started = time.perf_counter()
    image = prepared.run()
    first = time.perf_counter() - started
    program = prepared.program
    figures = Figures(
        resident_mb=peak_resident_megabytes(prepared.run),
        compile_s=first if program is None else program.compile_seconds,
        temporary_mb=program.temporary_bytes / 1e6
        if program is not None and program.temporary_bytes is not None
        else None,
    )
    return dataclasses.replace(figures, **_errors(image, loaded.truth, loaded.footprint))


def _errors(
    image: jax.Array, truth: Any, footprint: Bool[np.ndarray, "height width"]
) -> dict[str, float]:
    """PSNR, SSIM and FLIP on display values, whole and where motion reaches."""
    if truth is None:
        return {}
    shown, expected = metrics.display(image), metrics.display(truth)
    visible = metrics.flip_map(shown, expected)
    areas = {"": None, "moving_": footprint}
    errors = {}
    for area, mask in areas.items():
        if mask is not None and not mask.any():
            continue
        errors[f"{area}psnr"] = float(metrics.psnr(shown, expected, mask=mask))
        errors[f"{area}ssim"] = float(metrics.ssim(shown, expected, mask))
        errors[f"{area}flip"] = float(visible.mean() if mask is None else visible[mask].mean())
    return errors


def _timed(figures: Figures, prepared: _Prepared, own: Timing, machine: Timing) -> Figures:
    """Add the times to what else is known of a case."""
    compile_seconds = figures.compile_s
    if prepared.program is None and compile_seconds is not None:
        compile_seconds = max(0.0, compile_seconds - own.median)
    return dataclasses.replace(
        figures,
        radius_px=prepared.radius,
        ms=1e3 * own.median,
        ms_iqr=1e3 * own.spread,
        cpu_ms=1e3 * own.cpu_median,
        cpu_ms_iqr=1e3 * own.cpu_spread,
        rounds=len(own.seconds),
        calibration_ms=1e3 * machine.median,
        calibration_ms_iqr=1e3 * machine.spread,
        compile_s=compile_seconds,
        load=_load(),
    )


def _load() -> float | None:
    """Mean number of running processes in the last minute, where the system tells."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None
