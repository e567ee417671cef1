"""Which filter runs on a frame, with which parameters and settings."""

import argparse
import dataclasses
import logging
import math
from collections.abc import Mapping
from typing import Any

from jaxblur.settings import Settings

from . import posts
from .arguments import CommandError
from .loading import Loaded

LOG = logging.getLogger("jaxblur")

# Every radius costs a compilation, so a sequence uses few: from 20 px on, each at most 1.5 times
# as large as needed.
SEQUENCE_RADII = (10, 20, 30, 40, 60, 80, 120, 160, 240, 320, 480, 640, 960, 1280, 1920)

PASSED_THROUGH = "none"
"""In the place of the filter's name for a frame that was not blurred."""


@dataclasses.dataclass(frozen=True)
class Choice:
    """A filter with its parameters and settings.

    Attributes:
        name: of a registered filter, or `PASSED_THROUGH`.
        parameters: of the filter, by name.
        settings: of the filter.
    """

    name: str
    parameters: Mapping[str, float]
    settings: Settings


def choose(arguments: argparse.Namespace, asked: Choice, loaded: Loaded) -> Choice:
    """Make the choices that depend on the frame: plan and radius.

    Args:
        arguments: of the command.
        asked: choices from the options.
        loaded: the frame.

    Returns:
        The choice to run.

    Raises:
        CommandError: no plan fits the frame.
    """
    if arguments.plan:
        chosen = _planned(arguments, loaded.buffers)
        return _with_radius(chosen, chosen.settings.radius, arguments)
    largest = 0.0
    if loaded.lens is not None:
        largest = posts.largest_disc(loaded.buffers.depth, loaded.lens)
        LOG.info("lens: discs up to a radius of %.1f px", largest)
        if asked.settings.radius < largest and arguments.radius != 0:
            LOG.warning(
                "lens: discs up to a radius of %.0f px are cut to the radius of %d px; check "
                "--focus, --f-number and --unit, or give a larger --radius.",
                largest,
                asked.settings.radius,
            )
    if arguments.radius == 0:
        radius = loaded.speeds.suggested_radius + math.ceil(largest)
        chosen = _with_radius(asked, radius, arguments)
        fastest = loaded.speeds.percentiles[100.0]
        LOG.info("radius: %d px, for half-spreads up to %.1f px", chosen.settings.radius, fastest)
        return chosen
    if loaded.speeds.beyond_share > 0:
        enough = loaded.speeds.suggested_radius
        LOG.warning(
            "%.2g %% of the vectors are longer than the radius of %d px and are cut to it; %s",
            100 * loaded.speeds.beyond_share,
            asked.settings.radius,
            f"--radius auto would take {enough}"
            if enough > asked.settings.radius
            else "some are longer than the frame is wide: check --preset and --shutter (frames)",
        )
    return asked


def passed_through(asked: Choice) -> Choice:
    """The choice for a frame that is not blurred, in a run whose other frames are."""
    names = [field.name for field in dataclasses.fields(Settings)]
    settings = Settings(**{name: getattr(asked.settings, name) for name in names})
    return Choice(PASSED_THROUGH, {}, settings)


def _planned(arguments: argparse.Namespace, buffers: Any) -> Choice:
    """Choose from the frame's statistics what `complete` takes from the options, and log why."""
    from jaxblur.planning import PERCEPTUAL_TOLERANCE, plan

    tolerance = {"tolerance_db": arguments.tolerance}
    if arguments.plan == "perceptual":
        tolerance = {"tolerance_jod": arguments.tolerance or PERCEPTUAL_TOLERANCE}
    try:
        chosen = plan(buffers.frame(), arguments.budget, **tolerance)
    except ValueError as error:
        raise CommandError(f"--plan {arguments.plan}: {error}") from error
    # In a sequence every choice is said once, since the line is the same for its frames.
    LOG.info("plan: %s", chosen.summary)
    LOG.debug("plan: %s", chosen.reason)
    values = {} if chosen.parameters is None else dataclasses.asdict(chosen.parameters)
    return Choice(chosen.filter, values, chosen.settings)


def _with_radius(choice: Choice, radius: int, arguments: argparse.Namespace) -> Choice:
    """Take a radius from the frame; in a sequence, the next larger one of a few."""
    if arguments.in_sequence:
        radius = next((step for step in SEQUENCE_RADII if step >= radius), radius)
    settings = dataclasses.replace(choice.settings, radius=radius)
    return dataclasses.replace(choice, settings=settings)
