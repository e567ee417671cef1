"""Static choices of a filter run: what is fixed when a filter is compiled."""

import dataclasses
import math
import typing
from typing import Literal

Border = Literal["skip", "clamp"]
Fetch = Literal["nearest", "bilinear"]
TileChoice = Literal["stochastic", "own", "expected"]
Split = Literal["even", "variance"]
NoiseKind = Literal["ign", "halton", "none"]
Directions = Literal["two", "one"]
DirectionWeights = Literal["on", "off"]
DiagonalTiles = Literal["reaching", "all"]
Backend = Literal["auto", "native", "xla"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """Static settings of a filter run; hashable, equal settings share one compilation.

    Defaults are those of Guertin et al. 2014 section 3.5. McGuire et al. 2012 publish
    ``Settings(samples=15, radius=20)``.

    Attributes:
        samples: taps per pixel, N or S in the papers; McGuire 2012 needs an odd number.
        radius: tile size and the longest half-spread, in pixels; longer ones are clamped to it.
        spacing: pixels of path that a sample stands for at least, k/S constant [McGuire 2012,
            section 2.1]: shorter paths take fewer samples, at least five. 0 takes all of them
            everywhere, as published; 0.7 costs less than 0.1 dB.
        border: ``skip`` gives taps outside the image no weight; ``clamp`` reads the edge texel.
        fetch: how *color* is read at a tap; velocity and depth always come from the nearest
            texel, because interpolating opposed velocities cancels them.
        tile_choice: which tile's dominant velocity a pixel reads near a tile border:
            ``stochastic`` draws it, ``own`` never leaves the tile, ``expected`` mixes the results
            of all reachable tiles by their probability (differentiable in tau).
        split: how taps are shared between the two directions of Guertin 2014: ``even`` half and
            half, ``variance`` by the angular variance of the tile's ring (eq. 3.2).
        noise: built-in noise used when none is passed: interleaved gradient noise, Halton, none.
        directions: ``one`` sends every tap of Guertin 2014 along the dominant velocity, for
            scenes in which neighbors move alike.
        direction_weights: ``off`` leaves out how well a velocity agrees with the direction of the
            tap in the weights of Guertin 2014.
        diagonal_tiles: which diagonal tiles Guertin 2014 counts in the dominant velocity:
            those whose velocity is ``reaching`` the tile (section 3.4.4), or ``all``.
        backend: what sums the samples: on a CPU ``native`` code, compiled on first use and kept
            in the user's cache folder, needs a C++ compiler and float32; ``xla`` runs everywhere;
            ``auto`` takes native code where it can. Results agree but for rounding. What a CPU
            exports for other platforms needs ``xla``.

    Raises:
        ValueError: a setting is out of range or unknown.
    """

    samples: int = 35
    radius: int = 40
    spacing: float = 0.0
    border: Border = "skip"
    fetch: Fetch = "nearest"
    tile_choice: TileChoice = "stochastic"
    split: Split = "even"
    noise: NoiseKind = "ign"
    directions: Directions = "two"
    direction_weights: DirectionWeights = "on"
    diagonal_tiles: DiagonalTiles = "reaching"
    backend: Backend = "auto"

    def __post_init__(self):
        for name in ("samples", "radius"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int):
                raise ValueError(f"`{name}` must be a whole number, got {value!r}.")
            if value < 1:
                raise ValueError(f"`{name}` must be at least 1, got {value}.")
        if not 0 <= self.spacing < math.inf:
            raise ValueError(f"`spacing` must be a number of pixels >= 0, got {self.spacing}.")
        for name, kind in CHOICES.items():
            value = getattr(self, name)
            if value not in kind:
                options = ", ".join(repr(option) for option in kind)
                raise ValueError(f"`{name}` must be one of {options}, got {value!r}.")


CHOICES: dict[str, tuple[str, ...]] = {
    "border": typing.get_args(Border),
    "fetch": typing.get_args(Fetch),
    "tile_choice": typing.get_args(TileChoice),
    "split": typing.get_args(Split),
    "noise": typing.get_args(NoiseKind),
    "directions": typing.get_args(Directions),
    "direction_weights": typing.get_args(DirectionWeights),
    "diagonal_tiles": typing.get_args(DiagonalTiles),
    "backend": typing.get_args(Backend),
}
