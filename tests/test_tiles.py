import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.filters.tiles import chances_of_tiles, chosen_tile, drawn_tile, read_between_tiles
from jaxblur.kernels import At, Image
from jaxblur.safe_math import clamp_speed
from tests.helpers import SHAPES, check_gradients, random_frame
from tests.reference import plain_loops


def test_clamp_keeps_directions_and_short_vectors():
    velocity = jnp.asarray([[[30.0, 40.0], [3.0, 4.0], [0.0, 0.0]]])
    clamped, speed = clamp_speed(velocity, 10)
    np.testing.assert_allclose(clamped[0], [[6, 8], [3, 4], [0, 0]], rtol=1e-6)
    np.testing.assert_allclose(speed[0], [10, 5, 0])


@pytest.mark.parametrize("size", [1e6, 1e20, 1e30])
def test_clamp_far_beyond_the_radius(size):
    velocity = jnp.asarray([[[-size, size]]], jnp.float32)
    clamped, speed = clamp_speed(velocity, 40)
    np.testing.assert_allclose(clamped[0, 0], np.array([-40, 40]) / np.sqrt(2), rtol=1e-6)
    assert speed == 40


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("radius", [1, 4, 50])
def test_reductions_equal_plain_loops(shape, radius):
    velocity = random_frame(shape).velocity
    tiles = jaxblur.tile_max(velocity, radius)
    expected = plain_loops.tile_max(np.asarray(velocity), radius)
    np.testing.assert_array_equal(tiles, expected.astype(np.float32))
    ring = jaxblur.neighbor_max(tiles)
    np.testing.assert_array_equal(ring, plain_loops.neighbor_max(np.asarray(tiles)))
    all_nine = plain_loops.neighbor_max(np.asarray(tiles), diagonal_rule=False)
    np.testing.assert_array_equal(jaxblur.neighbor_max(tiles, "all"), all_nine)
    expected = plain_loops.tile_variance(np.asarray(ring, np.float64))
    np.testing.assert_allclose(jaxblur.tile_variance(ring), expected, atol=2e-6)


def test_ties_go_to_the_first_in_row_major_order():
    velocity = jnp.zeros((4, 4, 2)).at[1, 2].set((3, 4)).at[2, 0].set((0, 5)).at[1, 3].set((5, 0))
    np.testing.assert_array_equal(jaxblur.tile_max(velocity, 4)[0, 0], (3, 4))


def test_ties_between_tiles_go_to_the_center_and_then_row_major():
    tiles = jnp.zeros((3, 3, 2)).at[1, 1].set((0, 5)).at[0, 1].set((5, 0)).at[2, 1].set((3, 4))
    ring = jaxblur.neighbor_max(tiles)
    np.testing.assert_array_equal(ring[1, 1], (0, 5))
    np.testing.assert_array_equal(jaxblur.neighbor_max(tiles.at[1, 1].set(0))[1, 1], (5, 0))


def test_a_diagonal_tile_counts_only_if_it_can_reach_the_center():
    toward = jnp.zeros((3, 3, 2)).at[0, 0].set((2, 2))
    past = jnp.zeros((3, 3, 2)).at[0, 0].set((2, -2))
    axis_aligned = jnp.zeros((3, 3, 2)).at[0, 0].set((2, 0))
    np.testing.assert_array_equal(jaxblur.neighbor_max(toward)[1, 1], (2, 2))
    np.testing.assert_array_equal(jaxblur.neighbor_max(-toward)[1, 1], (-2, -2))
    np.testing.assert_array_equal(jaxblur.neighbor_max(past)[1, 1], (0, 0))
    np.testing.assert_array_equal(jaxblur.neighbor_max(axis_aligned)[1, 1], (0, 0))
    np.testing.assert_array_equal(jaxblur.neighbor_max(past, "all")[1, 1], (2, -2))


def test_still_tiles_count_as_aligned():
    tiles = jnp.zeros((1, 3, 2)).at[0, 0].set((1, 0)).at[0, 1].set((0, 3))
    np.testing.assert_allclose(jaxblur.tile_variance(tiles)[0], [1 / 2, 1 / 3, 0], atol=1e-6)


def places(shape):
    return At(*(jnp.asarray(place) for place in np.indices(shape)))


