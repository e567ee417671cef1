"""Smooth maps between the parameters of the filters and the real numbers that are optimized.

An optimizer moves each parameter through all real numbers; the map keeps the parameter inside its
open range, so that no value is clipped and no derivative vanishes at a bound.

=============== ============== ============= ====================================================
parameter       range          map           because
=============== ============== ============= ====================================================
kappa           above 0        exponential   divides a weight
gamma           above 0        exponential   divides a speed
tau             between 0, 1   sigmoid       reach of the tile jitter; beyond 1 leaves the ring
eta             above 0        exponential   scale of the tap jitter
phi             above 0        exponential   scale of the tap jitter
depth_sharpness above 0        exponential   scale of relative depth
soft_z_extent   above 0        exponential   a length
=============== ============== ============= ====================================================

Of `layered`, ``bend``, ``jitter`` and ``thin_coverage`` are shares between 0 and 1, the others are
positive scales.

Under the exponential map a step of h is a relative change of h, and so is a standard error.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

INSET = 0.05
"""Share of an interval at either end where nothing starts: the sigmoid is flat there."""


@dataclasses.dataclass(frozen=True)
class Positive:
    """All values above 0, ``value = exp(free)``."""

    def value(self, free: jax.Array) -> jax.Array:
        """Map a real number into the range."""
        return jnp.exp(free)

    def free(self, value: jax.Array) -> jax.Array:
        """Map a value of the range to the real number that gives it."""
        return jnp.log(value)

    def start(self, value: float) -> float:
        """Take a value as a start; only 0, an end of the range, cannot be one."""
        if not 0 < value < float("inf"):
            raise ValueError(f"must be a number above 0, got {value:g}")
        return value

    def at_end(self, value: float) -> bool:
        """Tell whether a fitted value ran into the end of the range."""
        return not 1e-4 < value < 1e6


@dataclasses.dataclass(frozen=True)
class Interval:
    """Values between two bounds, ``value = low + (high - low) sigmoid(free)``.

    Attributes:
        low: lower bound, not reached.
        high: upper bound, not reached.
    """

    low: float
    high: float

    def value(self, free: jax.Array) -> jax.Array:
        """Map a real number into the range."""
        return self.low + (self.high - self.low) * jax.nn.sigmoid(free)

    def free(self, value: jax.Array) -> jax.Array:
        """Map a value of the range to the real number that gives it."""
        share = (value - self.low) / (self.high - self.low)
        return jnp.log(share) - jnp.log1p(-share)

    def start(self, value: float) -> float:
        """Move a value that lies on a bound, or within `INSET` of it, inside."""
        if not self.low <= value <= self.high:
            raise ValueError(f"must be from {self.low:g} to {self.high:g}, got {value:g}")
        inset = INSET * (self.high - self.low)
        return min(max(value, self.low + inset), self.high - inset)

    def at_end(self, value: float) -> bool:
        """Tell whether a fitted value ran into an end of the range."""
        return not 0.01 < (value - self.low) / (self.high - self.low) < 0.99


Constraint = Positive | Interval

CONSTRAINTS: dict[str, dict[str, Constraint]] = {
    "guertin2014": {
        "kappa": Positive(),
        "gamma": Positive(),
        "tau": Interval(0.0, 1.0),
        "eta": Positive(),
        "phi": Positive(),
        "depth_sharpness": Positive(),
    },
    "mcguire2012": {"soft_z_extent": Positive()},
    "pixel_velocity": {},
    "layered": {
        "front_sharpness": Positive(),
        "landing_tolerance": Positive(),
        "own_tolerance": Positive(),
        "surface_sharpness": Positive(),
        "bend": Interval(0.0, 1.0),
        "jitter": Interval(0.0, 1.0),
        "distinct": Positive(),
        "thin_coverage": Interval(0.0, 1.0),
    },
}
"""Range of every parameter of every filter."""


def constraints_of(filter_name: str) -> dict[str, Constraint]:
    """The ranges of a filter's parameters.

    Args:
        filter_name: a key of `jaxblur.FILTERS`.

    Returns:
        Constraints by parameter name; empty for a filter without parameters.

    Raises:
        ValueError: no ranges are known for the filter.
    """
    if filter_name not in CONSTRAINTS:
        known = ", ".join(CONSTRAINTS)
        raise ValueError(f"`filter` must be one of {known}, got {filter_name!r}.")
    return CONSTRAINTS[filter_name]


def to_free(
    filter_name: str, values: Mapping[str, float], names: Sequence[str]
) -> Float[Array, " names"]:
    """Map parameters to the vector that is optimized.

    Args:
        filter_name: a key of `jaxblur.FILTERS`.
        values: parameters by name, strictly inside their ranges.
        names: which of them, and in which order.

    Returns:
        One real number for each name.
    """
    table = constraints_of(filter_name)
    return jnp.stack([table[name].free(jnp.asarray(values[name], float)) for name in names])


def to_values(
    filter_name: str, free: Float[Array, " names"], names: Sequence[str]
) -> dict[str, jax.Array]:
    """Map an optimized vector to parameters; smooth, the inverse of `to_free`.

    Args:
        filter_name: a key of `jaxblur.FILTERS`.
        free: one real number for each name.
        names: of the parameters.

    Returns:
        Values by name.
    """
    table = constraints_of(filter_name)
    return {name: table[name].value(free[index]) for index, name in enumerate(names)}


def starting_values(filter_name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Where an optimization can start: the given values, none of them on a bound.

    Args:
        filter_name: a key of `jaxblur.FILTERS`.
        values: parameters by name.

    Returns:
        The same names; a value on the bound of an interval is moved inside by `INSET` of it.

    Raises:
        ValueError: a value is out of its range, or at an end that it cannot leave.
    """
    table = constraints_of(filter_name)
    starts = {}
    for name, value in values.items():
        try:
            starts[name] = table[name].start(float(value))
        except ValueError as error:
            raise ValueError(f"`initial.{name}` {error}; start inside the range.") from error
    return starts
