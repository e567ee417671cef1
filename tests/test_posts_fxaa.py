"""FXAA: against plain loops, on edges by hand, with the hint, and its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.posts import FXAAParameters, fxaa, perceived_luma

from .helpers import SHAPES, check_gradients, random_frame, random_noise
from .reference import posts_loops


def half_plane(shape=(40, 56), slope=0.15, colors=((0, 0, 0), (1, 0.5, 2))):
    """Two colors on either side of a slanted line, a pixel of one or of the other."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    below = (y - shape[0] / 2 > slope * (x - shape[1] / 2))[..., None]
    return np.where(below, np.float32(colors[1]), np.float32(colors[0]))


def covered(shape=(40, 56), slope=0.15, colors=((0, 0, 0), (1, 0.5, 2)), fine=16):
    """The same by area."""
    offsets = (np.arange(fine) + 0.5) / fine - 0.5
    y, x = np.mgrid[: shape[0], : shape[1]]
    share = np.mean(
        [y + v - shape[0] / 2 > slope * (x + u - shape[1] / 2) for v in offsets for u in offsets],
        axis=0,
    )[..., None]
    return share * np.float32(colors[1]) + (1 - share) * np.float32(colors[0])


@pytest.mark.parametrize("backend", ["auto", "xla"])
@pytest.mark.parametrize("shape", SHAPES)
def test_it_equals_the_plain_loops(shape, backend):
    image = np.random.default_rng(3).random((*shape, 3)).astype(np.float32)
    image[shape[0] // 2 :, : shape[1] // 2] *= 8
    expected = posts_loops.fxaa(image)
    actual = fxaa(image, backend=backend)
    assert actual.dtype == jnp.float32
    np.testing.assert_allclose(actual, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("quality", [12, 29, 39])
@pytest.mark.parametrize("transposed", [False, True])
def test_long_edges_equal_the_plain_loops(quality, transposed):
    image = half_plane(slope=0.05)
    if transposed:
        image = image.swapaxes(0, 1)
    expected = posts_loops.fxaa(image, quality=quality)
    np.testing.assert_allclose(fxaa(image, quality=quality), expected, atol=1e-5)


def test_thresholds_and_strength_equal_the_plain_loops():
    image = np.random.default_rng(5).random((15, 22, 3)).astype(np.float32)
    parameters = FXAAParameters(subpixel=0.3, threshold=0.3, threshold_min=0.2)
    expected = posts_loops.fxaa(image, subpixel=0.3, threshold=0.3, threshold_min=0.2)
    np.testing.assert_allclose(fxaa(image, parameters=parameters), expected, atol=1e-5)


def test_a_slanted_edge_comes_near_its_coverage():
    def error(image):
        return float(np.sqrt(np.mean((np.asarray(image) - covered()) ** 2)))

    assert error(fxaa(half_plane())) < 0.6 * error(half_plane())


def test_what_has_no_edge_stays_bit_for_bit():
    image = 0.5 + 0.01 * np.random.default_rng(0).random((20, 30, 4)).astype(np.float32)
    assert np.array_equal(fxaa(image), image)


def test_a_step_by_hand():
    """An edge of which the one end is near and the other beyond the search."""
    image = np.zeros((9, 30, 1), np.float32)
    image[4:, :] = 1
    image[3, 15:] = 1
    row = np.asarray(fxaa(image, parameters=FXAAParameters(subpixel=0)))[3, :, 0]
    # From column 14 the ends are 1 px to the right and beyond the search's 26.5 px to the left.
    assert row[14] == pytest.approx(0.5 - 1 / 27.5, abs=1e-6)
    assert row[12] == pytest.approx(0.5 - 3 / 29.5, abs=1e-6)


def test_the_hint_smooths_what_moves_and_nothing_else():
    rng = np.random.default_rng(2)
    frame = random_frame((32, 48), speed=0, sky=0, still=1)
    velocity = np.zeros((32, 48, 2), np.float32)
    velocity[:, 32:] = (9, 0)
    color = 0.5 + 0.03 * rng.standard_normal((32, 48, 3)).astype(np.float32)
    frame = frame.replace(color=color, velocity=velocity, depth=np.ones((32, 48), np.float32))
    settings = jaxblur.GuertinSettings(radius=12)
    noise = random_noise((32, 48))
    hint = jaxblur.luma_hint(frame, jaxblur.GuertinParameters(), settings=settings, noise=noise)
    plain, hinted = np.asarray(fxaa(color)), np.asarray(fxaa(color, hint))
    assert np.array_equal(plain, color), "noise of 3 % is below the thresholds"
    still = int(np.isin(hint, (0, 1)).any(axis=0).argmax()) - 1
    assert still > 4 and np.array_equal(hinted[:, :still], color[:, :still])
    assert hinted[:, 36:].std() < 0.8 * color[:, 36:].std()


@pytest.mark.slow
def test_derivatives_agree_with_differences():
    with jax.enable_x64(True):
        image = np.random.default_rng(1).random((6, 7, 3))
        hint = np.random.default_rng(2).random((6, 7))

        def run(image, hint, subpixel):
            return fxaa(image, hint, FXAAParameters(subpixel=subpixel), backend="xla")

        check_gradients(run, image, hint, 0.6)
        check_gradients(lambda image: fxaa(image, backend="xla"), image)


@pytest.mark.parametrize("backend", ["auto", "xla"])
def test_derivatives_are_finite_where_nothing_differs(backend):
    flat = np.zeros((8, 9, 3), np.float32)
    for image in (flat, half_plane((8, 9)), -flat - 1, 1e30 * half_plane((8, 9))):
        gradient = jax.grad(lambda i: fxaa(i, backend=backend).mean())(jnp.asarray(image))
        assert np.isfinite(gradient).all()


def test_reverse_is_the_transpose_of_forward_in_native_code():
    image = jnp.asarray(np.random.default_rng(4).random((12, 14, 3)), jnp.float32)
    given = fxaa(image), jax.grad(lambda i: (fxaa(i) ** 2).sum())(image)
    other = jax.grad(lambda i: (fxaa(i, backend="xla") ** 2).sum())(image)
    np.testing.assert_allclose(given[1], other, atol=1e-4)


def test_vmap_equals_a_loop():
    images = np.random.default_rng(4).random((2, 9, 11, 3)).astype(np.float32)
    together = jax.vmap(fxaa)(images)
    for image, result in zip(images, together, strict=True):
        np.testing.assert_allclose(result, fxaa(image), atol=1e-6)


def test_perceived_luma_is_that_of_rec_709_under_a_curve():
    image = np.array([[[1.0, 0, 0], [0, 0, 0], [1, 1, 1], [-3, -3, -3]]], np.float32)
    y = np.array([0.2126, 0, 1, 0])
    expected = np.sqrt(y / (1 + y) + 1 / 1024) - 1 / 32
    np.testing.assert_allclose(perceived_luma(image)[0], expected, rtol=1e-5, atol=1e-6)


def test_refusals():
    image = np.zeros((4, 5, 3), np.float32)
    with pytest.raises(ValueError, match="`quality` must be one of 12, 29, 39"):
        fxaa(image, quality=10)
    with pytest.raises(ValueError, match=r"must be an array, got a Frame; pass frame\.color"):
        fxaa(random_frame((4, 5)))  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="`image` must have shape"):
        fxaa(image[..., 0])
    with pytest.raises(ValueError, match="`hint` must have shape"):
        fxaa(image, image)
    with pytest.raises(ValueError, match="must be FXAAParameters"):
        fxaa(image, parameters=0.5)  # pyright: ignore[reportArgumentType]
