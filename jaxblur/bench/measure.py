"""Measure cases on a subject: time, memory, error."""

import dataclasses
import functools
import logging
import os
import platform
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool

from .. import metrics, scenes
from ..filters import FILTERS, PUBLISHED
from ..frame import Frame
from ..settings import Settings
from ..vectors import speed_statistics
from .cases import UNBLURRED, Case
from .memory import peak_resident_megabytes
from .results import Figures, Row, code_digest, identity
from .subjects import Loaded, Subject
from .timing import Timing, calibration, time_in_turn

LOG = logging.getLogger("jaxblur")
CALIBRATION = "calibration"


@dataclasses.dataclass(frozen=True)
class Program:
    """A filter, compiled for one size.

    Attributes:
        compiled: function of parameters and frame.
        compile_seconds: of tracing and compiling.
        temporary_bytes: peak of the temporary buffers by the compiler's account, or None.
    """

    compiled: Any
    compile_seconds: float
    temporary_bytes: int | None


class Programs:
    """Compiled filters. Settings that come to the same program share it, and so its figures."""

    def __init__(self):
        self._by_case: dict[Any, Program] = {}
        self._by_text: dict[str, Program] = {}

    def get(self, method: str, settings: Settings, frame: Frame) -> Program:
        """The program for a frame of this size, compiled if it is new.

        Raises:
            ValueError: the filter refuses the settings.
        """
        shapes = tuple(buffer.shape for buffer in jax.tree.leaves(frame))
        key = method, settings, shapes
        if key not in self._by_case:
            self._by_case[key] = self._compile(method, settings, frame)
        return self._by_case[key]

    def _compile(self, method: str, settings: Settings, frame: Frame) -> Program:
        blur = functools.partial(FILTERS[method], settings=settings)
        started = time.perf_counter()
        lowered = jax.jit(lambda parameters, frame: blur(frame, parameters)).lower(
            parameters_of(method), frame
        )
        text = lowered.as_text()
        if text not in self._by_text:
            compiled = lowered.compile()
            seconds = time.perf_counter() - started
            analysis = compiled.memory_analysis()
            temporary = None if analysis is None else int(analysis.temp_size_in_bytes)
            self._by_text[text] = Program(compiled, seconds, temporary)
        return self._by_text[text]


def parameters_of(method: str) -> Any:
    """The published parameters of a filter as float32 scalars, None if it has none."""
    record = PUBLISHED[method][0] if method in PUBLISHED else None
    return jax.tree.map(np.float32, record)


@dataclasses.dataclass(frozen=True)
class _Prepared:
    """A case ready to run."""

    case: Case
    run: Callable[[], jax.Array]
    program: Program | None
    radius: int | None


def measure(
    subject: Subject,
    cases: Sequence[Case],
    programs: Programs,
    repeats: int = 9,
    limit: float = 60.0,
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

    Returns:
        A row for each case that could run.
    """
    loaded = subject.load()
    prepared = [p for case in cases if (p := _prepare(subject, loaded, case, programs))]
    first = {_same(p): p for p in reversed(prepared)}
    measured = {key: _look(p, loaded) for key, p in first.items()}
    runs = {key: p.run for key, p in first.items()} | {CALIBRATION: calibration()}
    times = time_in_turn(runs, repeats, limit)
    rows = []
    for p in prepared:
        figures = _timed(measured[_same(p)], p, times[_same(p)], times[CALIBRATION])
        rows.append(Row(identity(subject, p.case), code_digest(), machine(), figures))
    return rows


def machine() -> str:
    """The version of jax, the kind of device and the number of processors, in a few words."""
    device = jax.devices()[0].device_kind
    return f"jax {jax.__version__} {device} {platform.machine()} x{os.cpu_count()}"


def _same(prepared: _Prepared) -> Any:
    """Equal for cases that are one program on one frame."""
    return prepared.case if prepared.program is None else id(prepared.program)


def _prepare(subject: Subject, loaded: Loaded, case: Case, programs: Programs) -> _Prepared | None:
    if case.method == UNBLURRED:
        return _Prepared(case, lambda: loaded.frame.color, None, None)
    if not case.is_filter:
        return _prepare_renderer(subject, loaded, case)
    settings = case.settings
    if case.auto_radius:
        radius = speed_statistics(np.asarray(loaded.frame.velocity)).suggested_radius
        settings = dataclasses.replace(settings, radius=radius)
    try:
        program = programs.get(case.method, settings, loaded.frame)
    except ValueError as error:
        LOG.warning("%s on %s: left out: %s", case.label, subject.name, error)
        return None
    parameters = parameters_of(case.method)

    def run() -> jax.Array:
        return program.compiled(parameters, loaded.frame).block_until_ready()

    return _Prepared(case, run, program, settings.radius)


def _prepare_renderer(subject: Subject, loaded: Loaded, case: Case) -> _Prepared | None:
    if loaded.scene is None:
        LOG.warning("%s on %s: left out: it is no scene of the catalogue", case.label, subject.name)
        return None
    scene, number = loaded.scene, case.settings.samples
    shared = {"shutter": subject.shutter, "size": subject.size}
    renderers = {
        "accumulate": lambda: scenes.accumulate(scene, samples=number, **shared),
        "stochastic": lambda: scenes.stochastic(scene, samples=number, **shared),
        "motion_paths": lambda: scenes.motion_paths(scene, spatial_samples=number, **shared),
    }
    render = renderers[case.method]
    return _Prepared(case, lambda: jax.block_until_ready(render()), None, None)


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
