"""Metrics: hand-checked values, independent twins, derivatives, kinks, the published table."""

import doctest

import flip_evaluator
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy import ndimage

from jaxblur import exr, metrics
from jaxblur.frame import Frame
from jaxblur.metrics import errors, images
from jaxblur.metrics.color_video_vdp import display as displays, metric

LOSSES = {
    "mse": metrics.mse,
    "psnr": metrics.psnr,
    "relative_mse": metrics.relative_mse,
    "smape": metrics.smape,
    "ssim": metrics.ssim,
}


def pair(shape=(17, 23, 3), dtype=jnp.float32, seed=0):
    generator = np.random.default_rng(seed)
    truth = generator.uniform(0.1, 0.9, shape)
    image = np.clip(truth + generator.normal(scale=0.05, size=shape), 0, 1)
    return jnp.asarray(image, dtype), jnp.asarray(truth, dtype)


def left_half(image):
    return np.arange(image.shape[1])[None, :].repeat(image.shape[0], 0) < image.shape[1] // 2


@pytest.mark.parametrize("module", [errors, metric, displays], ids=lambda module: module.__name__)
def test_docstring_examples_hold(module):
    result = doctest.testmod(module)
    assert result.attempted > 0
    assert result.failed == 0


def test_display_drops_alpha_clips_and_makes_gray_of_one_channel():
    image = np.full((2, 3, 4), 0.5, np.float32)
    image[0, 0] = [7.0, -1.0, 0.0, 0.25]
    shown = metrics.display(image)
    assert shown.shape == (2, 3, 3)
    np.testing.assert_array_equal(shown[0, 0], [1.0, 0.0, 0.0])
    gray = metrics.display(image[..., :1])
    np.testing.assert_array_equal(gray[..., 0], gray[..., 2])
    with pytest.raises(
        ValueError, match=r"`image` must .* 1 or at least 3 channels, .*\(2, 3, 2\)"
    ):
        metrics.display(image[..., :2])


def test_psnr_of_a_constant_difference():
    truth = np.full((3, 5, 3), 0.5, np.float32)
    np.testing.assert_allclose(metrics.psnr(truth + 0.01, truth), 40.0, atol=1e-3)
    np.testing.assert_allclose(metrics.psnr(truth + 0.01, truth, peak=10.0), 60.0, atol=1e-3)


def test_relative_mse_and_smape_of_one_pixel():
    image, truth = np.full((1, 1, 1), 3.0, np.float32), np.full((1, 1, 1), 1.0, np.float32)
    np.testing.assert_allclose(metrics.relative_mse(image, truth), 4 / 1.01, rtol=1e-6)
    np.testing.assert_allclose(metrics.smape(image, truth), 2 / 4.01, rtol=1e-6)


def ssim_twin(image, truth):
    """scikit-image's structural_similarity with Gaussian weights, in NumPy and SciPy, float64."""
    image, truth = np.asarray(image, np.float64), np.asarray(truth, np.float64)

    def blurred(values):
        return np.stack(
            [ndimage.gaussian_filter(values[..., c], 1.5, truncate=3.5) for c in range(3)], -1
        )

    mean_a, mean_b = blurred(image), blurred(truth)
    variance_a = blurred(image**2) - mean_a**2
    variance_b = blurred(truth**2) - mean_b**2
    covariance = blurred(image * truth) - mean_a * mean_b
    numerator = (2 * mean_a * mean_b + 0.01**2) * (2 * covariance + 0.03**2)
    denominator = (mean_a**2 + mean_b**2 + 0.01**2) * (variance_a + variance_b + 0.03**2)
    return numerator / denominator


@pytest.mark.parametrize("shape", [(11, 11, 3), (17, 30, 3)])
def test_ssim_equals_its_twin(shape):
    image, truth = pair(shape)
    similarity = ssim_twin(image, truth)
    np.testing.assert_allclose(metrics.ssim(image, truth), similarity[5:-5, 5:-5].mean(), atol=2e-6)


