"""Native code of operations, reads, loops and stages; and what is left to XLA."""

import functools
import logging
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur.kernels import Image, Outcome, cpp, each_pixel, sum_over
from jaxblur.kernels.cpp import build
from jaxblur.kernels.tracing import UnsupportedProgram
from jaxblur.settings import Backend
from tests.helpers import slow

pytestmark = pytest.mark.skipif(build.find_compiler() is None, reason="needs a C++ compiler")

SIZE = (5, 19)
BACKENDS: tuple[Backend, Backend] = ("native", "xla")


class Planes(NamedTuple):
    a: Image
    t: Image


def sum_of(function, table=None, backend: Backend = "native", dtype: Any = jnp.float32):
    """Sum of a function of (index, value, table, place) over 3 samples of a 5 x 19 image."""
    plane = jnp.asarray(np.random.default_rng(0).uniform(-2, 2, (*SIZE, 1)), dtype)
    images = Planes(Image(plane), Image(plane if table is None else table))

    def program(at, images, _, __):
        (a,) = images.a.here()
        place = at.row * images.a.width + at.column
        total = sum_over(3, lambda i: (function(i, a, images.t, place) + 0 * i).astype(dtype))
        return Outcome((total,))

    return each_pixel(program, SIZE, images, backend=backend)


def one(t, index):
    return t.read_texel(index)[0]


def whole(a):
    return (a * 3).astype(jnp.int32)


def read_rows(i, a, t, place, width):
    """A sum over the channels of a pixel, in which they count differently."""
    row = t.read_texel((place * 7 + i) % (t.height * t.width))
    assert len(row) == width
    return sum(((k + 1) * value for k, value in enumerate(row)), start=0 * a)


