"""Evaluate equations of scalars on scalars or on whole planes.

A value may be a scalar (), a value for each sample (n,), a plane (H, W, 1), or all samples of all
pixels (H, W, n); operands broadcast against one another as in NumPy. On scalars this is plain
evaluation, so that the same code serves tracing for C++ and running by XLA.
"""

import contextlib
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend import core, source_info_util

from .reads import place_primitive, read_table, texel_of

_SAME = {"broadcast_in_dim", "copy", "expand_dims", "reshape", "squeeze"}
"""Operations that leave a scalar as it is."""
_INNER = {"jit", "pjit", "closed_call", "core_call"}

ELEMENTWISE = {
    *("abs", "add", "add_any", "and", "atan2", "cbrt", "ceil", "clamp", "convert_element_type"),
    *("cos", "div", "eq", "erf", "exp", "exp2", "expm1", "floor", "ge", "gt", "integer_pow"),
    *("is_finite", "le", "log", "log1p", "logistic", "lt", "max", "min", "mul", "ne", "neg", "not"),
    *("or", "pow", "rem", "round", "rsqrt", "select_n", "shift_left", "sign", "sin", "sqrt"),
    *("shift_right_arithmetic", "shift_right_logical", "square", "stop_gradient", "sub", "tan"),
    *("tanh", "xor"),
}


def opened(jaxpr: Any) -> tuple[Any, Sequence[Any]]:
    """A jaxpr and its constants; versions of JAX differ in whether it comes closed."""
    return (jaxpr.jaxpr, jaxpr.consts) if isinstance(jaxpr, core.ClosedJaxpr) else (jaxpr, ())


def inlined(closed: Any) -> Any:
    """The same jaxpr of scalars without calls of other jaxprs; equations know their lines."""
    jaxpr = closed.jaxpr

    def run(*inputs: Any) -> list[Any]:
        values = dict(zip(jaxpr.constvars, closed.consts, strict=True))
        values |= zip(jaxpr.invars, inputs, strict=True)
        look = evaluate(jaxpr.eqns, values, keeps_places=True, keeps_lines=True)
        return [look(variable) for variable in jaxpr.outvars]

    shapes = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in jaxpr.invars]
    return jax.make_jaxpr(run)(*shapes)


def evaluate(
    equations: Sequence[Any],
    values: dict[Any, Any],
    wanted: Sequence[Any] | None = None,
    keeps_places: bool = False,
    keeps_lines: bool = False,
) -> Callable[[Any], Any]:
    """Evaluate equations.

    Args:
        equations: of a jaxpr of scalars, in order.
        values: of the variables that are known.
        wanted: variables that are needed; equations that they do not depend on are left out. All
            equations if None.
        keeps_places: whether `nearest_place` stays an operation of its own.
        keeps_lines: whether equations that this makes are of the lines of those evaluated.

    Returns:
        A function from a variable or a literal to its value.
    """
    values = dict(values)

    def look(atom: Any) -> Any:
        if isinstance(atom, core.Literal):
            return np.asarray(atom.val, getattr(atom.aval, "dtype", None))
        return values[atom]

    chosen = equations if wanted is None else live(equations, wanted)
    for equation in chosen:
        inputs = [look(atom) for atom in equation.invars]
        source = contextlib.nullcontext()
        if keeps_lines:
            source = source_info_util.user_context(equation.source_info.traceback)
        with source:
            results = _equation(equation, inputs, keeps_places, keeps_lines)
        values.update(zip(equation.outvars, results, strict=True))
    return look


def live(equations: Sequence[Any], wanted: Sequence[Any], known: Sequence[Any] = ()) -> list[Any]:
    """The equations that the wanted variables depend on.

    Args:
        equations: of a jaxpr, in order.
        wanted: variables or literals.
        known: variables whose values are known.

    Returns:
        Some of the equations, in order.
    """
    needed = {v for v in wanted if not isinstance(v, core.Literal)} - set(known)
    chosen = []
    for equation in reversed(equations):
        if needed & set(equation.outvars):
            needed |= {v for v in equation.invars if not isinstance(v, core.Literal)} - set(known)
            chosen.append(equation)
    return chosen[::-1]


def _equation(equation: Any, inputs: list[Any], keeps_places: bool, keeps_lines: bool) -> list[Any]:
    name, parameters = equation.primitive.name, equation.params
    if equation.primitive is place_primitive:
        find = place_primitive.bind if keeps_places else texel_of
        return find(*inputs, **parameters)
    if name in _INNER:
        inner, constants = opened(parameters.get("jaxpr") or parameters.get("call_jaxpr"))
        values = dict(zip(inner.constvars, constants, strict=True))
        values |= zip(inner.invars, inputs, strict=True)
        # Lines inside would be those of whoever was the first to call it: traces are kept.
        look = evaluate(inner.eqns, values, inner.outvars, keeps_places)
        return [look(variable) for variable in inner.outvars]
    if name == "gather" and equation.invars[0].aval.ndim == 1:
        return [read_table(*inputs)]
    if name in _SAME and equation.outvars[0].aval.size == 1:
        return [inputs[0]]
    if name in ELEMENTWISE:
        if not all(np.shape(value) == np.shape(inputs[0]) for value in inputs):
            inputs = list(jnp.broadcast_arrays(*inputs))
        return [equation.primitive.bind(*inputs, **parameters)]
    if name == "scan" and parameters["num_consts"] + parameters["num_carry"] == len(inputs):
        return _loop(equation, inputs, keeps_lines)
    return _one_by_one(equation, inputs)


def _loop(equation: Any, inputs: list[Any], keeps_lines: bool) -> list[Any]:
    """A loop that carries values on, as `lax.fori_loop` of known length makes it."""
    parameters, constants = equation.params, equation.params["num_consts"]
    body, closed_over = opened(parameters["jaxpr"])
    scalars = [v for v, o in zip(inputs, equation.invars, strict=True) if o.aval.ndim == 0]
    shape = np.broadcast_shapes(*map(np.shape, scalars))
    known = dict(zip(body.constvars, closed_over, strict=True))
    known |= zip(body.invars[:constants], inputs[:constants], strict=True)

    def step(carried: list[Any], _: None) -> tuple[list[Any], None]:
        values = known | dict(zip(body.invars[constants:], carried, strict=True))
        look = evaluate(body.eqns, values, body.outvars, keeps_lines=keeps_lines)
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
