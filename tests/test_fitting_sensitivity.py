"""Standard errors: against closed forms, against refitting, and what they flag."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.fitting.sensitivity import difference_hessian, sandwich
from tests.planted import SETTINGS, TRUE, planted_pair

pytestmark = pytest.mark.slow


def regression(seed, count=4000, slope=(2.0, -1.0), spread=0.7):
    """Least squares with two correlated regressors and noise that grows with the first."""
    generator = np.random.default_rng(seed)
    x = generator.normal(size=(count, 2)) @ np.array([[1.0, 0.6], [0.0, 0.8]])
    noise = spread * generator.normal(size=count) * (0.3 + np.abs(x[:, 0]))
    return x, x @ np.asarray(slope) + noise


def test_the_sandwich_is_the_spread_of_least_squares_over_new_data():
    def solve(seed):
        x, y = regression(seed)
        return np.linalg.lstsq(x, y, rcond=None)[0]

    estimates = np.stack([solve(seed) for seed in range(400)])
    said, naive = [], []
    for seed in range(40):
        x, y = regression(seed)
        residual, count = y - x @ solve(seed), len(y)
        hessian, blocks = 2 * x.T @ x / count, -2 * residual[:, None] * x / count
        covariance, determined = sandwich(hessian, blocks)
        assert determined.all()
        said.append(covariance)
        naive.append(residual.var() * np.linalg.inv(x.T @ x))
    # 400 estimates tell a variance to 7 %.
    spread = np.cov(estimates.T)
    np.testing.assert_allclose(np.diag(np.mean(said, axis=0)), np.diag(spread), rtol=0.2)
    assert spread[0, 0] > 1.4 * np.mean(naive, axis=0)[0, 0], "the textbook error is too small"


def test_a_direction_without_curvature_is_not_determined():
    hessian = np.diag([4.0, 0.0, 1.0])
    blocks = np.random.default_rng(0).normal(size=(50, 3))
    covariance, determined = sandwich(hessian, blocks)
    assert determined.tolist() == [True, False, True]
    assert np.isfinite(covariance).all()
    entangled = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert sandwich(entangled, blocks)[1].tolist() == [False, False, True]
    assert not sandwich(np.diag([1.0, -1.0, 1.0]), blocks)[1][1], "a maximum determines nothing"


def test_hessian_by_differences_is_exact_on_a_quadratic_and_close_on_a_smooth_function():
    matrix = np.array([[3.0, 1.0, 0.0], [1.0, 2.0, -1.0], [0.0, -1.0, 5.0]])
    point = jnp.asarray([0.3, -0.2, 1.0])
    found = difference_hessian(lambda x: matrix @ np.asarray(x), point)
    np.testing.assert_allclose(found, matrix, rtol=1e-4, atol=1e-4)

    def smooth(x):
        return jnp.exp(x[0]) * jnp.sin(x[1]) + jnp.cosh(x[2] * x[0])

    found = difference_hessian(lambda x: np.asarray(jax.grad(smooth)(x)), point)
    np.testing.assert_allclose(found, jax.hessian(smooth)(point), rtol=0.01, atol=0.01)


def noisy_fit(frame, truth, **options):
    return jaxblur.fit(
        "guertin2014",
        [(frame, truth)],
        initial=TRUE,
        settings=dataclasses.replace(SETTINGS, tile_choice="own", radius=12),
        noise="builtin",
        steps=40,
        **options,
    )


def test_what_the_frames_do_not_show_is_flagged():
    frame, truth = planted_pair()
    flat = dataclasses.replace(frame, depth=jnp.ones_like(frame.depth))
    result = noisy_fit(flat, truth, free=("kappa", "depth_sharpness"))
    assert result.sensitivity is not None
    assert np.isinf(result.sensitivity.standard_error[1])
    assert any(
        flag.startswith("depth_sharpness: the loss has") for flag in result.sensitivity.flags
    )
    assert not any(flag.startswith("kappa") for flag in result.sensitivity.flags)


def test_standard_errors_predict_the_spread_over_pictures():
    generator = np.random.default_rng(0)
    frame, truth = planted_pair()
    found, predicted = [], []
    for _ in range(8):
        # Independent noise in the truth is what a standard error should account for.
        noisy = np.asarray(truth) + 0.01 * generator.normal(size=truth.shape).astype(np.float32)
        result = noisy_fit(frame, noisy, free=("kappa", "depth_sharpness"))
        assert result.sensitivity is not None
        found.append(np.log([result.parameters[name] for name in result.free]))
        predicted.append(result.sensitivity.relative_error)
    spread, said = np.std(found, axis=0, ddof=1), np.median(predicted, axis=0)
    assert (spread / said > 0.4).all() and (spread / said < 2.5).all(), (spread, said)


def test_correlations_are_correlations():
    frame, truth = planted_pair()
    result = noisy_fit(frame, 1.1 * truth, free=("kappa", "gamma", "depth_sharpness"))
    assert result.sensitivity is not None
    matrix = np.asarray(result.sensitivity.correlation)
    np.testing.assert_array_equal(np.diag(matrix), 1)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
    assert np.abs(matrix).max() <= 1 + 1e-9 and np.linalg.eigvalsh(matrix).min() > -1e-9
