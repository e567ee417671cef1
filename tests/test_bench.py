"""``jaxblur.bench``: timing, files, fronts, growth, comparison."""

import dataclasses
import importlib
import os
from typing import Any

import numpy as np
import pytest

import jaxblur
from jaxblur import bench, metrics
from jaxblur.bench import Row, make_case
from jaxblur.bench.fronts import Point
from jaxblur.bench.results import IDENTITY_COLUMNS, Figures
from jaxblur.bench.timing import Timing, time_in_turn
from jaxblur.exr import JaxblurIOError
from jaxblur.vectors import speed_statistics
from tests.helpers import random_frame

pytestmark = pytest.mark.slow

SHAPE = (24, 32)


@pytest.fixture(scope="module")
def subject():
    """A random frame, with itself blurred by another filter for a truth."""
    frame = random_frame(SHAPE, sky=0.0)
    settings = jaxblur.Settings(samples=9, radius=10)
    return bench.frame_subject(
        "random", frame, jaxblur.pixel_velocity(frame, None, settings=settings)
    )


def row(
    method="guertin2014", *, scene="s", width=32, height=24, figures=None, **settings: Any
) -> Row:
    """A made-up row."""
    case = make_case(method, **settings)
    subject = bench.Subject(scene, (height, width), 0.5, "made up", lambda: None)  # type: ignore[arg-type]
    return Row(bench.identity(subject, case), "code", "machine", figures or Figures())


def timed(ms, iqr=0.0, **others: Any):
    calibration = {"calibration_ms": 10.0, "calibration_ms_iqr": 0.0}
    return Figures(ms=ms, ms_iqr=iqr, rounds=9, **calibration, **others)


def test_functions_are_timed_in_turn_after_one_untimed_run():
    calls = []
    runs = {name: lambda name=name: calls.append(name) for name in "ab"}
    times = time_in_turn(runs, 3)
    assert calls == ["a", "b"] + ["a", "b"] * 3
    assert {name: len(timing.seconds) for name, timing in times.items()} == {"a": 3, "b": 3}
    assert all(seconds >= 0 for timing in times.values() for seconds in timing.cpu_seconds)


def test_what_settles_runs_once_more_before_it_is_timed():
    calls = []
    time_in_turn({name: lambda name=name: calls.append(name) for name in "ab"}, 2, settle=True)
    assert calls == ["a", "b"] + ["a", "a", "b", "b"] * 2


def test_a_limit_of_time_leaves_three_rounds():
    assert len(time_in_turn({"a": lambda: None}, 9, limit=0.0)["a"].seconds) == 3


def test_timing_takes_the_median_and_the_middle_half():
    timing = Timing((1.0, 2.0, 3.0, 4.0, 100.0), (5.0,) * 5)
    assert (timing.median, timing.spread) == (3.0, 2.0)
    assert (timing.cpu_median, timing.cpu_spread) == (5.0, 0.0)


def test_no_rounds_are_refused():
    with pytest.raises(ValueError, match="`repeats` must be at least 1, got 0"):
        time_in_turn({}, 0)


def test_product_holds_every_combination_once():
    axes = {"samples": (9, 15), "radius": ("auto", 20), "fetch": ("nearest",)}
    cases = bench.product(["guertin2014", "unblurred", "accumulate"], axes)
    labels = [case.label for case in cases]
    assert labels == [
        "guertin2014 N=9 r=auto",
        "guertin2014 N=9 r=20",
        "guertin2014 N=15 r=auto",
        "guertin2014 N=15 r=20",
        "unblurred",
        "accumulate N=9",
        "accumulate N=15",
    ]


def test_one_at_a_time_starts_from_the_published_settings():
    cases = bench.one_at_a_time(["mcguire2012"], {"samples": (9, 15), "radius": (40,)})
    assert [case.label for case in cases] == [
        "mcguire2012 N=15",
        "mcguire2012 N=9",
        "mcguire2012 N=15 r=40",
    ]
    assert [case.is_published for case in cases] == [True, False, False]


