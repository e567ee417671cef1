from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.noise import interleaved_gradient, make_noise
from tests.helpers import random_frame


@pytest.mark.parametrize("kind", ["ign", "halton"])
def test_noise_is_uniform_and_independent(kind):
    noise = make_noise(kind, 96, 128)
    values = np.stack([noise.tap / 2, noise.tile[..., 0], noise.tile[..., 1]])
    assert values.min() >= -0.5 and values.max() < 0.5
    for plane in values:
        histogram, _ = np.histogram(plane, bins=8, range=(-0.5, 0.5))
        np.testing.assert_allclose(histogram / plane.size, 1 / 8, atol=0.01)
    correlation = np.corrcoef(values.reshape(3, -1))
    np.testing.assert_allclose(correlation, np.eye(3), atol=0.05)


def test_none_is_zero():
    noise = make_noise("none", 3, 4)
    assert not noise.tap.any() and not noise.tile.any()


def test_interleaved_gradient_noise_at_a_hand_checked_pixel():
    # x = 3, y = 2: 0.06711056 * 3 + 0.00583715 * 2 = 0.21300598; times 52.9829189 = 11.28567879
    assert make_noise("ign", 4, 5).tap[2, 3] == pytest.approx(2 * 0.28567879 - 1, abs=1e-6)


def test_interleaved_gradient_noise_equals_its_formula_far_from_the_origin():
    """Coordinates are so large that float32 has 18 bits left, and columns are negative too."""
    x, y = np.ogrid[-9000:9000:37, 0:9000:41]
    expected = 52.9829189 * ((0.06711056 * x + 0.00583715 * y) % 1) % 1
    apart = np.abs(interleaved_gradient(x, y) - expected)
    assert np.minimum(apart, 1 - apart).max() < 1e-7


def test_every_program_gives_the_same_noise_to_the_bit():
    def alone():
        return make_noise("ign", 61, 83)

    def among_other_things(image):
        noise = make_noise("ign", 61, 83)
        return noise, jnp.sum(image * (1.7 * noise.tap + 0.3)) + jnp.sum(noise.tile * 2.1)

    with jax.disable_jit():
        eager = alone()
    images = jnp.ones((2, 61, 83))
    others = {
        "jit": jax.jit(alone)(),
        "larger program": jax.jit(among_other_things)(images[0])[0],
        "vmap": jax.tree.map(lambda a: a[1], jax.vmap(among_other_things)(images)[0]),
        "scan": jax.tree.map(lambda a: a[1], jax.lax.map(among_other_things, images)[0]),
    }
    for name, noise in others.items():
        np.testing.assert_array_equal(noise.tap, eager.tap, err_msg=name)
        np.testing.assert_array_equal(noise.tile, eager.tile, err_msg=name)


@pytest.mark.parametrize("kind", ["ign", "halton"])
def test_a_seed_moves_the_pattern(kind):
    still, moved = make_noise(kind, 40, 150), make_noise(kind, 40 + 303, 150 + 97)
    np.testing.assert_array_equal(make_noise(kind, 40, 150, 1).tap, moved.tap[303:, 97:])
    np.testing.assert_array_equal(make_noise(kind, 40, 150, 1).tile, moved.tile[303:, 97:])
    np.testing.assert_array_equal(make_noise(kind, 40, 150, 0).tap, still.tap)
    corner = make_noise(kind, 40, 150, origin=(97, 303))
    np.testing.assert_array_equal(corner.tap, moved.tap[303:, 97:])
    np.testing.assert_array_equal(make_noise(kind, 40, 150, 1, origin=(-97, -303)).tap, still.tap)
    for seed in (-7, 123457, 10**18 + 1):
        other = make_noise(kind, 40, 150, seed).tap
        assert -1 <= other.min() < -0.9 and 0.9 < other.max() < 1
        assert np.mean(other == still.tap) < 0.1


def test_the_values_of_a_pixel_are_spread_evenly_over_frames():
    """Of eight frames one value lies in every quarter, nearly everywhere: at random 40 %."""
    taps = np.stack([make_noise("ign", 50, 60, seed).tap for seed in range(1001, 1009)])
    quarters = np.floor(2 * (taps + 1)).astype(int)
    seen = np.stack([(quarters == quarter).any(axis=0) for quarter in range(4)])
    assert seen.all(axis=0).mean() > 0.99


def test_halton_starts_with_its_known_points():
    tap = make_noise("halton", 1, 4).tap
    np.testing.assert_allclose((tap[0] + 1) / 2, [0, 1 / 2, 1 / 4, 3 / 4])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tap": jnp.zeros((3, 4))}, r"`noise.tap` must have shape \(4, 5\), got \(3, 4\)"),
        ({"tile": jnp.zeros((4, 5))}, r"`noise.tile` must have shape \(4, 5, 2\), got \(4, 5\)"),
    ],
)
def test_explicit_noise_of_another_shape_is_refused(change, message):
    arrays = {"tap": jnp.zeros((4, 5)), "tile": jnp.zeros((4, 5, 2))} | change
    with pytest.raises(ValueError, match=message):
        jaxblur.guertin2014(
            random_frame((4, 5)), jaxblur.GuertinParameters(), noise=jaxblur.Noise(**arrays)
        )


def test_noise_of_another_type_is_rejected():
    noise: Any = jnp.zeros((4, 5))
    with pytest.raises(ValueError, match=r"`noise` must be a jaxblur.Noise"):
        jaxblur.layered(random_frame((4, 5)), jaxblur.LayeredParameters(), noise=noise)
