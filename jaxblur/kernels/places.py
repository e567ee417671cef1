"""The derivative in the place at which a program reads.

A program reads the texel nearest to an offset o, ``n = floor(o + 1/2)``. Let f(n) be what it
computes from that texel. As o grows, f(n) jumps each time o passes the border between two texels.
The mean of f(n) over many samples and pixels has no jumps, since o is somewhere else in each. The
derivative here is the one of that mean. It is the derivative of an interpolation between results,
where ``a = o - n`` is the offset from the middle of the texel, and s = -1 or 1 its sign:

    B(o) = f(n) + 4 |a|^3 (f(n + s) - f(n)),    dB/do = 12 a^2 s (f(n + s) - f(n)).

Every share of the neighbor that grows from 0 in the middle of the texel to 1/2 at its border gives
the right mean. The cube is close to 0 but near the border, where the jumps are. That matters for a
squared error, whose derivative is a product with the colors of the same sample: linear
interpolation halves the part of it that is due to noise. Where a = 0, dB/do is that of linear
interpolation, so that motion along an axis has a derivative across it.

The interpolation is between results, not between the texels that are read: two opposed velocities
would cancel. It varies one axis at a time, and where a program reads at several places, one place
at a time.

The offset of a still place is that of a table which moves while the pixel stays. It is often the
same for all samples of a surface, so that a share near the border alone would be 0 or far too
large. Its share of the neighbor is |a|: of the two pixels at an outline exactly one counts.
"""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jax.extend import core

from .inlining import live
from .planes import evaluate
from .reads import place_primitive, rounded, texel_of


def results_of(
    equations: Sequence[Any], values: dict[Any, Any], wanted: Sequence[Any]
) -> list[Any]:
    """Evaluate equations, with the derivative in the places at which they read.

    Args:
        equations: of a jaxpr of scalars without inner calls, in order.
        values: of the variables that are known.
        wanted: variables or literals.

    Returns:
        The values of `wanted`.
    """
    chosen = live(equations, wanted)
    if not any(equation.primitive is place_primitive for equation in chosen):
        look = evaluate(chosen, values)
        return [look(variable) for variable in wanted]
    made = {variable for equation in chosen for variable in equation.outvars}
    used = {v for equation in chosen for v in _read(equation)}
    results = [v for v in dict.fromkeys(filter(_is_variable, wanted)) if v in made]
    stage = _Stage(chosen, [v for v in values if v in used], results)
    computed = stage(*(jnp.asarray(values[variable]) for variable in stage.inputs))
    look = evaluate([], values | dict(zip(results, computed, strict=True)))
    return [look(variable) for variable in wanted]


def _is_variable(atom: Any) -> bool:
    return not isinstance(atom, core.Literal)


def _read(equation: Any) -> list[Any]:
    """The variables that an equation reads."""
    return [atom for atom in equation.invars if _is_variable(atom)]


def _depending(equations: Sequence[Any], variables: Sequence[Any]) -> list[Any]:
    """The equations that depend on some variables."""
    touched, chosen = set(variables), []
    for equation in equations:
        if not touched.isdisjoint(_read(equation)):
            touched.update(equation.outvars)
            chosen.append(equation)
    return chosen


class _Place:
    """A place at which a stage reads, and what depends on it.

    Attributes:
        offsets: variables of the offset, x and y.
        wholes: variables of the nearest texel, x and y.
        blends: whether the value is a blend over four texels.
        after: the equations that depend on the texel.
        around: the variables that those use and that do not depend on it.
        results: which results of the stage depend on it.
    """

    def __init__(self, equation: Any, stage: "_Stage") -> None:
        self.offsets, self.wholes = equation.invars, equation.outvars
        self.blends: bool = equation.params["blends"]
        self.still: bool = equation.params["still"]
        after = _depending(stage.equations, self.wholes)
        made = {*self.wholes, *(v for later in after for v in later.outvars)}
        self.results = [
            k
            for k, v in enumerate(stage.results)
            if v in made and jnp.issubdtype(v.aval.dtype, jnp.inexact)
        ]
        self.after = live(after, [stage.results[k] for k in self.results])
        used = dict.fromkeys(v for later in self.after for v in _read(later))
        self.around = [v for v in used if v not in made]

    def offset(self, look: Any) -> list[jax.Array]:
        """The offset, x and y."""
        return [jnp.asarray(look(variable)) for variable in self.offsets]

    def whole(self, look: Any) -> list[jax.Array]:
        """The texel, x and y."""
        return texel_of(*self.offset(look), blends=self.blends, still=self.still)

    def moved(self, stage: "_Stage", look: Any, wholes: Sequence[Any]) -> list[Any]:
        """The results that depend on the place, with another texel."""
        known = {variable: look(variable) for variable in self.around}
        other = evaluate(self.after, known | dict(zip(self.wholes, wholes, strict=True)))
        return [other(stage.results[k]) for k in self.results]


