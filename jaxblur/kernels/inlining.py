"""Write the equations of the jaxprs that a jaxpr calls in place of the calls.

Variables are renamed, nothing is traced again, which would take as long as the first trace.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jax.extend import core

CALLS = {"jit", "pjit", "closed_call", "core_call"}
"""Primitives that do nothing but call a jaxpr."""
SAME = {"broadcast_in_dim", "copy", "expand_dims", "reshape", "squeeze"}
"""Operations that leave a scalar as it is."""


def opened(jaxpr: Any) -> tuple[Any, Sequence[Any]]:
    """A jaxpr and its constants; versions of JAX differ in whether it comes closed."""
    return (jaxpr.jaxpr, jaxpr.consts) if isinstance(jaxpr, core.ClosedJaxpr) else (jaxpr, ())


def called(equation: Any) -> tuple[Any, Sequence[Any]]:
    """The jaxpr that an equation of `CALLS` calls, and its constants."""
    return opened(equation.params.get("jaxpr") or equation.params.get("call_jaxpr"))


def live(equations: Sequence[Any], wanted: Sequence[Any], known: Sequence[Any] = ()) -> list[Any]:
    """The equations that the wanted variables depend on.

    Args:
        equations: of a jaxpr, in order.
        wanted: variables or literals.
        known: variables whose values are known.

    Returns:
        Some of the equations, in order.
    """
    given = set(known)
    needed = {v for v in wanted if not isinstance(v, core.Literal)} - given
    chosen = []
    for equation in reversed(equations):
        if not needed.isdisjoint(equation.outvars):
            needed.update(
                v for v in equation.invars if not isinstance(v, core.Literal) and v not in given
            )
            chosen.append(equation)
    return chosen[::-1]


def inlined(closed: Any) -> Any:
    """The same jaxpr of scalars without calls of other jaxprs; equations know their lines.

    Args:
        closed: a closed jaxpr.

    Returns:
        A closed jaxpr of the equations that its results depend on, inside loops too. Constants are
        in the order in which equations read them.

    Raises:
        ValueError: an equation has no result, as that of ``jax.debug.print``.
    """
    jaxpr = closed.jaxpr
    constants = dict(zip(jaxpr.constvars, closed.consts, strict=True))
    equations: list[Any] = []
    atoms = {variable: variable for variable in (*jaxpr.constvars, *jaxpr.invars)}
    results = _append(equations, constants, jaxpr, atoms, None)
    equations = live(equations, results)
    read = [*(atom for equation in equations for atom in equation.invars), *results]
    kept = dict.fromkeys(v for v in read if not isinstance(v, core.Literal) and v in constants)
    jaxpr = jaxpr.replace(constvars=[*kept], eqns=equations, outvars=results)
    return core.ClosedJaxpr(jaxpr, [constants[variable] for variable in kept])


def _append(
    equations: list[Any], constants: dict[Any, Any], jaxpr: Any, atoms: dict[Any, Any], caller: Any
) -> list[Any]:
    """Append the equations of a jaxpr.

    Args:
        equations: get longer.
        constants: values of variables; get more.
        jaxpr: what is appended.
        atoms: from its constants and inputs to variables and literals; get more.
        caller: the equation that calls it, None for the outermost jaxpr.

    Returns:
        Variables and literals of its results.
    """

    def look(atom: Any) -> Any:
        return atom if isinstance(atom, core.Literal) else atoms[atom]

    for equation in jaxpr.eqns:
        if not equation.outvars:
            raise ValueError(
                f"a program must only compute values, but its operation {equation.primitive} has "
                "an effect; to see a value (jax.debug.print), return it as a channel."
            )
        inputs = [look(atom) for atom in equation.invars]
        # Lines inside would be those of whoever was the first to call it: traces are kept.
        line = caller or equation
        if equation.primitive.name in CALLS:
            inner, values = called(equation)
            variables = [core.Var(variable.aval) for variable in inner.constvars]
            constants.update(zip(variables, values, strict=True))
            within = zip((*inner.constvars, *inner.invars), (*variables, *inputs), strict=True)
            results = _append(equations, constants, inner, dict(within), line)
        elif (same := _unchanged(equation, inputs[0] if inputs else None)) is not None:
            results = [same]
        else:
            results = [core.Var(variable.aval) for variable in equation.outvars]
            parameters = equation.params
            if equation.primitive.name == "scan":
                parameters = parameters | {"jaxpr": _inside(parameters["jaxpr"])}
            equations.append(
                equation.replace(
                    invars=inputs,
                    outvars=results,
                    params=parameters,
                    source_info=line.source_info,
                )
            )
        atoms.update(zip(equation.outvars, results, strict=True))
    return [look(atom) for atom in jaxpr.outvars]


def _inside(jaxpr: Any) -> Any:
    """The body of a loop without calls, closed if it came so."""
    body, values = opened(jaxpr)
    closed = inlined(core.ClosedJaxpr(body, values))
    return closed if body is not jaxpr else closed.jaxpr


def _unchanged(equation: Any, value: Any) -> Any:
    """The variable or literal that the result of an operation on a scalar is, None elsewhere."""
    aval = equation.outvars[0].aval
    if equation.primitive.name in SAME and aval.shape == () and value.aval.shape == ():
        return value
    if equation.primitive.name != "convert_element_type" or aval.shape:
        return None
    if isinstance(value, core.Literal):
        return core.Literal(np.asarray(value.val).astype(aval.dtype), aval)
    return value if value.aval.dtype == aval.dtype else None
