import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.ndimage import map_coordinates
from jax.typing import DTypeLike

import jaxblur
from jaxblur import sample_sums, sampling
from jaxblur.settings import Border


def test_taps_are_evenly_spaced_inside_the_line():
    positions = sampling.tap_position(jnp.arange(3), 3, jnp.float32(0))
    np.testing.assert_allclose(positions, [-0.5, 0, 0.5])
    shifted = sampling.tap_position(jnp.arange(3), 3, jnp.float32(0.5))
    np.testing.assert_allclose(shifted, [-0.25, 0.25, 0.75])


def read_at(offset_x, offset_y, size, border: Border = "skip"):
    shape = (*size, 1)
    x, y = (jnp.full(shape, value, jnp.float32) for value in (offset_x, offset_y))
    return sampling.read_position(x, y, size, border)


@pytest.mark.parametrize(("offset", "column"), [(-0.5, 2), (-0.51, 1), (0.49, 2), (0.5, 3)])
def test_positions_round_half_up(offset, column):
    assert read_at(offset, 0, (1, 5)).index[0, 2, 0] == column


def test_plus_one_in_x_reads_the_column_to_the_right_and_plus_one_in_y_the_row_below():
    assert read_at(1, 0, (3, 4)).index[1, 1, 0] == 1 * 4 + 2
    assert read_at(0, 1, (3, 4)).index[1, 1, 0] == 2 * 4 + 1


def test_outside_the_image_clamp_counts_and_skip_does_not():
    skip, clamp = read_at(-9, 9, (3, 4), "skip"), read_at(-9, 9, (3, 4), "clamp")
    assert skip.index[1, 1, 0] == clamp.index[1, 1, 0] == 2 * 4 + 0
    assert not skip.counts[1, 1, 0] and clamp.counts[1, 1, 0]


def places(texels):
    """Rows and columns, real numbers."""
    return [texels.row + texels.down, texels.column + texels.across]


def test_bilinear_fetch_equals_map_coordinates():
    generator = np.random.default_rng(0)
    size = (5, 7)
    image = jnp.asarray(generator.random((*size, 2)), jnp.float32)
    offsets = generator.uniform(-4, 4, (2, *size, 6)).astype(np.float32)
    texels = sampling.read_position(jnp.asarray(offsets[0]), jnp.asarray(offsets[1]), size, "clamp")
    table = image.reshape(-1)
    for channel, value in enumerate(sampling.read_color(table, texels, size, "bilinear")):
        expected = map_coordinates(image[..., channel], places(texels), order=1, mode="nearest")
        np.testing.assert_allclose(value, expected, atol=1e-5)


@pytest.mark.parametrize("along_x", [True, False])
def test_reading_along_an_axis_is_linear_there_and_nearest_across(along_x):
    generator = np.random.default_rng(0)
    size = (5, 7)
    image = jnp.asarray(generator.random((*size, 2)), jnp.float32)
    offsets = generator.uniform(-4, 4, (2, *size, 6)).astype(np.float32)
    texels = sampling.read_position(jnp.asarray(offsets[0]), jnp.asarray(offsets[1]), size, "clamp")
    place = places(texels)
    place[1 - along_x] = jnp.floor(place[1 - along_x] + 0.5)
    values = sampling.read_color_along(image.reshape(-1), texels, size, jnp.asarray(along_x))
    for channel, value in enumerate(values):
        expected = map_coordinates(image[..., channel], place, order=1, mode="nearest")
        np.testing.assert_allclose(value, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("reach", "spacing", "count"), [(0.6, 2, 5), (4, 1, 9), (4.1, 1, 11), (40, 2, 35)]
)
def test_a_path_takes_a_sample_every_spacing(reach, spacing, count):
    settings = jaxblur.Settings(samples=35, spacing=spacing)
    assert sampling.path_samples(jnp.float32(reach), settings)["count"] == count


def test_bilinear_fetch_at_integers_has_the_slope_to_the_right():
    plane = jnp.asarray([0.0, 1.0, 4.0])

    def read(offset):
        texels = sampling.read_position(
            jnp.full((1, 3, 1), offset), jnp.zeros((1, 3, 1)), (1, 3), "clamp"
        )
        return sampling.read_color(plane, texels, (1, 3), "bilinear")[0][0, 1, 0]

    assert read(0.0) == 1
    assert jax.grad(read)(0.0) == 3


def windowed_sine(scale, index, local, tables):
    """Two terms that use local planes, a local scalar, and a table read elsewhere."""
    a, b = local["a"], local["b"]
    height, width, _ = a.shape
    place = jnp.arange(height * width).reshape(height, width, 1)
    read = sampling.read_nearest(tables["d"], (place * 5 + index) % (height * width))
    return scale * a * jnp.sin(b * index) * read, a * jnp.cos(index * b) * local["c"]


def operands(shape, dtype: DTypeLike = "float64"):
    generator = np.random.default_rng(1)
    planes = {name: jnp.asarray(generator.normal(size=(*shape, 1)), dtype) for name in "ab"}
    local = planes | {"c": jnp.asarray(0.7, dtype)}
    return local, {"d": jnp.asarray(generator.normal(size=shape[0] * shape[1]), dtype)}


@pytest.mark.parametrize("active", [(0,), (1,), (0, 1)], ids=["local", "tables", "both"])
def test_sum_and_its_derivatives_equal_a_plain_sum(active):
    sample, count = functools.partial(windowed_sine, 2.0), 5

    def plain(local, tables):
        terms = [sample(jnp.asarray([i]), local, tables) for i in range(count)]
        return tuple(sum(term[..., 0] for term in column) for column in zip(*terms, strict=True))

    with jax.enable_x64(True):
        values = operands((3, 4))
        ours = functools.partial(sample_sums.sum_samples, sample, count, jnp.ones((3, 4), bool))

        def derivatives(function):
            return (
                function(*values),
                jax.jacfwd(function, argnums=active)(*values),
                jax.jacrev(function, argnums=active)(*values),
                jax.hessian(lambda *v: sum(map(jnp.sum, function(*v))), argnums=active)(*values),
            )

        for actual, expected in zip(
            jax.tree.leaves(derivatives(ours)), jax.tree.leaves(derivatives(plain)), strict=True
        ):
            np.testing.assert_allclose(actual, expected, atol=1e-12)


@pytest.mark.parametrize("active", [0, 1], ids=["local", "tables"])
def test_no_array_holds_all_samples(active):
    shape, count = (64, 64), 200
    values = operands(shape, np.float32)
    sample, moving = functools.partial(windowed_sine, 2.0), jnp.ones(shape, bool)
    total = functools.partial(sample_sums.sum_samples, sample, count, moving)
    loss = jax.grad(lambda *v: sum(map(jnp.sum, total(*v))), argnums=active)
    plane = 4 * shape[0] * shape[1]
    for function in (total, loss):
        memory: Any = jax.jit(function).lower(*values).compile().memory_analysis()
        assert memory.temp_size_in_bytes < 20 * plane


def test_nothing_is_computed_where_nothing_moves():
    values = operands((3, 4), np.float32)
    sample, still = functools.partial(windowed_sine, 2.0), jnp.zeros((3, 4), bool)
    for total in sample_sums.sum_samples(sample, 5, still, *values):
        np.testing.assert_array_equal(total, 0)
