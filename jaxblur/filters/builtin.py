"""The filters of the package, as the registry knows them. Loads no jax."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

from ..settings import GuertinSettings, LayeredSettings, McGuireSettings, Settings
from .parameters import GuertinParameters, LayeredParameters, McGuireParameters
from .registry import FilterInfo, register

LAYERED_SLICE = 3
"""Samples that a time slice of layered takes: two guesses, and the search for what is in front."""
LAYERED_RADIUS = 4095
"""Largest radius of layered. A mark holds an offset and a depth in 31 bits; a larger offset would
leave too few for the depth."""
_HALF_A_SPACING = 0.5
"""Largest jitter of the taps, in spacings, of the filters without a parameter for it."""


def needs_odd_samples(settings: Settings) -> None:
    """Reject an even number of samples."""
    if settings.samples % 2 == 0:
        raise ValueError(
            f"`settings.samples` must be odd for mcguire2012, got {settings.samples}; "
            f"use {settings.samples + 1}."
        )


def check_layered(settings: Settings) -> None:
    """Reject fewer samples than a time slice takes, and a radius that is too large."""
    if settings.samples < LAYERED_SLICE:
        raise ValueError(
            f"`settings.samples` must be at least {LAYERED_SLICE} for layered, got "
            f"{settings.samples}."
        )
    if settings.radius > LAYERED_RADIUS:
        raise ValueError(
            f"`settings.radius` must be at most {LAYERED_RADIUS} for layered, got "
            f"{settings.radius}; longer motions are cut to the radius."
        )


def _expect_tiles(settings: GuertinSettings) -> GuertinSettings:
    """The stochastic choice of tile becomes its exact expectation."""
    if settings.tile_choice == "stochastic":
        return dataclasses.replace(settings, tile_choice="expected")
    return settings


def _check_guertin_fit(
    free: Sequence[str], settings: GuertinSettings, start: Mapping[str, float]
) -> None:
    """Whether frames can determine the free parameters of guertin2014."""
    if {"eta", "phi"} <= set(free):
        raise ValueError(
            "`free` must not hold both eta and phi: only their product enters the filter, so that "
            "no frame can separate them; fit phi and leave eta as it is."
        )
    jitter = [name for name in ("eta", "phi") if name in free]
    if jitter and settings.noise == "none":
        raise ValueError(
            f"`free` must not hold {jitter[0]} with `noise='none'`: it scales the noise; pass "
            "settings with 'ign' or 'halton', or leave it out."
        )
    if "tau" not in free:
        return
    if settings.tile_choice == "own":
        raise ValueError(
            "`free` must not hold tau with `tile_choice='own'`, which never leaves the tile: pass "
            "settings with 'stochastic' or 'expected', or leave tau out."
        )
    shortest = 1 / settings.radius
    if start["tau"] <= shortest:
        raise ValueError(
            f"`initial.tau` must be above 1/radius = {shortest:.3g} to be fitted, got "
            f"{start['tau']:g}: below it no pixel reaches another tile, and the loss is flat."
        )


def _tap_rows(settings: Settings, jitter: float = _HALF_A_SPACING) -> int:
    """Rows that the farthest tap reaches; jitter may carry it beyond the radius."""
    farthest = max(1.0, 1 + 2 * (jitter - 1) / (settings.samples + 1))
    # One for bilinear reads, one for colors that masked pixels take from their neighbors.
    return math.ceil(settings.radius * farthest) + 2


def _pixel_velocity_rows(parameters: None, settings: Settings, curved: bool) -> tuple[int, int]:
    return 1, _tap_rows(settings)


def _mcguire_rows(
    parameters: McGuireParameters, settings: Settings, curved: bool
) -> tuple[int, int]:
    return settings.radius, max(settings.radius, _tap_rows(settings))


def _guertin_rows(
    parameters: GuertinParameters, settings: GuertinSettings, curved: bool
) -> tuple[int, int]:
    try:
        jitter = float(parameters.eta) * float(parameters.phi) / settings.samples
    except TypeError as error:
        raise ValueError(
            "`parameters` must be numbers here, not traced: the reach of a tap depends on them; "
            "close over them, or use one device."
        ) from error
    # The ring of a tile that a pixel may read beside its own; with `split` the ring of that.
    rings = 2 + (settings.split == "variance")
    return settings.radius, max(rings * settings.radius, _tap_rows(settings, jitter))


def _layered_rows(
    parameters: LayeredParameters, settings: Settings, curved: bool
) -> tuple[int, int]:
    # An owner is as far as the radius. Its path depends on velocities half as far from it, and on
    # their neighbors. The point that is read is at most a slice away from the owner. The background
    # is searched up to 16 px away.
    return 1, max(2 * settings.radius + 4, 20)


BUILTIN: Sequence[FilterInfo] = (
    FilterInfo(
        name="guertin2014",
        summary="feature-aware weights along two directions [Guertin et al. 2014]",
        function="jaxblur.filters.guertin2014:guertin2014",
        parameters=GuertinParameters,
        settings=GuertinSettings(),
        outcomes="jaxblur.filters.guertin2014:tile_outcomes",
        smooth=_expect_tiles,
        check_fit=_check_guertin_fit,
        row_reach=_guertin_rows,
    ),
    FilterInfo(
        name="mcguire2012",
        summary="along the dominant velocity of the neighborhood [McGuire et al. 2012]",
        function="jaxblur.filters.mcguire2012:mcguire2012",
        parameters=McGuireParameters,
        settings=McGuireSettings(),
        check=needs_odd_samples,
        row_reach=_mcguire_rows,
    ),
    FilterInfo(
        name="pixel_velocity",
        summary="along each pixel's own velocity, the baseline",
        function="jaxblur.filters.pixel_velocity:pixel_velocity",
        row_reach=_pixel_velocity_rows,
    ),
    FilterInfo(
        name="layered",
        summary="by time slices, in each the nearest surface that covers the pixel",
        function="jaxblur.filters.layered:layered",
        parameters=LayeredParameters,
        settings=LayeredSettings(),
        check=check_layered,
        row_reach=_layered_rows,
        takes_neighbors=True,
        takes_shutter=True,
        takes_lens=True,
    ),
)
for _info in BUILTIN:
    register(_info)