def test_ssim_with_a_mask_counts_the_pixels_of_the_mask():
    image, truth = pair()
    mask = left_half(image)
    expected = ssim_twin(image, truth)[5:-5, 5:-5][mask[5:-5, 5:-5]].mean()
    np.testing.assert_allclose(metrics.ssim(image, truth, mask), expected, atol=2e-6)


def test_ssim_refuses_images_smaller_than_its_window():
    with pytest.raises(ValueError, match=r"`image` must have at least 11 rows .* \(10, 20\)"):
        metrics.ssim(*pair((10, 20, 3)))


def test_differing_shapes_are_rejected_instead_of_broadcast():
    # The tests' type checker rejects them before the public functions do.
    image, truth = pair((12, 20, 3))
    with pytest.raises(ValueError, match=r"one shape, got \(12, 20, 3\) and \(12, 20, 1\)"):
        images.of_one_shape(image, truth[..., :1])


@pytest.mark.parametrize("name", ["mse", "psnr", "relative_mse", "smape"])
def test_a_mask_equals_cropping(name):
    image, truth = pair()
    half = image.shape[1] // 2
    np.testing.assert_allclose(
        LOSSES[name](image, truth, mask=left_half(image)),
        LOSSES[name](image[:, :half], truth[:, :half]),
        rtol=1e-6,
    )


@pytest.mark.parametrize("name", LOSSES)
def test_jit_equals_eager_and_float32_stays(name):
    image, truth = pair()
    eager = LOSSES[name](image, truth)
    assert eager.dtype == jnp.float32
    np.testing.assert_allclose(jax.jit(LOSSES[name])(image, truth), eager, rtol=1e-5)


@pytest.mark.parametrize("name", LOSSES)
def test_vmap_equals_a_loop(name):
    pairs = [pair(seed=seed) for seed in range(3)]
    images, truths = (jnp.stack(arrays) for arrays in zip(*pairs, strict=True))
    looped = [LOSSES[name](*both) for both in pairs]
    np.testing.assert_allclose(jax.vmap(LOSSES[name])(images, truths), looped, rtol=1e-5)


@pytest.mark.parametrize("name", LOSSES)
def test_derivatives_match_finite_differences(name):
    with jax.enable_x64(True):
        image, truth = pair((11, 12, 3), jnp.float64)
        # SSIM has kinks (sign and minimum of the covariance) that random windows do not hit.
        check_grads(LOSSES[name], (image, truth), order=1, modes=("fwd", "rev"))


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.parametrize("value", [0.0, 0.5])
def test_equal_images_have_finite_derivatives(name, value):
    image = jnp.full((12, 13, 3), value)
    gradient = jax.grad(LOSSES[name])(image, image)
    assert np.isfinite(gradient).all()
    # Rounding of variances near 0 leaves SSIM with a derivative of up to 3e-4 here.
    np.testing.assert_allclose(gradient, 0, atol=1e-3)


def test_equal_images_have_the_ideal_values():
    image, _ = pair()
    assert metrics.psnr(image, image) == np.inf
    assert metrics.smape(image, image) == 0
    np.testing.assert_allclose(metrics.ssim(image, image), 1, atol=1e-6)
    assert metrics.flip(image, image) == 0


def test_flip_passes_display_values_in_the_right_order():
    image, truth = pair((20, 30, 3))
    expected, mean, _ = flip_evaluator.evaluate(
        np.array(truth), np.array(image), "LDR", applyMagma=False, parameters={"ppd": 67}
    )
    np.testing.assert_array_equal(metrics.flip_map(image, truth), expected[..., 0])
    assert metrics.flip(image, truth) == pytest.approx(mean, rel=1e-5)
    assert 0 < metrics.flip(image, truth) < 1


def test_flip_follows_the_viewer_and_the_range():
    image, truth = pair((20, 30, 3))
    assert metrics.flip(image, truth, pixels_per_degree=20.0) != metrics.flip(image, truth)
    bright = 30 * np.asarray(truth)
    assert metrics.flip(bright * 1.5, bright, hdr=True) > 0.01


