"""Static choices of a filter run: what is fixed when a filter is compiled."""

import dataclasses
import functools
import math
import numbers
import typing
from typing import Literal, TypeVar

Border = Literal["skip", "clamp"]
Fetch = Literal["nearest", "bilinear", "blend"]
TileChoice = Literal["stochastic", "own", "expected"]
Split = Literal["even", "variance"]
NoiseKind = Literal["ign", "halton", "none"]
Directions = Literal["two", "one"]
DirectionWeights = Literal["on", "off"]
DiagonalTiles = Literal["reaching", "all"]
Dominant = Literal["max", "soft"]
Backend = Literal["auto", "native", "xla"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """Static settings that every filter has; hashable, equal settings share one compilation.

    A filter with other defaults or further choices has a subclass of its own, such as
    `LayeredSettings` or `GuertinSettings`: a frozen, keyword-only dataclass whose fields have
    defaults, choices annotated as ``Literal``. It takes plain `Settings` too, and then all of their
    values, so that ``Settings(samples=105)`` has a radius of 40 px for every filter.

    Attributes:
        samples: taps per pixel, N or S in the papers; McGuire 2012 needs an odd number.
        radius: tile size and the longest half-spread, in pixels; longer ones are clamped to it.
        spacing: minimum sample spacing in pixels, k/S constant [McGuire 2012, section 2.1]:
            shorter paths take fewer samples, at least five. 0 takes all of them everywhere, as
            published; 0.7 costs less than 0.1 dB.
        border: ``skip`` gives taps outside the image no weight; ``clamp`` reads the edge texel.
        fetch: what a tap reads. ``nearest``: the nearest texel. ``bilinear``: color mixed of the
            texels around it, velocity and depth of the nearest one, because interpolating opposed
            velocities cancels them. ``blend``: what the tap adds to the sums is computed for each
            of the four texels around it and then mixed, so that the picture has no jumps as taps
            move; takes three to four times the time of ``nearest``.
        noise: built-in noise used when none is passed: interleaved gradient noise, Halton, none.
        backend: how the samples are summed: on a CPU ``native`` code, compiled on first use and
            kept in the user's cache folder, needs a C++ compiler and float32; ``xla`` runs
            everywhere; ``auto`` takes native code where it can. Results agree except for rounding.
            A function that a CPU exports for other platforms needs ``xla``.

    Raises:
        ValueError: a setting is out of range or unknown, or not hashable.
    """

    samples: int = 35
    radius: int = 40
    spacing: float = 0.0
    border: Border = "skip"
    fetch: Fetch = "nearest"
    noise: NoiseKind = "ign"
    backend: Backend = "auto"

    def __post_init__(self):
        for name in ("samples", "radius"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, numbers.Integral):
                raise ValueError(f"`{name}` must be a whole number, got {value!r}.")
            if value < 1:
                raise ValueError(f"`{name}` must be at least 1, got {value}.")
            # That of NumPy is another one where it is written out.
            object.__setattr__(self, name, int(value))
        if not (_is_number(self.spacing) and 0 <= self.spacing < math.inf):
            raise ValueError(f"`spacing` must be a number of pixels >= 0, got {self.spacing!r}.")
        for name, options in choices_of(type(self)).items():
            value = getattr(self, name)
            if value not in options:
                listing = ", ".join(repr(option) for option in options)
                raise ValueError(f"`{name}` must be one of {listing}, got {value!r}.")
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            try:
                hash(value)
            except TypeError:
                raise ValueError(
                    f"`{field.name}` must be hashable, such as a number, a text or a tuple of "
                    f"them, because equal settings share one compilation, got {value!r}."
                ) from None

    @property
    def has_outcomes(self) -> bool:
        """Whether the filter draws one of several outcomes at a pixel, such as a tile."""
        return False


@dataclasses.dataclass(frozen=True, kw_only=True)
class McGuireSettings(Settings):
    """Settings of `jaxblur.mcguire2012`; the defaults are those of the paper.

    Raises:
        ValueError: a setting is out of range or unknown.
    """

    samples: int = 15
    radius: int = 20


@dataclasses.dataclass(frozen=True, kw_only=True)
class LayeredSettings(Settings):
    """Settings of `jaxblur.layered` and `jaxblur.blur_layers`.

    A radius costs no time, since there are no tiles: it is the longest half-spread that is
    followed.

    Raises:
        ValueError: a setting is out of range or unknown.
    """

    radius: int = 160
    fetch: Fetch = "bilinear"


@dataclasses.dataclass(frozen=True, kw_only=True)
class GuertinSettings(Settings):
    """Settings of `jaxblur.guertin2014`; the defaults are those of section 3.5 of the paper.

    Attributes:
        tile_choice: which tile's dominant velocity a pixel reads near a tile border:
            ``stochastic`` draws it, ``own`` never leaves the tile, ``expected`` mixes the results
            of all reachable tiles by their probability (differentiable in tau).
        split: how taps are shared between the two directions: ``even`` half and half,
            ``variance`` by the angular variance of the tile's ring (eq. 3.2).
        directions: ``one`` sends every tap along the dominant velocity, for scenes in which
            neighbors move alike.
        direction_weights: ``off`` leaves out of the weights how well a velocity agrees with the
            direction of the tap.
        diagonal_tiles: which diagonal tiles count in the dominant velocity: those whose velocity
            is ``reaching`` the tile (section 3.4.4), or ``all``.
        dominant: ``max`` is the longest velocity of a neighborhood, which jumps from one pixel to
            another as velocities change; ``soft`` a mean of all, weighted by ``exp(speed / T)``,
            which has a derivative in all of them: for descent on the speeds of objects.
        temperature: T of ``soft``, pixels. The smaller, the nearer to the longest. ``max`` has
            none, and takes the default alone.

    Raises:
        ValueError: a setting is out of range or unknown.
    """

    tile_choice: TileChoice = "stochastic"
    split: Split = "even"
    directions: Directions = "two"
    direction_weights: DirectionWeights = "on"
    diagonal_tiles: DiagonalTiles = "reaching"
    dominant: Dominant = "max"
    temperature: float = 0.5

    def __post_init__(self):
        super().__post_init__()
        if not (_is_number(self.temperature) and 0 < self.temperature < math.inf):
            raise ValueError(f"`temperature` must be pixels above 0, got {self.temperature!r}.")
        if self.dominant != "soft" and self.temperature != type(self).temperature:
            raise ValueError(
                f"`temperature` must be left out unless dominant='soft', got {self.temperature} "
                f"with dominant={self.dominant!r}, which has none."
            )

    @property
    def soft_temperature(self) -> float | None:
        """The temperature of smooth maxima; None where they are as published."""
        return self.temperature if self.dominant == "soft" else None

    @property
    def has_outcomes(self) -> bool:
        """Whether a pixel may read another tile than its own."""
        return self.tile_choice != "own"


def _is_number(value: object) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


Kind = TypeVar("Kind", bound=Settings)


def checked_settings(settings: Settings, kind: type[Kind], filter: str = "the filter") -> Kind:
    """Settings as a filter takes them.

    Args:
        settings: of that kind, or plain `Settings`, to which the choices of the kind are added.
        kind: the class that the filter takes: `Settings` or a subclass.
        filter: its name, for the message.

    Returns:
        The same settings as an object of that class.

    Raises:
        ValueError: they are no settings, or hold choices that the filter does not have.

    Examples:
        >>> checked_settings(Settings(samples=9), GuertinSettings).tile_choice
        'stochastic'
    """
    if type(settings) is kind:
        return settings
    # A class of one's own is no name of jaxblur.
    public = f"jaxblur.{kind.__name__}" if kind.__module__ == __name__ else kind.__name__
    if not isinstance(settings, Settings):
        given = type(settings).__name__
        if isinstance(settings, type):
            given = f"the class {settings.__name__} itself"
        raise ValueError(
            f"`settings` must be {kind.__name__}: {filter} takes {kind.__name__}, not {given}; "
            f"pass settings={public}(...), or leave it out for the defaults."
        )
    names = {field.name for field in dataclasses.fields(kind)}
    extra = [field.name for field in dataclasses.fields(settings) if field.name not in names]
    if extra:
        raise ValueError(
            f"`settings` holds choices that {filter} does not have ({', '.join(extra)}): it takes "
            f"{kind.__name__}, not {type(settings).__name__}; pass {public}."
        )
    values = {field.name: getattr(settings, field.name) for field in dataclasses.fields(settings)}
    return kind(**values)


@functools.cache
def choices_of(kind: type[Settings]) -> dict[str, tuple[str, ...]]:
    """The choices of a class of settings.

    Args:
        kind: `Settings` or a subclass.

    Returns:
        Options by name of the field, for fields that are annotated as ``Literal``.

    Examples:
        >>> choices_of(Settings)["border"]
        ('skip', 'clamp')
    """
    hints = typing.get_type_hints(kind)
    return {
        field.name: typing.get_args(hints[field.name])
        for field in dataclasses.fields(kind)
        if typing.get_origin(hints[field.name]) is Literal
    }
