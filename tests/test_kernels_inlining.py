"""Traced programs: calls are written out, and what is known without another trace is right."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend import core

from jaxblur.kernels import Image, Outcome, sum_over
from jaxblur.kernels.inlining import CALLS, inlined
from jaxblur.kernels.planes import evaluate
from jaxblur.kernels.reads import still_place
from jaxblur.kernels.stages import Grid, Prepared
from jaxblur.kernels.tracing import trace

SCALAR = jax.ShapeDtypeStruct((), jnp.float32)


def calls(jaxpr):
    """Equations that call a jaxpr, those inside loops too."""
    found = [equation for equation in jaxpr.eqns if equation.primitive.name in CALLS]
    for equation in jaxpr.eqns:
        if equation.primitive.name == "scan":
            found += calls(equation.params["jaxpr"].jaxpr)
    return found


def traced(function):
    """Its jaxpr, and the same without calls."""
    closed = jax.make_jaxpr(function)(SCALAR, SCALAR)
    assert calls(closed.jaxpr)
    short = inlined(closed)
    core.check_jaxpr(short.jaxpr)
    assert not calls(short.jaxpr)
    return closed, short


def assert_equal(closed, short):
    for numbers in ((0.3, -2.0), (-1.5, 0.25)):
        operands = [jnp.float32(number) for number in numbers]
        ours, jaxs = (core.jaxpr_as_fun(c)(*operands) for c in (short, closed))
        np.testing.assert_array_equal(ours, jaxs)


def test_a_call_that_is_made_twice_has_variables_of_its_own():
    def function(x, y):
        return jnp.clip(jnp.clip(x * 2, 0, y) - jnp.where(x > y, x, 0), -1, 1)

    closed, short = traced(function)
    assert_equal(closed, short)
    made = [variable for equation in short.jaxpr.eqns for variable in equation.outvars]
    assert len(made) == len(set(made))
    # A whole number where a float is wanted is a float at once.
    assert all(equation.primitive.name != "convert_element_type" for equation in short.jaxpr.eqns)


def test_calls_inside_calls_and_loops():
    @jax.jit
    def outer(x, y):
        return jax.lax.fori_loop(0, 3, lambda k, total: jnp.where(total > y, total, x + k), x)

    closed, short = traced(lambda x, y: outer(x, y) * outer(y, x))
    assert_equal(closed, short)


def test_what_a_result_does_not_need_is_left_out():
    @jax.jit
    def both(x, y):
        return jnp.sin(x), jnp.cos(y)

    _, short = traced(lambda x, y: both(x, y)[0])
    assert [equation.primitive.name for equation in short.jaxpr.eqns] == ["sin"]


def test_constants_are_in_the_order_in_which_they_are_read():
    first, second = jnp.arange(3.0), jnp.arange(4.0)

    @jax.jit
    def sums(x, y):
        return x * second.sum() + y * first.sum()

    _, short = traced(lambda x, y: sums(x, y) + jnp.clip(x, 0, 1))
    assert [np.shape(value) for value in short.consts] == [(4,), (3,)]


class Images(NamedTuple):
    own: Image


def program(at, images, parameters, _):
    (own,) = images.own.here()
    scale, near, flag = parameters * 2, own * parameters, own > 0

    def sample(i):
        return scale * near + i, jnp.where(flag, near, scale)

    total, other = sum_over(3, sample)
    return Outcome((total + at.row.astype(jnp.float32), other))


def alternative(at, images, parameters, _):
    (own,) = images.own.here()
    return Outcome((parameters, own), where=parameters > 1, otherwise=(-parameters, parameters))


def still(at, images, parameters, _):
    (own,) = images.own.here()
    across, down = still_place(0.25 * own, 0.25 * own)
    return Outcome((parameters + across + down, own + across))


@pytest.mark.parametrize(
    ("function", "varies"),
    [(program, (False, True, True, True)), (alternative, (False, True)), (still, (False, True))],
)
def test_which_values_differ_between_pixels_is_known_from_the_trace(function, varies):
    stages = trace(function, Images(Image(jnp.ones((2, 3)))), jnp.float32(3), None).stages
    assert stages.prepared == tuple(Prepared("float32", varying) for varying in varies)
    place, own = Grid(2, 3, (2, 3)).place(), jnp.ones((2, 3, 1))

    def values():
        local = [(own,), (jnp.float32(3),)]
        wanted, found = stages.where(place, local, [])
        values = stages.prepare(place, local, [], found)
        if stages.otherwise is None:
            return values
        others = stages.otherwise(place, local, [], found)
        return [jnp.where(wanted, *pair) for pair in zip(values, others, strict=True)]

    shapes = jax.eval_shape(values)
    assert [(shape.dtype.name, shape.ndim == 3) for shape in shapes] == [
        (value.dtype, value.varies) for value in stages.prepared
    ]


def test_a_sample_knows_the_types_of_its_terms():
    stages = trace(program, Images(Image(jnp.ones((2, 3)))), jnp.float32(3), None).stages
    assert stages.sample is not None
    assert stages.sample.types == ("float32", "float32")


def test_a_literal_fills_a_plane_once():
    closed = jax.make_jaxpr(lambda x: (x * 2.5 + 2.5) * (x - 2.5))(SCALAR)

    def on_plane(plane):
        look = evaluate(closed.jaxpr.eqns, {closed.jaxpr.invars[0]: plane})
        return look(closed.jaxpr.outvars[0])

    equations = jax.make_jaxpr(on_plane)(jnp.ones((2, 3, 1))).jaxpr.eqns
    names = [equation.primitive.name for equation in equations]
    assert sorted(names) == ["add", "broadcast_in_dim", "mul", "mul", "sub"]
