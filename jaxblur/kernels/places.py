"""The derivative in the place at which a program reads.

A program reads at whole places, ``n = floor(o + 1/2)`` for an offset o. What it computes from a
texel, f(n), changes by jumps as o grows, and its mean over samples and pixels changes smoothly: it
is that of a blend over the texels around the offset,

    B(o) = sum_c share_c(o) f(c),  c the four texels around o,

whose derivative is, along each axis and with s = -1 or 1 the side of the texel's middle on which
the offset lies,

    dB/do = s (f(n + s) - f(n)).

The terms of a sample are blended, never what is read, so that opposed motions do not cancel.
Where a program reads at several places, one is varied at a time.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jax.extend import core

from .planes import evaluate, live
from .reads import place_primitive, rounded


def results_of(equations: Sequence[Any], values: dict[Any, Any], wanted: Sequence[Any]) -> Any:
    """Evaluate equations, with the derivative in the places at which they read.

    Args:
        equations: of a jaxpr of scalars without inner calls, in order.
        values: of the variables that are known.
        wanted: variables or literals.

    Returns:
        The values of `wanted`, a list.
    """
    chosen = live(equations, wanted)
    made = {variable for equation in chosen for variable in equation.outvars}
    results = [v for v in dict.fromkeys(v for v in wanted if _is_variable(v)) if v in made]
    if not any(equation.primitive is place_primitive for equation in chosen):
        look = evaluate(chosen, values)
        return [look(variable) for variable in wanted]
    used = {v for equation in chosen for v in equation.invars if _is_variable(v)}
    stage = _Stage(chosen, [v for v in values if v in used], results)
    computed = stage(*(jnp.asarray(values[variable]) for variable in stage.inputs))
    look = evaluate([], values | dict(zip(results, computed, strict=True)))
    return [look(variable) for variable in wanted]


def _is_variable(atom: Any) -> bool:
    return not isinstance(atom, core.Literal)


class _Stage:
    """Equations as a function from inputs to results, with a derivative of its own."""

    def __init__(
        self, equations: Sequence[Any], inputs: Sequence[Any], results: Sequence[Any]
    ) -> None:
        self.equations, self.inputs, self.results = equations, inputs, results

    def __call__(self, *inputs: jax.Array) -> list[jax.Array]:
        @jax.custom_jvp
        def run(*inputs: jax.Array) -> list[jax.Array]:
            return self._values(inputs)[0]

        run.defjvp(self._derivative, symbolic_zeros=True)
        return run(*inputs)

    def _values(self, inputs: Sequence[Any]) -> tuple[list[jax.Array], Any]:
        """The results, and a function from a variable to its value."""
        look = evaluate(self.equations, dict(zip(self.inputs, inputs, strict=True)))
        results = [jnp.asarray(look(variable)) for variable in self.results]
        for place in self._places():
            if place.params["blends"]:
                blend = self._blend(place, look)
                results = [a + b for a, b in zip(results, blend, strict=True)]
        return results, look

    def _places(self) -> list[Any]:
        return [e for e in self.equations if e.primitive is place_primitive]

    def _derivative(self, inputs: Any, changes: Any) -> Any:
        active = [k for k, change in enumerate(changes) if not isinstance(change, SymbolicZero)]
        reached = self._reached([self.inputs[k] for k in active])
        places = [
            place
            for place in self._places()
            if not place.params["blends"] and reached & set(map(_hashable, place.invars))
        ]
        kept = sorted({v for place in places for v in self._around(place)}, key=self._number)

        def smooth(*values: Any) -> tuple[Any, Any]:
            every = list(inputs)
            for k, value in zip(active, values, strict=True):
                every[k] = value
            results, look = self._values(every)
            offsets = [[jnp.asarray(look(v)) for v in place.invars] for place in places]
            return (results, offsets), [look(variable) for variable in kept]

        primals, tangents = [inputs[k] for k in active], [changes[k] for k in active]
        (results, _), (change, moves), around = jax.jvp(
            smooth, primals, tangents, has_aux=True
        )
        look = evaluate([], dict(zip(kept, around, strict=True)))
        for place, tangent in zip(places, moves, strict=True):
            for axis, along in enumerate(tangent):
                slopes = self._slopes(place, look, axis, results)
                change = [
                    total if slope is None else total + slope * along
                    for total, slope in zip(change, slopes, strict=True)
                ]
        return results, change

    def _slopes(self, place: Any, look: Any, axis: int, results: Any) -> list[Any]:
        """Derivative of each result by an offset along one axis; None where there is none."""
        offset = jnp.asarray(look(place.invars[axis]))
        whole = rounded(*(look(v) for v in place.invars))
        side = jnp.where(offset < whole[axis], -1, 1)
        moved = list(whole)
        moved[axis] = whole[axis] + side
        beside = self._moved(place, look, moved)
        return [
            (other - result) * side.astype(result.dtype)
            if other is not None and jnp.issubdtype(result.dtype, jnp.inexact)
            else None
            for result, other in zip(results, beside, strict=True)
        ]

    def _after(self, place: Any) -> list[Any]:
        """The equations that depend on a place."""
        touched, chosen = set(place.outvars), []
        for equation in self.equations:
            if any(v in touched for v in equation.invars if _is_variable(v)):
                touched |= set(equation.outvars)
                chosen.append(equation)
        return chosen

    def _around(self, place: Any) -> set[Any]:
        """The variables that have to be known to move a place: its offsets, and what joins it."""
        after = self._after(place)
        made = {*place.outvars, *(v for equation in after for v in equation.outvars)}
        used = {v for e in (place, *after) for v in e.invars if _is_variable(v)}
        return used - made

    def _moved(self, place: Any, look: Any, moved: Sequence[Any]) -> list[Any]:
        """The results as they are with another place; None for those that do not depend on it."""
        after = self._after(place)
        made = {v for equation in after for v in equation.outvars}
        known = {v: look(v) for v in self._around(place)}
        known |= zip(place.outvars, moved, strict=True)
        wanted = [v for v in self.results if v in made]
        other = evaluate(after, known, wanted)
        return [other(v) if v in made else None for v in self.results]

    def _blend(self, place: Any, look: Any) -> list[Any]:
        raise NotImplementedError

    def _reached(self, variables: Sequence[Any]) -> set[Any]:
        """The variables that depend on these."""
        reached = set(variables)
        for equation in self.equations:
            if reached & set(map(_hashable, equation.invars)):
                reached |= set(equation.outvars)
        return reached

    def _number(self, variable: Any) -> int:
        order = [*self.inputs, *(v for e in self.equations for v in e.outvars)]
        return order.index(variable)


def _hashable(atom: Any) -> Any:
    return atom if _is_variable(atom) else None
