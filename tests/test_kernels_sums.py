"""Sums over samples and their derivatives, by XLA in float64, against plain sums."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.typing import DTypeLike

from jaxblur.kernels import Image, Outcome, each_pixel, sum_over


class Planes(NamedTuple):
    a: Image
    b: Image
    d: Image


def windowed_sine(at, images, c, count):
    """Two sums that use the pixel's own values, a scalar, and a table read elsewhere."""
    (a,), (b,) = images.a.here(), images.b.here()
    place = at.row * images.a.width + at.column

    def sample(i):
        read = images.d.read_texel((place * 5 + i) % (images.d.height * images.d.width))[0]
        return 2.0 * a * jnp.sin(b * i) * read, a * jnp.cos(i * b) * c

    return Outcome(sum_over(count, sample))


def ours(a, b, c, d, count=5):
    planes = Planes(Image(a), Image(b), Image(d))
    return each_pixel(windowed_sine, a.shape, planes, c, count, backend="xla")


def plain(a, b, c, d):
    place = jnp.arange(a.size).reshape(a.shape)
    terms = []
    for i in range(5):
        read = d.reshape(-1)[(place * 5 + i) % a.size]
        terms.append(jnp.stack([2.0 * a * jnp.sin(b * i) * read, a * jnp.cos(i * b) * c], -1))
    return sum(terms)


def operands(shape, dtype: DTypeLike = "float64"):
    generator = np.random.default_rng(1)
    a, b, d = (jnp.asarray(generator.normal(size=shape), dtype) for _ in range(3))
    return a, b, jnp.asarray(0.7, dtype), d


@pytest.mark.parametrize("active", [(0, 1), (2,), (3,), (0, 1, 2, 3)])
def test_sums_and_their_derivatives_equal_plain_sums(active):
    with jax.enable_x64(True):
        values = operands((3, 4))

        @functools.partial(jax.jit, static_argnums=0)
        def derivatives(function):
            return (
                function(*values),
                jax.jacfwd(function, argnums=active)(*values),
                jax.jacrev(function, argnums=active)(*values),
                jax.hessian(lambda *v: jnp.sum(function(*v) ** 2), argnums=active)(*values),
            )

        for actual, expected in zip(
            jax.tree.leaves(derivatives(ours)), jax.tree.leaves(derivatives(plain)), strict=True
        ):
            np.testing.assert_allclose(actual, expected, atol=1e-11)


@pytest.mark.parametrize("active", [0, 2, 3], ids=["own", "scalar", "table"])
def test_no_array_holds_all_samples(active):
    shape, count = (64, 64), 200
    values = operands(shape, np.float32)

    def total(*values):
        return jnp.sum(ours(*values, count=count))

    plane = 4 * shape[0] * shape[1]
    for function in (total, jax.grad(total, argnums=active)):
        memory: Any = jax.jit(function).lower(*values).compile().memory_analysis()
        assert memory.temp_size_in_bytes < 24 * plane