def test_errors_are_those_of_the_blurred_frame(subject):
    cases = [make_case("guertin2014", samples=9, radius=10), make_case("unblurred")]
    blurred, unblurred = bench.measure(subject, cases, bench.Programs(), repeats=3)
    loaded = subject.load()
    settings = jaxblur.Settings(samples=9, radius=10)
    image = jaxblur.guertin2014(loaded.frame, jaxblur.GuertinParameters(), settings=settings)
    mask = metrics.motion_footprint(loaded.frame)
    for picture, figures in ((image, blurred.figures), (loaded.frame.color, unblurred.figures)):
        for area, part in (("", None), ("moving_", mask)):
            expected = metrics.compare(picture, loaded.truth, part)
            for name, value in expected._asdict().items():
                assert getattr(figures, area + name) == pytest.approx(value, rel=1e-3)
    known: Any = blurred.figures
    assert known.ms > 0 and known.rounds == 3
    assert known.compile_s > 0 and known.temporary_mb > 0
    assert blurred.figures.radius_px == 10 and unblurred.figures.radius_px is None


def test_cases_that_are_one_program_share_their_figures(subject):
    radius = speed_statistics(np.asarray(subject.load().frame.velocity)).suggested_radius
    cases = [make_case("pixel_velocity", radius=each) for each in ("auto", radius)]
    automatic, same = bench.measure(subject, cases, bench.Programs(), repeats=3)
    assert automatic.figures.ms == same.figures.ms and automatic.identity != same.identity


def test_a_radius_from_the_frame_holds_the_longest_vector(subject):
    case = make_case("pixel_velocity", radius="auto")
    (measured,) = bench.measure(subject, [case], bench.Programs(), repeats=3)
    velocity = np.asarray(subject.load().frame.velocity)
    fastest = float(np.hypot(velocity[..., 0], velocity[..., 1]).max())
    radius: Any = measured.figures.radius_px
    assert fastest <= radius < fastest + 5
    assert measured["radius"] == "auto" and measured.case == case


def test_what_a_method_refuses_is_left_out_with_a_reason(subject, caplog):
    cases = [make_case("mcguire2012", samples=8), make_case("accumulate", samples=2)]
    assert bench.measure(subject, cases, bench.Programs(), repeats=3) == []
    assert "must be odd for mcguire2012" in caplog.text
    assert "must be a scene of the catalogue" in caplog.text


def test_other_methods_join_and_unknown_ones_are_refused(subject):
    def method(subject, settings):
        return lambda: subject.load().truth

    cases = [make_case("mine", samples=3)]
    (measured,) = bench.measure(subject, cases, bench.Programs(), 3, others={"mine": method})
    assert measured.figures.moving_flip == 0.0 and measured["samples"] == "3"
    with pytest.raises(ValueError, match=r"`method` must be one of .*, got 'mine'"):
        bench.measure(subject, cases, bench.Programs(), 3)


def test_renderers_run_on_scenes():
    subject = bench.catalogue_subject("crossing", (36, 64), 0.5, truth_samples=4)
    case = make_case("accumulate", samples=4)
    (measured,) = bench.measure(subject, [case], bench.Programs(), repeats=1)
    # The truth is the same four images.
    assert measured.figures.moving_flip == 0.0
    assert [measured[name] for name in ("samples", "radius", "fetch")] == ["4", "", ""]


def test_rows_come_back_from_the_file(tmp_path):
    path = tmp_path / "rows.csv"
    rows = [
        row(radius="auto", samples=9, figures=timed(1.25, psnr=float("inf"), moving_flip=0.1)),
        row("accumulate", samples=4, scene="with, comma"),
        row("unblurred"),
    ]
    bench.write_rows(path, rows)
    assert bench.read_rows(path) == rows
    assert [r.case for r in bench.read_rows(path)] == [r.case for r in rows]


def test_an_older_file_without_some_columns_is_read(tmp_path):
    path = tmp_path / "old.csv"
    path.write_text("scene,method,samples,ms,extra\ns,guertin2014,9,1.5,x\n", encoding="utf-8")
    (old,) = bench.read_rows(path)
    assert old.figures.ms == 1.5 and old.case.settings.samples == 9


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "has no column method, ms, scene; give a file that"),
        ("scene,method,ms\ns,guertin2014,fast\n", "line 2: could not convert string to float"),
    ],
)
def test_other_files_are_refused(tmp_path, text, message):
    path = tmp_path / "other.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        bench.read_rows(path)


