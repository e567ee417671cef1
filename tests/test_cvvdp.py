"""ColorVideoVDP: the package's values, twins of its steps, derivatives, kinks, conventions."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxblur import metrics
from jaxblur.metrics.color_video_vdp import display, metric, pyramid, sensitivity, temporal
from tests.reference import cvvdp_clips

STORED = json.loads(cvvdp_clips.STORED.read_text(encoding="utf-8"))["jod"]
QUICK = ("unblurred", "animated_grain", "fixed_grain", "flicker", "tint", "image_unblurred")
TOLERANCE = 0.002
"""JOD, a fifth of what the documentation promises."""


@pytest.fixture(scope="module")
def pairs():
    return cvvdp_clips.pairs()


def quality(pair):
    return float(
        metrics.cvvdp(
            pair.test,
            pair.reference,
            frames_per_second=pair.frames_per_second,
            display=pair.display,
        )
    )


@pytest.mark.parametrize(
    "name",
    [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in STORED],
)
def test_the_package_is_reproduced(pairs, name):
    assert quality(pairs[name]) == pytest.approx(STORED[name], abs=TOLERANCE)


def test_the_stored_clips_cover_the_scale(pairs):
    assert pairs.keys() == STORED.keys()
    assert sum(pair.test.ndim == 4 for pair in pairs.values()) == 10
    assert min(STORED.values()) < 7
    assert max(STORED.values()) > 9


@pytest.mark.slow
def test_the_stored_values_are_those_of_the_package(pairs):
    pytest.importorskip("pycvvdp", reason="needs `pip install cvvdp`, which brings torch")
    for name in QUICK:
        assert cvvdp_clips.by_the_package(pairs[name]) == pytest.approx(STORED[name], abs=1e-3)


def tiny(dtype=jnp.float32, frames=3):
    generator = np.random.default_rng(4)
    reference = generator.uniform(0.2, 0.8, (frames, 12, 17, 3))
    test = reference + generator.normal(scale=0.05, size=reference.shape)
    return jnp.asarray(test, dtype), jnp.asarray(reference, dtype)


@pytest.mark.slow
def test_derivatives_match_finite_differences():
    with jax.enable_x64(True):
        check_grads(
            lambda test, reference: metrics.cvvdp(test, reference, frames_per_second=12.0),
            tiny(jnp.float64),
            order=1,
            modes=("rev",),
            rtol=1e-4,
        )


def test_equal_clips_have_ten_and_finite_derivatives():
    _, reference = tiny()
    value, slopes = jax.value_and_grad(
        lambda a, b: metrics.cvvdp(a, b, frames_per_second=12.0), argnums=(0, 1)
    )(reference, reference)
    assert float(value) == 10
    for slope in slopes:
        np.testing.assert_allclose(slope, 0, atol=1e-6)


@pytest.mark.slow
def test_descent_leads_to_the_reference():
    test, reference = tiny()
    slope = jax.grad(lambda a: metrics.cvvdp(a, reference, frames_per_second=12.0))(test)
    assert float(jnp.vdot(slope, reference - test)) > 0


def test_a_clip_of_one_frame_is_an_image():
    test, reference = tiny(frames=1)
    image = metrics.cvvdp(test[0], reference[0])
    assert image.dtype == jnp.float32
    assert float(image) == float(metrics.cvvdp(test, reference, frames_per_second=12.0))


def test_vmap_equals_a_loop():
    test, reference = tiny()
    looped = [metrics.cvvdp(*images) for images in zip(test, reference, strict=True)]
    np.testing.assert_allclose(jax.vmap(metrics.cvvdp)(test, reference), looped, atol=1e-5)


def test_a_difference_is_seen_better_from_nearby():
    test, reference = tiny()
    near, far = (
        float(metrics.cvvdp(test[0], reference[0], pixels_per_degree=each))
        for each in (20.0, 150.0)
    )
    assert near < far < 10


@pytest.mark.parametrize("size", [(12, 16), (13, 16), (12, 17), (13, 17)])
def test_reduction_equals_a_loop(size):
    """Mirrored borders; the end of the columns is mirrored by the parity of the rows."""
    planes = np.random.default_rng(0).random(size)

    def halved(line, odd):
        known = [line[1], line[0], *line]
        out = [
            sum(
                weight * known[2 * place + tap]
                for tap, weight in enumerate(pyramid.KERNEL)
                if 2 * place + tap < len(known)
            )
            for place in range((len(line) + 1) // 2)
        ]
        out[-1] += 0.25 * line[-1] + 0.05 * line[-2] if odd else 0.05 * line[-1]
        return out

    odd = size[0] % 2 == 1
    tall = np.array([halved(column, odd) for column in planes.T]).T
    expected = np.array([halved(row, odd) for row in tall])
    np.testing.assert_allclose(pyramid.reduced(jnp.asarray(planes)), expected, rtol=1e-5)


@pytest.mark.parametrize("size", [(12, 16), (13, 17)])
def test_expansion_keeps_constants_and_interpolates_ramps(size):
    half = tuple((side + 1) // 2 for side in size)
    np.testing.assert_allclose(pyramid.expanded(jnp.full(half, 0.7), size), 0.7, rtol=1e-6)
    ramp = jnp.broadcast_to(2.0 * jnp.arange(half[1]), half)
    inner = pyramid.expanded(ramp, size)[0, 2:-3]
    np.testing.assert_allclose(inner, np.arange(2, size[1] - 3), rtol=1e-5)


def test_bands_end_at_the_coarsest_that_fits():
    np.testing.assert_allclose(
        pyramid.band_frequencies((96, 128), 60.0), [30, 9.684, 4.842, 2.421, 1.2105, 0.1]
    )
    assert pyramid.band_frequencies((4, 9), 60.0).tolist() == [30, 0.1]
    # 0.3228 * 30 / 2^6 = 0.151 is the first below 0.2 cycles per degree.
    assert len(pyramid.band_frequencies((4000, 4000), 60.0)) == 9


def test_white_has_the_luminance_of_the_display_and_no_color():
    """L + M of white is 1.051 times its luminance by the matrices of the model."""
    screen = metrics.DISPLAYS["standard_4k"]
    white = display.opponent_channels(jnp.ones((1, 1, 3)), screen)[:, 0, 0]
    assert float(white[0]) == pytest.approx(1.051 * (200 + 250 * 0.005 / np.pi), rel=1e-3)
    np.testing.assert_allclose(white[1:] / white[0], 0, atol=0.01)
    red = display.opponent_channels(jnp.asarray([[[1.0, 0, 0]]]), screen)[:, 0, 0]
    assert red[1] > 0 > red[2]


def test_hdr_pixels_are_light():
    screen = metrics.nits_display(1000.0, 0.01, 60.0)
    channels = display.opponent_channels(jnp.full((1, 2, 3), 300.0).at[0, 1].set(5000), screen)
    np.testing.assert_allclose(channels[0, 0], [1.051 * 300, 1.051 * 1000], rtol=1e-3)


def test_sustained_filters_keep_what_stands_still_and_the_transient_does_not():
    sums = temporal.temporal_filters(24.0).sum(axis=1)
    np.testing.assert_allclose(sums[:3], 1, rtol=1e-6)
    assert abs(sums[3]) < 1e-3
    assert temporal.temporal_filters(24.0).shape == (4, 7)
    assert temporal.temporal_filters(60.0).shape == (4, 17)


def test_sensitivity_is_that_of_the_table():
    """At a node: 10^table, less 0.28 dB; beyond the table its end holds."""
    found = sensitivity.sensitivity(0.1, jnp.log10(jnp.asarray([[0.005, 1e-4]])), 4)
    logarithms = np.array([0.5404148, 0.4612012, 0.05930849, 0.2157486])
    expected = 10 ** (logarithms - 0.2797423 / 20)
    np.testing.assert_allclose(found[:, 0, 0], expected, rtol=1e-4)
    np.testing.assert_allclose(found[:, 0, 1], expected, rtol=1e-4)


@pytest.mark.parametrize(
    ("shape", "options", "message"),
    [
        ((2, 8, 8, 3), {}, "`frames_per_second` must be positive for a clip, got None"),
        ((2, 8, 8, 3), {"frames_per_second": 0.0}, "must be positive for a clip, got 0.0"),
        ((8, 8, 3), {"display": "my_tv"}, "`display` must be one of standard_4k, .* 'my_tv'"),
        ((8, 8, 3), {"pixels_per_degree": -1.0}, "`pixels_per_degree` must be positive, got -1"),
        ((3, 8, 3), {}, r"`test` must have shape .* at least 4, got \(3, 8, 3\)"),
    ],
)
def test_errors_name_the_argument(shape, options, message):
    image = np.full(shape, 0.5, np.float32)
    with pytest.raises(ValueError, match=message):
        metrics.cvvdp(image, image, **options)


def test_differing_shapes_are_rejected():
    # The tests' type checker rejects them before the public function does.
    with pytest.raises(ValueError, match=r"one shape, got \(8, 8, 3\) and \(8, 9, 3\)"):
        metric.check_shapes((8, 8, 3), (8, 9, 3))
