"""Experiment 013: what its tables and curves are made of."""

import importlib

import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.gradient_check import check, measure
from tests.helpers import random_frame

curves = importlib.import_module("experiments.013_gradients.curves")
depth = importlib.import_module("experiments.013_gradients.depth")


def test_an_integral_by_trapezoids():
    places = np.array([0.0, 1.0, 3.0])
    assert curves.integral(2 * places, places) == pytest.approx(9)


def test_pixels_that_cross_the_floor_do_not_count():
    scales = np.array([0.5, 1.0])
    curve = curves.Curve("any", "any", scales, within=False)
    # Between 0.49 and 1.02 times their speed: below half a pixel, across it, above it.
    speeds = jnp.array([[0.4, 0.7, 1.2]])
    velocity = jnp.stack([speeds, jnp.zeros_like(speeds)], axis=-1)
    frame = jaxblur.Frame(jnp.zeros((1, 3, 3)), jnp.ones((1, 3)), velocity)
    assert curves.counted(curve, frame).ravel().tolist() == [1, 0, 1]
    assert curves.counted(curve._replace(within=True), frame).ravel().tolist() == [1, 1, 1]


def test_places_of_a_curve_are_scales_of_the_velocity():
    curve = curves.Curve("any", "any", np.array([0.5, 2.0]))
    frame = random_frame((5, 7))
    first, second = curves.motions(curve, frame).values()
    np.testing.assert_allclose(first(0.0).velocity, 0.5 * frame.velocity, rtol=1e-6)
    np.testing.assert_allclose(second(0.1).velocity, 2.2 * frame.velocity, rtol=1e-6)


def test_where_a_depth_is_determined(tmp_path):
    file = tmp_path / "ratios.csv"
    file.write_text(
        "filter,frame,quantity\n"
        '"layered, bilinear","catalogue, zoom",object depth\n'
        '"layered, bilinear","catalogue, gears",object speed\n'
        '"guertin2014, nearest","rendered, sky_car",object depth\n',
        encoding="utf-8",
    )
    assert list(depth.cases_in(file)) == [
        ("layered", "bilinear", "catalogue_zoom"),
        ("guertin2014", "nearest", "rendered_sky_car"),
    ]


@pytest.mark.slow
def test_all_parts_of_a_moved_frame_are_the_filter():
    still, moved = random_frame((12, 20), speed=4.0), random_frame((12, 20), seed=3, speed=4.0)
    moved = moved.replace(color=still.color)
    truth = jnp.full((12, 20, 3), 0.5)
    (noise, *_) = measure.draw_noise(2, 0, still)

    def blurred(frame):
        image = jaxblur.layered(frame, depth.PARAMETERS, settings=depth.SETTINGS, noise=noise)
        return float(check.squared_error(image, truth))

    found = [
        float(depth.error(still, moved, takes, truth, noise))
        for takes in ([False] * 3, [True] * 3, [True, False, False])
    ]
    assert found[0] == pytest.approx(blurred(still), rel=1e-5)
    assert found[1] == pytest.approx(blurred(moved), rel=1e-5)
    assert abs(found[2] - found[0]) > 1e-4 * found[0]