def test_a_write_that_fails_leaves_the_older_file(tmp_path, monkeypatch):
    path = tmp_path / "rows.csv"
    bench.write_rows(path, [row()])
    before = path.read_bytes()

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(JaxblurIOError, match="the disk is full"):
        bench.write_rows(path, [row(), row(samples=9)])
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_what_is_known_is_not_measured_again_unless_the_code_changes(monkeypatch):
    subject = bench.Subject("s", (24, 32), 0.5, "x", lambda: None)  # type: ignore[arg-type]
    cases = [make_case("guertin2014", samples=n) for n in (5, 9, 15)]
    cases.append(make_case("accumulate", samples=2))
    jobs = [(subject, case) for case in cases]
    programs = importlib.import_module("jaxblur.bench.programs")
    results = importlib.import_module("jaxblur.bench.results")
    code, machine = results.code_digest(), programs.machine()
    done = [Row(bench.identity(subject, cases[1]), code, machine, Figures())]
    left = bench.batches(jobs, done, 2)
    assert [cases for _, cases in left] == [[cases[0], cases[2]], [cases[3]]]
    changed = [dataclasses.replace(done[0], code="older")]
    assert sum(len(cases) for _, cases in bench.batches(jobs, changed, 2)) == 4


def verdict(old, new, tolerance=0.1):
    (change,) = bench.compare([row(figures=old)], [row(figures=new)], tolerance)
    return change


def test_a_comparison_tells_change_from_noise():
    assert verdict(timed(100), timed(125)).verdict == "slower"
    assert verdict(timed(100), timed(75)).verdict == "quicker"
    assert verdict(timed(100), timed(112)).verdict == "same"
    # The same change with a spread that may have made it.
    noisy = verdict(timed(100, iqr=40), timed(125, iqr=40))
    assert noisy.verdict == "same" and noisy.ratio == pytest.approx(1.25)
    # 0.93 IQR / (median sqrt(9)) of each, and the floor of two percent.
    expected = np.sqrt(0.02**2 + (0.93 * 0.4 / 3) ** 2 + (0.93 * 0.32 / 3) ** 2)
    assert noisy.noise == pytest.approx(expected)


def test_a_machine_that_is_busier_does_not_count():
    busy = dataclasses.replace(timed(200), calibration_ms=20.0)
    assert verdict(timed(100), busy).ratio == pytest.approx(1.0)


def test_memory_and_error_count_too():
    old = timed(100, temporary_mb=10.0, moving_psnr=30.0)
    assert verdict(old, timed(100, temporary_mb=12.0, moving_psnr=29.8)).verdict == "larger+worse"
    better = verdict(old, timed(100, temporary_mb=9.0, moving_psnr=31.0))
    assert better.verdict == "same" and better.psnr_change == pytest.approx(1.0)
    assert not better.is_regression


def test_only_shared_cases_are_compared():
    old, new = row(samples=9, figures=timed(1.0)), row(samples=15, figures=timed(1.0))
    assert bench.compare([old], [new]) == []
    with pytest.raises(ValueError, match="`tolerance` must be at least 0"):
        bench.compare([old], [new], -0.1)


def planted(generator, noise):
    """Rows of two scenes that grow with pixels^1.1, samples^0.9 and radius^0.2."""
    rows = []
    for scene, scale in (("a", 1e-5), ("b", 3e-5)):
        for width, samples, radius in ((320, 9, 20), (640, 9, 40), (640, 35, 20), (1280, 35, 80)):
            pixels = width * width
            ms = scale * pixels**1.1 * samples**0.9 * radius**0.2
            ms *= float(np.exp(noise * generator.normal()))
            figures = timed(ms, cpu_ms=ms**2, radius_px=float(radius))
            settings: Any = {"samples": samples, "radius": radius}
            rows.append(row(scene=scene, width=width, height=width, figures=figures, **settings))
    return rows


