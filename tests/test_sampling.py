import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.ndimage import map_coordinates

import jaxblur
from jaxblur.filters import _sampling as sampling
from jaxblur.kernels import At, Image
from jaxblur.settings import Border, Settings


def test_taps_are_evenly_spaced_inside_the_line():
    positions = sampling.tap_position(jnp.arange(3), 3, jnp.float32(0))
    np.testing.assert_allclose(positions, [-0.5, 0, 0.5])
    shifted = sampling.tap_position(jnp.arange(3), 3, jnp.float32(0.5))
    np.testing.assert_allclose(shifted, [-0.25, 0.25, 0.75])


def find(offset_x, offset_y, size, border: Border = "skip"):
    """Texels of every pixel, (H, W, n)."""
    row, column = (jnp.asarray(place)[..., None] for place in np.indices(size))
    return sampling.find_texel(
        At(row, column), offset_x, offset_y, Image(jnp.zeros(size)), Settings(border=border)
    )


def read_at(offset_x, offset_y, size, border: Border = "skip"):
    x, y = (jnp.full((*size, 1), value, jnp.float32) for value in (offset_x, offset_y))
    return find(x, y, size, border)


@pytest.mark.parametrize(("offset", "column"), [(-0.5, 2), (-0.51, 1), (0.49, 2), (0.5, 3)])
def test_positions_round_half_up(offset, column):
    assert read_at(offset, 0, (1, 5)).number[0, 2, 0] == column


def test_plus_one_in_x_reads_the_column_to_the_right_and_plus_one_in_y_the_row_below():
    assert read_at(1, 0, (3, 4)).number[1, 1, 0] == 1 * 4 + 2
    assert read_at(0, 1, (3, 4)).number[1, 1, 0] == 2 * 4 + 1


def test_outside_the_image_clamp_counts_and_skip_does_not():
    skip, clamp = read_at(-9, 9, (3, 4), "skip"), read_at(-9, 9, (3, 4), "clamp")
    assert skip.number[1, 1, 0] == clamp.number[1, 1, 0] == 2 * 4 + 0
    assert not skip.counts[1, 1, 0] and clamp.counts[1, 1, 0]


def places(texels):
    """Rows and columns, real numbers."""
    return [texels.row + texels.down, texels.column + texels.across]


def test_bilinear_fetch_equals_map_coordinates():
    generator = np.random.default_rng(0)
    size = (5, 7)
    image = jnp.asarray(generator.random((*size, 2)), jnp.float32)
    offsets = generator.uniform(-4, 4, (2, *size, 6)).astype(np.float32)
    texels = find(jnp.asarray(offsets[0]), jnp.asarray(offsets[1]), size, "clamp")
    for channel, value in enumerate(sampling.read_color(Image(image), texels, "bilinear")):
        expected = map_coordinates(image[..., channel], places(texels), order=1, mode="nearest")
        np.testing.assert_allclose(value, expected, atol=1e-5)


@pytest.mark.parametrize("along_x", [True, False])
def test_reading_along_an_axis_is_linear_there_and_nearest_across(along_x):
    generator = np.random.default_rng(0)
    size = (5, 7)
    image = jnp.asarray(generator.random((*size, 2)), jnp.float32)
    offsets = generator.uniform(-4, 4, (2, *size, 6)).astype(np.float32)
    texels = find(jnp.asarray(offsets[0]), jnp.asarray(offsets[1]), size, "clamp")
    place = places(texels)
    place[1 - along_x] = jnp.floor(place[1 - along_x] + 0.5)
    values = sampling.read_color_along(Image(image), texels, jnp.asarray(along_x))
    for channel, value in enumerate(values):
        expected = map_coordinates(image[..., channel], place, order=1, mode="nearest")
        np.testing.assert_allclose(value, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("reach", "spacing", "count"), [(0.6, 2, 5), (4, 1, 9), (4.1, 1, 11), (40, 2, 35)]
)
def test_a_path_takes_a_sample_every_spacing(reach, spacing, count):
    settings = jaxblur.Settings(samples=35, spacing=spacing)
    assert sampling.path_samples(jnp.float32(reach), settings) == count


def test_bilinear_fetch_at_integers_has_the_slope_to_the_right():
    plane = jnp.asarray([[0.0, 1.0, 4.0]])

    def read(offset):
        texels = find(jnp.full((1, 3, 1), offset), jnp.zeros((1, 3, 1)), (1, 3), "clamp")
        return sampling.read_color(Image(plane), texels, "bilinear")[0][0, 1, 0]

    assert read(0.0) == 1
    assert jax.grad(read)(0.0) == 3