def test_flip_with_a_mask_averages_its_map():
    image, truth = pair((20, 30, 3))
    mask = left_half(image)
    expected = metrics.flip_map(image, truth)[mask].mean()
    assert metrics.flip(image, truth, mask) == pytest.approx(float(expected))


@pytest.mark.parametrize(
    ("values", "hdr", "message"),
    [
        (1.5, False, r"`image` must lie in \[0, 1\], got .* 1\.5; apply `metrics\.display`"),
        (-0.5, True, r"`image` must lie in \[0, inf\], got -0\.5 .*; clamp it"),
        (np.nan, False, r"`image` must be finite, got 1 NaN .* row 3, column 4"),
    ],
)
def test_flip_refuses_values_out_of_range(values, hdr, message):
    truth = np.full((12, 12, 3), 0.5, np.float32)
    image = truth.copy()
    image[3, 4, 1] = values
    with pytest.raises(ValueError, match=message):
        metrics.flip(image, truth, hdr=hdr)


def test_flip_refuses_alpha():
    truth = np.full((12, 12, 4), 0.5, np.float32)
    with pytest.raises(ValueError, match=r"must both have shape .* \(12, 12, 4\)"):
        metrics.flip(truth, truth)


def test_temporal_error_ignores_static_errors():
    truths = np.random.default_rng(0).random((3, 4, 5, 3)).astype(np.float32)
    constant = np.random.default_rng(1).random((4, 5, 3)).astype(np.float32)
    np.testing.assert_allclose(
        metrics.temporal_difference_error(truths + constant, truths), 0, atol=1e-6
    )
    flicker = truths + np.array([0.0, 0.3, 0.3], np.float32)[:, None, None, None]
    error = metrics.temporal_difference_error(flicker, truths)
    np.testing.assert_allclose(error, [0.3, 0.0], atol=1e-6)


def test_temporal_error_is_differentiable_without_error_too():
    truths = jnp.ones((2, 3, 3, 1))
    total = lambda images: metrics.temporal_difference_error(images, truths).sum()  # noqa: E731
    np.testing.assert_array_equal(jax.grad(total)(truths), 0)
    with jax.enable_x64(True):
        images = jnp.asarray(np.random.default_rng(0).random((3, 4, 5, 2)))
        check_grads(
            lambda images: metrics.temporal_difference_error(images, images[::-1] ** 2),
            (images,),
            order=1,
        )


def test_temporal_error_refuses_one_frame():
    with pytest.raises(ValueError, match="`images` must hold at least 2 frames, got 1"):
        metrics.temporal_difference_error(*2 * [np.ones((1, 2, 2, 3), np.float32)])


def test_compare_works_on_linear_light():
    image, truth = pair()
    scores = metrics.compare(image, truth)
    shown, expected = metrics.display(image), metrics.display(truth)
    assert scores.psnr == pytest.approx(float(metrics.psnr(shown, expected)))
    assert scores.ssim == pytest.approx(float(metrics.ssim(shown, expected)))
    assert scores.flip == pytest.approx(metrics.flip(shown, expected))


def test_compare_refuses_an_empty_mask():
    image, truth = pair()
    with pytest.raises(ValueError, match="`mask` must hold at least one pixel"):
        metrics.compare(image, truth, np.zeros(image.shape[:2], bool))


def frame_of(velocity, path=None):
    buffers = (np.zeros((*velocity.shape[:2], 1)), np.ones(velocity.shape[:2]), velocity)
    return Frame(
        *(jnp.asarray(buffer, jnp.float32) for buffer in buffers),
        path=None if path is None else jnp.asarray(path, jnp.float32),
    )