def test_a_power_law_is_found_again():
    law = bench.fit_power_law(planted(np.random.default_rng(0), 0.0))
    expected = {"pixels": 1.1, "samples": 0.9, "radius": 0.2}
    assert law.exponents == pytest.approx(expected, abs=1e-6)
    assert law.residual < 1e-6 and law.rows == 8
    squared = bench.fit_power_law(planted(np.random.default_rng(0), 0.0), "cpu_ms")
    assert squared.exponents["pixels"] == pytest.approx(2.2, abs=1e-6)


def test_intervals_of_a_power_law_hold_as_often_as_they_say():
    generator, hits = np.random.default_rng(1), 0
    for _ in range(200):
        law = bench.fit_power_law(planted(generator, 0.1))
        hits += abs(law.exponents["samples"] - 0.9) <= law.errors["samples"]
    # Binomial with 0.95: within three standard deviations.
    assert abs(hits / 200 - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 200)


def test_too_few_rows_for_a_law_are_refused():
    with pytest.raises(ValueError, match="must number at least 5 to fit pixels, samples, radius"):
        bench.fit_power_law(planted(np.random.default_rng(0), 0.0)[:4])


def point(label, ms, flip, psnr=20.0):
    return Point(make_case("guertin2014", samples=label), ms, 0.0, psnr, 0.9, flip, 1.0)


def test_the_front_holds_what_nothing_beats():
    found = [point(1, 1.0, 0.4), point(2, 2.0, 0.5), point(3, 3.0, 0.1), point(4, 3.0, 0.2)]
    assert [p.case.settings.samples for p in bench.front(found)] == [1, 3]
    by_psnr = [point(1, 1.0, 0.4, 20), point(2, 2.0, 0.5, 30), point(3, 3.0, 0.1, 25)]
    assert [p.case.settings.samples for p in bench.front(by_psnr, "rmse")] == [1, 2]
    assert point(1, 1.0, 0.1, 20.0).rmse == pytest.approx(0.1)


def test_pooled_points_are_means_over_scenes_that_have_them_all():
    groups = [[point(1, 1.0, 0.2), point(2, 1.0, 0.2)], [point(1, 4.0, 0.4)]]
    (both,) = bench.pooled(groups)
    assert both.ms == pytest.approx(2.0) and both.flip == pytest.approx(0.3)


def test_the_report_marks_fronts_and_published_settings():
    errors = {"moving_psnr": 30.0, "moving_ssim": 0.9}
    rows = [
        row(figures=timed(5.0, moving_flip=0.2, **errors)),
        row(samples=9, figures=timed(1.0, moving_flip=0.1, **errors)),
        row("unblurred", figures=timed(0.001, moving_flip=0.5, **errors)),
        row(samples=15, figures=timed(3.0)),
    ]
    lines = bench.report(rows).splitlines()
    assert lines[2].startswith("| unblurred |  | 0.001 |")
    assert lines[3].startswith("| guertin2014 N=9 | FLIP, RMSE | 1 |")
    assert lines[4].startswith("| guertin2014 N=35 (published) |  | 5 |")
    assert len(lines) == 5


def test_the_moving_frame_moves_where_it_says():
    velocity = np.asarray(bench.moving_frame(90, 160, moving=0.5, tile=40).velocity)
    assert not velocity[:, 80:].any()
    assert np.hypot(velocity[:, :80, 0], velocity[:, :80, 1]).max() > 0.5


ALTERNATIVES = "experiments.007_speed_vs_error.alternatives"


def test_the_alternative_in_numpy_is_the_filter():
    frame = bench.moving_frame(73, 130)
    module = importlib.import_module(f"{ALTERNATIVES}_numpy")
    common = importlib.import_module(ALTERNATIVES)
    settings = jaxblur.Settings(samples=9, radius=10)
    assert common.check("NumPy", module.guertin2014, frame, settings) <= common.SHARE


def test_an_alternative_that_is_another_filter_is_not_timed():
    common = importlib.import_module(ALTERNATIVES)
    frame = bench.moving_frame(37, 53)
    settings = jaxblur.Settings(samples=9, radius=10)
    with pytest.raises(ValueError, match=r"sharp is another filter: .* % of the pixels differ"):
        common.check("sharp", lambda inputs: inputs.color, frame, settings)


def test_identity_columns_name_every_setting():
    names = {field.name for field in dataclasses.fields(jaxblur.Settings)}
    assert names < set(IDENTITY_COLUMNS)
