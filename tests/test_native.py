"""Native kernels: equal to XLA's, used where they can be, and left alone where they cannot."""

import dataclasses
import functools
import logging
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import gathers, native, sample_sums, sampling
from jaxblur.native import build
from jaxblur.settings import Backend

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
        settings = jaxblur.Settings(samples=samples, radius=5, backend=backend, **options)
        both.append(functools.partial(jaxblur.FILTERS[name], settings=settings))
    return both


def parameters_of(name):
    return jaxblur.filters.PUBLISHED[name][0]


def assert_trees_close(ours, theirs, tolerance):
    for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        scale = max(1.0, float(np.max(np.abs(b), initial=0)))
        np.testing.assert_allclose(a, b, atol=tolerance * scale)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", sorted(jaxblur.FILTERS))
def test_equals_xla(name, size):
    by_native, by_xla = runs(name)
    frame = make_frame(size)
    ours = by_native(frame, parameters_of(name))
    assert_trees_close(ours, by_xla(frame, parameters_of(name)), 4e-6)


@pytest.mark.parametrize(
    "options",
    [
        {"fetch": "bilinear"},
        {"border": "clamp"},
        {"tile_choice": "expected"},
        {"split": "variance"},
        {"directions": "one", "direction_weights": "off"},
        {"noise": "none"},
    ],
    ids=lambda options: "-".join(options.values()),
)
def test_equals_xla_in_every_setting(options):
    by_native, by_xla = runs("guertin2014", **options)
    frame, parameters = make_frame((12, 35)), jaxblur.GuertinParameters()
    assert_trees_close(by_native(frame, parameters), by_xla(frame, parameters), 2e-6)


@pytest.mark.parametrize("name", sorted(jaxblur.FILTERS))
def test_equals_xla_where_short_paths_take_fewer_samples(name):
    frame, parameters = make_frame((9, 37)), parameters_of(name)

    def both(blur):
        def total(color):
            changed = jaxblur.Frame(color, frame.depth, frame.velocity)
            return jnp.sum(blur(changed, parameters) ** 2)

        return blur(frame, parameters), jax.grad(total)(frame.color)

    ours, theirs = map(both, runs(name, spacing=4.0))
    assert_trees_close(ours, theirs, 2e-5)
    dense = runs(name)[0](frame, parameters)
    # Two slices are fewer than the fewest.
    assert np.max(np.abs(ours[0] - dense)) > 0.01 or name == "layered"


@pytest.mark.parametrize("fetch", ["nearest", "bilinear"])
def test_derivatives_equal_those_of_xla(fetch):
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
        reverse = jax.grad(loss, argnums=(0, 1), allow_int=False)(frame, parameters)
        alone = jax.grad(loss, argnums=1)(frame, parameters)
        return reverse, alone, jax.jvp(along, (0.0,), (1.0,))

    ours, theirs = map(derivatives, runs("guertin2014", fetch=fetch, tile_choice="own"))
    assert_trees_close(ours, theirs, 2e-5)


def test_derivatives_equal_those_of_xla_where_depths_are_equal():
    frame = make_frame((12, 40))
    depth, velocity = frame.depth.at[:, 20].set(2), frame.velocity.at[:, 20].set(1)

    def derivatives(blur):
        def loss(depth, coverage):
            parameters = jaxblur.LayeredParameters(thin_coverage=coverage)
            blurred = blur(jaxblur.Frame(frame.color, depth, velocity), parameters)
            return jnp.sum((blurred - 0.5) ** 2)

        alone = jax.grad(loss, argnums=1)(depth, 0.5)
        assert alone != 0, "something is thin"
        return jax.grad(loss, argnums=(0, 1))(depth, 0.5), alone

    ours, theirs = map(derivatives, runs("layered", fetch="bilinear"))
    assert_trees_close(ours, theirs, 2e-5)


