"""The objective is what will run, and its gradient is that of the objective."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.filters.guertin2014 import tile_outcomes
from jaxblur.fitting.constraints import to_free
from jaxblur.fitting.losses import Outcomes, error_map
from jaxblur.fitting.objective import (
    Objective,
    block_losses,
    blocks_and_gradients,
    draw_noise,
    forward_differentiated,
    sum_blocks,
    value_and_gradient,
    value_and_jacobian,
)
from jaxblur.fitting.pairs import make_batches, make_pairs, pixel_weights
from tests.helpers import random_frame
from tests.planted import TRUE

FREE = ("kappa", "gamma", "tau", "phi", "depth_sharpness")
SHAPE = (13, 17)
RUN = jaxblur.GuertinSettings(samples=5, radius=6, fetch="blend")


def as_float64(frame):
    return jax.tree.map(lambda buffer: jnp.asarray(buffer, np.float64), frame)


def objective(**changes):
    choices: dict[str, Any] = {
        "filter_name": "guertin2014",
        "free": FREE,
        "pixel": "mse",
        "over": "expected",
        "settings": RUN,
        "noise": "fixed",
        "noise_draws": 1,
    }
    return Objective(**choices | changes)


def batches_of(*frames, dtype: Any = np.float32):
    truth = np.full((*SHAPE, 3), 0.4, dtype)
    pairs = make_pairs([(frame, truth) for frame in frames], None)
    return make_batches(pairs, pixel_weights(pairs, None, "mse"))


@pytest.mark.slow
def test_expected_loss_is_the_average_error_of_what_runs():
    frame = random_frame(SHAPE, seed=3)
    noise = draw_noise(jax.random.key(5), SHAPE)

    @jax.jit
    def run(key):
        tile = draw_noise(key, SHAPE).tile
        image = jaxblur.guertin2014(
            frame,
            jaxblur.GuertinParameters(**TRUE),
            settings=RUN,
            noise=dataclasses.replace(noise, tile=tile),
        )
        return jnp.mean((image - 0.4) ** 2)

    errors = np.asarray(jax.lax.map(run, jax.random.split(jax.random.key(1), 400)))
    # The same tap noise in every draw: only the tile varies.
    exact = _loss_with_taps(frame, noise, "expected")
    margin = 4 * errors.std() / np.sqrt(len(errors))
    assert abs(errors.mean() - exact) < margin
    assert exact - _loss_with_taps(frame, noise, "mean") > 2 * margin, "the mean image costs less"


def _loss_with_taps(frame, noise, over):
    settings = objective().smooth_settings
    assert isinstance(settings, jaxblur.GuertinSettings) and settings.tile_choice == "expected"
    parameters = jaxblur.GuertinParameters(**TRUE)
    outcomes = tile_outcomes(frame, parameters, settings=settings, noise=noise)
    return float(jnp.mean(error_map("mse", over, Outcomes(*outcomes), jnp.full((*SHAPE, 3), 0.4))))


@pytest.mark.slow
def test_gradient_equals_finite_differences():
    with jax.enable_x64(True):
        batches = batches_of(as_float64(random_frame(SHAPE)), dtype=np.float64)
        free, fixed = to_free("guertin2014", TRUE, FREE), {"eta": 0.95}
        key = jax.random.key(2)
        loss, gradient = value_and_gradient(objective(), free, fixed, batches, key)

        @jax.jit
        def whole(point):
            return jnp.sum(block_losses(objective(), point, fixed, batches, key))

        np.testing.assert_allclose(loss, whole(free), rtol=1e-12)
        step = 1e-6 * np.eye(len(FREE))
        numeric = [(whole(free + s) - whole(free - s)) / 2e-6 for s in step]
        assert np.abs(numeric).min() > 1e-8
        np.testing.assert_allclose(gradient, numeric, rtol=1e-4)


@pytest.mark.slow
def test_pairs_count_the_same_and_blocks_sum_to_the_loss():
    frames = random_frame(SHAPE, seed=0), random_frame(SHAPE, seed=1)
    free, fixed, key = to_free("guertin2014", TRUE, FREE), {"eta": 0.95}, jax.random.key(0)
    what = objective(noise="builtin")
    both = batches_of(*frames)
    assert len(both) == 1, "pairs of one size are stacked"
    blocks, slopes = blocks_and_gradients(what, free, fixed, both, key)
    assert blocks.shape == (2 * 3 * 3,) and slopes.shape == (18, len(FREE))
    single = [value_and_gradient(what, free, fixed, batches_of(f), key)[0] for f in frames]
    np.testing.assert_allclose(jnp.sum(blocks), np.mean(single), rtol=1e-5)


def test_blocks():
    plane = jnp.arange(12.0).reshape(3, 4)
    np.testing.assert_array_equal(sum_blocks(plane, 2), [0 + 1 + 4 + 5, 2 + 3 + 6 + 7, 17, 21])


def test_noise_is_uniform_and_depends_on_pair_and_key_alone():
    noise = draw_noise(jax.random.key(0), (100, 100))
    for values, low, high in ((noise.tap, -1, 1), (noise.tile, -0.5, 0.5)):
        assert low <= values.min() and values.max() < high
        np.testing.assert_allclose(values.mean(), 0, atol=0.02)
        np.testing.assert_allclose(values.std(), (high - low) / np.sqrt(12), rtol=0.02)
    same = random_frame(SHAPE)
    blocks = blocks_and_gradients(
        objective(),
        to_free("guertin2014", TRUE, FREE),
        {"eta": 0.95},
        batches_of(same, same),
        jax.random.key(0),
    )[0].reshape(2, -1)
    assert not np.allclose(blocks[0], blocks[1], rtol=1e-5), "each pair has noise of its own"


def test_settings_are_made_differentiable_only_where_needed():
    nearest = jaxblur.GuertinSettings(samples=5, radius=6)
    assert objective(settings=nearest, free=("kappa", "tau")).smooth_settings == (
        dataclasses.replace(nearest, tile_choice="expected")
    )
    assert objective(settings=nearest, free=("phi",)).smooth_settings.fetch == "nearest"
    own = dataclasses.replace(nearest, tile_choice="own")
    assert objective(settings=own, free=("kappa",)).smooth_settings == own


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "mse error expected over the random outcomes; fixed noise, 1 a step"),
        ({"over": "mean"}, "of the mean image over the random outcomes"),
        ({"settings": jaxblur.GuertinSettings()}, "; fetch nearest"),
        ({"settings": jaxblur.GuertinSettings(noise="none")}, "; no noise;"),
        ({"settings": jaxblur.GuertinSettings(tile_choice="own")}, "mse error of the image;"),
    ],
)
def test_the_result_says_what_was_minimized(changes, words):
    assert words in objective(**changes).describe()


def test_equal_objectives_compile_once():
    traced = []

    @functools.partial(jax.jit, static_argnames=("what",))
    def count(what, x):
        traced.append(what)
        return x

    count(objective(), 1.0)
    count(objective(settings=jaxblur.GuertinSettings(samples=5, radius=6, fetch="blend")), 2.0)
    assert len(traced) == 1
    count(objective(noise_draws=2), 2.0)
    assert len(traced) == 2


def test_jacobian_and_the_gradient_that_line_searches_see():
    def function(x):
        return jnp.stack([x[0] * x[1], jnp.sin(x[1])])

    point = jnp.asarray([0.3, 0.7])
    value, jacobian = value_and_jacobian(function, point)
    np.testing.assert_allclose(value, function(point))
    np.testing.assert_allclose(jacobian, jax.jacrev(function)(point), rtol=1e-6)

    wrapped = forward_differentiated(lambda x: (x @ x, 2 * x))
    np.testing.assert_allclose(jax.grad(lambda x: 3 * wrapped(x))(point), 6 * point, rtol=1e-6)


def test_frames_with_and_without_a_curved_path_are_stacked_apart():
    plain = random_frame(SHAPE)
    path = jnp.stack([0.5 * plain.velocity, 2 * plain.velocity], axis=2)
    curved = dataclasses.replace(plain, path=path)
    batches = batches_of(plain, curved, curved)
    assert [batch.truth.shape[0] for batch in batches] == [1, 2]
    assert batches[0].frame.path is None
    assert batches[1].frame.path is not None
    np.testing.assert_array_equal(batches[1].frame.path[0], path)
    assert sum(float(batch.weight.sum()) for batch in batches) == pytest.approx(1)


def test_a_path_that_is_not_finite_is_refused_and_counts_in_the_hash():
    plain = random_frame(SHAPE)
    truth = np.full((*SHAPE, 3), 0.4, np.float32)
    curved = dataclasses.replace(plain, path=jnp.zeros((*SHAPE, 2, 2)))
    hashes = {pair.sha256() for pair in make_pairs([(plain, truth), (curved, truth)], None)}
    assert len(hashes) == 2
    bad = dataclasses.replace(plain, path=jnp.full((*SHAPE, 2, 2), jnp.nan))
    with pytest.raises(ValueError, match="pair 0: path is NaN or infinite at 221 pixels"):
        make_pairs([(bad, truth)], None)
