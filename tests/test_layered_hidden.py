"""What `layered` shows of hidden surfaces: how much, how blurred, and from which neighbor."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.filters.layered.background import place_at
from jaxblur.filters.layered.paths import Path

PARAMETERS = jaxblur.LayeredParameters()
SETTINGS = jaxblur.Settings(samples=99, radius=40, fetch="bilinear")


def frame_of(color, depth, speed):
    """A frame of rows that are all alike, from a gray, a depth and a speed for each column."""
    color, depth, speed = (
        np.tile(np.asarray(row, np.float32), (12, 1)) for row in (color, depth, speed)
    )
    velocity = np.stack([speed, np.zeros_like(speed)], axis=-1)
    return jaxblur.Frame(*map(jnp.asarray, (np.repeat(color[..., None], 3, -1), depth, velocity)))


def middle_row(frame, **options):
    return np.asarray(jaxblur.layered(frame, PARAMETERS, settings=SETTINGS, **options))[6, :, 0]


def test_a_thing_counts_for_its_time_in_front_of_what_was_hidden_behind_it():
    """A white post moves by 8 px before a dark wall that comes out from behind it at 30 px."""
    x = np.arange(96)
    post = (x >= 30) & (x < 60)
    frame = frame_of(post, np.where(post, 2, 9), np.where(post, 8, 30))
    times = np.linspace(-1, 1, 801)[:, None]
    covered = ((x - 8 * times > 29.5) & (x - 8 * times < 59.5)).mean(axis=0)
    # Without a mean for what is hidden the post is up to 0.06 too dense.
    np.testing.assert_allclose(middle_row(frame)[45:], covered[45:], atol=0.025)


def test_a_hidden_color_is_blurred_along_its_own_motion():
    """A block uncovers a wall of noise that rushes upward; its color is no single texel's."""
    columns = np.tile(np.arange(64), (240, 1))
    block = (columns >= 24) & (columns < 40)
    noise = np.random.default_rng(3).random((240, 64)).astype(np.float32)
    color = np.repeat(np.where(block, 0.5, noise)[..., None], 3, -1)
    velocity = np.where(block[..., None], (12.0, 0.0), (0.0, 12.0))
    frame = jaxblur.Frame(
        jnp.asarray(color, jnp.float32),
        jnp.asarray(np.where(block, 2.0, 9.0), jnp.float32),
        jnp.asarray(velocity, jnp.float32),
    )
    uncovered = np.asarray(jaxblur.layered(frame, PARAMETERS, settings=SETTINGS))[20:220, 24, 0]
    # Half of the time the wall shows there. With single texels the spread is 0.134.
    assert uncovered.std() < 0.115


@pytest.mark.parametrize("hidden", [False, True])
def test_what_a_neighbor_shows_farther_counts_unless_it_hides_the_surface_itself(hidden):
    """A gray wall comes over the border; the frame after shows a white ground there."""
    x = np.arange(64)
    frame = frame_of(np.full(64, 0.2), np.full(64, 4.0), np.full(64, -8.0))
    # The wall at the border is 32 px to the left in the frame after, where the post is.
    post = (x < 48) if hidden else np.zeros(64, bool)
    after = frame_of(np.where(post, 0.0, 1.0), np.where(post, 1.0, 40.0), np.zeros(64))
    shown = middle_row(frame, after=after)[60:]
    if hidden:
        np.testing.assert_allclose(shown, 0.2, atol=1e-3)
    else:
        assert shown.max() > 0.4


@pytest.mark.parametrize("turn", [0.1, 0.4])
def test_a_point_that_turns_is_sought_on_its_circle(turn):
    """Half of the exposure turns it by an angle; the neighbor is four of these away."""
    radius, position = 50.0, np.array([50.0, 0.0])

    def displaced(angle):
        return radius * np.array([math.cos(angle), math.sin(angle)]) - position

    opening, closing = displaced(-turn), displaced(turn)
    velocity, bend = (closing - opening) / 2, (closing + opening) / 2
    path = Path(*map(jnp.float32, (*velocity, 0.0, *bend)))
    place = place_at(path, jnp.float32(3.5), jnp.float32(4.0))
    np.testing.assert_allclose(place, displaced(3.5 * turn), atol=0.02)