@pytest.mark.parametrize("name", [*sorted(jaxblur.FILTERS), "layered along paths"])
def test_derivatives_by_every_input_equal_those_of_xla(name):
    frame = make_frame((6, 40))
    if "paths" in name:
        name = "layered"
        bend = jnp.asarray(np.random.default_rng(3).normal(0, 1, (6, 40, 2)), jnp.float32)
        path = jnp.stack([bend - frame.velocity, bend + frame.velocity], axis=-2)
        frame = dataclasses.replace(frame, path=path)
    parameters = jax.tree.map(jnp.float32, parameters_of(name))

    def derivatives(blur):
        def loss(frame, parameters):
            return jnp.sum((blur(frame, parameters) - 0.5) ** 2)

        return jax.grad(loss, argnums=(0, 1))(frame, parameters)

    ours, theirs = map(derivatives, runs(name, fetch="bilinear"))
    # Where taps move by a scalar, a sum over pixels cancels: 3.5e-5 at worst, for eta.
    assert_trees_close(ours, theirs, 5e-5)
    moved = ours[0].velocity if frame.path is None else ours[0].path
    assert np.any(np.abs(moved) > 1e-3) and np.any(np.abs(ours[0].color) > 1e-3)


@pytest.mark.parametrize("channels", [1, 2, 5])
@pytest.mark.parametrize("name", ["guertin2014", "layered", "mcguire2012", "pixel_velocity"])
def test_any_number_of_channels_has_a_native_form(name, channels):
    frame = make_frame((5, 19))
    color = jnp.tile(frame.color, 2)[..., :channels]
    parameters = parameters_of(name)

    def value_and_derivative(blur):
        def loss(color):
            result = blur(dataclasses.replace(frame, color=color), parameters)
            return jnp.sum(result**2), result

        return jax.grad(loss, has_aux=True)(color)

    ours, theirs = map(value_and_derivative, runs(name, fetch="bilinear"))
    assert ours[1].shape == (5, 19, channels)
    assert_trees_close(ours, theirs, 1e-5)


@pytest.mark.parametrize("name", ["guertin2014", "layered", "mcguire2012"])
def test_derivatives_by_scalars_are_carried_by_the_kernel(name, monkeypatch):
    monkeypatch.delattr(gathers, "_by_stages")
    settings = jaxblur.Settings(samples=9, radius=4, backend="native")
    frame, parameters = make_frame((7, 21)), parameters_of(name)
    # Motion depends on these two, and motion is no scalar.
    not_alone = {"surface_sharpness", "thin_coverage"}
    free = {key: value for key, value in vars(parameters).items() if key not in not_alone}

    def total(free):
        changed = dataclasses.replace(parameters, **free)
        return jnp.sum(jaxblur.FILTERS[name](frame, changed, settings=settings))

    _, change = jax.jvp(total, (free,), (free,))
    assert change != 0


def test_second_derivatives_and_batches_equal_those_of_xla():
    frame, parameters = make_frame((4, 18)), jaxblur.GuertinParameters()
    colors = jnp.stack([make_frame((4, 18), seed).color for seed in (2, 3)])

    def derivatives(blur):
        def loss(kappa, color):
            changed = jaxblur.GuertinParameters(kappa=kappa)
            moved = jaxblur.Frame(color, frame.depth, frame.velocity)
            return jnp.sum(blur(moved, changed) ** 2)

        curvature = jax.hessian(loss)(40.0, colors[0])
        of_batch = jax.grad(lambda c: jnp.sum(jax.vmap(lambda one: loss(40.0, one))(c)))(colors)
        per_frame = jax.vmap(jax.grad(loss, argnums=1), (None, 0))(40.0, colors)
        mixed = jax.jvp(lambda c: jax.grad(loss, argnums=1)(40.0, c), (colors[0],), (colors[1],))
        return curvature, of_batch, per_frame, mixed

    del parameters
    ours, theirs = map(derivatives, runs("guertin2014", tile_choice="own"))
    assert_trees_close(ours, theirs, 2e-5)


def test_the_same_frame_gives_the_same_bits():
    by_native, _ = runs("guertin2014", fetch="bilinear")
    frame, parameters = make_frame((40, 64)), jaxblur.GuertinParameters()
    loss = jax.jit(jax.value_and_grad(lambda frame: jnp.sum(by_native(frame, parameters) ** 2)))
    first, second = loss(frame), loss(frame)
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_array_equal(a, b)


def test_nan_and_infinity_pass_through_as_with_xla():
    frame = make_frame((6, 20))
    color = frame.color.at[4, 7].set(jnp.nan).at[5, 12].set(jnp.inf)
    velocity = frame.velocity.at[5, 3].set(jnp.nan)
    frame = jaxblur.Frame(color, frame.depth, velocity)
    ours, theirs = (blur(frame, jaxblur.GuertinParameters()) for blur in runs("guertin2014"))
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))
    np.testing.assert_array_equal(np.isinf(ours), np.isinf(theirs))


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
