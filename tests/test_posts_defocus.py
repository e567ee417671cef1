"""Defocus: the formula of the disc, how near and far spread, derivatives, and truth."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import scenes
from jaxblur.posts import PRESETS, Lens, circle_of_confusion, defocus

from .helpers import random_frame, random_noise
from .reference import posts_loops

LENS = Lens(focus=3.0, f_number=2.0, focal_length=50.0, sensor_width=36.0)


def spreading(pixels, focus=3.0, width=40):
    """A lens whose disc at infinity has a radius of so many pixels."""
    return Lens(
        focus, f_number=LENS.f_number * _at_infinity(focus, width) / pixels, focal_length=50
    )


def _at_infinity(focus, width):
    return float(Lens(focus, LENS.f_number, 50.0).radius_at_infinity(width))


def two_planes(near, far, shape=(24, 40), split=20, colors=(1.0, 0.0)):
    """A near plane on the left, a far one on the right."""
    left = np.arange(shape[1]) < split
    depth = np.broadcast_to(np.where(left, near, far), shape).astype(np.float32)
    color = np.broadcast_to(np.where(left, *colors)[:, None], (*shape, 3)).astype(np.float32)
    return jaxblur.Frame(color, depth, np.zeros((*shape, 2), np.float32))


def test_the_disc_by_hand():
    """50 mm at f/2 focused at 3 m: a point at 6 m gets a disc of 25 (50 / 2950) / 2 mm."""
    frame = random_frame((1, 3), sky=0).replace(depth=np.array([[6.0, 3.0, np.inf]], np.float32))
    at_infinity = 25 * 50 / 2950 / 2 / 36 * 3
    disc = circle_of_confusion(frame, LENS)
    np.testing.assert_allclose(disc, [[at_infinity / 2, 0, at_infinity]], rtol=1e-6)
    near = frame.replace(depth=np.full((1, 3), 1.5, np.float32))
    np.testing.assert_allclose(circle_of_confusion(near, LENS), -at_infinity, rtol=1e-6)


def test_an_aperture_and_an_angle_of_view_make_the_lens_of_the_truth():
    lens = Lens.of_aperture(0.02, 4.0, 1.2)
    assert float(lens.aperture_radius) == pytest.approx(0.02)
    # radius f |1 / F - 1 / z|, the f of the pinhole in pixels.
    assert float(lens.radius_at_infinity(100)) == pytest.approx(0.02 * 120 / 4, rel=1e-6)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_lenses(name):
    Lens.preset(name, 2.0).check()


@pytest.mark.parametrize("backend", ["auto", "xla"])
@pytest.mark.parametrize("shape", [(13, 17), (24, 32), (1, 9), (1, 1)])
def test_it_equals_the_plain_loops(shape, backend):
    frame, noise = random_frame(shape), random_noise(shape)
    lens = spreading(5.0, width=shape[1])
    given = {"samples": 17, "radius": 6, "extent": 0.2}
    actual = defocus(frame, lens, noise=noise, backend=backend, **given)
    disc = np.asarray(circle_of_confusion(frame, lens), float)
    expected = posts_loops.defocus(frame.color, frame.depth, disc, noise.tap, **given)
    assert actual.dtype == jnp.float32
    np.testing.assert_allclose(actual, expected, atol=2e-5)


def test_a_constant_image_stays():
    frame = random_frame((30, 40)).replace(color=np.full((30, 40, 3), 0.7, np.float32))
    np.testing.assert_allclose(defocus(frame, spreading(9.0)), 0.7, rtol=1e-5)


def test_in_focus_everything_stays_bit_for_bit():
    frame = random_frame((30, 40)).replace(depth=np.full((30, 40), 3.0, np.float32))
    assert np.array_equal(defocus(frame, spreading(9.0)), frame.color)


def test_the_far_side_does_not_spread_over_what_is_in_focus():
    frame = two_planes(3.0, 30.0)
    result = np.asarray(defocus(frame, spreading(6.0)))
    assert np.array_equal(result[:, :20], frame.color[:, :20])
    # Nor does what is in focus spread over the far side.
    np.testing.assert_allclose(result[:, 20:], 0, atol=1e-6)


def test_the_near_side_spreads_over_what_is_in_focus():
    frame = two_planes(1.5, 3.0)
    result = np.asarray(defocus(frame, spreading(6.0), samples=512))[12, :, 0]
    # A disc of 6 px covers half of a pixel at its center's side, and nothing 6 px away.
    offset = (np.arange(40) - 19.5) / 6
    inside = np.clip(offset, -1, 1)
    share = 0.5 - (inside * np.sqrt(1 - inside**2) + np.arcsin(inside)) / np.pi
    np.testing.assert_allclose(result, share, atol=0.05)


def test_a_point_becomes_a_disc_of_the_same_light():
    """A far point before farther darkness: its light is spread, and none is lost."""
    shape = (41, 41)
    color = np.zeros((*shape, 1), np.float32)
    color[20, 20] = 100
    frame = jaxblur.Frame(color, np.full(shape, 30.0, np.float32), np.zeros((*shape, 2)))
    lens = spreading(5 / 0.9, width=41)
    result = np.asarray(defocus(frame, lens, samples=1024))[..., 0]
    assert result.sum() == pytest.approx(100, rel=0.05)
    assert result[20, 24] == pytest.approx(100 / (np.pi * 25), rel=0.3)
    assert result[20, 27] == 0


def test_masked_pixels_are_left_out():
    frame = two_planes(30.0, 30.0, colors=(0.5, 0.5))
    color = np.array(frame.color)
    color[10:12, 15:18] = 1e6
    valid = np.ones(frame.depth.shape, bool)
    valid[10:12, 15:18] = False
    result = defocus(frame.replace(color=color, valid=valid), spreading(6.0))
    np.testing.assert_allclose(result, 0.5, rtol=1e-3)


def smooth_frame(shape=(24, 32)):
    y, x = np.mgrid[: shape[0], : shape[1]]
    color = np.stack([np.sin(x / 3) + 1, np.cos(y / 4) + 1, np.sin((x + y) / 5) + 1], -1)
    depth = np.where(x < shape[1] // 2, 1.6 + y / 60, 5 + x / 20)
    return jaxblur.Frame(color, depth, np.zeros((*shape, 2)))


def test_derivatives_in_the_lens_agree_with_differences():
    with jax.enable_x64(True):
        frame, lens = smooth_frame(), jax.tree.map(float, spreading(5.0, width=32))

        @jax.jit
        def loss(lens):
            return jnp.mean(defocus(frame, lens, samples=256, backend="xla") ** 2)

        gradient = jax.jit(jax.grad(loss))(lens)
        for name in ("focus", "f_number", "focal_length"):
            value = getattr(lens, name)
            ends = [dataclasses.replace(lens, **{name: value * k}) for k in (0.97, 1.03)]
            difference = float(loss(ends[1]) - loss(ends[0])) / (0.06 * value)
            assert float(getattr(gradient, name)) == pytest.approx(difference, rel=0.1), name


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["auto", "xla"])
def test_derivatives_are_finite(backend):
    frame = random_frame((12, 15))

    def loss(color, depth, lens):
        return (defocus(frame.replace(color=color, depth=depth), lens, backend=backend) ** 2).sum()

    for lens in (spreading(8.0, width=15), Lens(1e6), spreading(1e-6)):
        inputs = frame.color, frame.depth, jax.tree.map(float, lens)
        leaves = jax.tree.leaves(jax.jit(jax.grad(loss, (0, 1, 2)))(*inputs))
        assert all(np.isfinite(leaf).all() for leaf in leaves)


@pytest.mark.slow
def test_reverse_in_native_code_equals_that_of_xla():
    frame = random_frame((12, 15))

    def loss(color, backend):
        changed = frame.replace(color=color)
        return (defocus(changed, spreading(5.0, width=15), backend=backend) ** 2).sum()

    native, xla = (jax.grad(loss)(frame.color, backend) for backend in ("auto", "xla"))
    np.testing.assert_allclose(native, xla, rtol=1e-3, atol=1e-4)


SIZE = (48, 64)


@pytest.fixture(scope="module")
def wheels():
    scene = scenes.SCENES["wheels_at_three_depths"]()
    return scene, scenes.render(scene, 0, 0, SIZE)


@pytest.mark.slow
def test_it_comes_near_the_truth_through_a_lens(wheels):
    scene, frame = wheels
    focus, radius = 7.5, 0.3
    lens = Lens.of_aperture(radius, focus, float(scene.world.camera.focal))
    truth = scenes.accumulate(scene, 0, 0, 128, SIZE, lens=scenes.ThinLens(radius, focus))

    def error(image):
        return float(jnp.sqrt(jnp.mean((image - truth) ** 2)))

    assert error(defocus(frame, lens)) < 0.6 * error(frame.color)


@pytest.mark.slow
def test_the_truth_through_a_lens(wheels):
    scene, frame = wheels
    pinhole = scenes.accumulate(scene, 0, 0, 16, SIZE)
    closed = scenes.accumulate(scene, 0, 0, 16, SIZE, lens=scenes.ThinLens(0.0, 5.0))
    np.testing.assert_allclose(closed, pinhole, atol=1e-6)
    far = float(frame.depth[0, 0])
    lens = scenes.ThinLens(0.2, far)
    points = lens.points(64)
    assert np.abs(points.mean(axis=0)).max() < 1e-12
    assert np.hypot(*points.T).max() < 0.2 * 1.1
    # What is in the plane of focus stays: the corner of the wall.
    opened = scenes.accumulate(scene, 0, 0, 64, SIZE, lens=lens)
    sharp = scenes.accumulate(scene, 0, 0, 64, SIZE)
    np.testing.assert_allclose(opened[:4, :4], sharp[:4, :4], atol=0.02)
    assert np.abs(opened - sharp).max() > 0.1


def test_refusals():
    frame = random_frame((4, 5))
    with pytest.raises(ValueError, match=r"`lens` must be a jaxblur\.posts\.Lens"):
        defocus(frame, 2.0)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"`lens\.f_number` must be a finite number above 0"):
        defocus(frame, Lens(3.0, f_number=0))
    with pytest.raises(ValueError, match="beyond the focal length"):
        defocus(frame, Lens(3.0, unit=0.01))
    with pytest.raises(ValueError, match="`samples` must be"):
        defocus(frame, LENS, samples=1)
    with pytest.raises(ValueError, match="`name` must be one of"):
        Lens.preset("pinhole", 2.0)
    with pytest.raises(ValueError, match="`radius` must be"):
        scenes.ThinLens(-1, 3)
    with pytest.raises(ValueError, match="`focus` must be"):
        scenes.ThinLens(1, 0)


def test_jit_and_vmap_equal_plain_calls():
    frames = [random_frame((9, 12), seed) for seed in range(2)]
    lens = jax.tree.map(float, spreading(4.0, width=12))
    alone = [defocus(frame, lens) for frame in frames]
    together = jax.vmap(defocus, (0, None))(jax.tree.map(lambda *x: jnp.stack(x), *frames), lens)
    np.testing.assert_allclose(together, jnp.stack(alone), atol=1e-6)
    np.testing.assert_allclose(jax.jit(defocus)(frames[0], lens), alone[0], atol=1e-6)


@pytest.mark.slow
def test_focus_and_aperture_are_found_in_a_picture_of_the_truth(wheels):
    """Descent on the logarithms of focus and f-number, from wrong ones."""
    scene, frame = wheels
    focal = float(scene.world.camera.focal)
    true = Lens.of_aperture(1.0, 7.5, focal)
    truth = scenes.accumulate(scene, 0, 0, 256, SIZE, lens=scenes.ThinLens(1.0, 7.5))

    @jax.jit
    def step(logs):
        def loss(logs):
            lens = dataclasses.replace(true, focus=jnp.exp(logs[0]), f_number=jnp.exp(logs[1]))
            return jnp.mean((defocus(frame, lens, samples=128, radius=16) - truth) ** 2)

        return jax.value_and_grad(loss)(logs)

    logs = jnp.log(jnp.array([6.0, 1.5 * true.f_number]))
    momentum = scale = jnp.zeros(2)
    for k in range(1, 61):
        _, slope = step(logs)
        momentum, scale = 0.8 * momentum + 0.2 * slope, 0.95 * scale + 0.05 * slope**2
        rate = 0.04 * 0.96**k
        logs -= rate * momentum / (1 - 0.8**k) / (jnp.sqrt(scale / (1 - 0.95**k)) + 1e-12)
    found = jnp.exp(logs)
    assert float(found[0]) == pytest.approx(7.5, rel=0.05)
    assert float(found[1]) == pytest.approx(true.f_number, rel=0.1)
