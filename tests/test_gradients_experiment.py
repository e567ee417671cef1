"""Experiment 013: what its tables and curves are made of."""

import importlib
import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.frame import without_alpha
from jaxblur.gradient_check import GradientCheck, GradientRow, check, measure
from tests.helpers import random_frame

away = importlib.import_module("experiments.013_gradients.away")
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


def test_places_of_a_curve_turn_an_object():
    curve = curves.Curve("any", "any", np.array([0.0, 0.5]), "object direction")
    frame = jaxblur.Frame(jnp.zeros((4, 5, 3)), jnp.ones((4, 5)), jnp.full((4, 5, 2), 3.0))
    held, turned = curves.motions(curve, frame).values()
    np.testing.assert_allclose(held(0.0).velocity, frame.velocity, rtol=1e-6)
    angle = math.pi / 4 + 0.6
    expected = 3 * math.sqrt(2) * np.array([math.cos(angle), math.sin(angle)])
    np.testing.assert_allclose(turned(0.1).velocity[2, 3], expected, rtol=1e-5)


def test_quantities_are_moved_from_their_places():
    frame = jaxblur.Frame(jnp.zeros((4, 5, 3)), jnp.ones((4, 5)), jnp.full((4, 5, 2), 3.0))
    moves = away.directions(frame)
    assert len(moves) == 8 * len(away.PLACES) + 6 * len(away.OFF)
    np.testing.assert_allclose(moves["-0.1: object speed"](0.02).velocity, 3 * 0.92, rtol=1e-6)
    still, moved = moves["0: twist rotation y"], moves["0.1: twist rotation y"]
    np.testing.assert_allclose(still(0.1).velocity, moved(0.0).velocity, rtol=1e-6)
    assert np.abs(moved(0.0).velocity - frame.velocity).max() > 0.1
    near, far = (moves[f"off by {share:g}: twist rotation z"](0.0) for share in away.OFF)
    sizes = [np.linalg.norm(guess.velocity - frame.velocity) for guess in (near, far)]
    assert sizes[0] > 1
    assert 1.8 < sizes[1] / sizes[0] < 2.6


def gradient_row(name, difference, reverse, determined=True):
    ratio = reverse / difference
    return GradientRow(
        *(name, 0.0, reverse, 0.0, None, difference, 0.0, ratio, 0.01, 1.0, determined)
    )


def test_rows_of_a_table_by_quantity_and_place():
    rows = [
        gradient_row("gamma", 5.0, 5.0),
        gradient_row("-0.1: object speed", -4.0, -3.0),
        gradient_row("0: object speed", 0.01, 1.0, determined=False),
        gradient_row("0.1: object speed", 2.0, 2.0),
        gradient_row("-0.1: twist rotation x", 0.1, 0.1, determined=False),
        gradient_row("0: twist rotation x", 0.3, 0.4, determined=False),
        gradient_row("0.1: twist rotation x", 0.2, 0.1, determined=False),
        gradient_row("off by 0.1: twist rotation x", 3.0, 3.0),
        gradient_row("off by 0.1: twist rotation y", 4.0, -3.0),
        gradient_row("off by 0.2: twist rotation x", 3.0, 6.0),
    ]
    table = GradientCheck("layered", jaxblur.Settings(), (4, 5), 0.02, 4, 1.0, tuple(rows))
    found = away.rows_of("any", table)
    kept = [(r.quantity, r.place, r.found.difference, r.steepest, r.counts) for r in found]
    assert kept == [
        ("object speed", -0.1, -4.0, 4.0, True),
        ("object speed", 0.0, 0.01, 4.0, True),
        ("object speed", 0.1, 2.0, 4.0, True),
        ("twist rotation x", -0.1, 0.1, 0.3, False),
        ("twist rotation x", 0.0, 0.3, 0.3, False),
        ("twist rotation x", 0.1, 0.2, 0.3, False),
    ]
    # (3, 4) and (3, -3): cosine of -3 / (5 * 3 sqrt(2)).
    assert away.cosines(table) == ("1.000", "-0.141", "1.000")


def test_rows_at_the_true_motion_are_apart_from_those_away_from_it():
    def row(quantity, place, difference, reverse, steepest, determined=True):
        found = gradient_row(quantity, difference, reverse, determined)
        return away.Row("any", quantity, place, found, steepest, True)

    rows = [
        row("object speed", -0.1, -1.0, -0.94, 2.0),
        row("object speed", 0.0, 0.01, 0.11, 2.0, determined=False),
        row("object speed", 0.1, 2.0, 2.0, 2.0),
        row("object direction", 0.0, 1.0, 1.5, 1.0),
        row("object direction", 0.1, 1.0, 1.5, 1.0),
        row("twist rotation z", 0.0, 1.0, 1.0, 1.0),
        row("twist translation z", 0.1, 4.0, 2.0, 4.0),
    ]
    # Kind, place, ratios, their median, within 5 / 10 / 20 %, slopes, their median error.
    assert away.summarize(rows) == [
        ("object speed", "0", 0, "", "0 / 0 / 0", 1, "0.050"),
        ("object speed", "±0.1", 2, "0.970", "1 / 2 / 2", 2, "0.015"),
        ("object direction", "0", 1, "1.500", "0 / 0 / 0", 1, "0.500"),
        ("object direction", "±0.1", 1, "1.500", "0 / 0 / 0", 1, "0.500"),
        ("camera", "0", 1, "1.000", "1 / 1 / 1", 1, "0.000"),
        ("camera", "±0.1", 1, "0.500", "0 / 0 / 0", 1, "0.500"),
    ]


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


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cube_over_crates", "falling_cubes"])
def test_away_from_the_true_motion_derivatives_do_what_the_picture_does(name):
    data = Path(__file__).parent / "data"
    frame = jaxblur.read_frame(data / f"{name}_frame_0011.exr", shutter=0.5)
    truth = jaxblur.exr.read_image(data / f"{name}_truth_0011.exr")
    frame, truth = without_alpha(frame, truth)
    moves = away.directions(frame)
    wanted = ("0.1: object", "-0.1: object", "off by 0.1")
    moves = {name: move for name, move in moves.items() if name.startswith(wanted)}
    table = jaxblur.check_gradient(
        *("layered", frame, truth), draws=4, scales=(), object=None, directions=moves
    )
    assert table.cosine("off by 0.1: twist") > 0.99
    objects = [row for row in table.rows if "object" in row.name]
    assert len(objects) == 4
    for row in objects:
        assert row.determined, str(table)
        assert abs(row.ratio - 1) < 0.15 + 3 * row.ratio_error, str(table)
