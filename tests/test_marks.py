"""The largest marks that samples leave: by hand, by plain loops, native code and XLA alike."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur.marks import largest_marks
from jaxblur.native import build

BACKENDS = [
    pytest.param(
        "native",
        marks=pytest.mark.skipif(build.find_compiler() is None, reason="needs a C++ compiler"),
    ),
    "xla",
]
LENGTH = 50


def walk(index, local, tables):
    """Two marks a sample: one walks up the table, the other leaves what stands in another table."""
    step = index.astype(jnp.float32)
    ahead = jnp.floor(local["start"] + step * local["stride"]).astype(jnp.int32)
    inside = (ahead >= 0) & (ahead < LENGTH) & (step < local["count"])
    place = jnp.where(inside, ahead, 0)
    height = jnp.floor(tables["height"].at[place].get(mode="promise_in_bounds")).astype(jnp.int32)
    value = local["value"].astype(jnp.int32)
    return (place, jnp.where(inside, value, 0)), (
        jnp.where(inside, LENGTH - 1 - place, 0),
        jnp.where(inside, height, 0),
    )


def count(local):
    return local["count"]


def lines(size, seed=0):
    generator = np.random.default_rng(seed)
    local = {
        "start": generator.uniform(-5, LENGTH + 5, size),
        "stride": generator.normal(0, 3, size),
        "count": generator.integers(0, 9, size),
        "value": generator.integers(-3, 2**20, size),
    }
    tables = {"height": generator.uniform(-2, 2**20, LENGTH)}
    return jax.tree.map(lambda array: jnp.asarray(array, jnp.float32), (local, tables))


def by_loops(local, tables):
    table = np.zeros(LENGTH, np.int64)
    names = "start", "stride", "count", "value"
    planes = [np.asarray(local[name]).reshape(-1) for name in names]
    for start, stride, steps, value in zip(*planes, strict=True):
        for step in range(int(steps)):
            place = int(np.floor(start + np.float32(step) * stride))
            if 0 <= place < LENGTH:
                table[place] = max(table[place], int(value))
                height = int(np.floor(tables["height"][place]))
                table[LENGTH - 1 - place] = max(table[LENGTH - 1 - place], height)
    return table


@pytest.mark.parametrize("backend", BACKENDS)
def test_three_lines_by_hand(backend):
    local = {
        "start": [[[3.0], [5.0], [5.0]]],
        "stride": [[[1.0], [-1.0], [0.0]]],
        "count": [[[3.0], [3.0], [0.0]]],
        "value": [[[7.0], [2.0], [99.0]]],
    }
    planes = {name: jnp.asarray(values) for name, values in local.items()}
    table = largest_marks(walk, count, planes, {"height": jnp.zeros(LENGTH)}, LENGTH, backend)
    assert table.dtype == jnp.int32
    # The first covers 3, 4, 5, the second 5, 4, 3 with less; the third takes no step.
    assert table.tolist() == [0] * 3 + [7] * 3 + [0] * (LENGTH - 6)


@pytest.mark.parametrize("size", [(1, 1, 1), (3, 16, 1), (9, 37, 1), (2, 300, 1)])
@pytest.mark.parametrize("backend", BACKENDS)
def test_equals_plain_loops(backend, size):
    local, tables = lines(size)
    for call in (largest_marks, jax.jit(largest_marks, static_argnums=(0, 1, 4, 5))):
        table = call(walk, count, local, tables, LENGTH, backend)
        np.testing.assert_array_equal(table, by_loops(local, tables))


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_batch_is_one_after_the_other(backend):
    batch = [lines((4, 20, 1), seed) for seed in range(3)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *batch)
    tables = jax.vmap(
        lambda local, tables: largest_marks(walk, count, local, tables, LENGTH, backend)
    )(*stacked)
    for table, one in zip(tables, batch, strict=True):
        np.testing.assert_array_equal(table, by_loops(*one))


def test_no_native_form_is_said_or_done_by_xla():
    with jax.enable_x64(True):
        local, tables = jax.tree.map(lambda leaf: leaf.astype(jnp.float64), lines((4, 20, 1)))
        with pytest.raises(ValueError, match="operands of type float64"):
            largest_marks(walk, count, local, tables, LENGTH, "native")
        table = largest_marks(walk, count, local, tables, LENGTH, "auto")
    np.testing.assert_array_equal(table, by_loops(local, tables))


@pytest.mark.skipif(build.find_compiler() is None, reason="needs a C++ compiler")
def test_marks_are_whole_numbers():
    def halves(index, local, tables):
        ((place, mark), _) = walk(index, local, tables)
        return ((place, mark / 2),)

    local, tables = lines((2, 8, 1))
    with pytest.raises(ValueError, match="marks of another type than int32"):
        largest_marks(halves, count, local, tables, LENGTH, "native")
