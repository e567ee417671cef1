"""Gradients of the filters: right away from kinks, finite everywhere."""

import dataclasses
import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.filters import FILTERS
from tests.helpers import (
    check_gradients,
    fields,
    random_frame,
    random_noise,
    settings_of,
    slow,
    with_slow,
)

PARAMETERS = {
    "guertin2014": {
        "kappa": 11.0,
        "gamma": 2.3,
        "tau": 0.71,
        "eta": 0.83,
        "phi": 2.9,
        "depth_sharpness": 1.7,
    },
    "mcguire2012": {"soft_z_extent": 3.7},
    "pixel_velocity": {},
    "layered": {
        "front_sharpness": 1.3,
        "landing_tolerance": 2.3,
        "own_tolerance": 0.9,
        "surface_sharpness": 0.7,
        "bend": 0.4,
        "jitter": 0.9,
        "distinct": 4.1,
        "thin_coverage": 0.6,
    },
}
CLASSES = {
    "guertin2014": jaxblur.GuertinParameters,
    "mcguire2012": jaxblur.McGuireParameters,
    "pixel_velocity": lambda: None,
    "layered": jaxblur.LayeredParameters,
}


def blur(name, settings, noise):
    settings = settings_of(name, settings)

    def function(color, depth, velocity, parameters):
        frame = jaxblur.Frame(color, depth, velocity)
        return FILTERS[name](frame, CLASSES[name](**parameters), settings=settings, noise=noise)

    return function


@pytest.mark.parametrize("name", with_slow(FILTERS, "guertin2014", "layered", "mcguire2012"))
def test_every_input_equals_finite_differences(name, monkeypatch):
    # Where what a texel gives is blended in the value too, its derivative is that of the value.
    shape, fetch = (5, 7), "blend"

    def still(x, y):
        return jnp.zeros_like(x, jnp.int32), jnp.zeros_like(y, jnp.int32)

    # Outlines of layered move in the derivative alone (tests/test_gradient_check.py).
    owners = importlib.import_module("jaxblur.filters.layered.owners")
    monkeypatch.setattr(owners, "still_place", still)
    settings = jaxblur.GuertinSettings(samples=5, radius=4, fetch=fetch, tile_choice="expected")
    with jax.enable_x64(True):
        # Without still pixels: at v = 0 the side of the perpendicular switches.
        frame = random_frame(shape, seed=5, speed=5.0, dtype=np.float64, channels=2, still=0)
        noise = random_noise(shape, dtype=np.float64)
        check_gradients(
            blur(name, settings, noise),
            *(np.asarray(b) for b in (frame.color, frame.depth, frame.velocity)),
            PARAMETERS[name],
        )


# In the fast suite, `test_every_input_equals_finite_differences` differentiates by all of these
# parameters along one direction, and tests/test_fitting_objective.py by five of them one by one.
@pytest.mark.slow
def test_every_parameter_matters_and_has_its_gradient():
    shape, step = (12, 13), 1e-6
    settings = jaxblur.GuertinSettings(samples=7, radius=4, fetch="blend", tile_choice="expected")
    with jax.enable_x64(True):
        frame = random_frame(shape, speed=5.0, dtype=np.float64)
        function = blur("guertin2014", settings, random_noise(shape, dtype=np.float64))

        @jax.jit
        @jax.value_and_grad
        def loss(parameters):
            output = function(frame.color, frame.depth, frame.velocity, parameters)
            return jnp.mean((output - 0.3) ** 2)

        start = PARAMETERS["guertin2014"]
        _, gradient = loss(start)
        for field, value in start.items():
            (above, _), (below, _) = (loss(start | {field: value + h}) for h in (step, -step))
            numeric = (above - below) / (2 * step)
            assert abs(numeric) > 1e-8, field
            np.testing.assert_allclose(gradient[field], numeric, rtol=1e-4, err_msg=field)


def kink_frames():
    """Frames that sit on every kink that the specification names."""
    shape = (8, 9)
    base = random_frame(shape, speed=5.0)
    opposed = jnp.where(jnp.arange(9)[None, :, None] % 2 == 0, 1.0, -1.0)
    right = jnp.asarray([1.0, 0.0])

    def with_velocity(velocity):
        return jaxblur.Frame(base.color, base.depth, jnp.broadcast_to(velocity, (*shape, 2)))

    def with_depth(depth):
        return jaxblur.Frame(base.color, jnp.broadcast_to(depth, shape), base.velocity)

    return {
        "still": with_velocity(jnp.zeros(2)),
        "half a pixel": with_velocity(0.5 * right),
        "exactly the radius": with_velocity(4.0 * right),
        "far beyond the radius": with_velocity(1e6 * right),
        "tiny": with_velocity(1e-20 * right),
        "opposed": with_velocity(3 * opposed * right),
        "some still": with_velocity(jnp.where(opposed > 0, 3.0 * right, 0.0)),
        "sky": with_depth(jnp.inf),
        "half sky": with_depth(jnp.where(jnp.arange(9) < 4, jnp.inf, 2.0)),
        "one depth": with_depth(2.0),
        "extreme depths": with_depth(jnp.where(jnp.arange(9) % 2 == 0, 1e-30, 1e9)),
    }


def small_frames():
    base = random_frame((8, 9), speed=5.0)
    return {
        "one pixel": jax.tree.map(lambda buffer: buffer[:1, :1], base),
        "one row": jax.tree.map(lambda buffer: buffer[:1], base),
    }


