import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur.safe_math import safe_divide, safe_norm, safe_normalize
from tests.helpers import check_gradients


def test_norm_of_three_four_is_five():
    assert safe_norm(jnp.float32(3), jnp.float32(-4)) == 5


@pytest.mark.parametrize("size", [1e-30, 1e-20, 1.0, 1e6, 1e20, 1e30])
def test_norm_neither_underflows_nor_overflows(size):
    np.testing.assert_allclose(safe_norm(jnp.float32(3 * size), jnp.float32(4 * size)), 5 * size)


@pytest.mark.parametrize("size", [0.0, 1e-40, 1e-30, 1.0, 1e30])
def test_norm_has_a_finite_gradient(size):
    gradient = jax.grad(safe_norm, argnums=(0, 1))(jnp.float32(size), jnp.float32(0))
    expected = (1, 0) if size > 1e-38 else (0, 0)
    np.testing.assert_allclose(gradient, expected, atol=1e-6)


def test_normalize_gives_unit_vectors_and_zero_at_zero():
    np.testing.assert_allclose(safe_normalize(jnp.float32(0), jnp.float32(-7)), (0, -1))
    np.testing.assert_array_equal(safe_normalize(jnp.float32(0), jnp.float32(0)), (0, 0))


@pytest.mark.parametrize("size", [0.0, 1e-30, 1e-20, 1.0, 1e30])
def test_normalize_has_a_finite_gradient(size):
    jacobian = jax.jacfwd(safe_normalize, argnums=(0, 1))(jnp.float32(size), jnp.float32(size))
    assert all(jnp.isfinite(part) for part in jax.tree.leaves(jacobian))


def test_divide_by_zero_gives_the_stated_value_and_no_gradient():
    value, gradient = jax.value_and_grad(safe_divide, argnums=1)(
        jnp.float32(2), jnp.float32(0), 7.0
    )
    assert (value, gradient) == (7, 0)


def test_gradients_equal_finite_differences():
    with jax.enable_x64(True):
        x, y = jnp.asarray([3.0, -0.2, 0.0]), jnp.asarray([4.0, 0.5, -2.0])
        check_gradients(safe_norm, x, y, order=2)
        check_gradients(safe_normalize, x, y)
