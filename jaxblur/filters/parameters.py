"""Parameters of the filters: their records, and what the rest of the package must know of each.

Loads no jax, so that the command line can list and check parameters at once.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import jax

_KEY = "jaxblur"


@dataclasses.dataclass(frozen=True, kw_only=True)
class ParameterInfo:
    """One parameter of a filter: default, range, meaning.

    Attributes:
        default: its usual value: the published one, where the filter was published.
        low: lower end of the range; ``-inf`` together with a ``high`` of ``inf`` for any number.
        high: upper end of the range, allowed if it is finite.
        includes_low: whether ``low`` itself is allowed. Fits stay above it in either case.
        meaning: a few words for the help.
        unit: of the value; empty for a plain number.
        free: whether `jaxblur.fit` fits it unless told otherwise.
        useful: lower and upper end of the values that make a difference, within the range that is
            allowed; infinite where there is no such end. A fit that ends there found no value: what
            the parameter controls is switched off, or does all that it can.
        ends: what the filter does at the lower and at the upper end of ``useful``, in words that
            follow "at the end of its useful range,".
    """

    default: float
    low: float
    high: float
    includes_low: bool
    meaning: str
    unit: str = ""
    free: bool = True
    useful: tuple[float, float] = (-math.inf, math.inf)
    ends: tuple[str, str] = ("", "")

    def __post_init__(self):
        if not self.low < self.high or (self.low == -math.inf and self.high < math.inf):
            raise ValueError(
                f"`low` must be a number below `high`, got {self.low:g} and {self.high:g}; for "
                "any number leave out both."
            )
        if not self.allows(self.default):
            raise ValueError(f"`default` must be {self.range}, got {self.default:g}.")
        first, last = self.useful
        if not first < self.default < last:
            raise ValueError(
                f"`useful` must be two values around the default {self.default:g}, got {first:g} "
                f"and {last:g}; -math.inf and math.inf leave an end open."
            )
        for end, reason in zip(self.useful, self.ends, strict=True):
            if math.isfinite(end) and not reason:
                raise ValueError(f"`ends` must say what the filter does at {end:g}.")

    @property
    def range(self) -> str:
        """The values that are allowed, in words: ``above 0 px``."""
        unit = f" {self.unit}" if self.unit else ""
        if math.isfinite(self.high):
            return f"{self.low:g} to {self.high:g}{unit}"
        if not math.isfinite(self.low):
            return f"any number{unit and f', in{unit}'}"
        return f"{self.low:g}{unit} or more" if self.includes_low else f"above {self.low:g}{unit}"

    def allows(self, value: float) -> bool:
        """Whether a value is in range; NaN and infinity are not."""
        above = value >= self.low if self.includes_low else value > self.low
        return math.isfinite(value) and above and value <= self.high

    def useless(self, value: float) -> str:
        """What the filter does with a value at, or beyond, an end of the useful range.

        Args:
            value: in the range that is allowed.

        Returns:
            The entry of `ends`; empty for a value inside.

        Examples:
            >>> from jaxblur import filter_info
            >>> filter_info("guertin2014").parameter_infos["depth_sharpness"].useless(0.0019)
            'depth is switched off'
        """
        first, last = self.useful
        if value <= first:
            return self.ends[0]
        return self.ends[1] if value >= last else ""


def parameter(
    default: float,
    *,
    above: float | None = None,
    low: float | None = None,
    high: float = math.inf,
    meaning: str,
    unit: str = "",
    free: bool = True,
    useful: tuple[float, float] = (-math.inf, math.inf),
    ends: tuple[str, str] = ("", ""),
) -> Any:
    """A field of a filter's parameters, with what the rest of the package must know of it.

    The value of a field is a float, an array without axes, or a tracer.

    Args:
        default: its usual value.
        above: lower end of the range, not allowed itself.
        low: lower end of the range, allowed itself; give one of the two, or neither for any number.
        high: upper end of the range, allowed itself.
        meaning: a few words for the help.
        unit: of the value; empty for a plain number.
        free: whether `jaxblur.fit` fits it unless told otherwise.
        useful: see `ParameterInfo`.
        ends: see `ParameterInfo`.

    Returns:
        A `dataclasses.field`.

    Raises:
        ValueError: a range is empty or ambiguous, or does not hold the default.

    Examples:
        >>> @dataclasses.dataclass(frozen=True)
        ... class Parameters:
        ...     strength: float = parameter(1.0, above=0.0, meaning="strength of the blur")
        >>> infos_of(Parameters)["strength"].range
        'above 0'
    """
    if above is not None and low is not None:
        raise ValueError("`above` and `low` must not both be given; leave out one of the two.")
    lowest = above if low is None else low
    info = ParameterInfo(
        default=default,
        low=-math.inf if lowest is None else lowest,
        high=high,
        includes_low=above is None,
        meaning=meaning,
        unit=unit,
        free=free,
        useful=useful,
        ends=ends,
    )
    return dataclasses.field(default=default, metadata={_KEY: info})


def infos_of(parameters: type | None) -> dict[str, ParameterInfo]:
    """The `ParameterInfo` of each field of a filter's parameters.

    Args:
        parameters: a dataclass whose fields were made by `parameter`, or None.

    Returns:
        By name, in the order of the fields; empty for None.

    Raises:
        ValueError: it is no dataclass, or a field was not made by `parameter`.
    """
    if parameters is None:
        return {}
    if not (isinstance(parameters, type) and dataclasses.is_dataclass(parameters)):
        raise ValueError(f"`parameters` must be a dataclass or None, got {parameters!r}.")
    infos = {}
    for field in dataclasses.fields(parameters):
        if _KEY not in field.metadata:
            raise ValueError(
                f"`{parameters.__name__}.{field.name}` must have a default made by "
                "`jaxblur.parameter`, which gives its range and meaning."
            )
        infos[field.name] = field.metadata[_KEY]
    return infos


# Useful ranges end where another factor of three changes test frames by less than one or two
# percent of what the blur changes, or where what the parameter controls has vanished.
NO_DEPTH, STRICT_DEPTH = "depth is switched off", "every difference of depth is a full step"


def check_parameters_type(
    parameters: object, kind: type | None, filter: str, argument: str = "parameters"
) -> None:
    """Reject what are not the parameters of a filter; values are not looked at, but for their type.

    Args:
        parameters: as given.
        kind: the class that the filter takes, or None if it has no parameters.
        filter: its name, for the message.
        argument: name of the argument, for the message.

    Raises:
        ValueError: they are of another class, or one of them is no number.
    """
    given = type(parameters).__name__
    if kind is None:
        if parameters is not None:
            raise ValueError(
                f"`{argument}` must be None: {filter} has no parameters, not {given}; leave it out."
            )
        return
    name = kind.__name__
    if not isinstance(parameters, kind):
        remedy = f"pass {name}()"
        if isinstance(parameters, type):
            given = f"the class {parameters.__name__} itself"
        elif isinstance(parameters, dict):
            remedy = f"pass {name}(**values)"
        raise ValueError(
            f"`{argument}` must be {name}: {filter} takes {name}, not {given}; {remedy}."
        )
    for field, value in vars(parameters).items():
        if value is None or isinstance(value, str | bytes | list | tuple | dict):
            raise ValueError(f"`{argument}.{field}` must be a number, got {value!r}.")


@dataclasses.dataclass(frozen=True)
class GuertinParameters:
    """Parameters of Guertin 2014; floats, arrays or tracers. Defaults are the published ones.

    Attributes:
        kappa: divides the weight of the pixel's own color, > 0.
        gamma: speed in pixels over which the second direction turns from the perpendicular of
            the dominant velocity to the pixel's own velocity, > 0.
        tau: reach of the tile jitter in tiles, in [0, 1]; differentiable with
            ``tile_choice="expected"`` only.
        eta: largest jitter of the taps, in spacings at N = phi. Only eta * phi matters.
        phi: number of samples that eta refers to: the jitter shrinks as phi / N.
        depth_sharpness: k of departure 1; 1 as published separates depths that differ by a factor
            of two, 10 to 20 separates 5 to 10 percent.
    """

    kappa: float | jax.Array = parameter(
        40.0,
        above=0.0,
        meaning="divides the weight of the pixel's own color",
        useful=(0.1, 3e3),
        ends=(
            "the pixel's own color outweighs all samples",
            "its own color has no weight of its own",
        ),
    )
    gamma: float | jax.Array = parameter(
        1.5,
        above=0.0,
        meaning="speed over which the second direction turns",
        unit="px",
        useful=(0.1, 1e3),
        ends=(
            "the second direction is the pixel's own velocity at any speed",
            "the second direction is the perpendicular at any speed",
        ),
    )
    tau: float | jax.Array = parameter(
        1.0,
        low=0.0,
        high=1.0,
        meaning="reach of the tile jitter",
        unit="tiles",
        useful=(0.05, math.inf),
        ends=("the tile jitter is switched off", ""),
    )
    eta: float | jax.Array = parameter(
        0.95,
        low=0.0,
        meaning="largest jitter of the samples",
        unit="spacings",
        free=False,
        useful=(0.003, 30.0),
        ends=("the jitter is switched off", "the jitter is as long as the path"),
    )
    phi: float | jax.Array = parameter(
        27.0,
        low=0.0,
        meaning="number of samples that eta refers to",
        useful=(0.1, 1e3),
        ends=("the jitter is switched off", "the jitter is as long as the path"),
    )
    depth_sharpness: float | jax.Array = parameter(
        1.0,
        above=0.0,
        meaning="how strictly depths are separated",
        free=False,
        useful=(0.03, 1e3),
        ends=(NO_DEPTH, STRICT_DEPTH),
    )


@dataclasses.dataclass(frozen=True)
class McGuireParameters:
    """Parameters of McGuire 2012; floats, arrays or tracers.

    Attributes:
        soft_z_extent: depth over which foreground fades into background, in scene units, > 0.
    """

    soft_z_extent: float | jax.Array = parameter(
        0.1,
        above=0.0,
        meaning="depth over which foreground fades into background",
        unit="units",
        # Wide, since it depends on the unit of the scene; a flat profile says the rest.
        useful=(1e-5, 1e5),
        ends=(STRICT_DEPTH, NO_DEPTH),
    )


@dataclasses.dataclass(frozen=True)
class LayeredParameters:
    """Parameters of the layered filter; floats, arrays or tracers.

    The first three were fitted to scenes of the catalogue with an earlier edition of the filter;
    they were kept, since the optimum is flat. The others have round values (experiment 012).

    Attributes:
        front_sharpness: how strictly one depth is in front of another, per unit of log depth,
            > 0: at 10, ten percent of depth are a full step, at 6.7 sixteen.
        landing_tolerance: pixels by which the place that a guess leads to may miss the pixel, > 0.
        own_tolerance: largest difference of velocity within a surface, as a share of the pixel's
            own velocity, > 0.
        surface_sharpness: how strictly depths of one surface agree, per unit of log depth, > 0.
        bend: how much the path along the own velocity bends with the change of velocity along it,
            0 to 1: 0.5 is the path of a motion whose velocities stay where they are in the image.
        jitter: share of a tap's stratum over which noise moves the tap, 0 to 1.
        distinct: difference in pixels from which another velocity counts as different from the
            pixel's own, > 0.
        thin_coverage: least share of its pixels that an object of one pixel's width covers, above
            0, at most 1; 1 leaves its vectors as they are.
    """

    front_sharpness: float | jax.Array = parameter(
        6.7,
        above=0.0,
        meaning="how strictly one depth is in front of another",
        # The sky is a factor of 1e18 away, 40 in log depth.
        useful=(1e-3, 1e3),
        ends=(NO_DEPTH, STRICT_DEPTH),
    )
    landing_tolerance: float | jax.Array = parameter(
        1.0,
        above=0.0,
        meaning="distance by which a guess may miss the pixel",
        unit="px",
        useful=(0.01, 30.0),
        ends=("a guess lands only where it meets the pixel exactly", "every guess lands"),
    )
    own_tolerance: float | jax.Array = parameter(
        0.42,
        above=0.0,
        meaning="difference of velocity within a surface, as a share of it",
        useful=(0.03, 3.0),
        ends=("only equal velocities are of one surface", "all velocities are of one surface"),
    )
    surface_sharpness: float | jax.Array = parameter(
        20.0,
        above=0.0,
        meaning="how strictly depths of a surface agree",
        useful=(0.01, 1e4),
        ends=("all depths are of one surface", "only equal depths are of one surface"),
    )
    bend: float | jax.Array = parameter(
        0.5,
        low=0.0,
        high=1.0,
        meaning="how much its own velocities bend a pixel's path",
        useful=(0.02, math.inf),
        ends=("paths are not bent", ""),
    )
    jitter: float | jax.Array = parameter(
        1.0,
        low=0.0,
        high=1.0,
        meaning="noise of the taps, share of a stratum",
        useful=(0.02, math.inf),
        ends=("the jitter is switched off", ""),
    )
    distinct: float | jax.Array = parameter(
        20.0,
        above=0.0,
        meaning="difference from which two velocities count as two",
        unit="px",
        useful=(0.01, 30.0),
        ends=("all velocities count as different", "no two velocities count as different"),
    )
    thin_coverage: float | jax.Array = parameter(
        0.5,
        above=0.0,
        high=1.0,
        meaning="least share of a pixel that thin objects cover",
        useful=(0.02, 0.98),
        ends=("any share counts as an object's", "vectors of thin objects stay as they are"),
    )
