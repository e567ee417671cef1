"""The arc on which a point moves, far beyond the exposure: from a frame to the next."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from ...safe_math import safe_divide
from .paths import Vector

_CURVED = 1e-3
"""Radians. Below, an arc equals the parabola in float32."""
_WIDEST = 2 / 3 * math.pi
"""Radians per frame, as in `jaxblur.vectors.to_half_spread`: how far an arc can turn."""


class Bend(NamedTuple):
    """What bends an arc.

    Attributes:
        along: c1, pixels.
        across: c2, pixels.
        curved: whether it is no parabola.
        angle: w, radians.
        chord: 1/sin(w).
        sagitta: 1/sin(w/2)^2.
    """

    along: Vector
    across: Vector
    curved: Array
    angle: Array
    chord: Array
    sagitta: Array


class Arc(NamedTuple):
    """The motion of a point that is at its own place at t = 0; t is in half exposures.

    With l half of the chord and the rest c split into c1 along l and c2 across it, the arc is

        x(t) = l sin(w t)/sin(w) + c2 sin(w t/2)^2/sin(w/2)^2 + c1 t^2,  tan(w/2) = |c2|/|l|,

    as `jaxblur.vectors.to_half_spread` defines it.

    Attributes:
        line: l, pixels.
        bend: None where the motion is straight.
    """

    line: Vector
    bend: Bend | None

    @classmethod
    def through(cls, vectors: Sequence[Array], half: Array | None = None) -> "Arc":
        """The arc of the vectors that a frame has.

        Args:
            vectors: x and y of a velocity; or of the displacements at opening and closing.
            half: half of the exposure in frames, which bounds how far the arc turns in a half
                exposure as `to_half_spread` does, so that the arc at the next frame is where its
                vector leads; None for no bound.

        Returns:
            The arc.
        """
        if len(vectors) == 2:
            return cls((vectors[0], vectors[1]), None)
        opening_x, opening_y, closing_x, closing_y = vectors
        x, y = (closing_x - opening_x) / 2, (closing_y - opening_y) / 2
        rest_x, rest_y = (closing_x + opening_x) / 2, (closing_y + opening_y) / 2
        inverse = safe_divide(jnp.ones_like(x), x * x + y * y)
        along, across = (x * rest_x + y * rest_y) * inverse, (x * rest_y - y * rest_x) * inverse
        ratio = jnp.abs(across)
        curved = ratio > _CURVED
        angle = 2 * jnp.arctan(jnp.where(curved, ratio, 1))
        if half is not None:
            angle = jnp.minimum(angle, _WIDEST * half)
        bend = Bend(
            along=(along * x, along * y),
            across=(-across * y, across * x),
            curved=curved,
            angle=angle,
            chord=1 / jnp.sin(angle),
            sagitta=1 / jnp.square(jnp.sin(angle / 2)),
        )
        return cls((x, y), bend)

    def at(self, time: Array) -> Vector:
        """Displacement at a time; x and y, pixels."""
        x, y = self.line
        if self.bend is None:
            return time * x, time * y
        along, across, curved, angle, *scales = self.bend
        squared = time * time
        chord = jnp.where(curved, jnp.sin(time * angle) * scales[0], time)
        sagitta = jnp.where(curved, jnp.square(jnp.sin(time * angle / 2)) * scales[1], squared)
        return (
            chord * x + sagitta * across[0] + squared * along[0],
            chord * y + sagitta * across[1] + squared * along[1],
        )
