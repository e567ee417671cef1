"""The published filters as the parser needs to know them, without loading jax.

A test holds this table against `jaxblur.filters.PUBLISHED`.
"""

import dataclasses
import math
from collections.abc import Iterable, Mapping

from jaxblur.settings import Fetch

from .arguments import CommandError, did_you_mean


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A filter parameter.

    Attributes:
        default: the published value.
        low: smallest value.
        high: largest value.
        open: ``low`` itself is not allowed.
        meaning: a few words for the help.
    """

    default: float
    low: float
    high: float
    open: bool
    meaning: str

    def range(self) -> str:
        """Say which values are allowed."""
        if math.isfinite(self.high):
            return f"{self.low:g} to {self.high:g}"
        return f"above {self.low:g}" if self.open else f"{self.low:g} or more"

    def allows(self, value: float) -> bool:
        """Tell whether a value is in range; NaN and infinity are not."""
        above = value > self.low if self.open else value >= self.low
        return math.isfinite(value) and above and value <= self.high


@dataclasses.dataclass(frozen=True)
class Published:
    """A filter with its published settings.

    Attributes:
        parameters: by name.
        samples: taps per pixel.
        radius: longest half-spread, pixels.
        fetch: how color is read at a tap.
    """

    parameters: Mapping[str, Parameter]
    samples: int
    radius: int
    fetch: Fetch = "nearest"


def _positive(default: float, meaning: str) -> Parameter:
    return Parameter(default, 0.0, math.inf, True, meaning)


def _not_negative(default: float, meaning: str) -> Parameter:
    return Parameter(default, 0.0, math.inf, False, meaning)


FILTERS: dict[str, Published] = {
    "guertin2014": Published(
        {
            "kappa": _positive(40.0, "divides the weight of the pixel's own color"),
            "gamma": _positive(1.5, "speed, px, over which the second direction turns"),
            "tau": Parameter(1.0, 0.0, 1.0, False, "reach of the tile jitter, tiles"),
            "eta": _not_negative(0.95, "largest jitter of the samples, spacings"),
            "phi": _not_negative(27.0, "number of samples that eta refers to"),
            "depth_sharpness": _positive(1.0, "how strictly depths are told apart"),
        },
        samples=35,
        radius=40,
    ),
    "mcguire2012": Published(
        {"soft_z_extent": _positive(0.1, "depth over which things overlap, scene units")},
        samples=15,
        radius=20,
    ),
    "pixel_velocity": Published({}, samples=35, radius=40),
    "layered": Published(
        {
            "front_sharpness": _positive(6.7, "how strictly one depth is in front of another"),
            "landing_tolerance": _positive(1.0, "px by which a guess may miss the pixel"),
            "own_tolerance": _positive(0.42, "change of velocity within a surface, share"),
            "surface_sharpness": _positive(20.0, "how strictly depths of a surface agree"),
            "bend": Parameter(0.5, 0.0, 1.0, False, "bending of the own way by its velocities"),
            "jitter": Parameter(1.0, 0.0, 1.0, False, "noise of the taps, share of a stratum"),
            "distinct": _positive(1.0, "px from which on velocities count as different"),
            "thin_coverage": Parameter(
                0.5, 0.0, 1.0, True, "least share of a pixel that thin things cover"
            ),
        },
        samples=35,
        radius=160,
        fetch="bilinear",
    ),
}
DEFAULT_FILTER = "layered"
GUERTIN_CHOICES = ("tile_choice", "split", "directions", "direction_weights", "diagonal_tiles")
"""Choices of `jaxblur.Settings` that only ``guertin2014`` has."""
FITTED_FILTER = "guertin2014"
"""What `jaxblur fit` fits unless another is named: the one whose parameters are free by default."""


def checked_parameters(
    name: str, given: Mapping[str, float], source: str = "--param"
) -> dict[str, float]:
    """Complete the parameters of a filter by the published ones.

    Args:
        name: a key of `FILTERS`.
        given: values by parameter name.
        source: where they come from, for the message.

    Returns:
        All parameters of the filter.

    Raises:
        CommandError: the filter has no such parameter, or a value is out of range.
    """
    table = FILTERS[name].parameters
    check_names(name, given, source)
    for parameter, value in given.items():
        if not table[parameter].allows(value):
            allowed = table[parameter].range()
            raise CommandError(f"{source}: {parameter} must be {allowed}, got {value:g}.")
    return {parameter: known.default for parameter, known in table.items()} | dict(given)


def check_names(name: str, parameters: Iterable[str], source: str) -> None:
    """Refuse parameters that a filter does not have.

    Args:
        name: a key of `FILTERS`.
        parameters: their names.
        source: where they come from, for the message.

    Raises:
        CommandError: there is one.
    """
    table = FILTERS[name].parameters
    for parameter in parameters:
        if parameter not in table:
            known = f"it has {', '.join(table)}" if table else "it has none"
            hint = did_you_mean(parameter, table)
            raise CommandError(f"{source}: {name} has no parameter {parameter!r}{hint}; {known}.")


def describe_filters() -> str:
    """List filters, parameters and published values for the help."""
    lines = ["filters, with their published settings and --param names:"]
    for name, published in FILTERS.items():
        settings = f"--samples {published.samples} --radius {published.radius}"
        lines.append(f"  {name}: {settings} --fetch {published.fetch}")
        lines += [
            f"      {f'{key}={parameter.default:g}':<20} {parameter.meaning} ({parameter.range()})"
            for key, parameter in published.parameters.items()
        ]
    return "\n".join(lines)
