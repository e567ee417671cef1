"""Frames and tolerances that several tests share."""

import contextlib
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from jax.typing import DTypeLike

import jaxblur
from jaxblur.filters.registry import filter_info, register, unregister

RELATIVE = {"float32": 1e-4, "float64": 1e-10}
"""Filter against its plain-loop twin."""

SHAPES = ((13, 17), (24, 32), (7, 41), (1, 9), (1, 1))
"""Ragged and whole tiles, rows, single pixels."""


def slow(*values):
    """Parameters of a test that only the whole suite runs."""
    return pytest.param(*values, marks=pytest.mark.slow)


def with_slow(names, *slow_ones):
    """Names as parameters of a test; with some of them only the whole suite runs it."""
    return [slow(name) if name in slow_ones else name for name in names]


def random_frame(
    shape, seed=0, speed=9.0, channels=3, dtype: DTypeLike = "float32", sky=0.1, still=0.2
):
    """Random color, depth (a share of it sky) and velocity (a share of it zero)."""
    generator = np.random.default_rng(seed)
    height, width = shape
    depth = generator.uniform(1, 10, shape)
    depth[generator.random(shape) < sky] = np.inf
    velocity = generator.normal(size=(height, width, 2)) * speed / 2
    velocity[generator.random(shape) < still] = 0
    return jaxblur.Frame(
        color=jnp.asarray(generator.random((height, width, channels)), dtype),
        depth=jnp.asarray(depth, dtype),
        velocity=jnp.asarray(velocity, dtype),
    )


def random_noise(shape, seed=1, dtype: DTypeLike = "float32"):
    """Uniform noise in the ranges that `jaxblur.Noise` states."""
    generator = np.random.default_rng(seed)
    return jaxblur.Noise(
        tap=jnp.asarray(generator.uniform(-1, 1, shape), dtype),
        tile=jnp.asarray(generator.uniform(-0.5, 0.5, (*shape, 2)), dtype),
    )


def as_arrays(frame):
    """The buffers of a frame as NumPy arrays, in the order color, depth, velocity."""
    return tuple(np.asarray(buffer) for buffer in (frame.color, frame.depth, frame.velocity))


def fields(record):
    """The fields of a dataclass as a plain dict."""
    return {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}


def settings_of(name, settings):
    """Some settings without the choices that a filter does not have."""
    kind = filter_info(name).kind
    return kind(**{name: getattr(settings, name) for name in fields(kind())})


@contextlib.contextmanager
def registered(info):
    """A filter that is known for as long as the context lasts."""
    register(info)
    try:
        yield info
    finally:
        unregister(info.name)


def check_gradients(function, *arguments, order=1):
    """Forward and reverse derivatives against finite differences, in float64.

    Call it inside ``jax.enable_x64(True)``, away from kinks.
    """

    @jax.jit
    def compiled(*values):
        return function(*values)

    def on_arrays(*values):
        return compiled(*jax.tree.map(jnp.asarray, values))

    check_grads(on_arrays, arguments, order, ("fwd", "rev"), eps=1e-6, atol=1e-5, rtol=1e-5)
