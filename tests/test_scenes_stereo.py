"""Two eyes of a scene, and noise that they share."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import scenes
from jaxblur.noise import make_noise

pytestmark = pytest.mark.slow

SIZE = (24, 40)


def test_each_eye_sees_points_where_the_disparity_says():
    scene = scenes.SCENES["uniform_pan"]()
    left, right = scenes.stereo(scene, 0.5)
    assert (left.name, right.name) == ("uniform_pan_left", "uniform_pan_right")
    frames = [scenes.render(eye, 0.0, 0.5, SIZE) for eye in (left, right)]
    # A wall parallel to the image: one depth, so that the views are shifted copies.
    np.testing.assert_allclose(frames[0].depth, frames[1].depth, rtol=1e-5)
    apart = np.asarray(scenes.disparity(left, frames[0].depth, 0.5))
    wide = scenes.render(scenes.stereo(scene, 0.5 * 4 / apart[0, 0])[0], 0.0, 0.5, SIZE)
    other = scenes.render(scenes.stereo(scene, 0.5 * 4 / apart[0, 0])[1], 0.0, 0.5, SIZE)
    assert apart.min() > 0
    np.testing.assert_allclose(wide.color[:, 4:], other.color[:, :-4], atol=2e-3)
    np.testing.assert_allclose(frames[0].velocity, frames[1].velocity, atol=1e-3)


def test_no_separation_is_the_scene_itself():
    scene = scenes.SCENES["gears"]()
    for eye in scenes.stereo(scene, 0.0):
        np.testing.assert_array_equal(
            scenes.render(eye, 0.0, 0.5, SIZE).color, scenes.render(scene, 0.0, 0.5, SIZE).color
        )


def test_the_eyes_turn_with_the_camera():
    scene = scenes.SCENES["camera_turn"]()
    left, right = scenes.stereo(scene, 0.4)
    later = [scenes.render(eye, 3.0, 0.5, SIZE) for eye in (left, right)]
    middle = scenes.render(scene, 3.0, 0.5, SIZE)
    nearest = [np.asarray(frame.depth).min() for frame in (*later, middle)]
    # Sideways only: planar depths hardly change.
    np.testing.assert_allclose(nearest[:2], nearest[2], rtol=0.15)
    assert np.abs(np.asarray(later[0].color) - np.asarray(later[1].color)).max() > 0.05


@pytest.mark.parametrize("separation", [-0.1, np.nan, np.inf])
def test_a_separation_that_is_none_is_refused(separation):
    with pytest.raises(ValueError, match="`separation` must be 0 or more"):
        scenes.stereo(scenes.SCENES["gears"](), separation)


def test_shared_noise_sticks_to_the_surface():
    noise = make_noise("ign", 6, 20)
    near = jnp.full((6, 20), 3.0)
    shared = jaxblur.shared_noise(noise, near)
    # What the right view shows at column x is at x + 3 in the left.
    np.testing.assert_array_equal(shared.tap[:, :17], noise.tap[:, 3:])
    np.testing.assert_array_equal(shared.tile[:, :17], noise.tile[:, 3:])
    np.testing.assert_array_equal(shared.tap[:, 17:], np.repeat(noise.tap[:, -1:], 3, 1))
    far = jaxblur.shared_noise(noise, jnp.zeros((6, 20)))
    np.testing.assert_array_equal(far.tap, noise.tap)
    with pytest.raises(ValueError, match="`disparity` must have the shape"):
        jaxblur.shared_noise(noise, jnp.zeros((6, 19)))
