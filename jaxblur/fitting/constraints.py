"""Smooth maps between the parameters of the filters and the real numbers that are optimized.

An optimizer moves each parameter through all real numbers; the map keeps the parameter inside its
open range, so no value is clipped and no derivative vanishes at a bound. The ranges are those
of the registry (`jaxblur.ParameterInfo`):

===================== ========================================= ==============================
range                 map                                       such as
===================== ========================================= ==============================
above a bound         exponential, ``bound + exp(free)``        kappa, a length, a sharpness
between two bounds    sigmoid                                   tau, a share
any number            identity
===================== ========================================= ==============================

Under the exponential map of a parameter above 0 a step of h is a relative change of h, and so is a
standard error.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..filters.registry import filter_info

INSET = 0.05
"""Share of an interval at either end that no start lies in: the sigmoid is flat there."""


@dataclasses.dataclass(frozen=True)
class Above:
    """All values above a bound, ``value = low + exp(free)``.

    Attributes:
        low: the bound, not reached.
    """

    low: float = 0.0

    def value(self, free: jax.Array) -> jax.Array:
        """Map a real number into the range."""
        return self.low + jnp.exp(free) if self.low else jnp.exp(free)

    def free(self, value: jax.Array) -> jax.Array:
        """Map a value of the range to the real number that gives it."""
        return jnp.log(value - self.low)

    def start(self, value: float) -> float:
        """Take a value as a start; the bound itself cannot be one."""
        if not self.low < value < math.inf:
            raise ValueError(f"must be a number above {self.low:g}, got {value:g}")
        return value

    def at_end(self, value: float) -> bool:
        """Whether a fitted value ran into the end of the range."""
        return not 1e-4 < value - self.low < 1e6

    def around(self, value: float) -> tuple[float, float]:
        """Half and double the distance from the bound."""
        return self.low + (value - self.low) / 2, self.low + 2 * (value - self.low)


@dataclasses.dataclass(frozen=True)
class AnyNumber:
    """All real numbers, as they are."""

    def value(self, free: jax.Array) -> jax.Array:
        """The same number."""
        return free

    def free(self, value: jax.Array) -> jax.Array:
        """The same number."""
        return value

    def start(self, value: float) -> float:
        """Take a value as a start."""
        if not math.isfinite(value):
            raise ValueError(f"must be a finite number, got {value:g}")
        return value

    def at_end(self, value: float) -> bool:
        """Whether a fitted value diverged."""
        return not abs(value) < 1e6

    def around(self, value: float) -> tuple[float, float]:
        """Half the value to either side, and 1 where it is 0."""
        step = abs(value) / 2 or 1.0
        return value - step, value + step


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
        """Whether a fitted value ran into an end of the range."""
        return not 0.01 < (value - self.low) / (self.high - self.low) < 0.99

    def around(self, value: float) -> tuple[float, float]:
        """Both ends of the interval, but for `INSET`."""
        return self.start(self.low), self.start(self.high)


Constraint = Above | Interval | AnyNumber


def constraints_of(filter_name: str) -> dict[str, Constraint]:
    """The smooth maps of a filter's parameters.

    Args:
        filter_name: name of a registered filter.

    Returns:
        Constraints by parameter name; empty for a filter without parameters.

    Raises:
        ValueError: there is no such filter.
    """
    infos = filter_info(filter_name).parameter_infos
    return {name: _constraint(info.low, info.high) for name, info in infos.items()}


def _constraint(low: float, high: float) -> Constraint:
    if not math.isfinite(low):
        return AnyNumber()
    return Interval(low, high) if math.isfinite(high) else Above(low)


def to_free(
    filter_name: str, values: Mapping[str, float], names: Sequence[str]
) -> Float[Array, " names"]:
    """Map parameters to the vector that is optimized.

    Args:
        filter_name: name of a registered filter.
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
        filter_name: name of a registered filter.
        free: one real number for each name.
        names: of the parameters.

    Returns:
        Values by name.
    """
    table = constraints_of(filter_name)
    return {name: table[name].value(free[index]) for index, name in enumerate(names)}


def starting_values(filter_name: str, values: Mapping[str, float]) -> dict[str, float]:
    """The given values as a start of an optimization, none of them on a bound.

    Args:
        filter_name: name of a registered filter.
        values: parameters by name.

    Returns:
        The same names; a value on the bound of an interval is moved inside by `INSET` of it.

    Raises:
        ValueError: a value is out of its range, or at an end from which no descent leads.
    """
    table = constraints_of(filter_name)
    starts = {}
    for name, value in values.items():
        try:
            starts[name] = table[name].start(float(value))
        except ValueError as error:
            raise ValueError(f"`initial.{name}` {error}; start inside the range.") from error
    return starts
