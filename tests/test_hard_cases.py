"""Every filter on the hard cases of experiments/008_hard_cases: finite, precise, invariant."""

import importlib
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.filters import FILTERS

pytestmark = pytest.mark.slow

cases = importlib.import_module("experiments.008_hard_cases.cases")
measuring = importlib.import_module("experiments.008_hard_cases.measure")
transformations = importlib.import_module("experiments.008_hard_cases.transformations")
experiment = importlib.import_module("experiments.008_hard_cases.run")
encoding = importlib.import_module("experiments.008_hard_cases.encoding")

# As the invariants are checked, so that they share the compilation.
SETTINGS = jaxblur.GuertinSettings(
    samples=cases.SAMPLES,
    radius=cases.RADIUS,
    fetch="bilinear",
    tile_choice="own",
    noise="none",
)
# Those of one size without a mask, likewise; the experiment measures the others too.
CASES = [case for case in cases.all_cases() if case.group != "shape" and case.nonfinite == "error"]
PROMISED_ERROR, PROMISED_FLIPS = 1e-5, 0.01
# In a symmetric field many paths end exactly between two pixels, and rounding decides which of the
# two they reach.
MORE_FLIPS = {
    ("layered", "motion: swirl"): 0.15,
    ("layered", "motion: zoom from a still center"): 0.15,
}


def reference(setup, frame):
    with jax.enable_x64(True):
        return np.asarray(measuring._jitted(setup, measuring.as_inputs(setup, frame, "float64")))


@pytest.mark.parametrize("name", FILTERS)
def test_values_derivatives_precision_and_invariants(name):
    setup = measuring.Setup(name, SETTINGS)
    problems = {}
    for case in CASES:
        frame, _ = jaxblur.finite_frame(case.frame, case.nonfinite)
        inputs = measuring.as_inputs(setup, frame, "float32")
        moves = measuring.directions(inputs)
        found = measuring.derivatives(setup, inputs, moves, jnp.ones_like(inputs["color"]))
        broken = measuring.broken_invariants(setup, frame)
        if not all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(found)):
            broken.append("finite")
        error = np.abs(np.asarray(found[0]) - reference(setup, frame))
        error /= np.abs(np.asarray(inputs["color"])).max()
        flipped = error > measuring.FLIPPED
        if np.max(error, where=~flipped, initial=0) > PROMISED_ERROR:
            broken.append("precision")
        if flipped.mean() > MORE_FLIPS.get((name, case.label), PROMISED_FLIPS):
            broken.append("flips")
        if broken:
            problems[case.label] = broken
    assert problems == {}


def test_the_door_refuses_what_the_filters_must_not_see():
    assert experiment.check_door() == []
    assert len(list(cases.refused_frames())) == 10


def test_the_measures_see_what_is_broken():
    """A filter that divides by the speed, loses precision and sees the sign of the motion."""

    def broken_filter(frame, parameters, *, settings, noise=None):
        speed = jnp.sqrt(jnp.sum(frame.velocity**2, axis=-1, keepdims=True))
        rounded = frame.color.astype(jnp.bfloat16).astype(frame.color.dtype)
        color = frame.color if frame.color.dtype == jnp.float64 else rounded
        return color * (1 + 0.1 * frame.velocity[..., :1] / speed)

    # Settings of its own: compiled programs are kept by name and settings.
    setup = measuring.relative(measuring.Setup("pixel_velocity", SETTINGS), {"samples": 7})
    by_name = {case.name: case for case in CASES}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measuring, "FILTERS", {"pixel_velocity": broken_filter})
        still = measuring.measure(setup, by_name["zero"].frame)
        swirl = measuring.measure(setup, by_name["half-float buffers"].frame)
        broken = measuring.broken_invariants(setup, by_name["half-float buffers"].frame)
    assert not still.finite_value and not still.finite_gradient
    assert swirl.finite_value and swirl.flipped > 0.5
    assert {"-V", "constant", "4 C - 1"} <= set(broken)


def test_finite_differences_tell_a_wrong_derivative():
    @jax.custom_jvp
    def wrong(color):
        return color**2

    wrong.defjvp(lambda primals, tangents: (primals[0] ** 2, 1.9 * primals[0] * tangents[0]))
    setup = measuring.relative(measuring.Setup("pixel_velocity", SETTINGS), {"samples": 3})
    with pytest.MonkeyPatch.context() as patch:
        squared = {"pixel_velocity": lambda frame, *_, **__: wrong(frame.color)}
        patch.setattr(measuring, "FILTERS", squared)
        numbers = measuring.measure(setup, cases.plain_frame((6, 7)))
    assert numbers.wrong > 0.5 and numbers.jumps == 0


@pytest.mark.parametrize("what", transformations.CHECKS)
def test_transformations_change_nothing_but_rounding(what):
    [(_, _, difference, equal)] = transformations.rows("pixel_velocity", what)
    assert float(difference) < 1e-5
    if what in ("the same frame twice", "gradient twice") or what.startswith("half"):
        assert equal == "yes"


def test_every_case_is_measured_once_for_every_filter():
    labels = [(t.table, *label) for t in experiment.tasks(quick=False) for label in t.labels]
    assert len(set(labels)) == len(labels)
    for name in FILTERS:
        for fetch in experiment.MODES:
            measured = {label[3] for label in labels if label[:3] == ("hard_cases", name, fetch)}
            wanted = [c for c in cases.all_cases() if c.group != "shape" or fetch == "bilinear"]
            assert measured == {case.label for case in wanted}
        assert ("transformations", name, "4096x2160: a part alone") in labels


@pytest.mark.parametrize(
    ("name", "samples", "reason"), [("layered", 1, "N is too small"), ("mcguire2012", 2, "N must")]
)
def test_numbers_of_samples_that_a_filter_refuses_are_told(name, samples, reason):
    (case,) = (case for case in cases.all_cases() if case.name == f"N = {samples}")
    assert f"refused: {reason}" in experiment.row(name, "bilinear", case)[3]


def test_rows_that_are_there_are_not_measured_again(tmp_path, monkeypatch):
    column, shape = experiment.COLUMNS, transformations.COLUMNS
    experiment.write_table(
        tmp_path, "hard_cases", column, [("a", "b", "c", *["yes"] * 2, *"1" * 7)]
    )
    experiment.write_table(tmp_path, "transformations", shape, [])
    there = experiment.Task("hard_cases", (("a", "b", "c"),), _never)
    missing = experiment.Task("transformations", (("a", "zoom"),), _a_row)
    monkeypatch.setattr(
        experiment, "ProcessPoolExecutor", lambda jobs, mp_context: ThreadPoolExecutor(jobs)
    )
    experiment.measure_all(tmp_path, [there, missing], jobs=1)
    experiment.write(tmp_path, [there, missing])
    assert "| a | zoom | 0 | yes |" in (tmp_path / "transformations.md").read_text()
    assert "| c | 1 | yes |" in (tmp_path / "summary.md").read_text()


def _never():
    raise AssertionError("measured again")


def _a_row():
    return [("a", "zoom", "0", "yes")]


def test_encodings_differ_where_vectors_are_longer_than_the_radius():
    velocity = jnp.asarray([[[30.0, 3.0], [1.0, 2.0]]])
    for encode, worst in ((encoding.radial, 1.0), (encoding.apart, 14.0)):
        angle = encoding.worst_angle(velocity, encode(velocity, 10))
        assert (angle < 2) if worst < 2 else (angle > 10)
