"""Paths of `layered` through five places: what the vectors of neighbors add to those of a frame."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur import Frame, vectors
from jaxblur.filters.layered.arcs import Arc
from jaxblur.filters.layered.five_places import through_five_places
from jaxblur.settings import Backend

SIZE, SHUTTER = (12, 40), 0.5


def shaken(place, time=0):
    """A frame of a picture that moves as a whole, from its places at the frames around it."""
    here = place(time)
    steps = [np.broadcast_to(np.float32(place(time + side) - here), (*SIZE, 2)) for side in (-1, 1)]
    velocity, path = vectors.to_half_spread(vectors.Displacements(*steps), SHUTTER)
    assert path is not None
    color = np.full((*SIZE, 3), 0.5, np.float32)
    depth = jnp.ones(SIZE)
    return Frame(
        color=jnp.asarray(color),
        depth=depth,
        velocity=jnp.asarray(velocity),
        path=jnp.asarray(path),
    )


def refined(place, before=True, after=True, backend: Backend = "xla"):
    early, late = shaken(place, -1) if before else None, shaken(place, 1) if after else None
    frame = through_five_places(shaken(place), early, late, jnp.float32(SHUTTER), backend)
    return np.asarray(frame.path)[SIZE[0] // 2, SIZE[1] // 2]


def true_ends(place):
    return np.stack([place(side * SHUTTER / 2) - place(0) for side in (-1, 1)])


def swing(time):
    return np.array([5 * np.sin(1.3 * time + 0.2), 2 * np.cos(1.1 * time)])


@pytest.mark.parametrize("backend", ["native", "xla"])
def test_a_swing_is_followed_closer(backend):
    arc = np.asarray(shaken(swing).path)[0, 0]
    missed = np.abs(arc - true_ends(swing)).max()
    found = refined(swing, backend=backend)
    assert np.abs(found - true_ends(swing)).max() < missed / 3
    # One side alone leads a part of the way.
    alone = refined(swing, before=False, backend=backend)
    assert np.abs(alone - true_ends(swing)).max() < 0.8 * missed


def test_a_turn_stays_the_arc_that_it_is():
    def turn(time):
        return 4 * np.array([np.cos(0.9 * time), np.sin(0.9 * time)])

    np.testing.assert_allclose(refined(turn), true_ends(turn), atol=2e-5)


def test_what_a_neighbor_does_not_show_is_left_alone():
    # The neighbors move otherwise than the frame says: they show other things there.
    frame, other = shaken(swing), shaken(lambda time: -3 * swing(time + 1.5))
    found = through_five_places(frame, other, other, jnp.float32(SHUTTER), "xla")
    np.testing.assert_array_equal(found.path, frame.path)
    # A frame without a path has no vectors to both sides.
    straight = frame.replace(path=None)
    assert through_five_places(straight, other, other, jnp.float32(SHUTTER), "xla") is straight


def test_the_derivative_is_that_of_the_path():
    near = shaken(swing, -1), shaken(swing, 1)

    def end(scale):
        frame = shaken(swing)
        frame = frame.replace(path=scale * jnp.asarray(frame.path))
        found = through_five_places(frame, *near, jnp.float32(SHUTTER), "xla")
        return jnp.asarray(found.path)[6, 20, 1, 0]

    step = 1e-2
    difference = (end(1 + step) - end(1 - step)) / (2 * step)
    np.testing.assert_allclose(jax.grad(end)(1.0), difference, rtol=0.02)


def test_an_arc_leads_where_the_vectors_do():
    """Also where a motion reverses, and an arc would turn farther than it may in a frame."""
    random = np.random.default_rng(1)
    previous, following = random.uniform(-20, 20, (2, 500, 1, 2)).astype(np.float32)
    _, path = vectors.to_half_spread(vectors.Displacements(previous, following), SHUTTER)
    assert path is not None
    ends, half = [jnp.asarray(path[..., k, axis]) for k in (0, 1) for axis in (0, 1)], SHUTTER / 2
    for side, displacement in ((-1, previous), (1, following)):
        arc = Arc.through(ends, jnp.float32(half))
        place = jnp.stack(arc.at(jnp.float32(side / half)), -1)
        np.testing.assert_allclose(place, displacement, atol=2e-3)
