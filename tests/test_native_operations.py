"""What native kernels make of operations, reads, loops and stages; what they leave to XLA."""

import functools
import logging
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur import gathers, native, sample_sums, sampling
from jaxblur.native import build
from jaxblur.settings import Backend

pytestmark = pytest.mark.skipif(build.find_compiler() is None, reason="needs a C++ compiler")


def sum_of(function, tables=None, backend: Backend = "native", dtype: Any = jnp.float32):
    """Sum of a function of (index, plane, table) over 3 samples of a 5 x 19 image."""
    plane = jnp.asarray(np.random.default_rng(0).uniform(-2, 2, (5, 19, 1)), dtype)
    tables = {"t": plane.reshape(-1)} if tables is None else tables

    def sample(index, local, tables):
        return (function(index, local["a"], tables["t"]) + jnp.zeros(index.shape, dtype),)

    moving = jnp.ones((5, 19), bool)
    return sample_sums.sum_samples(sample, 3, moving, {"a": plane}, tables, backend)[0]


def read_rows(i, a, t, width):
    """A sum over rows of a table, in which the elements count differently."""
    rows = (own_place(a) * 7 + i) % (5 * 19 // width)
    row = sampling.read_row(t, rows, width)
    return sum(((k + 1) * value for k, value in enumerate(row)), start=0 * a)


def own_place(a):
    columns = a.shape[1]
    row = jax.lax.broadcasted_iota(jnp.int32, a.shape, 0)
    return row * columns + jax.lax.broadcasted_iota(jnp.int32, a.shape, 1)


OPERATIONS = {
    "elementary": lambda i, a, t: jnp.sin(a) + jnp.cos(a * i) + jnp.tanh(a) + jnp.exp(a),
    "roots": lambda i, a, t: jnp.sqrt(jnp.abs(a) + i) + jax.lax.rsqrt(a * a + 1) + jnp.cbrt(a * 0),
    "logarithms": lambda i, a, t: jnp.log(a * a + 1) + jnp.log1p(a * a),
    "powers": lambda i, a, t: a**3 + (jnp.abs(a) + 1) ** (-2) + (a * a) ** 1.3,
    "rounding": lambda i, a, t: jnp.floor(a * i) + jnp.ceil(a) + jnp.sign(a) + jnp.round(a),
    "remainders": lambda i, a, t: jnp.fmod(a, 0.7) + (i % 2) * a,
    "comparisons": lambda i, a, t: jnp.where((a > 0) & (a < 1) | ~(a >= -1), a, i == 1),
    "extremes": lambda i, a, t: jnp.clip(a * i, -1, 1) + jnp.minimum(a, 0.3) * jnp.maximum(a, i),
    "choices": lambda i, a, t: (
        jnp.where(a > i, a, 1.0 * i) + jnp.where(a < 0.3, a, 0.3) + jnp.where(a > 0.5, 0.5, a)
    ),
    "choices of nan": lambda i, a, t: jnp.where(jnp.log(-jnp.exp(a)) > i, jnp.nan, a * i),
    "larger than nan": lambda i, a, t: jnp.where((n := jnp.log(-jnp.exp(a))) > a, n, a * 1.0) + i,
    "integers": lambda i, a, t: jnp.abs(jnp.clip((a * 3).astype(jnp.int32), -2, 4) - i) * a,
    "reads": lambda i, a, t: sampling.read_nearest(t, (own_place(a) * 7 + i) % (5 * 19)) * a,
    **{f"rows of {w}": functools.partial(read_rows, width=w) for w in (2, 3, 4, 5)},
    "floors": lambda i, a, t: (jnp.floor(a * (i + 1)).astype(jnp.int32) + jnp.floor(a)) * a,
    "constants": lambda i, a, t: a * jnp.asarray([0.5, -1.0, 2.0])[None, None, :],
}


@pytest.mark.parametrize("name", [name for name in OPERATIONS if name != "roots"])
def test_operations_mean_the_same(name):
    ours, theirs = (sum_of(OPERATIONS[name], backend=kind) for kind in ("native", "xla"))
    np.testing.assert_allclose(ours, theirs, rtol=2e-6, atol=2e-6)


@pytest.mark.parametrize(
    ("width", "wanted", "length"), [(2, 1, 95), (3, 3, 95), (4, 3, 95), (4, 3, 96), (5, 5, 95)]
)
def test_derivatives_by_rows_of_a_table_equal_those_of_xla(width, wanted, length):
    table = jnp.asarray(np.random.default_rng(1).uniform(-2, 2, length), jnp.float32)

    def some_of_rows(i, a, t):
        row = sampling.read_row(t, (own_place(a) * 7 + i) % (length // width), width, wanted)
        return sum(((k + 1) * value**2 for k, value in enumerate(row)), start=0 * a)

    def derivative(backend: Backend):
        return jax.grad(lambda t: jnp.sum(sum_of(some_of_rows, {"t": t}, backend)))(table)

    np.testing.assert_allclose(derivative("native"), derivative("xla"), rtol=1e-5, atol=1e-5)


def test_neighbors_in_memory_are_read_as_often_as_they_are_asked_for():
    image = jnp.asarray(np.random.default_rng(0).random((3, 19, 2)), jnp.float32)

    def prepare(local, tables, found):
        first, second, again = (sampling.channel(local, k) for k in (0, 1, 1))
        return [first + 2 * second, again]

    stages = native.Stages(
        moving=lambda local, _: (jnp.ones((3, 19, 1), bool), ()), prepare=prepare
    )
    ours = gathers.gather_samples(stages, 0, image, image, {}, "native")
    expected = [image[..., 0] + 2 * image[..., 1], image[..., 1]]
    np.testing.assert_allclose(ours, np.stack(expected, axis=-1), rtol=1e-6)


def test_a_loop_carries_values_on():
    """Values change places, a loop runs in the loop, and both count."""
    generator = np.random.default_rng(0)
    plane = jnp.asarray(generator.uniform(-1, 1, (5, 19, 1)), jnp.float32)

    def stage(local, tables, _):
        def step(k, carried):
            first, second, steps = carried
            inner = jax.lax.fori_loop(
                0,
                3,
                lambda j, total: total + k * j + sampling.read_nearest(tables, own),
                jnp.zeros_like(local),
            )
            return second, first + second * 0.5 + inner, steps + (k > 2)

        own = own_place(local)
        start = local, 2 * local, jnp.zeros_like(local, jnp.int32)
        first, second, steps = jax.lax.fori_loop(0, 7, step, start)
        return [first, second, steps.astype(jnp.float32)]

    a, b = plane, 2 * plane
    for k in range(7):
        a, b = b, a + b * 0.5 + 3 * k + 3 * plane
    stages = gathers.everywhere(stage)
    for backend in ("native", "xla"):
        result = gathers.gather_samples(stages, 0, plane, plane, plane.reshape(-1), backend)
        np.testing.assert_allclose(result[..., :1], a, rtol=1e-5)
        np.testing.assert_allclose(result[..., 1:2], b, rtol=1e-5)
        assert (result[..., 2] == 4).all()


def test_samples_and_results_for_the_rest_do_not_go_together():
    plane = jnp.ones((2, 3, 1))
    stages = native.Stages(
        moving=lambda local, _: (local > 0, ()),
        prepare=lambda local, tables, found: local,
        sample=lambda index, local, _: (local * index,),
        rest=lambda local, tables, found: [local],
    )
    with pytest.raises(ValueError, match=r"`stages.rest` is for stages without samples"):
        gathers.gather_samples(stages, 3, plane, plane, ())


def test_a_part_of_the_samples_has_no_native_form():
    def one_of_them(i, a, t):
        return (a * (i + 1.0))[..., :1] + 0 * i

    with pytest.raises(ValueError, match="a slice other than of one channel"):
        sum_of(one_of_them)


def test_loops_without_a_native_form_are_named():
    def over_arrays(i, a, t):
        return a + jax.lax.scan(lambda c, x: (c + x, None), 0.0, jnp.ones(3))[0] * i

    def within_a_sample(i, a, t):
        return jax.lax.fori_loop(0, 3, lambda k, c: c + i, a + 0 * i)

    for function, words in (
        (over_arrays, "a scan over arrays"),
        (within_a_sample, "a loop within a sample"),
    ):
        with pytest.raises(ValueError, match=words):
            sum_of(function)


def test_logarithms_of_what_is_not_usual():
    values = np.array([0, -0.0, -1, np.inf, np.nan, 1.2e-38, 1, 1e38, 3.4e38], np.float32)
    usual = np.geomspace(1e-37, 1e37, 1000, dtype=np.float32)
    for numbers in (values, usual, np.concatenate([usual, values])):
        plane = jnp.asarray(numbers).reshape(1, -1, 1)
        stages = native.Stages(
            moving=lambda local, _: (jnp.ones(local.shape, bool), ()),
            prepare=lambda local, tables, found: [jnp.log(local)],
        )
        ours = gathers.gather_samples(stages, 0, plane, plane, {}, "native").reshape(-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            exact = np.log(numbers.astype(np.float64))
        np.testing.assert_allclose(ours, exact, rtol=3e-7, atol=1e-7)


def test_what_has_no_native_form_is_left_to_xla(caplog):
    with pytest.raises(ValueError, match="'native', but the samples use the operation cbrt"):
        sum_of(OPERATIONS["roots"])
    with caplog.at_level(logging.INFO, logger="jaxblur"):
        ours = sum_of(OPERATIONS["roots"], backend="auto")
    assert "the operation cbrt" in caplog.text
    np.testing.assert_array_equal(ours, sum_of(OPERATIONS["roots"], backend="xla"))


def test_float64_is_left_to_xla():
    with jax.enable_x64(True):
        with pytest.raises(ValueError, match="float64"):
            sum_of(OPERATIONS["powers"], dtype=jnp.float64)
        assert sum_of(OPERATIONS["powers"], backend="auto", dtype=jnp.float64).dtype == jnp.float64


def test_without_a_compiler_xla_does_the_work(monkeypatch):
    monkeypatch.setattr(native, "find_compiler", lambda: None)
    with pytest.raises(ValueError, match="there is no C\\+\\+ compiler; use 'auto' or 'xla'"):
        sum_of(OPERATIONS["powers"])
    ours = sum_of(OPERATIONS["powers"], backend="auto")
    np.testing.assert_array_equal(ours, sum_of(OPERATIONS["powers"], backend="xla"))


def test_samples_beyond_the_limit_are_left_out_of_values_and_derivatives():
    # Their terms should be 0; these are not, so that one sees how many were summed.
    stages = native.Stages(
        moving=lambda local, _: (local > 0, ()),
        prepare=lambda local, tables, found: local,
        sample=lambda index, local, tables: (local + 0.0 * index,),
        finish=lambda sums, *_: sums,
        limit=lambda local: jnp.full_like(local, 3.0),
    )
    plane = jnp.ones((5, 19, 1), jnp.float32)

    def total(plane):
        return gathers.gather_samples(stages, 9, jnp.zeros_like(plane), plane, (), "native")

    value, change = jax.jvp(total, (plane,), (plane,))
    np.testing.assert_array_equal(total(plane), 3)
    np.testing.assert_array_equal(value, 3)
    np.testing.assert_array_equal(change, 3)
