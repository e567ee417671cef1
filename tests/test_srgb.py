"""The sRGB curve against the standard's values, in NumPy and JAX."""

import doctest

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxblur import srgb

LINEAR = [-0.01, 0.0, 0.001, 0.0031308, 0.18, 0.5, 1.0, 4.0]
# By hand from IEC 61966-2-1: 12.92 x below the joint, else 1.055 x^(1/2.4) - 0.055.
ENCODED = [-0.1292, 0.0, 0.01292, 0.0404499, 0.4613561, 0.7353570, 1.0, 1.8247959]


def test_docstring_examples_hold():
    assert doctest.testmod(srgb) == (0, 4)


@pytest.mark.parametrize("namespace", [np, jnp], ids=["numpy", "jax"])
def test_the_curve_has_the_standard_values(namespace):
    linear = namespace.asarray(LINEAR, dtype="float32")
    encoded = srgb.encode(linear)
    assert type(encoded) is type(linear) and encoded.dtype == linear.dtype
    np.testing.assert_allclose(encoded, ENCODED, atol=2e-6)
    np.testing.assert_allclose(srgb.decode(encoded), linear, atol=2e-6)


@pytest.mark.parametrize("curve", [srgb.encode, srgb.decode], ids=["encode", "decode"])
def test_derivatives_are_right_and_finite_everywhere(curve):
    kinks = jnp.array([-1.0, 0.0, 1e-30, srgb.LINEAR_JOINT, srgb.ENCODED_JOINT, 1e4])
    assert np.isfinite(jax.vmap(jax.grad(curve))(kinks)).all()
    with jax.enable_x64(True):
        check_grads(curve, (jnp.array([-0.5, 0.001, 0.02, 0.3, 2.0]),), order=2)
