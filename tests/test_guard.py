"""The guard of a redesign notices what it is there to notice."""

import importlib

import numpy as np
import pytest

pytestmark = pytest.mark.slow

guard = importlib.import_module("experiments.010_fast_paths.guard")


def test_equal_arrays_do_not_differ():
    values = np.array([0.0, np.nan, np.inf, -np.inf, 2.0], np.float32)
    np.testing.assert_array_equal(guard.differences(values, values.copy(), True), 0)


def test_a_changed_value_is_a_share_of_the_largest_magnitude():
    before, after = np.array([1.0, -4.0, np.inf]), np.array([1.0, -4.0 + 4e-6, np.inf])
    np.testing.assert_allclose(guard.differences(before, after, True), [0, 1e-6, 0], rtol=1e-6)
    np.testing.assert_allclose(guard.differences(before, after, False), [0, 4e-6, 0], rtol=1e-6)


@pytest.mark.parametrize("relative", [True, False])
def test_a_value_that_is_no_longer_finite_differs_without_end(relative):
    before, after = np.array([1.0, np.nan, np.inf]), np.array([np.nan, 1.0, 3.0])
    np.testing.assert_array_equal(guard.differences(before, after, relative), np.inf)


def test_zeros_that_become_something_differ_without_end():
    np.testing.assert_array_equal(guard.differences(np.zeros(1), np.ones(1), True), np.inf)


def test_another_shape_is_rejected():
    with pytest.raises(ValueError, match="`after` must have shape"):
        guard.differences(np.zeros(2), np.zeros(3), True)


def test_slower_code_is_measured_longer_and_reported():
    calls = []

    def measure(tree):
        calls.append(tree)
        return 2.0, 1.1 if tree else 1.0

    times = guard.time_both(measure, 3, 9)
    assert calls == [0, 1, 1, 0] * 4 + [0, 1]
    assert times == pytest.approx((1000, 1100, 1.1, 0, 1))


def test_code_as_fast_as_before_is_measured_once():
    calls = []
    times = guard.time_both(lambda tree: (calls.append(tree) or 1.0, 1.0), 3, 9)
    assert len(calls) == 6
    assert times.ratio == 1


def test_a_missed_bar_is_reported(tmp_path):
    kept, missed = guard.Bar("kept", 1.0, "here", 1.0), guard.Bar("missed", 1.04, "there", 1.03)
    assert guard.report([kept], tmp_path)
    assert not guard.report([kept, missed], tmp_path)
    assert "| missed | 1.04 | 1.03 | NO | there |" in (tmp_path / "guard.md").read_text()
