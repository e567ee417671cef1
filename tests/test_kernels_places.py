"""The derivative in the place at which a program reads."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur.kernels import (
    At,
    Image,
    Outcome,
    each_pixel,
    nearest_place,
    recorded_passes,
    still_place,
    sum_over,
)
from jaxblur.kernels.cpp import build, emit
from jaxblur.settings import Backend

SIZE = (9, 11)
BACKENDS: tuple[Backend, ...] = ("native", "xla")


class Images(NamedTuple):
    """What the programs read: values, and an offset for each pixel."""

    values: Image
    offset: Image


def read(at, images, x, y, blends):
    across, down = nearest_place(x, y, blends)
    row = jnp.clip(at.row + down, 0, images.values.height - 1)
    column = jnp.clip(at.column + across, 0, images.values.width - 1)
    return images.values.read(row, column)[0]


def squares(at: At, images: Images, scale, blends) -> Outcome:
    """The sum of the squares of the values at 1, 2 and 3 times ``scale * offset``."""
    x, y = images.offset.here()

    def sample(i):
        return jnp.square(read(at, images, (i + 1) * scale * x, (i + 1) * scale * y, blends))

    return Outcome((sum_over(3, sample),))


def without_sum(at: At, images: Images, scale, blends) -> Outcome:
    x, y = images.offset.here()
    return Outcome((jnp.square(read(at, images, scale * x, scale * y, blends)),))


def still(at: At, images: Images, scale, _) -> Outcome:
    """The square of the value at the pixel, of an image that moves by ``-scale * offset``."""
    x, y = (scale * part for part in images.offset.here())

    def sample(i):
        across, down = still_place(jnp.sin(x) / 2, jnp.sin(y) / 2)
        row = jnp.clip(at.row + down, 0, images.values.height - 1)
        column = jnp.clip(at.column + across, 0, images.values.width - 1)
        return (i + 1) * jnp.square(images.values.read(row, column)[0])

    return Outcome((sum_over(2, sample),))


def inputs(seed=0):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(*SIZE, 1)).astype(np.float32)
    return values, rng.uniform(-1.4, 1.4, (*SIZE, 2)).astype(np.float32)


def run(program, values, offset, scale, backend: Backend = "xla", blends=False):
    images = Images(Image(values), Image(offset))
    return each_pixel(program, SIZE, images, scale, blends, backend=backend)[..., 0]


def value_at(values, row, column):
    """f, at a place that may lie outside."""
    row, column = np.clip(row, 0, SIZE[0] - 1), np.clip(column, 0, SIZE[1] - 1)
    return values[row, column, 0] ** 2


def slopes(values, offset):
    """Value, and derivatives by x and y, at every pixel, by the formula of `places`."""
    row, column = np.indices(SIZE)
    x, y = offset[..., 0], offset[..., 1]
    nx, ny = (np.floor(o + 0.5).astype(int) for o in (x, y))
    a, b = x - nx, y - ny
    held = value_at(values, row + ny, column + nx)
    side_x, side_y = np.where(a < 0, -1, 1), np.where(b < 0, -1, 1)
    by_x = 12 * a**2 * side_x * (value_at(values, row + ny, column + nx + side_x) - held)
    by_y = 12 * b**2 * side_y * (value_at(values, row + ny + side_y, column + nx) - held)
    return held, by_x, by_y


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("program", "count"), [(squares, 3), (without_sum, 1)])
def test_the_derivative_is_that_of_the_formula(program, count, backend):
    values, offset = inputs()
    value = derivative = by_scale = 0
    for k in range(1, count + 1):
        held, by_x, by_y = slopes(values, (k * offset).astype(np.float32))
        value = value + held
        derivative = derivative + k * np.stack([by_x, by_y], axis=-1)
        by_scale = by_scale + k * (by_x * offset[..., 0] + by_y * offset[..., 1])
    one = jnp.float32(1)
    np.testing.assert_allclose(run(program, values, offset, one, backend), value, rtol=1e-5)

    def total(offset, scale):
        return jnp.sum(run(program, values, offset, scale, backend))

    found, found_scale = jax.grad(total, (0, 1))(jnp.asarray(offset), one)
    np.testing.assert_allclose(found, derivative, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found_scale, np.sum(by_scale), rtol=1e-3)
    np.testing.assert_allclose(
        jax.grad(total, 1)(jnp.asarray(offset), one), np.sum(by_scale), rtol=1e-3
    )
    forward = jax.jvp(lambda s: run(program, values, offset, s, backend), (one,), (one,))[1]
    np.testing.assert_allclose(forward, by_scale, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_still_place_reads_at_the_pixel_and_differentiates_linearly(backend):
    values, offset = inputs()
    row, column = np.indices(SIZE)
    held, one = value_at(values, row, column), jnp.float32(1)
    np.testing.assert_allclose(run(still, values, offset, one, backend), 3 * held, rtol=1e-5)
    found = jax.grad(lambda o: jnp.sum(run(still, values, o, one, backend)))(jnp.asarray(offset))
    x, y = np.sin(offset[..., 0]) / 2, np.sin(offset[..., 1]) / 2
    side_x, side_y = np.where(x < 0, -1, 1), np.where(y < 0, -1, 1)
    by_x = side_x * (value_at(values, row, column + side_x) - held)
    by_y = side_y * (value_at(values, row + side_y, column) - held)
    expected = 3 * np.stack([by_x, by_y], axis=-1) * np.cos(offset) / 2
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


def test_the_value_of_a_still_place_does_not_need_its_offset():
    values, offset = inputs()
    with recorded_passes() as passes:
        run(still, values, offset, jnp.float32(1), "xla")
    (found,) = passes
    if build.find_compiler() is None:
        pytest.skip("needs a C++ compiler")
    assert "sin" in str(found.traced.jaxpr)
    assert "sin" not in "".join(emit.emit_pass(found).parts.values())


@pytest.mark.parametrize("backend", BACKENDS)
def test_under_vmap_scan_and_checkpoint(backend):
    values, offset = inputs()
    scales = jnp.asarray([0.7, 1.0, 1.3], jnp.float32)

    @jax.checkpoint
    def total(scale):
        return jnp.sum(run(squares, values, offset, scale, backend))

    single = [jax.grad(total)(scale) for scale in scales]
    np.testing.assert_allclose(jax.vmap(jax.grad(total))(scales), single, rtol=1e-5)
    scanned = jax.grad(lambda s: jax.lax.scan(lambda c, x: (c + total(x), None), 0.0, s)[0])
    np.testing.assert_allclose(scanned(scales), single, rtol=1e-5)


def test_the_mean_over_places_has_the_mean_derivative():
    # Pixels all over the texels: what a picture does as the scale grows by 2 percent.
    rng = np.random.default_rng(4)
    values = np.repeat(np.arange(SIZE[1]) > 5, 1)[None, :, None] * np.ones((SIZE[0], 1, 1))
    values = values.astype(np.float32)

    @jax.jit
    def total(scale, offset):
        return jnp.sum(run(squares, values, offset, scale))

    gradient = jax.jit(jax.grad(total))
    slope, change = [], []
    for _ in range(300):
        offset = rng.uniform(0.2, 1.2, (*SIZE, 2)).astype(np.float32)
        slope.append(gradient(jnp.float32(1), offset))
        change.append((total(jnp.float32(1.02), offset) - total(jnp.float32(0.98), offset)) / 0.04)
    np.testing.assert_allclose(np.mean(slope), np.mean(change), rtol=0.05)
    assert abs(np.mean(change)) > 1


def test_along_an_axis_the_sides_take_turns():
    values, offset = inputs()
    offset[..., 1] = 0
    found = jax.grad(lambda o: jnp.sum(run(without_sum, values, o, jnp.float32(1))))(
        jnp.asarray(offset)
    )
    row, column = np.indices(SIZE)
    whole = np.floor(offset[..., 0] + 0.5).astype(int)
    side = np.where(offset[..., 0] - whole < 0, -1, 1)
    held = value_at(values, row, column + whole)
    expected = side * (value_at(values, row + side, column + whole) - held)
    np.testing.assert_allclose(found[..., 1], expected, rtol=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_blends_are_bilinear_mixes_of_what_is_computed(backend):
    values, offset = inputs()
    row, column = np.indices(SIZE)
    x, y = offset[..., 0], offset[..., 1]
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    expected = 0
    for i in (0, 1):
        for j in (0, 1):
            share = np.abs(1 - i - (x - left)) * np.abs(1 - j - (y - top))
            expected = expected + share * value_at(values, row + top + j, column + left + i)
    found = run(without_sum, values, offset, jnp.float32(1), backend, blends=True)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


def test_outside_a_program_the_texel_is_held():
    offset = jnp.asarray([0.4, 1.6])
    assert nearest_place(offset, offset)[0].tolist() == [0, 2]
    batched = jax.vmap(nearest_place)(offset, offset)
    assert batched[1].tolist() == [0, 2]
    assert jax.grad(lambda o: (o * nearest_place(o, o)[0]).sum())(offset).tolist() == [0, 2]
