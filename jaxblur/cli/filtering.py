"""Which filter runs, with what parameters and settings: options shared by the commands."""

import argparse
import dataclasses
from collections.abc import Mapping
from typing import Any

from jaxblur.settings import CHOICES, Settings

from . import published
from .arguments import CommandError, one_of, positive_integer, positive_number
from .console import print_line


def add_filter_options(
    parser: argparse.ArgumentParser, default: str = published.DEFAULT_FILTER
) -> Any:
    """Add the options that say which filter runs, and how; `complete` reads them.

    Args:
        parser: of a command.
        default: name of the filter that runs unless another is named.

    Returns:
        The group of these options.
    """
    group = parser.add_argument_group("filter")
    group.add_argument(
        "--filter",
        type=_filter_name,
        metavar="NAME",
        help=f"default {default}; see below",
    )
    parser.set_defaults(default_filter=default)
    group.add_argument(
        "--samples",
        type=positive_integer,
        metavar="N",
        help="per pixel; a third as many slices of time for layered (as published)",
    )
    group.add_argument(
        "--radius",
        type=_radius,
        metavar="auto|PX",
        help="longest half-spread; auto takes it from the frame (as published)",
    )
    group.add_argument(
        "--spacing",
        type=positive_number,
        metavar="PX",
        help="pixels of path that a sample stands for at least, so that slow motion takes fewer; "
        "0.7 is not seen (default: all samples everywhere)",
    )
    group.add_argument(
        "--param",
        type=_parameter,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="a parameter of the filter; repeat for several",
    )
    for name, options in CHOICES.items():
        default = "as published" if name == "fetch" else f"default {getattr(Settings(), name)}"
        only = "guertin2014 only; " if name in published.GUERTIN_CHOICES else ""
        group.add_argument(f"--{name.replace('_', '-')}", choices=options, help=only + default)
    return group


def add_nonfinite_option(group: Any) -> None:
    """Add the option that says what becomes of NaN and infinity; `report_ignored` tells the count.

    Args:
        group: of a parser.
    """
    group.add_argument(
        "--nonfinite",
        choices=("error", "ignore"),
        default="error",
        help="NaN and infinity: refuse the frame, or leave such colors out, take such vectors as "
        "still and such depths as sky, and print how many there were (default %(default)s)",
    )


def report_ignored(path: Any, ignored: Any) -> None:
    """Print how many pixels of a frame were left out, if there were any.

    Args:
        path: the frame.
        ignored: a `jaxblur.nonfinite.Ignored`.
    """
    if ignored:
        print_line(f"{path}: not finite: {ignored}")


def complete(
    arguments: argparse.Namespace, fitted: Any = None
) -> tuple[str, dict[str, float], Settings]:
    """Say which filter runs and how: as asked for, else as fitted, else as published.

    Args:
        arguments: with the options of `add_filter_options`.
        fitted: a `jaxblur.FitResult`, or None.

    Returns:
        Name of the filter, all of its parameters, settings.

    Raises:
        CommandError: another filter was fitted, a parameter is unknown or out of range, or the
            filter does not have a choice that was given.
    """
    name = arguments.filter or (fitted.filter if fitted else arguments.default_filter)
    if fitted and fitted.filter != name:
        raise CommandError(
            f"{arguments.parameters}: holds parameters of {fitted.filter}; leave out "
            f"--filter {name}."
        )
    if name not in published.FILTERS:
        known = ", ".join(published.FILTERS)
        raise CommandError(f"{arguments.parameters}: no filter {name!r}; there are {known}.")
    settings = {
        key: getattr(published.FILTERS[name], key) for key in ("samples", "radius", "fetch")
    }
    values = dict(arguments.param)
    if fitted:
        source = str(arguments.parameters)
        fitted_values = published.checked_parameters(name, fitted.parameters, source)
        settings, values = fitted.settings, fitted_values | values
    names = ("samples", "radius", "spacing", *CHOICES)
    given = {key: value for key in names if (value := getattr(arguments, key))}
    if name != "guertin2014" and (unused := [*given.keys() & set(published.GUERTIN_CHOICES)]):
        option = min(unused).replace("_", "-")
        raise CommandError(
            f"--{option}: {name} has no such choice; leave it out, or pass --filter guertin2014."
        )
    chosen = Settings(**settings | given)
    if name == "mcguire2012" and chosen.samples % 2 == 0:
        raise CommandError(
            f"--samples must be odd for {name}, got {chosen.samples}; use {chosen.samples + 1}."
        )
    if name == "layered" and chosen.samples < 3:
        raise CommandError(f"--samples must be at least 3 for {name}, got {chosen.samples}.")
    return name, published.checked_parameters(name, values), chosen


def apply_filter(
    name: str, buffers: Any, parameters: Mapping[str, float], settings: Settings
) -> Any:
    """Run a filter.

    Args:
        name: a key of `jaxblur.FILTERS`.
        buffers: a `jaxblur.Frame`, or buffers as `read_buffers` gives them.
        parameters: by name; the others are as published.
        settings: how to run it.

    Returns:
        (H, W, C) NumPy array.
    """
    import numpy as np

    from jaxblur.filters import FILTERS, PUBLISHED
    from jaxblur.frame import Frame

    frame = Frame(buffers.color, buffers.depth, buffers.velocity, buffers.path, buffers.valid)
    record = PUBLISHED[name][0]
    chosen = None if record is None else dataclasses.replace(record, **parameters)
    return np.asarray(FILTERS[name](frame, chosen, settings=settings))


def _filter_name(text: str) -> str:
    return one_of(text, tuple(published.FILTERS), "filter")


def _radius(text: str) -> int | None:
    """Parse ``--radius``; 0 stands for auto."""
    return 0 if text == "auto" else positive_integer(text)


def _parameter(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"expected NAME=VALUE, got {text!r}")
    try:
        return name.strip(), float(value)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{name} must be a number, got {value!r}") from error
