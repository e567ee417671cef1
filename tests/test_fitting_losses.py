"""The losses: their definitions, and the average over the choice of tile."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur import metrics
from jaxblur.fitting.losses import (
    PIXEL_LOSSES,
    Outcomes,
    check_loss,
    error_map,
    inner_pixels,
    pixel_error,
)

SHAPE = (15, 18)


def random_image(seed):
    return np.random.default_rng(seed).uniform(0, 1.4, (*SHAPE, 3)).astype(np.float32)


def random_outcomes():
    generator = np.random.default_rng(7)
    chances = generator.uniform(0, 1, (3, *SHAPE)).astype(np.float32)
    colors = np.stack([random_image(seed) for seed in (1, 2, 3)])
    return Outcomes(jnp.asarray(colors), jnp.asarray(chances / chances.sum(axis=0)))


def shown(image):
    return metrics.display(image)


METRIC = {
    "mse": metrics.mse,
    "relative": metrics.relative_mse,
    "display": lambda a, b, m: metrics.mse(shown(a), shown(b), m),
    "ssim": lambda a, b, m: 1 - metrics.ssim(shown(a), shown(b), m),
}


@pytest.mark.parametrize("pixel", PIXEL_LOSSES)
def test_the_mean_over_pixels_is_the_metric(pixel):
    image, truth = random_image(0), random_image(4)
    mask = np.random.default_rng(5).random(SHAPE) < 0.4
    error = pixel_error(pixel, image, truth)
    assert error.shape == SHAPE
    counts = mask & inner_pixels(pixel, SHAPE)
    found = np.asarray(error)[counts].mean()
    np.testing.assert_allclose(found, METRIC[pixel](image, truth, mask), rtol=1e-4)
    assert jnp.abs(pixel_error(pixel, truth, truth)).max() < 1e-5


@pytest.mark.parametrize("pixel", ["mse", "relative", "display"])
def test_the_expectation_is_the_sum_over_outcomes(pixel):
    outcomes, truth = random_outcomes(), random_image(4)
    expected = sum(
        np.asarray(outcomes.chances[k]) * np.asarray(pixel_error(pixel, outcomes.colors[k], truth))
        for k in range(3)
    )
    np.testing.assert_allclose(error_map(pixel, "expected", outcomes, truth), expected, rtol=1e-5)


def test_expected_error_is_error_of_the_mean_plus_variance():
    outcomes, truth = random_outcomes(), random_image(4)
    mean = np.sum(np.asarray(outcomes.chances)[..., None] * np.asarray(outcomes.colors), axis=0)
    spread = np.mean((np.asarray(outcomes.colors) - mean) ** 2, axis=-1)
    variance = np.sum(np.asarray(outcomes.chances) * spread, axis=0)
    difference = error_map("mse", "expected", outcomes, truth) - error_map(
        "mse", "mean", outcomes, truth
    )
    np.testing.assert_allclose(difference, variance, atol=1e-6)
    assert variance.min() > 1e-3


@pytest.mark.parametrize("pixel", PIXEL_LOSSES)
def test_gradients_equal_finite_differences(pixel):
    over = "mean" if pixel == "ssim" else "expected"
    with jax.enable_x64(True):
        truth = np.asarray(random_image(4), np.float64)
        start = np.asarray(random_outcomes().colors, np.float64) / 1.5
        chances = jnp.asarray(random_outcomes().chances, np.float64)
        direction = np.random.default_rng(0).normal(size=start.shape)

        def loss(scale):
            colors = jnp.asarray(start) + scale * direction
            return jnp.sum(error_map(pixel, over, Outcomes(colors, chances), truth))

        step = 1e-6
        numeric = (loss(step) - loss(-step)) / (2 * step)
        np.testing.assert_allclose(jax.grad(loss)(0.0), numeric, rtol=1e-5)


@pytest.mark.parametrize("pixel", PIXEL_LOSSES)
def test_gradient_at_equality_is_zero(pixel):
    truth = jnp.asarray(random_image(4))
    slope = jax.grad(lambda image: jnp.sum(pixel_error(pixel, image, truth)))(truth)
    assert jnp.abs(slope).max() < 1e-3


def test_undefined_combinations_are_refused():
    with pytest.raises(ValueError, match="`pixel` ssim compares windows"):
        check_loss("ssim", "expected")
    with pytest.raises(ValueError, match="`pixel` must be one of mse, relative"):
        check_loss("psnr", "mean")
    with pytest.raises(ValueError, match="`loss` must be auto, expected or mean, got 'max'"):
        check_loss("mse", "max")
    with pytest.raises(ValueError, match="at least 11 rows and columns"):
        inner_pixels("ssim", (10, 40))
