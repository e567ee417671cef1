"""Properties of every filter on frames that hypothesis makes: shapes, velocities, depths."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings as hypothesis_settings, strategies as st
from hypothesis.extra.numpy import arrays

import jaxblur
from jaxblur.filters import FILTERS, filter_info
from tests.helpers import settings_of, with_slow

# A size compiles anew: these are whole tiles and ragged ones.
SHAPES = ((4, 8), (5, 7))
# Odd and without noise, so that a reversed velocity reads the same taps.
SETTINGS = jaxblur.GuertinSettings(samples=5, radius=4, noise="none", tile_choice="own")
HEAVY = ("guertin2014", "layered", "mcguire2012")
SPECIAL = (0.0, 0.5, -0.5, 4.0, -4.0, 8.0, 1e-40, 1e-20, 1e6, -1e6)

speeds = st.one_of(
    st.sampled_from(SPECIAL),
    st.floats(-12, 12, width=32),
    st.floats(-(2.0**40), 2.0**40, width=32),
)
distances = st.one_of(
    st.sampled_from((1.0, 2.0, 1e-6, 1e9, float("inf"))),
    st.floats(2.0**-20, 2.0**20, width=32),
)
properties = functools.partial(
    hypothesis_settings, max_examples=30, deadline=None, derandomize=True, database=None
)


@st.composite
def frames(draw, shapes=SHAPES):
    """A frame of one of the shapes; hypothesis chooses motion and depth, a seed the color."""
    height, width = draw(st.sampled_from(shapes))
    generator = np.random.default_rng(draw(st.integers(0, 99)))
    color: Any = generator.random((height, width, 3), np.float32)
    depth = draw(arrays(np.float32, (height, width), elements=distances, fill=st.just(3.0)))
    velocity = draw(arrays(np.float32, (height, width, 2), elements=speeds, fill=speeds))
    return jaxblur.Frame(color, depth, velocity)


def run(name: str, frame: jaxblur.Frame, **changes: Any) -> np.ndarray:
    changed = dataclasses.replace(frame, **changes)
    parameters, settings = filter_info(name).make_parameters(), settings_of(name, SETTINGS)
    return np.asarray(FILTERS[name](changed, parameters, settings=settings))


@pytest.mark.parametrize("name", with_slow(FILTERS, "layered"))
@properties()
@given(frame=frames())
def test_the_result_is_an_average_of_the_colors(name, frame):
    output = run(name, frame)
    assert np.isfinite(output).all()
    assert output.min() >= np.min(frame.color) - 1e-5 and output.max() <= np.max(frame.color) + 1e-5
    constant = np.full_like(frame.color, 0.7)
    np.testing.assert_allclose(run(name, frame, color=constant), 0.7, rtol=2e-6)
    mapped = run(name, frame, color=4 * np.asarray(frame.color) - 1)
    np.testing.assert_allclose(mapped, 4 * output - 1, atol=2e-5)


@pytest.mark.parametrize("name", FILTERS)
@properties()
@given(frame=frames())
def test_reversed_motion_is_the_same_blur(name, frame):
    reverse = run(name, frame, velocity=-np.asarray(frame.velocity))
    np.testing.assert_allclose(reverse, run(name, frame), atol=1e-5)


@pytest.mark.parametrize("name", ["guertin2014", "layered"])
@properties()
@given(frame=frames(), power=st.integers(-6, 6))
def test_the_unit_of_depth_does_not_matter(name, frame, power):
    scaled = run(name, frame, depth=np.asarray(frame.depth) * np.float32(2.0**power))
    np.testing.assert_allclose(scaled, run(name, frame), atol=1e-5)


@pytest.mark.parametrize("name", FILTERS)
@properties()
@given(frame=frames(), share=st.floats(0, 1))
def test_half_a_pixel_or_less_is_the_identity_bit_for_bit(name, frame, share):
    velocity = np.asarray(frame.velocity)
    slow = np.clip(velocity, -0.35, 0.35) * np.float32(share)
    np.testing.assert_array_equal(run(name, frame, velocity=slow), frame.color)


@pytest.mark.parametrize("name", FILTERS)
@properties()
@given(frame=frames(shapes=SHAPES[1:2]), where=st.tuples(st.integers(0, 4), st.integers(0, 6)))
def test_a_masked_pixel_has_no_influence(name, frame, where):
    valid = np.ones((5, 7), bool)
    valid[where] = False
    outputs = []
    for value in (0.0, np.nan):
        color = np.array(frame.color)
        color[where] = value
        outputs.append(run(name, frame, color=color, valid=valid))
    assert np.isfinite(outputs[0]).all()
    np.testing.assert_array_equal(*outputs)


@functools.partial(jax.jit, static_argnames=("name",))
def gradients(name: str, inputs: Any) -> Any:
    def total(inputs):
        frame, parameters = inputs
        settings = settings_of(name, SETTINGS)
        return jnp.sum(jnp.square(FILTERS[name](frame, parameters, settings=settings)))

    return jax.grad(total)(inputs)


@pytest.mark.parametrize("name", with_slow(FILTERS, *HEAVY))
@properties()
@given(frame=frames(shapes=SHAPES[1:2]))
def test_gradients_are_finite_wherever_the_motion_goes(name, frame):
    frame = jax.tree.map(jnp.asarray, frame)
    parameters = jax.tree.map(jnp.float32, filter_info(name).make_parameters())
    for leaf in jax.tree.leaves(gradients(name, (frame, parameters))):
        assert jnp.isfinite(leaf).all()
