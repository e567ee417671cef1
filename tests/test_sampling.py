import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.ndimage import map_coordinates

from jaxblur import sampling
from tests.helpers import check_gradients


def test_taps_are_evenly_spaced_inside_the_line():
    positions = sampling.tap_position(jnp.arange(3), 3, jnp.float32(0))
    np.testing.assert_allclose(positions, [-0.5, 0, 0.5])
    shifted = sampling.tap_position(jnp.arange(3), 3, jnp.float32(0.5))
    np.testing.assert_allclose(shifted, [-0.25, 0.25, 0.75])


def read_at(offset_x, offset_y, size, border="skip"):
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
    for border, counts in (("skip", False), ("clamp", True)):
        texels = read_at(-9, 9, (3, 4), border)
        assert texels.index[1, 1, 0] == 2 * 4 + 0
        assert texels.counts[1, 1, 0] == counts


def test_bilinear_fetch_equals_map_coordinates():
    generator = np.random.default_rng(0)
    size = (5, 7)
    image = jnp.asarray(generator.random((*size, 2)), jnp.float32)
    offsets = generator.uniform(-4, 4, (2, *size, 6)).astype(np.float32)
    texels = sampling.read_position(jnp.asarray(offsets[0]), jnp.asarray(offsets[1]), size, "clamp")
    planes = sampling.color_planes(image)
    for channel, value in enumerate(sampling.read_color(planes, texels, size, "bilinear")):
        expected = map_coordinates(
            image[..., channel], [texels.y, texels.x], order=1, mode="nearest"
        )
        np.testing.assert_allclose(value, expected, atol=1e-5)


def test_bilinear_fetch_at_integers_has_the_slope_to_the_right():
    plane = jnp.asarray([0.0, 1.0, 4.0])

    def read(offset):
        texels = sampling.read_position(
            jnp.full((1, 3, 1), offset), jnp.zeros((1, 3, 1)), (1, 3), "clamp"
        )
        return sampling.read_color((plane,), texels, (1, 3), "bilinear")[0][0, 1, 0]

    assert read(0.0) == 1
    assert jax.grad(read)(0.0) == 3


def sum_of_products(scale, index, operands):
    a, b = operands["a"], operands["b"]
    return scale * a * jnp.sin(b * index), a * jnp.cos(index * b) * operands["c"]


def test_sum_and_its_derivatives_equal_a_plain_sum():
    sample, count = functools.partial(sum_of_products, 2.0), 5
    generator = np.random.default_rng(1)

    def plain(operands):
        terms = [sample(jnp.asarray([i]), operands) for i in range(count)]
        return tuple(sum(term[..., 0] for term in column) for column in zip(*terms, strict=True))

    with jax.enable_x64(True):
        operands = {
            "a": jnp.asarray(generator.normal(size=(3, 4, 1))),
            "b": jnp.asarray(generator.normal(size=(3, 4, 1))),
            "c": jnp.asarray(0.7),
        }
        ours = functools.partial(sampling.sum_samples, sample, count)
        for actual, expected in zip(ours(operands), plain(operands), strict=True):
            np.testing.assert_allclose(actual, expected, rtol=1e-12)

        def both_jacobians(function):
            return jax.jacfwd(function)(operands), jax.jacrev(function)(operands)

        for actual, expected in zip(
            jax.tree.leaves(both_jacobians(ours)),
            jax.tree.leaves(both_jacobians(plain)),
            strict=True,
        ):
            np.testing.assert_allclose(actual, expected, atol=1e-12)
        check_gradients(ours, operands)


def test_no_array_holds_all_samples():
    shape, count = (64, 64), 200
    operands = {"a": jnp.ones((*shape, 1)), "b": jnp.ones((*shape, 1)), "c": jnp.float32(1)}
    sample = functools.partial(sum_of_products, 2.0)
    total = functools.partial(sampling.sum_samples, sample, count)
    loss = jax.grad(lambda values: sum(map(jnp.sum, total(values))))
    plane = 4 * shape[0] * shape[1]
    for function in (total, loss):
        memory = jax.jit(function).lower(operands).compile().memory_analysis()
        assert memory.temp_size_in_bytes < 20 * plane
