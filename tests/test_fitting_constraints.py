"""The maps between parameters and the real numbers that are optimized."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur.filters import FILTERS, filter_info
from jaxblur.fitting.constraints import (
    INSET,
    Above,
    AnyNumber,
    Interval,
    constraints_of,
    starting_values,
    to_free,
    to_values,
)

EVERY = [(name, parameter) for name in FILTERS for parameter in constraints_of(name)]


@pytest.mark.parametrize(("name", "parameter"), EVERY)
def test_the_open_range_is_the_one_that_the_command_line_accepts(name, parameter):
    allowed = filter_info(name).parameter_infos[parameter]
    far = to_values(name, jnp.asarray([-60.0]), [parameter])[parameter]
    assert allowed.low <= far < allowed.low + 1e-20
    far = to_values(name, jnp.asarray([60.0]), [parameter])[parameter]
    assert far == allowed.high if np.isfinite(allowed.high) else far > 1e20
    assert allowed.allows(float(to_values(name, jnp.asarray([0.0]), [parameter])[parameter]))


@pytest.mark.parametrize(("name", "parameter"), EVERY)
def test_round_trip_and_slope(name, parameter):
    check_slope(constraints_of(name)[parameter])


@pytest.mark.parametrize("constraint", [AnyNumber(), Above(-3.0), Interval(-2.0, 6.0)])
def test_round_trip_and_slope_of_other_ranges(constraint):
    check_slope(constraint)


def check_slope(constraint):
    with jax.enable_x64(True):
        free = jnp.linspace(-6.0, 6.0, 25)
        values = constraint.value(free)
        np.testing.assert_allclose(constraint.free(values), free, atol=1e-9)
        slope = jax.vmap(jax.grad(constraint.value))(free)
        assert (slope > 1e-4).all(), "strictly increasing, never flat"
        step = 1e-6
        numeric = (constraint.value(free + step) - constraint.value(free - step)) / (2 * step)
        np.testing.assert_allclose(slope, numeric, rtol=1e-6)


def test_pins():
    assert Above().value(jnp.asarray(0.0)) == 1
    np.testing.assert_allclose(Above().value(jnp.log(40.0)), 40, rtol=1e-6)
    assert Interval(0, 1).value(jnp.asarray(0.0)) == 0.5
    np.testing.assert_allclose(Interval(-2, 6).value(jnp.log(3.0)), 4, rtol=1e-6)


def test_order_and_values_survive_the_vector():
    values = {"kappa": 30.0, "tau": 0.25, "phi": 9.0}
    free = to_free("guertin2014", values, ["tau", "kappa"])
    np.testing.assert_allclose(free, [np.log(1 / 3), np.log(30)], rtol=1e-5)
    back = to_values("guertin2014", free, ["tau", "kappa"])
    assert {k: round(float(v), 4) for k, v in back.items()} == {"tau": 0.25, "kappa": 30.0}


def test_nothing_starts_on_a_bound():
    starts = starting_values("guertin2014", {"tau": 1.0, "kappa": 40.0})
    assert starts == {"tau": 1 - INSET, "kappa": 40.0}
    assert starting_values("guertin2014", {"tau": 0.0})["tau"] == INSET
    assert starting_values("guertin2014", {"tau": 0.4})["tau"] == 0.4


@pytest.mark.parametrize(
    ("values", "match"),
    [
        ({"kappa": 0.0}, "`initial.kappa` must be a number above 0, got 0"),
        ({"phi": float("inf")}, "`initial.phi` must be a number above 0"),
        ({"gamma": float("nan")}, "`initial.gamma` must be a number above 0"),
        ({"tau": 1.5}, "`initial.tau` must be from 0 to 1, got 1.5"),
    ],
)
def test_starts_out_of_range_are_refused(values, match):
    with pytest.raises(ValueError, match=match):
        starting_values("guertin2014", values)


def test_an_unknown_filter_is_refused():
    with pytest.raises(ValueError, match="`filter` must be one of guertin2014"):
        to_values("box", jnp.zeros(0), [])
