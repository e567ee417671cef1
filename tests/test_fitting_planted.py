"""Planted truth: what the filter blurred with known parameters gives them back."""

import numpy as np
import optax
import pytest

import jaxblur
from jaxblur.fitting import profile
from tests.planted import FREE, SETTINGS, TRUE, planted_pair

pytestmark = pytest.mark.slow

STARTS = {
    "an order below": {"kappa": 3.0, "gamma": 0.2, "tau": 0.08, "phi": 0.9, "depth_sharpness": 0.4},
    "an order above": {
        "kappa": 300.0,
        "gamma": 20.0,
        "tau": 0.95,
        "phi": 90.0,
        "depth_sharpness": 40.0,
    },
    "mixed": {"kappa": 300.0, "gamma": 0.2, "tau": 0.1, "phi": 90.0, "depth_sharpness": 0.4},
}


def fit_from(start, steps=90, **options):
    return jaxblur.fit(
        "guertin2014",
        [planted_pair()],
        initial=start,
        free=FREE,
        settings=SETTINGS,
        noise="builtin",
        steps=steps,
        **options,
    )


@pytest.mark.parametrize("start", STARTS.values(), ids=STARTS)
def test_a_fit_finds_the_planted_parameters_within_one_percent(start):
    result = fit_from(start)
    for name in FREE:
        assert abs(result.parameters[name] / TRUE[name] - 1) < 0.01, (name, result.parameters)
    assert result.parameters["eta"] == TRUE["eta"]
    assert result.history["loss"][0] > 1e3 * result.history["loss"][-1]
    assert result.sensitivity is not None and result.sensitivity.flags == ()
    assert max(result.sensitivity.relative_error) < 0.01


def test_profiles_have_their_minimum_at_the_planted_value():
    result = fit_from({name: TRUE[name] for name in FREE}, steps=1)
    assert result.sensitivity is not None
    for name in ("gamma", "kappa"):
        values = TRUE[name] * np.exp([-0.4, -0.1, 0.0, 0.1, 0.4])
        scan = profile(result, [planted_pair()], name, values=values)
        assert np.isclose(scan.best, TRUE[name]) and not scan.refitted
        assert (np.diff(scan.losses)[:2] < 0).all() and (np.diff(scan.losses)[2:] > 0).all()
    # Kappa moves no tap, so that its gradient has no jumps that it does not know of.
    curvature = (scan.losses[1] - 2 * scan.losses[2] + scan.losses[3]) / 0.1**2
    row = FREE.index("kappa")
    np.testing.assert_allclose(result.sensitivity.curvature[row][row], curvature, rtol=0.1)

    # Refitting the others lowers the loss, be it by a percent, where they can make up for a part.
    refitted = profile(result, [planted_pair()], "kappa", values=values[[0, 4]], refit=True)
    change = refitted.losses - scan.losses[[0, 4]]
    assert (change <= 0).all() and (change < 0).any()


def test_mcguire_too_through_its_function():
    frame, _ = planted_pair()
    settings = jaxblur.Settings(samples=7, radius=16, fetch="bilinear")
    extent = jaxblur.McGuireParameters(soft_z_extent=0.7)
    truth = jaxblur.mcguire2012(frame, extent, settings=settings)
    result = jaxblur.fit(
        jaxblur.mcguire2012,
        [(frame, truth)],
        initial={"soft_z_extent": 0.07},
        settings=settings,
        noise="builtin",
        steps=40,
    )
    assert result.free == ("soft_z_extent",)
    assert abs(result.parameters["soft_z_extent"] / 0.7 - 1) < 0.01


def test_a_line_search_of_optax_works_too():
    result = fit_from(TRUE | {"kappa": 20.0, "gamma": 3.0}, steps=4, optimizer=optax.lbfgs())
    losses = result.history["loss"]
    assert len(losses) == 4 and (np.diff(losses) < 0).all()
