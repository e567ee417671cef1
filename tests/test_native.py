"""Native kernels: equal to XLA's, used where they can be, and left alone where they cannot."""

import concurrent.futures
import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.kernels import gathers
from jaxblur.kernels.cpp import build
from jaxblur.settings import Backend
from tests.helpers import slow

pytestmark = pytest.mark.skipif(build.find_compiler() is None, reason="needs a C++ compiler")

# No multiple of the lanes of a vector, fewer rows than a thread takes, one pixel, rows that end two
# pixels after a vector.
SIZES = [(9, 37), (3, 16), (1, 1), (6, 530)]


def make_frame(size, seed=0):
    generator = np.random.default_rng(seed)
    velocity = generator.normal(0, 4, (*size, 2))
    velocity[: size[0] // 2] = 0
    depth = generator.uniform(1, 5, size)
    depth[0, 0] = np.inf
    buffers = generator.random((*size, 3)), depth, velocity
    return jaxblur.Frame(*(jnp.asarray(buffer, jnp.float32) for buffer in buffers))


def runs(name, **options):
    """The filter by native code and by XLA, as functions of (frame, parameters)."""
    samples = 9 if name == "mcguire2012" else 8
    both = []
    backends: tuple[Backend, Backend] = ("native", "xla")
    for backend in backends:
        kind = jaxblur.filter_info(name).kind
        settings = kind(samples=samples, radius=5, backend=backend, **options)
        both.append(functools.partial(jaxblur.FILTERS[name], settings=settings))
    return both


def parameters_of(name) -> Any:
    return jaxblur.filter_info(name).make_parameters()


def assert_trees_close(ours, theirs, tolerance):
    for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        scale = max(1.0, float(np.max(np.abs(b), initial=0)))
        np.testing.assert_allclose(a, b, atol=tolerance * scale)


# A size compiles anew with XLA. The sizes try what is common to all kernels, so that in the fast
# suite one filter has all of them.
@pytest.mark.parametrize(
    ("name", "size"),
    [
        pytest.param(name, size, marks=[pytest.mark.slow] if seldom else [])
        for name in sorted(jaxblur.FILTERS)
        for size in SIZES
        for seldom in [size != SIZES[0] and name != "guertin2014"]
    ],
)
def test_equals_xla(name, size):
    by_native, by_xla = runs(name)
    frame = make_frame(size)
    ours = by_native(frame, parameters_of(name))
    assert_trees_close(ours, by_xla(frame, parameters_of(name)), 4e-6)


@pytest.mark.parametrize(
    "options",
    [
        {"fetch": "bilinear"},
        {"tile_choice": "expected"},
        {"split": "variance"},
        slow({"border": "clamp"}),
        slow({"directions": "one", "direction_weights": "off"}),
        slow({"noise": "none"}),
    ],
    ids=lambda options: "-".join(options.values()),
)
def test_equals_xla_in_every_setting(options):
    by_native, by_xla = runs("guertin2014", **options)
    frame, parameters = make_frame((12, 35)), jaxblur.GuertinParameters()
    assert_trees_close(by_native(frame, parameters), by_xla(frame, parameters), 2e-6)


# The few slices that `layered` has here are its fewest, and mcguire2012 spaces its taps as
# guertin2014 does.
@pytest.mark.slow
@pytest.mark.parametrize("name", ["guertin2014", "pixel_velocity"])
def test_equals_xla_where_short_paths_take_fewer_samples(name):
    frame, parameters = make_frame((9, 37)), parameters_of(name)

    def value_and_derivative(blur):
        def loss(color):
            result = blur(jaxblur.Frame(color, frame.depth, frame.velocity), parameters)
            return jnp.sum(result**2), result

        return jax.jit(jax.grad(loss, has_aux=True))(frame.color)

    ours, theirs = map(value_and_derivative, runs(name, spacing=4.0))
    assert_trees_close(ours, theirs, 2e-5)
    dense = runs(name)[0](frame, parameters)
    assert np.max(np.abs(ours[1] - dense)) > 0.01


@pytest.mark.slow
def test_derivatives_equal_those_of_xla():
    frame, parameters = make_frame((5, 273)), jaxblur.GuertinParameters()
    parameters = jax.tree.map(jnp.float32, parameters)
    target = make_frame((5, 273), seed=1).color

    def derivatives(blur):
        def loss(frame, parameters):
            return jnp.mean((blur(frame, parameters) - target) ** 2)

        direction = jax.tree.map(lambda leaf: jnp.cos(7 * leaf), (frame.color, frame.velocity))

        def along(step):
            moved = [leaf + step * d for leaf, d in zip(buffers, direction, strict=True)]
            return loss(jaxblur.Frame(moved[0], frame.depth, moved[1]), parameters)

        buffers = (frame.color, frame.velocity)
        reverse = jax.grad(loss, argnums=(0, 1))(frame, parameters)
        alone = jax.grad(loss, argnums=1)(frame, parameters)
        return reverse, alone, jax.jvp(along, (0.0,), (1.0,))

    blurs = runs("guertin2014", tile_choice="own")
    ours, theirs = (jax.jit(functools.partial(derivatives, blur))() for blur in blurs)
    assert_trees_close(ours, theirs, 2e-5)


def with_paths_and_a_thin_thing(frame):
    """The frame with bent paths, one depth, and a column before it, somewhat slower."""
    bend = np.random.default_rng(3).normal(0, 1, frame.velocity.shape)
    depth = jnp.full(frame.depth.shape, 5.0).at[:, 20].set(2)
    velocity = frame.velocity.at[..., 0].add(4).at[:, 20].set(jnp.array([3.0, 0.0]))
    path = jnp.stack([bend - velocity, bend + velocity], axis=-2).astype(jnp.float32)
    return dataclasses.replace(frame, depth=depth, velocity=velocity, path=path)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(jaxblur.FILTERS))
