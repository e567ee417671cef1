"""Evaluate equations of scalars on scalars or on whole planes.

A value may be a scalar (), a value for each sample (n,), a plane (H, W, 1), or all samples of all
pixels (H, W, n); operands broadcast against one another as in NumPy. On scalars this is plain
evaluation, so that the same code serves tracing for C++ and running by XLA.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend import core

from .inlining import SAME, live, opened
from .reads import place_primitive, read_table, texel_of

ELEMENTWISE = {
    *("abs", "acos", "acosh", "add", "add_any", "and", "asin", "asinh", "atan", "atan2", "atanh"),
    *("cbrt", "ceil", "clamp", "convert_element_type", "cos", "cosh", "div", "eq", "erf", "exp"),
    *("exp2", "expm1", "floor", "ge", "gt", "integer_pow", "is_finite", "le", "log", "log1p"),
    *("logistic", "lt", "max", "min", "mul", "ne", "neg", "not", "or", "pow", "rem", "round"),
    *("rsqrt", "select_n", "shift_left", "shift_right_arithmetic", "shift_right_logical", "sign"),
    *("sin", "sinh", "sqrt", "square", "stop_gradient", "sub", "tan", "tanh", "xor"),
}


def evaluate(
    equations: Sequence[Any],
    values: dict[Any, Any],
    wanted: Sequence[Any] | None = None,
) -> Callable[[Any], Any]:
    """Evaluate equations.

    Args:
        equations: of a jaxpr of scalars without inner calls, in order.
        values: of the variables that are known.
        wanted: variables that are needed; equations that they do not depend on are left out. All
            equations if None.

    Returns:
        A function from a variable or a literal to its value.
    """
    values = dict(values)
    spread: dict[Any, Any] = {}

    def look(atom: Any) -> Any:
        if isinstance(atom, core.Literal):
            return np.asarray(atom.val, getattr(atom.aval, "dtype", None))
        return values[atom]

    chosen = equations if wanted is None else live(equations, wanted)
    for equation in chosen:
        inputs = [look(atom) for atom in equation.invars]
        values.update(zip(equation.outvars, _equation(equation, inputs, spread), strict=True))
    return look


def _equation(equation: Any, inputs: list[Any], spread: dict[Any, Any]) -> list[Any]:
    """Results of an equation; `spread` keeps the literals that fill planes."""
    name, parameters = equation.primitive.name, equation.params
    if equation.primitive is place_primitive:
        return texel_of(*inputs, **parameters)
    if name == "gather" and equation.invars[0].aval.ndim == 1:
        return [read_table(*inputs)]
    if name in SAME and equation.outvars[0].aval.size == 1:
        return [inputs[0]]
    if name in ELEMENTWISE:
        shapes = {value.shape for value in inputs}
        if len(shapes) > 1:
            shape = np.broadcast_shapes(*shapes)
            inputs = [_broadcast(value, shape, spread) for value in inputs]
        return [equation.primitive.bind(*inputs, **parameters)]
    if name == "scan" and parameters["num_consts"] + parameters["num_carry"] == len(inputs):
        return _loop(equation, inputs)
    return _one_by_one(equation, inputs)


def _broadcast(value: Any, shape: tuple[int, ...], spread: dict[Any, Any]) -> Any:
    """A value as an array of a shape.

    A literal becomes one plane, however often it is used: half of the operations that XLA gets
    would be literals and their planes. `jax.numpy.broadcast_to` makes two operations of each.
    """
    if value.shape == shape:
        return value
    axes = tuple(range(len(shape) - value.ndim, len(shape)))
    is_literal = isinstance(value, np.ndarray | np.generic)
    key = (value.dtype, value.tobytes(), shape) if is_literal else None
    if key in spread:
        return spread[key]
    filled = lax.broadcast_in_dim(value, shape, axes)
    if is_literal:
        spread[key] = filled
    return filled


def _loop(equation: Any, inputs: list[Any]) -> list[Any]:
    """A loop that carries values on, as `lax.fori_loop` of known length makes it."""
    parameters, constants = equation.params, equation.params["num_consts"]
    body, closed_over = opened(parameters["jaxpr"])
    scalars = [v for v, o in zip(inputs, equation.invars, strict=True) if o.aval.ndim == 0]
    shape = np.broadcast_shapes(*map(np.shape, scalars))
    known = dict(zip(body.constvars, closed_over, strict=True))
    known |= zip(body.invars[:constants], inputs[:constants], strict=True)

    def step(carried: list[Any], _: None) -> tuple[list[Any], None]:
        values = known | dict(zip(body.invars[constants:], carried, strict=True))
        look = evaluate(body.eqns, values, body.outvars)
        return [jnp.broadcast_to(look(variable), shape) for variable in body.outvars], None

    start = [jnp.broadcast_to(value, shape) for value in inputs[constants:]]
    return lax.scan(step, start, None, parameters["length"])[0]


def _one_by_one(equation: Any, inputs: list[Any]) -> list[Any]:
    """Any other operation, as it is for scalars, mapped over all elements."""
    pairs = zip(equation.invars, inputs, strict=True)
    known = {v: value for v, value in pairs if not isinstance(v, core.Literal)}
    function = _function_of(equation, list(known))
    scalars = [variable.aval.ndim == 0 for variable in known]
    inputs = list(known.values())
    shape = np.broadcast_shapes(
        *(np.shape(v) for v, scalar in zip(inputs, scalars, strict=True) if scalar)
    )
    if not shape:
        return function(*map(jnp.asarray, inputs))
    flat = [
        jnp.broadcast_to(value, shape).reshape(-1) if scalar else value
        for value, scalar in zip(inputs, scalars, strict=True)
    ]
    axes = [0 if scalar else None for scalar in scalars]
    return [result.reshape(shape) for result in jax.vmap(function, axes)(*flat)]


def _function_of(equation: Any, variables: list[Any]) -> Callable[..., list[Any]]:
    """The operation alone, as a function of its variables; derivatives of its own are kept."""
    inner = [opened(value)[0] for value in equation.params.values() if _is_jaxpr(value)]
    if not inner:

        def bind(*values: Any) -> list[Any]:
            known = dict(zip(variables, values, strict=True))
            inputs = [
                atom.val if isinstance(atom, core.Literal) else known[atom]
                for atom in equation.invars
            ]
            result = equation.primitive.bind(*inputs, **equation.params)
            return list(result) if equation.primitive.multiple_results else [result]

        return bind
    alone = inner[0].replace(
        constvars=(), invars=variables, outvars=equation.outvars, eqns=[equation]
    )
    return core.jaxpr_as_fun(core.ClosedJaxpr(alone, ()))


def _is_jaxpr(value: Any) -> bool:
    return isinstance(value, core.Jaxpr | core.ClosedJaxpr)