OPERATIONS = {
    "elementary": lambda i, a, t, p: jnp.sin(a) + jnp.cos(a * i) + jnp.tanh(a) + jnp.exp(a),
    "angles": lambda i, a, t, p: jnp.sin(400 * a) + jnp.sin(-9e4 * a * i) + jnp.arctan(a * i),
    "inverse angles": lambda i, a, t, p: (
        jnp.arcsin(a / 2) + jnp.arccos(a / 3) + jnp.arctan2(a, a - i) + jnp.tan(a / 2)
    ),
    "hyperbolas": lambda i, a, t, p: (
        jnp.sinh(a) + jnp.cosh(a * i) + jnp.arcsinh(a) + jnp.arccosh(a * a + 2) + jnp.arctanh(a / 3)
    ),
    "curves of networks": lambda i, a, t, p: (
        jax.nn.sigmoid(40 * a) + jax.nn.elu(a) + jax.nn.silu(a * i) + jax.scipy.special.erf(a)
    ),
    "shifts": lambda i, a, t, p: ((whole(a) << 3) + (i << i)) * a,
    "roots": lambda i, a, t, p: (
        jnp.cbrt(a) + jnp.exp2(a) + jnp.sqrt(jnp.abs(a) + i) + jax.lax.rsqrt(a * a + 1)
    ),
    "logarithms": lambda i, a, t, p: jnp.log(a * a + 1) + jnp.log1p(a * a),
    "powers": lambda i, a, t, p: a**3 + (jnp.abs(a) + 1) ** (-2) + (a * a) ** 1.3,
    "rounding": lambda i, a, t, p: jnp.floor(a * i) + jnp.ceil(a) + jnp.sign(a) + jnp.round(a),
    "remainders": lambda i, a, t, p: jnp.fmod(a, 0.7) + (i % 2) * a,
    "comparisons": lambda i, a, t, p: jnp.where((a > 0) & (a < 1) | ~(a >= -1), a, i == 1),
    "extremes": lambda i, a, t, p: jnp.clip(a * i, -1, 1) + jnp.minimum(a, 0.3) * jnp.maximum(a, i),
    "choices": lambda i, a, t, p: (
        jnp.where(a > i, a, 1.0 * i) + jnp.where(a < 0.3, a, 0.3) + jnp.where(a > 0.5, 0.5, a)
    ),
    "choices of nan": lambda i, a, t, p: jnp.where(jnp.log(-jnp.exp(a)) > i, jnp.nan, a * i),
    "larger than nan": lambda i, a, t, p: (
        jnp.where((n := jnp.log(-jnp.exp(a))) > a, n, a * 1.0) + i
    ),
    "integers": lambda i, a, t, p: jnp.abs(jnp.clip((a * 3).astype(jnp.int32), -2, 4) - i) * a,
    "whole divisions": lambda i, a, t, p: (
        (whole(a) // 2 + p // 4 - i // 2 + jnp.sign(whole(a))) * a
    ),
    "extremes of conditions": lambda i, a, t, p: (
        jnp.maximum(a > 0, i > 1) * a + 2 * jnp.minimum(a > 0, a < 1) + jnp.maximum(i > 0, i > 1)
    ),
    "orders of conditions": lambda i, a, t, p: (
        ((a > 0) < (i > 0)) + 2 * ((a > 0) > (a > 1)) + 4 * ((i > 0) <= (i > 1))
    ),
    "exclusive or": lambda i, a, t, p: jnp.where((a > 0) ^ (i > 0), a, 0) + (whole(a) ^ i),
    "finite": lambda i, a, t, p: jnp.where(jnp.isfinite(jnp.log(a) / (a < 1)), a, i),
    "reads": lambda i, a, t, p: one(t, (p * 7 + i) % (5 * 19)) * a,
    "reads at one place": lambda i, a, t, p: one(t, i * 3) * a,
    "floors": lambda i, a, t, p: (jnp.floor(a * (i + 1)).astype(jnp.int32) + jnp.floor(a)) * a,
    "relu": lambda i, a, t, p: jax.nn.relu(a - 0.2 * i),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_operations_mean_the_same(name):
    ours, theirs = (sum_of(OPERATIONS[name], backend=kind) for kind in ("native", "xla"))
    np.testing.assert_allclose(ours, theirs, rtol=2e-6, atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("channels", [3, *map(slow, (2, 4, 5))])
def test_derivatives_by_rows_of_a_table_equal_those_of_xla(channels):
    shape = (5, 19, channels)
    table = jnp.asarray(np.random.default_rng(1).uniform(-2, 2, shape), jnp.float32)

    def squares(i, a, t, place):
        row = t.read_texel((place * 7 + i) % (5 * 19), 1 + channels // 2)
        return sum(((k + 1) * value**2 for k, value in enumerate(row)), start=0 * a)

    def both(backend: Backend):
        def total(table):
            rows = functools.partial(read_rows, width=channels)
            return jnp.sum(sum_of(squares, table, backend) + sum_of(rows, table, backend))

        return jax.value_and_grad(total)(table)

    for ours, theirs in zip(both("native"), both("xla"), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-5, atol=2e-5)


def test_a_custom_derivative_is_kept():
    @jax.custom_jvp
    def wave(x):
        return jnp.sin(x)

    wave.defjvp(lambda primals, tangents: (jnp.sin(primals[0]), 7 * tangents[0]))

    def program(at, images, _, __):
        return Outcome((wave(images.a.here()[0]),))

    def total(plane, backend: Backend):
        images = Planes(Image(plane), Image(plane))
        return jnp.sum(each_pixel(program, SIZE, images, backend=backend))

    for backend in BACKENDS:
        np.testing.assert_array_equal(jax.grad(total)(jnp.ones((*SIZE, 1)), backend), 7)


def channels_program(at, images, _, __):
    first, second = images.a.here()
    (again,) = images.a.read(at.row, at.column)[1:]
    return Outcome((first + 2 * second, again))


def test_neighbors_in_memory_are_read_as_often_as_they_are_asked_for():
    image = jnp.asarray(np.random.default_rng(0).random((3, 19, 2)), jnp.float32)
    images = Planes(Image(image), Image(image))
    ours = each_pixel(channels_program, (3, 19), images, backend="native")
    expected = [image[..., 0] + 2 * image[..., 1], image[..., 1]]
    np.testing.assert_allclose(ours, np.stack(expected, axis=-1), rtol=1e-6)


def far_program(at, images, _, __):
    """Reads far beyond every corner."""
    places = [(down * 10**8, across * 10**8) for down in (-1, 1) for across in (-1, 1)]
    return Outcome(tuple(images.a.read(*place)[0] for place in places))


@pytest.mark.parametrize("backend", ["native", "xla"])
def test_a_read_outside_the_image_gives_the_pixel_at_its_edge(backend):
    plane = jnp.asarray(np.random.default_rng(0).random((*SIZE, 1)), jnp.float32)
    images = Planes(Image(plane), Image(plane))
    result = each_pixel(far_program, SIZE, images, backend=backend)
    corners = plane[0, 0], plane[0, -1], plane[-1, 0], plane[-1, -1]
    for channel, corner in enumerate(corners):
        assert (result[..., channel] == corner).all()


def loop_program(at, images, _, __):
    """Values change places, a loop runs in the loop, and both count."""
    (local,) = images.a.here()

    def step(k, carried):
        first, second, steps = carried
        inner = jax.lax.fori_loop(
            *(0, 3, lambda j, total: total + k * j + images.t.read(at.row, at.column)[0]),
            jnp.zeros_like(local),
        )
        return second, first + second * 0.5 + inner, steps + (k > 2)

    start = local, 2 * local, jnp.zeros_like(local, jnp.int32)
    first, second, steps = jax.lax.fori_loop(0, 7, step, start)
    return Outcome((first, second, steps.astype(jnp.float32)))


@pytest.mark.parametrize("backend", ["native", "xla"])
def test_a_loop_carries_values_on(backend):
    plane = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (*SIZE, 1)), jnp.float32)
    a, b = plane, 2 * plane
    for k in range(7):
        a, b = b, a + b * 0.5 + 3 * k + 3 * plane
    images = Planes(Image(plane), Image(plane))
    result = each_pixel(loop_program, SIZE, images, backend=backend)
    np.testing.assert_allclose(result[..., :1], a, rtol=1e-5)
    np.testing.assert_allclose(result[..., 1:2], b, rtol=1e-5)
    assert (result[..., 2] == 4).all()


def neighbor_after_loop(at, images, _, __):
    """An element is read in a loop, its neighbor in memory after the loop, and the pixel's own."""
    index = at.row * images.t.width + at.column
    zero = jnp.zeros_like(images.t.read_texel(index)[0])
    inside = jax.lax.fori_loop(0, 2, lambda k, s: s + images.a.read_texel(index)[0] + k, zero)
    first, second = images.a.read_texel(index)
    own = jax.lax.fori_loop(0, 2, lambda k, s: s + images.t.here()[0], zero)
    return Outcome((inside, second, first, own + images.t.here()[0]))


def test_reads_inside_a_loop_and_after_it_do_not_share_variables():
    image = jnp.asarray(np.random.default_rng(0).random((*SIZE, 2)), jnp.float32)
    images = Planes(Image(image), Image(image[..., :1]))
    ours = each_pixel(neighbor_after_loop, SIZE, images, backend="native")
    first, second = image[..., 0], image[..., 1]
    expected = [2 * first + 1, second, first, 3 * first]
    np.testing.assert_allclose(ours, np.stack(expected, axis=-1), rtol=1e-6)
    # Later kernels of the process compile too.
    sum_of(lambda i, a, t, p: a * 1.2345 + i)


def test_two_sums_are_rejected():
    def program(at, images, _, __):
        (a,) = images.a.here()
        return Outcome((sum_over(3, lambda i: a * i) + sum_over(2, lambda i: a),))

    plane = Image(jnp.ones((*SIZE, 1)))
    with pytest.raises(UnsupportedProgram, match="one `sum_over` or `mark_over`, got two"):
        each_pixel(program, SIZE, Planes(plane, plane))


def test_a_condition_that_depends_on_the_sum_is_rejected():
    def program(at, images, _, __):
        (a,) = images.a.here()
        total = sum_over(3, lambda i: a * i)
        return Outcome((total,), where=total > 0)

    plane = jnp.ones((*SIZE, 1))
    with pytest.raises(UnsupportedProgram, match=r"`Outcome.where` must not depend on the sum"):
        each_pixel(program, SIZE, Planes(Image(plane), Image(plane)), kept=plane)


def test_a_condition_without_an_image_to_keep_is_rejected():
    def program(at, images, _, __):
        (a,) = images.a.here()
        return Outcome((a,), where=a > 0)

    plane = Image(jnp.ones((*SIZE, 1)))
    with pytest.raises(ValueError, match="`kept` must be an image: `program` says `where`"):
        each_pixel(program, SIZE, Planes(plane, plane))


NO_OUTCOMES = {
    "must return an Outcome, .* got tuple": lambda at, images, _, __: images.a.here(),
    "must return an Outcome, .* got NoneType": lambda at, images, _, __: None,
    "must be a tuple of scalars, .* write": lambda at, images, _, __: Outcome(images.a.here()[0]),
    r"must be scalars, one a channel, got shape \(3,\) for channel 0": lambda *_: Outcome(
        (jnp.zeros(3),)
    ),
    "`row` of Image.read must be a whole number, got one of type float32": (
        lambda at, images, _, __: Outcome(images.a.read(at.row + 0.5, at.column))
    ),
    "must be a condition, .* type float32": lambda at, images, _, __: Outcome(
        images.a.here(), where=images.a.here()[0]
    ),
    "`kept` must have at most as many channels .* 1, got 2": lambda at, images, _, __: Outcome(
        images.a.here(), where=at.row > 1
    ),
    "`count` must be a whole number that is known": lambda at, images, _, __: Outcome(
        (sum_over(images.a.here()[0], lambda i: 1.0 * i),)
    ),
    "its operation debug_print has an effect": lambda at, images, _, __: Outcome(
        (sum_over(3, lambda i: (jax.debug.print("{}", i), 1.0 * i)[1]),)
    ),
}


@pytest.mark.parametrize("match", NO_OUTCOMES)
def test_what_is_no_outcome_is_rejected(match):
    plane = Image(jnp.ones((*SIZE, 1)))
    with pytest.raises(ValueError, match=match):
        each_pixel(NO_OUTCOMES[match], SIZE, Planes(plane, plane), kept=jnp.ones((*SIZE, 2)))


def test_a_whole_number_of_the_pixel_does_not_cross_into_the_sum():
    def program(at, images, _, __):
        place = images.a.here()[0].astype(jnp.int32)
        return Outcome((sum_over(3, lambda i: images.t.read_texel(place + i)[0]),))

    plane = Image(jnp.ones((*SIZE, 1)))
    with pytest.raises(UnsupportedProgram, match="compute it there, or convert it to a float"):
        each_pixel(program, SIZE, Planes(plane, plane))


@pytest.mark.parametrize("backend", ["native", "xla"])
def test_a_whole_number_of_the_place_is_computed_again_in_the_sum(backend):
    def program(at, images, _, __):
        place = at.row * images.t.width + at.column * 0
        return Outcome((sum_over(3, lambda i: images.t.read_texel(place + i)[0]),))

    plane = jnp.arange(5.0 * 19).reshape(*SIZE, 1)
    images = Planes(Image(plane), Image(plane))
    ours = each_pixel(program, SIZE, images, backend=backend)[..., 0]
    np.testing.assert_array_equal(ours, np.repeat(3 * 19.0 * np.arange(5)[:, None] + 3, 19, 1))


def test_an_image_of_another_size_is_rejected_where_its_own_pixel_is_read():
    small = Image(jnp.ones((2, 3, 1)))
    with pytest.raises(ValueError, match="must have 5 rows and 19 columns, got shape"):
        each_pixel(loop_program, SIZE, Planes(small, small))


def test_loops_without_a_native_form_are_named():
    def over_arrays(i, a, t, p):
        return a + jax.lax.scan(lambda c, x: (c + x, None), 0.0, jnp.ones(3))[0] * i

    def within_a_sample(i, a, t, p):
        return jax.lax.fori_loop(0, 3, lambda k, c: c + i, a + 0 * i)

    for function, words in (
        (over_arrays, "a scan over arrays"),
        (within_a_sample, "a loop within a sample"),
    ):
        with pytest.raises(ValueError, match=words):
            sum_of(function)


def log_program(at, images, _, __):
    return Outcome((jnp.log(images.a.here()[0]),))


def test_logarithms_of_unusual_numbers():
    values = np.array([0, -0.0, -1, np.inf, np.nan, 1.2e-38, 1, 1e38, 3.4e38], np.float32)
    usual = np.geomspace(1e-37, 1e37, 1000, dtype=np.float32)
    for numbers in (values, usual, np.concatenate([usual, values])):
        image = Image(jnp.asarray(numbers).reshape(1, -1, 1))
        size = 1, numbers.size
        ours = each_pixel(log_program, size, Planes(image, image), backend="native").reshape(-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            exact = np.log(numbers.astype(np.float64))
        np.testing.assert_allclose(ours, exact, rtol=3e-7, atol=1e-7)


def log_gamma(i, a, t, p):
    return jax.lax.lgamma(a) * i


def test_programs_without_a_native_form_are_left_to_xla(caplog):
    with pytest.raises(ValueError, match="'native', but the program uses the operation lgamma"):
        sum_of(log_gamma)
    with caplog.at_level(logging.INFO, logger="jaxblur"):
        ours = sum_of(log_gamma, backend="auto")
    assert "the operation lgamma" in caplog.text
    np.testing.assert_array_equal(ours, sum_of(log_gamma, backend="xla"))


def test_float64_is_left_to_xla():
    with jax.enable_x64(True):
        with pytest.raises(ValueError, match="float64"):
            sum_of(OPERATIONS["powers"], dtype=jnp.float64)
        assert sum_of(OPERATIONS["powers"], backend="auto", dtype=jnp.float64).dtype == jnp.float64


def warnings_in(caplog):
    """Another test may have asked for remarks, too."""
    return [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


def test_without_a_compiler_xla_does_the_work_and_says_the_remedy_once(monkeypatch, caplog):
    monkeypatch.setattr(cpp, "find_compiler", lambda: None)
    cpp._warn_once.cache_clear()
    with pytest.raises(ValueError, match=r"no C\+\+ compiler \(remedy: .*use 'auto' or 'xla'"):
        sum_of(OPERATIONS["powers"])
    expected = sum_of(OPERATIONS["powers"], backend="xla")
    for _ in range(2):
        np.testing.assert_array_equal(sum_of(OPERATIONS["powers"], backend="auto"), expected)
    assert warnings_in(caplog) == [
        'there is no C++ compiler (remedy: pip install "jaxblur[compiler]"); XLA does the work, '
        "several times as slow"
    ]


def test_a_system_that_cannot_load_kernels_is_not_told_to_install_a_compiler(monkeypatch, caplog):
    monkeypatch.setattr(cpp, "loads_kernels", lambda: False)
    with pytest.raises(ValueError, match="on Linux and macOS only; use 'auto' or 'xla'"):
        sum_of(OPERATIONS["powers"])
    sum_of(OPERATIONS["powers"], backend="auto")
    assert not warnings_in(caplog)
    ours = sum_of(OPERATIONS["powers"], backend="auto")
    np.testing.assert_array_equal(ours, sum_of(OPERATIONS["powers"], backend="xla"))


def limited_program(at, images, _, __):
    (a,) = images.a.here()
    return Outcome((sum_over(9, lambda i: a + 0.0 * i, limit=a * 0 + 3.0),))


def test_samples_beyond_the_limit_are_left_out_of_values_and_derivatives():
    # Their terms should be 0; these are not, so that one sees how many were summed.
    plane = jnp.ones((*SIZE, 1), jnp.float32)

    def total(plane):
        images = Planes(Image(plane), Image(plane))
        return each_pixel(limited_program, SIZE, images, backend="native")

    value, change = jax.jvp(total, (plane,), (plane,))
    np.testing.assert_array_equal(total(plane), 3)
    np.testing.assert_array_equal(value, 3)
    np.testing.assert_array_equal(change, 3)


def test_a_condition_of_samples_must_be_one():
    def program(at, images, _, __):
        (a,) = images.a.here()
        return Outcome((sum_over(3, lambda i: a * i, where=lambda i: a),))

    planes = Planes(*[Image(jnp.ones((*SIZE, 1)))] * 2)
    with pytest.raises(ValueError, match="`where` must give a condition"):
        each_pixel(program, SIZE, planes)


def test_the_arctangent_is_right_to_two_units_in_the_last_place():
    angles = np.linspace(-1.57, 1.57, 4000)
    values = np.concatenate([np.tan(angles), np.tan(angles) * 1e-4, [0.0, -0.0, np.inf, -np.inf]])
    values = jnp.asarray(values, jnp.float32).reshape(1, -1, 1)

    def program(at, images, _, __):
        return Outcome((jnp.arctan(images.a.here()[0]),))

    planes = Planes(Image(values), Image(values))
    found = np.asarray(each_pixel(program, values.shape[:2], planes, backend="native"))
    expected = np.arctan(np.asarray(values, np.float64))
    np.testing.assert_array_max_ulp(found, expected.astype(np.float32), maxulp=2)
    assert np.signbit(found[0, -3, 0]) and not np.signbit(found[0, -4, 0])
    nan = Planes(Image(values * jnp.nan), Image(values))
    assert jnp.isnan(each_pixel(program, values.shape[:2], nan, backend="native")).all()
