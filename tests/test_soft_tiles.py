"""Smooth maxima of tiles: near the maximum, the same whatever the sign, with a derivative."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.filters.tiles import dominant_velocity
from tests.command_line import refused
from tests.exr_files import CAR

RADIUS = 8


def coherent(seed=0, size=(19, 27)):
    """Velocities that differ by a few tenths of a pixel."""
    noise = np.random.default_rng(seed).normal(size=(*size, 2))
    return jnp.asarray(0.4 * noise + np.array([3.0, 1.5]))


def soft(velocity, temperature=0.5):
    return dominant_velocity(velocity, RADIUS, "reaching", temperature)


@pytest.mark.slow
def test_a_low_temperature_gives_the_maximum():
    velocity = coherent().astype(jnp.float32)
    largest = dominant_velocity(velocity, RADIUS, "reaching")
    apart = [float(jnp.max(jnp.abs(soft(velocity, t) - largest))) for t in (0.5, 0.05, 0.001)]
    assert apart[0] > apart[1] > apart[2]
    assert apart[2] < 1e-3


def test_reversed_pixels_do_not_cancel():
    velocity = coherent().astype(jnp.float32)
    sign = np.where(np.random.default_rng(1).uniform(size=velocity.shape[:2]) < 0.5, -1, 1)
    np.testing.assert_allclose(
        np.abs(soft(velocity * sign[..., None])), np.abs(soft(velocity)), rtol=1e-4
    )


@pytest.mark.slow
def test_the_derivative_is_that_of_the_value():
    with jax.enable_x64(True):
        velocity = jnp.asarray(np.asarray(coherent()), np.float64)
        along = np.random.default_rng(2).normal(size=velocity.shape)

        def size(velocity):
            return jnp.sum(jnp.square(soft(velocity)))

        slope = jnp.sum(jax.grad(size)(velocity) * along)
        numeric = (size(velocity + 1e-6 * along) - size(velocity - 1e-6 * along)) / 2e-6
        np.testing.assert_allclose(slope, numeric, rtol=1e-5)


def test_still_frames_have_a_finite_derivative():
    still = jnp.zeros((19, 27, 2))
    assert not np.any(soft(still))
    assert np.isfinite(jax.grad(lambda v: jnp.sum(soft(v) ** 2))(still)).all()


def test_the_filter_takes_it():
    rng = np.random.default_rng(3)
    color = rng.uniform(size=(19, 27, 3)).astype(np.float32)
    frame = jaxblur.Frame(color, np.ones((19, 27), np.float32), coherent().astype(jnp.float32))
    images = [
        jaxblur.guertin2014(
            frame,
            jaxblur.GuertinParameters(),
            settings=jaxblur.GuertinSettings(radius=RADIUS, **choice),
        )
        for choice in ({}, {"dominant": "soft", "temperature": 1e-3})
    ]
    np.testing.assert_allclose(*images, atol=0.01)


def test_a_temperature_of_0_is_an_error():
    with pytest.raises(ValueError, match="`temperature` must be pixels above 0"):
        jaxblur.GuertinSettings(temperature=0.0)


def test_a_temperature_of_the_maximum_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="`temperature` must be left out unless dominant='soft'"):
        jaxblur.GuertinSettings(temperature=2.0)
    assert jaxblur.GuertinSettings(dominant="soft", temperature=2.0).soft_temperature == 2.0
    given = ("blur", CAR, "-o", tmp_path / "out.exr", "--filter", "guertin2014")
    for options in (("--temperature", "2"), ("--temperature", "0.5", "--dominant", "max")):
        words = refused(*given, *options)
        assert "--temperature: is that of --dominant soft; pass that too" in words


def test_a_maximum_given_over_soft_settings_leaves_their_temperature(tmp_path):
    from jaxblur.cli.filtering import complete
    from jaxblur.cli.main import build_parser

    soft_settings = jaxblur.GuertinSettings(dominant="soft", temperature=2.0)
    fitted = types.SimpleNamespace(
        filter="guertin2014", parameters={}, filter_settings=soft_settings
    )
    texts = ["blur", "a.exr", "-o", "b.exr"]
    for options, expected in (
        ([], soft_settings),
        (["--temperature", "1"], jaxblur.GuertinSettings(dominant="soft", temperature=1.0)),
        (["--dominant", "max"], jaxblur.GuertinSettings()),
    ):
        arguments = build_parser().parse_args([*texts, *options])
        assert complete(arguments, fitted)[2] == expected