class _Stage:
    """Equations as a function from inputs to results, with a derivative of its own."""

    def __init__(
        self, equations: Sequence[Any], inputs: Sequence[Any], results: Sequence[Any]
    ) -> None:
        self.equations, self.inputs, self.results = equations, inputs, results

    @functools.cached_property
    def places(self) -> list[_Place]:
        return [_Place(e, self) for e in self.equations if e.primitive is place_primitive]

    def __call__(self, *inputs: jax.Array) -> list[jax.Array]:
        @jax.custom_jvp
        def run(*inputs: jax.Array) -> list[jax.Array]:
            return self._values(inputs)[0]

        run.defjvp(self._derivative, symbolic_zeros=True)
        return run(*inputs)

    @functools.cached_property
    def _of_values(self) -> tuple[list[Any], dict[Any, Any]]:
        """The equations that values alone depend on, and the texels of still places."""
        texels = {v: np.int32(0) for place in self.places if place.still for v in place.wholes}
        blends = [v for place in self.places if place.blends for v in place.offsets]
        return live(self.equations, [*self.results, *blends], list(texels)), texels

    def _values(self, inputs: Sequence[Any], alone: bool = True) -> tuple[list[jax.Array], Any]:
        """The results, and a function from a variable to its value: of these alone, or of all."""
        equations, texels = self._of_values if alone else (self.equations, {})
        look = evaluate(equations, texels | dict(zip(self.inputs, inputs, strict=True)))
        results = [jnp.asarray(look(variable)) for variable in self.results]
        blends = [
            (place, self._blend(place, look, results)) for place in self.places if place.blends
        ]
        for place, blend in blends:
            for k, more in zip(place.results, blend, strict=True):
                results[k] = results[k] + more
        return results, look

    def _derivative(self, inputs: Any, changes: Any) -> Any:
        """The derivative with the texels held, and that in each place."""
        active = [k for k, change in enumerate(changes) if not isinstance(change, SymbolicZero)]
        moving = _depending(self.equations, [self.inputs[k] for k in active])
        reached = {self.inputs[k] for k in active} | {v for e in moving for v in e.outvars}
        places = [
            place
            for place in self.places
            if not place.blends and any(_is_variable(v) and v in reached for v in place.offsets)
        ]
        names = [v for place in places for v in (*place.around, *place.offsets)]
        kept = list(dict.fromkeys(filter(_is_variable, names)))

        def with_texels_held(*values: Any) -> tuple[Any, Any]:
            every = list(inputs)
            for k, value in zip(active, values, strict=True):
                every[k] = value
            results, look = self._values(every, alone=False)
            return (results, [place.offset(look) for place in places]), list(map(look, kept))

        (results, _), (change, moves), values = jax.jvp(
            with_texels_held,
            [inputs[k] for k in active],
            [changes[k] for k in active],
            has_aux=True,
        )
        look = evaluate([], dict(zip(kept, values, strict=True)))
        for place, tangents in zip(places, moves, strict=True):
            for axis, tangent in enumerate(tangents):
                slopes = self._slopes(place, look, axis, results)
                for k, slope in zip(place.results, slopes, strict=True):
                    change[k] = change[k] + slope * tangent
        return results, change

    def _slopes(self, place: _Place, look: Any, axis: int, results: Any) -> list[jax.Array]:
        """Derivatives by the offset along an axis, of the results that depend on the place."""
        (along, across), whole = place.offset(look), place.whole(look)
        if axis == 1:
            along, across = across, along
        along, across = along - whole[axis], across - whole[1 - axis]
        # An offset of 0 has no side (motion along the other axis): it takes that of the other
        # offset, which differs from sample to sample.
        side = jnp.where(jnp.where(along == 0, across, along) < 0, -1, 1)
        moved = list(whole)
        moved[axis] = whole[axis] + side
        others = place.moved(self, look, moved)
        slope = side * (1 if place.still else jnp.where(along == 0, 1, 12 * along * along))
        return [
            slope.astype(other.dtype) * (other - results[k])
            for k, other in zip(place.results, others, strict=True)
        ]

    def _blend(self, place: _Place, look: Any, results: Any) -> list[jax.Array]:
        """What the blend over the four texels around the offset differs by from the nearest."""
        offset = place.offset(look)
        whole = rounded(*offset)
        sides = [jnp.where(o < n, -1, 1) for o, n in zip(offset, whole, strict=True)]
        across, down = (abs(o - n) for o, n in zip(offset, whole, strict=True))
        (x, y), (side_x, side_y) = whole, sides
        corners = [
            (across * (1 - down), place.moved(self, look, [x + side_x, y])),
            ((1 - across) * down, place.moved(self, look, [x, y + side_y])),
            (across * down, place.moved(self, look, [x + side_x, y + side_y])),
        ]
        held = [results[k] for k in place.results]
        return [
            functools.reduce(jnp.add, [share * (values[k] - own) for share, values in corners])
            for k, own in enumerate(held)
        ]