def test_derivatives_by_every_input_equal_those_of_xla(name):
    frame, parameters = make_frame((6, 40)), jax.tree.map(jnp.float32, parameters_of(name))
    if name == "layered":
        frame = with_paths_and_a_thin_thing(frame)

    def derivatives(blur):
        def loss(frame, parameters):
            return jnp.sum((blur(frame, parameters) - 0.5) ** 2)

        return jax.jit(jax.grad(loss, argnums=(0, 1)))(frame, parameters)

    ours, theirs = map(derivatives, runs(name, fetch="bilinear"))
    # Where taps move by a scalar, a sum over pixels cancels: 3.5e-5 at worst, for eta.
    assert_trees_close(ours, theirs, 5e-5)
    moved = ours[0].velocity if frame.path is None else ours[0].path
    assert np.any(np.abs(moved) > 1e-3) and np.any(np.abs(ours[0].color) > 1e-3)
    assert name != "layered" or ours[1].thin_coverage != 0, "something is thin"


@pytest.mark.slow
@pytest.mark.parametrize("channels", [1, 5])
def test_any_number_of_channels_has_a_native_form(channels):
    frame = make_frame((5, 19))
    color = jnp.tile(frame.color, 2)[..., :channels]

    def value_and_derivative(blur):
        def loss(color):
            result = blur(dataclasses.replace(frame, color=color), None)
            return jnp.sum(result**2), result

        return jax.jit(jax.grad(loss, has_aux=True))(color)

    ours, theirs = map(value_and_derivative, runs("pixel_velocity", fetch="bilinear"))
    assert ours[1].shape == (5, 19, channels)
    assert_trees_close(ours, theirs, 1e-5)


@pytest.mark.parametrize("name", ["guertin2014", "layered", "mcguire2012"])
def test_derivatives_by_scalars_are_carried_by_the_kernel(name, monkeypatch):
    monkeypatch.delattr(gathers, "_prepared")
    settings = jaxblur.Settings(samples=9, radius=4, backend="native")
    frame, parameters = make_frame((7, 21)), parameters_of(name)
    # Paths or the background depend on these, and neither is a scalar.
    not_alone = {"surface_sharpness", "thin_coverage", "front_sharpness", "bend"}
    free = {key: value for key, value in vars(parameters).items() if key not in not_alone}

    def total(free):
        changed = dataclasses.replace(parameters, **free)
        return jnp.sum(jaxblur.FILTERS[name](frame, changed, settings=settings))

    _, change = jax.jvp(total, (free,), (free,))
    assert change != 0


@pytest.mark.slow
def test_second_derivatives_and_batches_equal_those_of_xla():
    frame = make_frame((4, 18))
    colors = jnp.stack([make_frame((4, 18), seed).color for seed in (2, 3)])

    def derivatives(blur):
        def loss(color):
            moved = jaxblur.Frame(color, frame.depth, frame.velocity)
            return jnp.sum(blur(moved, jaxblur.GuertinParameters()) ** 2)

        of_batch = jax.grad(lambda colors: jnp.sum(jax.vmap(loss)(colors)))(colors)
        return of_batch, jax.jvp(jax.grad(loss), (colors[0],), (colors[1],))

    blurs = runs("guertin2014", tile_choice="own")
    ours, theirs = (jax.jit(functools.partial(derivatives, blur))() for blur in blurs)
    assert_trees_close(ours, theirs, 2e-5)


@pytest.mark.slow
def test_threads_that_call_at_once_get_the_same_bits():
    by_native, _ = runs("guertin2014", fetch="bilinear")
    parameters = jaxblur.GuertinParameters()
    loss = jax.jit(jax.value_and_grad(lambda frame: jnp.sum(by_native(frame, parameters) ** 2)))
    frames = [make_frame((40, 64), seed) for seed in (1, 2)]
    alone = [loss(frame) for frame in frames]
    with concurrent.futures.ThreadPoolExecutor(6) as pool:
        together = list(pool.map(loss, frames * 30))
    for ours, theirs in zip(together, alone * 30, strict=True):
        for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
            np.testing.assert_array_equal(a, b)


def test_nan_and_infinity_pass_through_as_with_xla():
    frame = make_frame((6, 20))
    color = frame.color.at[4, 7].set(jnp.nan).at[5, 12].set(jnp.inf)
    velocity = frame.velocity.at[5, 3].set(jnp.nan)
    frame = jaxblur.Frame(color, frame.depth, velocity)
    # Under jit: NaN in motion is an error where values are known.
    blurs = [jax.jit(blur) for blur in runs("guertin2014")]
    ours, theirs = (blur(frame, jaxblur.GuertinParameters()) for blur in blurs)
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))
    np.testing.assert_array_equal(np.isinf(ours), np.isinf(theirs))