def grid_of(shape, radius):
    """An image of tiles; only its size counts."""
    return Image(jnp.zeros((-(-shape[0] // radius), -(-shape[1] // radius))))


def reachable_tiles(shape, radius, tau):
    """Flat indices of tiles that the jitter may reach, and their probabilities."""
    at, tiles = places(shape), grid_of(shape, radius)
    found = [chosen_tile(at, jnp.float32(k), radius, tiles) for k in range(3)]
    index = jnp.stack([row * tiles.width + column for row, column in found])
    return index, jnp.stack(chances_of_tiles(at, tau, radius, tiles))


def stochastic_tile(xi, tau, radius):
    tiles = grid_of(xi.shape[:2], radius)
    noise = xi[..., 0], xi[..., 1]
    row, column = drawn_tile(places(xi.shape[:2]), noise, tau, radius, tiles)
    return row * tiles.width + column


def test_bilinear_lookup_meets_tile_centers_and_stays_constant_outside():
    (values,) = read_between_tiles(places((3, 8)), Image(jnp.asarray([[0.0, 1.0]])), 4)
    expected = np.clip((np.arange(8) + 0.5 - 2) / 4, 0, 1)
    np.testing.assert_allclose(values, np.tile(expected, (3, 1)), atol=1e-6)


@pytest.mark.parametrize("tau", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("shape", [(13, 17), (5, 5), (1, 12)])
def test_tile_lookup_equals_plain_loops(shape, tau):
    (height, width), radius, generator = shape, 5, np.random.default_rng(3)
    rows, columns = -(-height // radius), -(-width // radius)
    xi = generator.uniform(-0.5, 0.5, (*shape, 2)).astype(np.float32)
    drawn = np.asarray(stochastic_tile(jnp.asarray(xi), jnp.float32(tau), radius))
    index, chance = reachable_tiles((height, width), radius, jnp.float32(tau))
    grid = (tau, radius, rows, columns)
    for row, column in np.ndindex(*shape):
        place = (row, column)
        tile = plain_loops.chosen_tile(row, column, xi[place], *grid)
        assert drawn[place] == tile[0] * columns + tile[1]
        expected = np.zeros(rows * columns)
        for probability, (y, x) in plain_loops.reachable(row, column, *grid):
            expected[y * columns + x] += probability
        actual = np.zeros(rows * columns)
        np.add.at(actual, np.asarray(index)[:, *place], np.asarray(chance)[:, *place])
        np.testing.assert_allclose(actual, expected, atol=1e-6)


def test_drawn_tiles_have_the_stated_probabilities():
    shape, radius, tau, draws = (12, 12), 6, 0.8, 4000
    xi = np.random.default_rng(4).uniform(-0.5, 0.5, (draws, *shape, 2)).astype(np.float32)
    draw = jax.vmap(lambda x: stochastic_tile(x, jnp.float32(tau), radius))
    drawn = draw(jnp.asarray(xi))
    index, chance = reachable_tiles(shape, radius, jnp.float32(tau))
    for tile in range(4):
        expected = np.sum(np.where(np.asarray(index) == tile, chance, 0), axis=0)
        share = np.mean(np.asarray(drawn) == tile, axis=0)
        np.testing.assert_allclose(share, expected, atol=5 * np.sqrt(0.25 / draws))


def test_gradients_follow_the_winner():
    with jax.enable_x64(True):
        velocity = random_frame((7, 9), dtype=np.float64).velocity

        def reductions(v):
            ring = jaxblur.neighbor_max(jaxblur.tile_max(v, 3))
            return ring, jaxblur.tile_variance(ring)

        check_gradients(reductions, velocity)
        check_gradients(lambda tau: reachable_tiles((13, 17), 5, tau)[1], 0.93)


def test_gradients_at_ties_and_at_zero_are_finite():
    def total(v):
        ring = jaxblur.neighbor_max(jaxblur.tile_max(v, 2))
        return jnp.sum(ring) + jnp.sum(jaxblur.tile_variance(ring))

    for value in (0.0, 3.0):
        assert jnp.isfinite(jax.grad(total)(jnp.full((4, 6, 2), value))).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: jaxblur.tile_max(jnp.zeros((4, 4)), 2), "`velocity` must have shape"),
        (lambda: jaxblur.tile_max(jnp.zeros((4, 4, 2)), 0), "`radius` must be at least 1, got 0"),
        (lambda: jaxblur.neighbor_max(jnp.zeros((4, 4, 3))), "`tiles` must have shape"),
        (lambda: jaxblur.neighbor_max(jnp.zeros((4, 4, 2)), "some"), "`diagonal` must be"),
    ],
)
def test_refusals(call, message):
    with pytest.raises(ValueError, match=message):
        call()