KINK_SETTINGS = jaxblur.GuertinSettings(samples=5, radius=4, fetch="bilinear")
OTHER_KINK_SETTINGS = dataclasses.replace(KINK_SETTINGS, fetch="nearest", tile_choice="expected")
"""Of guertin2014 alone."""


def assert_finite_both_ways(name, settings, frames):
    function = blur(name, settings, None)

    @jax.jit
    def both_modes(frame):
        inputs = (frame.color, frame.depth, frame.velocity, PARAMETERS[name])
        value, pull = jax.vjp(function, *inputs)
        ones = jax.tree.map(jnp.ones_like, jax.tree.map(jnp.asarray, inputs))
        return value, pull(jnp.ones_like(value)), jax.jvp(function, inputs, ones)[1]

    for kink, frame in frames.items():
        for leaf in jax.tree.leaves(both_modes(frame)):
            assert jnp.isfinite(leaf).all(), kink


# More such frames, for every filter with the tile choice "own", are in tests/test_hard_cases.py.
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("pixel_velocity", KINK_SETTINGS),
        slow("guertin2014", OTHER_KINK_SETTINGS),
    ],
    ids=["pixel_velocity", "guertin2014-expected"],
)
def test_value_and_gradients_are_finite_at_every_kink(name, settings):
    assert_finite_both_ways(name, settings, kink_frames())


# Each size compiles anew.
@pytest.mark.parametrize(
    ("name", "settings", "which"),
    [
        ("pixel_velocity", KINK_SETTINGS, "one row"),
        *(
            slow(*case)
            for case in [
                ("mcguire2012", KINK_SETTINGS, "one row"),
                ("guertin2014", KINK_SETTINGS, "one row"),
                ("guertin2014", OTHER_KINK_SETTINGS, "one pixel"),
                ("layered", KINK_SETTINGS, "one pixel"),
            ]
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else value.tile_choice,
)
def test_value_and_gradients_are_finite_on_one_pixel_and_one_row(name, settings, which):
    assert_finite_both_ways(name, settings, {which: small_frames()[which]})


def test_gradients_survive_debug_nans_vmap_and_checkpoint():
    frame = random_frame((6, 7), speed=4.0)
    settings = jaxblur.GuertinSettings(samples=3, radius=4, tile_choice="expected")
    function = blur("guertin2014", settings, None)

    def loss(color, kappa):
        parameters = fields(jaxblur.GuertinParameters(kappa=kappa))
        return jnp.sum(function(color, frame.depth, frame.velocity, parameters) ** 2)

    colors = jnp.stack([frame.color, 2 * frame.color])
    with jax.debug_nans(True):
        batched = jax.vmap(jax.grad(loss, argnums=1), in_axes=(0, None))(colors, 40.0)
    single = [jax.grad(jax.checkpoint(loss), argnums=1)(color, 40.0) for color in colors]
    np.testing.assert_allclose(batched, single, rtol=1e-4)


@pytest.mark.slow
def test_gradients_of_a_batch_are_those_of_each_frame():
    settings = jaxblur.GuertinSettings(samples=5, radius=4, noise="none", tile_choice="expected")
    frames = [random_frame((8, 12), seed=seed) for seed in (1, 2)]

    def loss(color, frame):
        changed = jaxblur.Frame(color, frame.depth, frame.velocity)
        return jnp.sum(
            jaxblur.guertin2014(changed, jaxblur.GuertinParameters(), settings=settings) ** 2
        )

    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *frames)
    of_batch = jax.jit(jax.grad(lambda colors: jnp.sum(jax.vmap(loss)(colors, stacked))))
    together, slope = of_batch(stacked.color), jax.jit(jax.grad(loss))
    alone = [slope(frame.color, frame) for frame in frames]
    np.testing.assert_allclose(together, jnp.stack(alone), rtol=1e-4, atol=1e-5)


def test_gradient_of_parameters_alone_scatters_nothing():
    frame = random_frame((16, 16))
    function = blur("guertin2014", jaxblur.GuertinSettings(samples=5, radius=8), None)

    def loss(kappa):
        parameters = fields(jaxblur.GuertinParameters(kappa=kappa))
        return jnp.sum(function(frame.color, frame.depth, frame.velocity, parameters))

    program = str(jax.jit(jax.grad(loss)).lower(40.0).compile().as_text())
    assert " scatter(" not in program
    assert " gather(" in program


# XLA's are compared with these in tests/test_native.py.
def test_second_derivatives_are_those_of_the_first():
    frame = random_frame((6, 7), speed=4.0)
    settings = jaxblur.GuertinSettings(
        samples=3, radius=4, backend="native", tile_choice="expected", fetch="bilinear"
    )

    def loss(kappa):
        parameters = jaxblur.GuertinParameters(kappa=kappa)
        return 1e4 * jnp.mean(jaxblur.guertin2014(frame, parameters, settings=settings) ** 2)

    slope = jax.grad(loss)

    @jax.jit
    def second(kappa):
        along = jax.jvp(slope, (kappa,), (1.0,))[1]
        return slope(kappa), jax.hessian(loss)(kappa), jax.grad(slope)(kappa), along

    by_differences = (second(44.0)[0] - second(36.0)[0]) / 8
    for way in second(40.0)[1:]:
        np.testing.assert_allclose(way, by_differences, rtol=0.05)