def test_footprint_is_the_path_of_a_moving_pixel():
    velocity = np.zeros((9, 12, 2))
    velocity[4, 5] = [3.0, -1.0]
    expected = np.zeros((9, 12), bool)
    for row, column in [(5, 2), (5, 3), (4, 4), (4, 5), (4, 6), (3, 7), (3, 8)]:
        expected[row, column] = True
    swept = metrics.motion_footprint(frame_of(velocity), margin=0)
    assert swept[expected].all()
    np.testing.assert_array_equal(swept & ndimage.binary_dilation(expected), swept)
    np.testing.assert_array_equal(
        metrics.motion_footprint(frame_of(velocity)),
        ndimage.binary_dilation(swept, iterations=2),
    )


def test_footprint_leaves_slow_points_out_and_stops_at_the_border():
    velocity = np.zeros((9, 12, 2))
    velocity[...] = 0.3
    assert not metrics.motion_footprint(frame_of(velocity)).any()
    velocity[0, 0] = [-50.0, 0.0]
    swept = metrics.motion_footprint(frame_of(velocity), margin=0)
    assert swept[0].all() and not swept[1:].any()


def test_footprint_follows_curved_paths():
    velocity = np.zeros((9, 12, 2))
    path = np.zeros((9, 12, 2, 2))
    path[4, 5] = [[3.0, 0.0], [0.0, 3.0]]
    velocity[4, 5] = (path[4, 5, 1] - path[4, 5, 0]) / 2
    swept = metrics.motion_footprint(frame_of(velocity, path), margin=0)
    expected = np.zeros((9, 12), bool)
    expected[4, 5:9] = expected[4:8, 5] = True
    np.testing.assert_array_equal(swept, expected)


def read_planes(path, *endings):
    """Stack the channels whose full names end in the given ways."""
    names = exr.inspect(path).channel_names
    return exr.read_channels(
        path, [next(name for name in names if name.endswith(ending)) for ending in endings]
    )


# Measured by the authors of the renders with their own code: whole frame sharp and Vector Blur,
# blur footprint sharp and Vector Blur.
PUBLISHED_PSNR = {
    "cube_over_crates": (26.64, 38.10, 15.85, 30.03),
    "falling_cubes": (24.72, 33.07, 19.31, 28.39),
    "flagpole": (23.66, 33.97, 23.26, 33.57),
    "sky_car": (27.26, 28.10, 21.93, 22.84),
}


@pytest.mark.parametrize("scene", PUBLISHED_PSNR)
def test_the_published_psnr_of_rendered_scenes_is_reproduced(reference_data, scene):
    folder = reference_data / scene
    rgb = ("Combined.R", "Combined.G", "Combined.B")
    sharp, blurred, truth = (
        read_planes(folder / f"{name}_0011.exr", *rgb) for name in ("frame", "vectorblur", "truth")
    )
    vector = read_planes(folder / "gbuf_0011.exr", "Vector.X", "Vector.Y", "Vector.Z", "Vector.W")
    # Displacements to the opening and closing of a shutter of half a frame, y down.
    path = (vector * [0.25, -0.25, -0.25, 0.25]).reshape(*vector.shape[:2], 2, 2)
    footprint = metrics.motion_footprint(frame_of((path[..., 1, :] - path[..., 0, :]) / 2, path))
    expected = metrics.display(truth)
    measured = [
        float(metrics.psnr(metrics.display(image), expected, mask=mask))
        for mask in (None, footprint)
        for image in (sharp, blurred)
    ]
    np.testing.assert_allclose(measured, PUBLISHED_PSNR[scene], atol=0.015)


def test_whole_numbers_do_not_wrap_around():
    # The tests' type checker rejects them before the public functions do.
    low, high = np.full((2, 12, 12, 3), [[[[100]]], [[[200]]]], np.uint8)
    image, truth = images.of_one_shape(low, high)
    assert image.dtype == truth.dtype == np.float32
    assert metrics.psnr(image, truth, peak=255.0) == pytest.approx(20 * np.log10(2.55), rel=1e-6)


def test_a_mask_of_another_size_is_rejected():
    with pytest.raises(ValueError, match=r"size of the images, \(12, 20\), got \(20, 12\)"):
        images.masked_mean(jnp.ones((12, 20, 3)), np.ones((20, 12), bool))
