"""A prior: fitted parameters stay near the published values unless the frames speak against them.

With u the unconstrained parameters of `jaxblur.fitting.constraints`, u* the published ones and L
the loss, a fit with a prior of strength s minimizes

    L(u) + s L(u*) / 2 sum_k (u_k - u*_k)^2,

the negative logarithm of a Gaussian around u* of standard deviation 1 / sqrt(s), in units of the
published loss. For a parameter above 0 the unconstrained form is the logarithm: at s = 0.01, a
value e times the published one costs half a percent of the published loss.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


@dataclasses.dataclass(frozen=True, eq=False)
class Prior:
    """A Gaussian around the published values, in the unconstrained parameters.

    Attributes:
        center: u*, (names,).
        curvature: s L(u*), the second derivative of the penalty along each parameter.
    """

    center: Float[Array, " names"]
    curvature: float

    def added_to(
        self, loss: jax.Array, gradient: jax.Array, free: Float[Array, " names"]
    ) -> tuple[jax.Array, jax.Array]:
        """Loss and gradient with those of the penalty.

        Args:
            loss: L(u), a scalar.
            gradient: of L, (names,).
            free: u, (names,).

        Returns:
            The same of the minimized sum.
        """
        away = free - self.center
        penalty = self.curvature / 2 * jnp.sum(jnp.square(away))
        return loss + penalty, gradient + self.curvature * away
