"""Reblur: against plain loops, what it keeps, what it mixes, and its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import metrics
from jaxblur.posts import ReblurParameters, reblur
from tests.helpers import SHAPES, check_gradients, random_frame

from .reference import posts_loops


@pytest.mark.parametrize("backend", ["auto", "xla"])
@pytest.mark.parametrize("shape", SHAPES)
def test_it_equals_the_plain_loops(shape, backend):
    frame = random_frame(shape, speed=8.0)
    image = np.random.default_rng(1).random((*shape, 3)).astype(np.float32)
    wide = ReblurParameters(shortest=2.0, alike=1.5, surface=0.6, noise=0.5)
    expected = image
    for parameters in (ReblurParameters(), wide):
        expected = posts_loops.reblur(image, frame, parameters)
        actual = reblur(image, frame, parameters, backend=backend)
        assert actual.dtype == jnp.float32
        np.testing.assert_allclose(actual, expected, rtol=1e-4, atol=1e-5)
    if min(shape) > 3:
        assert np.abs(expected - image).max() > 0.01


def pan(x, y, depth=2.0, shape=(12, 14)):
    velocity = np.broadcast_to(np.array([x, y], np.float32), (*shape, 2))
    return jaxblur.Frame(jnp.zeros((*shape, 1)), jnp.full(shape, depth), jnp.asarray(velocity))


def test_three_pixels_along_the_motion_are_mixed():
    image = np.zeros((12, 14, 1), np.float32)
    image[6, 7] = 3.0
    alike = ReblurParameters(noise=np.inf)
    across = np.asarray(reblur(image, pan(9, 0), alike))[..., 0]
    np.testing.assert_allclose(across[6, 6:9], 1, rtol=1e-6)
    assert across.sum() == pytest.approx(3)
    down = np.asarray(reblur(image, pan(0, 9), alike))[..., 0]
    np.testing.assert_allclose(down[5:8, 7], 1, rtol=1e-6)
    # What differs by more than noise is picture.
    np.testing.assert_allclose(reblur(image, pan(9, 0)), image, atol=1e-6)


@pytest.mark.parametrize("depth", [2.0, np.inf])
def test_what_rests_keeps_its_bits_and_sky_is_one_surface(depth):
    image = np.random.default_rng(0).random((12, 14, 3)).astype(np.float32)
    np.testing.assert_array_equal(reblur(image, pan(3, 0, depth)), image)
    moved = np.asarray(reblur(image, pan(8, 0, depth), ReblurParameters(noise=9.0)))
    assert np.isfinite(moved).all() and np.abs(moved - image).max() > 0.1


def test_other_surfaces_and_motions_are_not_mixed():
    shape = (12, 14)
    left = np.arange(14) < 7
    image = np.where(left, 0.0, 1.0)[None, :, None] * np.ones((*shape, 1), np.float32)
    alike = ReblurParameters(noise=np.inf)
    depth = jnp.where(left, 2.0, 3.0) * jnp.ones(shape)
    two = pan(9, 0).replace(depth=depth)
    np.testing.assert_array_equal(reblur(image, two, alike), image)
    velocity = jnp.where(left[None, :, None], jnp.array([9.0, 0]), jnp.array([-9.0, 0]))
    apart = pan(9, 0).replace(velocity=jnp.broadcast_to(velocity, (*shape, 2)))
    np.testing.assert_array_equal(reblur(image, apart, alike), image)
    assert np.abs(np.asarray(reblur(image, pan(9, 0), alike)) - image).max() > 0.3


def test_it_removes_noise_from_a_blur():
    generator = np.random.default_rng(4)
    # A texture that has moved by 21 px to the right, and grain.
    texture = generator.random((30, 80, 3)) ** 2
    truth = np.mean([np.roll(texture, shift, 1) for shift in range(21)], axis=0)
    noisy = np.maximum(truth + 0.02 * generator.normal(size=truth.shape), 0)
    clean = reblur(noisy.astype(np.float32), pan(10.5, 0, shape=(30, 80)))
    errors = [float(metrics.psnr(image, truth)) for image in (noisy, clean)]
    assert errors[1] > errors[0] + 2


def test_gradients_equal_finite_differences():
    with jax.enable_x64(True):
        frame = random_frame((5, 6), speed=9.0)
        velocity = np.asarray(frame.velocity, float)
        image = np.random.default_rng(2).random((5, 6, 2)) + 0.1

        def run(image, noise, velocity):
            parameters = ReblurParameters(shortest=0.5, alike=9.0, surface=0.9, noise=noise)
            moved = frame.replace(velocity=velocity)
            return reblur(image, moved, parameters, backend="xla")

        check_gradients(run, image, 0.4, velocity)


def test_vmap_equals_a_loop():
    frame = random_frame((8, 9), speed=8.0)
    images = jnp.asarray(np.random.default_rng(3).random((2, 8, 9, 3)), jnp.float32)
    together = jax.vmap(lambda image: reblur(image, frame))(images)
    for image, made in zip(images, together, strict=True):
        np.testing.assert_allclose(reblur(image, frame), made, atol=1e-6)


def test_refusals():
    with pytest.raises(ValueError, match="`frame` must be as large as `image`"):
        reblur(np.zeros((4, 5, 3)), pan(1, 1))
    with pytest.raises(ValueError, match=r"`parameters\.noise` must be a scalar"):
        reblur(np.zeros((12, 14, 3)), pan(1, 1), ReblurParameters(noise=jnp.ones((12, 14))))
