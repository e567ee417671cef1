"""Stochastic rasterization: unbiased, less noisy with more samples, right under rotation."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur import scenes
from jaxblur.scenes import materials, motion, primitives, stochastic
from jaxblur.scenes.keyframes import light_at, light_table, needed_pieces, position_at

pytestmark = pytest.mark.slow

SIZE = (27, 48)
SEEDS = 6


def rms(difference):
    return float(np.sqrt(np.mean(np.square(np.asarray(difference)))))


def spinning_bar(rate):
    """A bright bar that turns about the view axis in front of a dark wall."""
    bodies = [
        scenes.Body("wall", primitives.sheet((20, 20)), materials.flat("#202020")),
        scenes.Body(
            "bar",
            primitives.box((3.0, 0.4, 0.2)).moved((0, 0, 1)),
            materials.flat("#f0f0f0"),
            motion.rigid(spin_axis=(0, 0, 1), spin=(0, rate)),
        ),
    ]
    return scenes.make_scene("bar", bodies, motion.camera((0, 0, 6), (0, 0, 0)), scenes.daylight())


@pytest.fixture(scope="module")
def truth():
    return scenes.accumulate(scenes.SCENES["crossing"](), samples=128, size=SIZE)


def test_error_falls_with_the_number_of_samples(truth):
    scene = scenes.SCENES["crossing"]()
    errors = [rms(stochastic(scene, samples=n, size=SIZE) - truth) for n in (1, 16)]
    assert errors[0] > 4 * errors[1], errors


def test_the_mean_over_seeds_is_the_true_image(truth):
    scene = scenes.SCENES["crossing"]()
    images = [stochastic(scene, samples=1, size=SIZE, seed=seed) for seed in range(SEEDS)]
    noise = rms(images[0] - truth)
    # The mean of n independent errors falls as 1/sqrt(n); the factor 1.5 allows for chance.
    assert rms(sum(images) / SEEDS - truth) < 1.5 * noise / SEEDS**0.5
    assert rms(images[1] - images[0]) > noise


def test_one_seed_gives_one_image():
    scene = scenes.SCENES["crossing"]()
    first, second = (stochastic(scene, samples=1, size=SIZE, seed=5) for _ in range(2))
    assert first.dtype == jnp.float32
    np.testing.assert_array_equal(first, second)


def test_fast_rotation_within_one_stratum_follows_the_arc():
    """In a single stratum of a third of a turn a chord would cut through the middle."""
    scene = spinning_bar(4 * np.pi / 3)
    true = scenes.accumulate(scene, samples=64, size=SIZE)
    images = [stochastic(scene, samples=1, size=SIZE, seed=seed) for seed in range(SEEDS)]
    noise = rms(images[0] - true)
    assert rms(sum(images) / len(images) - true) < 1.5 * noise / len(images) ** 0.5


def test_time_is_weighted_by_the_shutter_function():
    scene = scenes.SCENES["crossing"]()
    true, box = (
        scenes.accumulate(scene, samples=64, size=SIZE, shutter_function=name)
        for name in ("triangle", "box")
    )
    image = stochastic(scene, samples=64, size=SIZE, shutter_function="triangle")
    assert rms(image - true) < 0.7 * rms(image - box)


def test_placement_moves_the_exposure():
    scene = scenes.SCENES["crossing"]()
    leading = stochastic(scene, 0.0, 0.5, 1, SIZE, placement="leading")
    np.testing.assert_array_equal(leading, stochastic(scene, 0.25, 0.5, 1, SIZE))


def test_a_closed_shutter_gives_the_sharp_image():
    scene = scenes.SCENES["crossing"]()
    sharp = scenes.accumulate(scene, shutter=0.0, samples=64, size=SIZE)
    assert rms(stochastic(scene, shutter=0.0, samples=64, size=SIZE) - sharp) < 0.01


@pytest.mark.parametrize("name", ["box", "trapezoid", "gaussian"])
def test_light_and_position_invert_each_other(name):
    table = light_table(name)
    light = jnp.linspace(0.01, 0.99, 33)
    np.testing.assert_allclose(light_at(table, position_at(table, light)), light, atol=1e-5)
    np.testing.assert_allclose(
        position_at(table, jnp.array([0.0, 0.5, 1.0])), [-0.5, 0, 0.5], atol=1e-6
    )


def test_the_number_of_pieces_follows_the_path():
    straight = scenes.SCENES["crossing"]().world
    assert needed_pieces(straight, -0.25, 0.25, SIZE, 0.1)[0] == 1
    turning = spinning_bar(2.0).world
    loose, error = needed_pieces(turning, -0.25, 0.25, SIZE, 0.4)
    tight, smaller = needed_pieces(turning, -0.25, 0.25, SIZE, 0.1)
    assert 1 < loose < tight
    assert error <= 0.4 and smaller <= 0.1
    # The sagitta of an arc falls with the square of its length.
    assert smaller == pytest.approx(error * (loose / tight) ** 2, rel=0.1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"samples": 0}, "`samples` must be at least 1, got 0"),
        ({"shutter": -1.0}, "`shutter` must not be negative"),
        ({"size": (0, 4)}, "`size` must be"),
        ({"shutter_function": "round"}, "`shutter_function` must be one of"),
        ({"placement": "late"}, "`placement` must be one of"),
    ],
)
def test_refusals(arguments, message):
    with pytest.raises(ValueError, match=message):
        stochastic(scenes.SCENES["crossing"](), **arguments)
