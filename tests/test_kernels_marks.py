"""The largest marks that samples leave: by hand, by plain loops, native code and XLA alike."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur.kernels import Image, Outcome, largest_marks, mark_over
from jaxblur.kernels.cpp import build

BACKENDS = [
    pytest.param(
        "native",
        marks=pytest.mark.skipif(build.find_compiler() is None, reason="needs a C++ compiler"),
    ),
    "xla",
]
LENGTH = 50


class Walkers(NamedTuple):
    start: Image
    stride: Image
    count: Image
    value: Image
    height: Image


def walk(at, images, _, __):
    """Two marks a step: one climbs the table, the other leaves the value of another table."""
    start, stride, count, value = (image.here()[0] for image in images[:4])

    def mark(index):
        step = index.astype(jnp.float32)
        ahead = jnp.floor(start + step * stride).astype(jnp.int32)
        inside = (ahead >= 0) & (ahead < LENGTH) & (step < count)
        place = jnp.where(inside, ahead, 0)
        height = jnp.floor(images.height.read_texel(place)[0]).astype(jnp.int32)
        return (place, jnp.where(inside, value.astype(jnp.int32), 0)), (
            jnp.where(inside, LENGTH - 1 - place, 0),
            jnp.where(inside, height, 0),
        )

    return Outcome(mark_over(count, mark), where=count > 0)


def marks_of(planes, backend):
    size = planes[0].shape
    return largest_marks(walk, size, Walkers(*map(Image, planes)), LENGTH, backend=backend)


def lines(size, seed=0):
    generator = np.random.default_rng(seed)
    planes = (
        generator.uniform(-5, LENGTH + 5, size),
        generator.normal(0, 3, size),
        generator.integers(0, 9, size),
        generator.integers(-3, 2**20, size),
        generator.uniform(-2, 2**20, (1, LENGTH)),
    )
    return tuple(jnp.asarray(plane, jnp.float32) for plane in planes)


def by_loops(planes):
    table = np.zeros(LENGTH, np.int64)
    *walkers, heights = (np.asarray(plane).reshape(-1) for plane in planes)
    for start, stride, steps, value in zip(*walkers, strict=True):
        for step in range(int(steps)):
            place = int(np.floor(start + np.float32(step) * stride))
            if 0 <= place < LENGTH:
                table[place] = max(table[place], int(value))
                height = int(np.floor(heights[place]))
                table[LENGTH - 1 - place] = max(table[LENGTH - 1 - place], height)
    return table


@pytest.mark.parametrize("backend", BACKENDS)
def test_three_lines_by_hand(backend):
    walkers = ([[3.0, 5.0, 5.0]], [[1.0, -1.0, 0.0]], [[3.0, 3.0, 0.0]], [[7.0, 2.0, 99.0]])
    planes = *map(jnp.asarray, walkers), jnp.zeros((1, LENGTH))
    table = marks_of(planes, backend)
    assert table.dtype == jnp.int32
    # The first covers 3, 4, 5, the second 5, 4, 3 with less; the third takes no step.
    assert table.tolist() == [0] * 3 + [7] * 3 + [0] * (LENGTH - 6)


@pytest.mark.parametrize("size", [(1, 1), (3, 16), (9, 37), (2, 300)])
@pytest.mark.parametrize("backend", BACKENDS)
def test_equals_plain_loops(backend, size):
    planes = lines(size)
    for call in (marks_of, jax.jit(marks_of, static_argnums=1)):
        np.testing.assert_array_equal(call(planes, backend), by_loops(planes))


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_batch_is_one_after_the_other(backend):
    batch = [lines((4, 20), seed) for seed in range(3)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *batch)
    tables = jax.vmap(lambda planes: marks_of(planes, backend))(stacked)
    for table, one in zip(tables, batch, strict=True):
        np.testing.assert_array_equal(table, by_loops(one))


def test_it_works_without_jit():
    planes = lines((3, 4))
    expected = marks_of(planes, "xla")
    with jax.disable_jit():
        np.testing.assert_array_equal(marks_of(planes, "xla"), expected)


def test_float64_is_left_to_xla_or_rejected():
    with jax.enable_x64(True):
        planes = tuple(plane.astype(jnp.float64) for plane in lines((4, 20)))
        with pytest.raises(ValueError, match="operands of type float64"):
            marks_of(planes, "native")
        table = marks_of(planes, "auto")
    np.testing.assert_array_equal(table, by_loops(planes))
