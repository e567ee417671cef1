import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur.filters import _weights as weights
from tests.helpers import check_gradients
from tests.reference import plain_loops

DISTANCES = np.array([0.0, 0.3, 1.0, 4.7, 5.0, 5.2, 5.3, 40.0], np.float32)
DEPTHS = np.array([1e-30, 1e-6, 1.0, 1.05, 2.0, 8.0, 10.0, 1e9, np.inf], np.float32)


@pytest.mark.parametrize("length", [0.5, 5.0, 40.0])
@pytest.mark.parametrize("name", ["cone", "cylinder"])
def test_profiles_equal_plain_loops(name, length):
    actual = getattr(weights, name)(jnp.asarray(DISTANCES), jnp.float32(1 / length))
    expected = [getattr(plain_loops, name)(float(d), length) for d in DISTANCES]
    np.testing.assert_allclose(actual, expected, atol=2e-5)


def test_cone_and_cylinder_by_hand():
    assert weights.cone(jnp.float32(1), jnp.float32(1 / 4)) == 0.75
    assert weights.cylinder(jnp.float32(4), jnp.float32(1 / 4)) == pytest.approx(0.5)


def test_level_or_nearer_is_fully_in_front():
    # Departure 1, by hand: pixel at 10, sample at 8 in front of it, k = 1.
    in_front, behind = weights.relative_closeness(*map(jnp.float32, (8, 10, 1)))
    assert (in_front, behind) == (1, 0.75)


@pytest.mark.parametrize(
    ("closeness", "twin", "scale"),
    [
        *((weights.relative_closeness, plain_loops.closer, k) for k in (0.3, 1.0, 20.0)),
        *((weights.absolute_closeness, plain_loops.soft_depth, e) for e in (1e-3, 0.1, 3.0)),
    ],
)
def test_closeness_equals_plain_loops(closeness, twin, scale):
    finite = weights.finite_depth(jnp.asarray(DEPTHS))
    in_front, behind = closeness(finite[:, None], finite[None], jnp.float32(scale))
    for (i, j), value in np.ndenumerate(np.asarray(in_front)):
        sample, pixel = float(DEPTHS[i]), float(DEPTHS[j])
        assert value == pytest.approx(twin(sample, pixel, scale), abs=1e-4)
        assert behind[i, j] == pytest.approx(twin(pixel, sample, scale), abs=1e-4)


@pytest.mark.parametrize(("apart", "expected"), [(1e-9, (-10, 0)), (-1e-9, (0, -10))])
def test_the_side_of_a_small_separation_is_not_rounded_away(apart, expected):
    """Next to 1 nothing of 1e-8 is left in float32."""

    def closeness(depth):
        return weights.absolute_closeness(depth, jnp.float32(1e-6), jnp.float32(0.1))

    slopes = jax.jacfwd(closeness)(jnp.float32(1e-6 + apart))
    np.testing.assert_allclose(slopes, np.abs(expected) * np.array([-1, 1]))


def test_scaling_the_depths_changes_nothing():
    near, far = jnp.float32(2.0), jnp.float32(2.3)
    for scale in (1e-3, 1.0, 1e6):
        in_front, behind = weights.relative_closeness(far * scale, near * scale, jnp.float32(4))
        np.testing.assert_allclose((in_front, behind), (1 - 4 * 0.15, 1), rtol=1e-5)


@pytest.mark.parametrize("closeness", [weights.relative_closeness, weights.absolute_closeness])
def test_gradients_are_finite_at_every_pair_of_depths(closeness):
    def total(depths, parameter):
        finite = weights.finite_depth(depths)
        return sum(map(jnp.sum, closeness(finite[:, None], finite[None], parameter)))

    for parameter in (1e-10, 1e-3, 1.0, 20.0):
        gradient = jax.grad(total, argnums=(0, 1))(jnp.asarray(DEPTHS), jnp.float32(parameter))
        assert all(jnp.isfinite(part).all() for part in gradient), parameter


def test_gradients_equal_finite_differences():
    with jax.enable_x64(True):
        distance, inverse = np.array([0.4, 3.0, 5.1, 9.0]), np.array([0.2, 0.21, 0.2, 0.2])
        check_gradients(weights.cone, distance, inverse)
        check_gradients(weights.cylinder, distance, inverse)
        near, far = np.array([2.0, 3.0, 1.0]), np.array([2.3, 2.8, 9.0])
        check_gradients(weights.relative_closeness, near, far, 2.0)
        check_gradients(weights.absolute_closeness, near, far, 0.7)
