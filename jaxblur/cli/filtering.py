"""Options for the filter, its parameters and settings, shared by the commands."""

import argparse
import dataclasses
import pathlib
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from jaxblur.filters.registry import FilterInfo, filter_info, load_filter, names
from jaxblur.settings import GuertinSettings, Settings, choices_of

from .arguments import CommandError, did_you_mean, one_of, positive_integer, positive_number

DEFAULT_FILTER = "layered"
FITTED_FILTER = "guertin2014"
"""The filter that `jaxblur fit` fits by default."""
QUALITIES = {"preview": 3 / 7, "standard": 1.0, "final": 3.0}
"""Samples per pixel as multiples of the filter's default, 35: 15, 35 and 105, multiples of three
and odd."""
CHOICES = choices_of(GuertinSettings)
"""Settings with an option that takes one of some names."""


def add_filter_options(
    parser: argparse.ArgumentParser, default: str = DEFAULT_FILTER, alone: bool = False
) -> Any:
    """Add the options that choose and configure the filter; `complete` reads them.

    Args:
        parser: of a command.
        default: name of the filter that runs unless another is named.
        alone: whether no other can be named, so that only its own options are added.

    Returns:
        The group of these options.
    """
    group = parser.add_argument_group("filter")
    own = {field.name for field in dataclasses.fields(filter_info(default).kind)}
    left_out = {"filter", *(name for name in (*CHOICES, "temperature") if name not in own)}
    left_out = left_out if alone else set()
    parser.set_defaults(default_filter=default, **dict.fromkeys(left_out))
    if not alone:
        group.add_argument(
            "--filter",
            type=filter_name,
            metavar="NAME",
            help=f"default {default}; see below; FILE.py:NAME for a filter of your own",
        )
    group.add_argument(
        "--samples",
        type=positive_integer,
        metavar="N",
        help="per pixel; layered takes three in each time slice (default: see below)",
    )
    group.add_argument(
        "--radius",
        type=_radius,
        metavar="auto|PX",
        help="longest half-spread; auto takes it from the frame (default: see below)",
    )
    group.add_argument(
        "--spacing",
        type=positive_number,
        metavar="PX",
        help="minimum sample spacing, so that slow motion takes fewer samples; 0.7 makes no "
        "visible difference (default: all samples everywhere)",
    )
    group.add_argument(
        "--param",
        type=_parameter,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="a parameter of the filter; repeat for several",
    )
    common, usual = choices_of(Settings), GuertinSettings()
    for name, options in CHOICES.items():
        if name in left_out:
            continue
        default = "see below" if name == "fetch" else getattr(usual, name)
        only = "" if name in common else "guertin2014 only; "
        group.add_argument(
            f"--{name.replace('_', '-')}", choices=options, help=f"{only}default {default}"
        )
    if "temperature" not in left_out:
        group.add_argument(
            "--temperature",
            type=positive_number,
            metavar="PX",
            help="guertin2014 only; of --dominant soft, the smaller the nearer to the longest "
            f"velocity (default {usual.temperature})",
        )
    return group


def add_quality_option(group: Any) -> None:
    """Add the option that chooses the samples by name; `complete` reads it.

    Args:
        group: that `add_filter_options` returned.
    """
    counts = ", ".join(f"{name} {samples_of(35, name)}" for name in QUALITIES)
    group.add_argument(
        "--quality",
        choices=tuple(QUALITIES),
        help=f"samples per pixel by name: {counts} (default standard); more samples, less grain; "
        "replaces --samples, which is rejected beside it",
    )


def add_seed_option(group: Any) -> None:
    """Add the option that moves the noise.

    Args:
        group: of a parser.
    """
    group.add_argument(
        "--seed",
        type=_seed,
        metavar="frame|N",
        help="moves the dot pattern of the noise: by the number of the frame (the default for "
        "sequences), or by any whole number; a single file uses 0 unless told otherwise",
    )


def samples_of(usual: int, quality: str) -> int:
    """The samples per pixel that a quality stands for.

    Args:
        usual: samples of the filter by default.
        quality: a key of `QUALITIES`.

    Returns:
        An odd number, as McGuire 2012 needs, if the usual number is odd.
    """
    return max(round(usual * QUALITIES[quality]), 1)


def add_nonfinite_option(group: Any) -> None:
    """Add the option for NaN and infinity; reading a frame warns of their number.

    Args:
        group: of a parser.
    """
    group.add_argument(
        "--nonfinite",
        choices=("error", "ignore"),
        default="error",
        help="NaN and infinity: reject the frame, or ignore them (such colors are left out, such "
        "vectors become zero, such depths sky) and warn of their number (default %(default)s)",
    )


def add_parameters_option(group: Any) -> None:
    """Add the option that names a file of `jaxblur fit` or `play`; `read_fitted` reads it.

    Args:
        group: that `add_filter_options` returned.
    """
    group.add_argument(
        "--parameters",
        type=pathlib.Path,
        metavar="FILE",
        help="filter, parameters and settings as `jaxblur fit` wrote them, or as a page of "
        "`jaxblur play` copies them; options override them",
    )


def read_fitted(arguments: argparse.Namespace) -> Any:
    """The `jaxblur.fitting.FilterChoice` that ``--parameters`` names, or None.

    Raises:
        ValueError: the file holds something else.
    """
    if arguments.parameters is None:
        return None
    from jaxblur.fitting import load_choice

    return load_choice(arguments.parameters)


def complete(
    arguments: argparse.Namespace, fitted: Any = None
) -> tuple[str, dict[str, float], Settings]:
    """The filter, its parameters and settings: from the options, else as fitted, else the defaults.

    Args:
        arguments: with the options of `add_filter_options`.
        fitted: as `read_fitted` gives it.

    Returns:
        Name of the filter, all of its parameters, settings.

    Raises:
        CommandError: another filter was fitted, a parameter is unknown or out of range, or the
            filter does not have a choice that was given.
        ValueError: the filter cannot run with these settings.
    """
    chosen = arguments.filter or (fitted.filter if fitted else arguments.default_filter)
    info = find_filter(chosen)
    if fitted and fitted.filter != info.name:
        raise CommandError(
            f"{arguments.parameters}: holds parameters of {fitted.filter}; leave out "
            f"--filter {chosen}."
        )
    usual, values = info.settings, dict(arguments.param)
    if fitted:
        usual, values = fitted.filter_settings, fitted.parameters | values
    known = {field.name for field in dataclasses.fields(info.kind)}
    every = ("samples", "radius", "spacing", "temperature", *CHOICES)
    given = {name: value for name in every if (value := getattr(arguments, name))}
    if quality := getattr(arguments, "quality", None):
        if "samples" in given:
            raise CommandError("--quality: chooses the samples; leave out --samples, or --quality.")
        given["samples"] = samples_of(info.settings.samples, quality)
    if unused := given.keys() - known:
        option = min(unused).replace("_", "-")
        raise CommandError(
            f"--{option}: {info.name} has no such choice; leave it out, or pass --filter "
            "guertin2014."
        )
    if isinstance(usual, GuertinSettings) and given.get("dominant", usual.dominant) != "soft":
        if "temperature" in given:
            raise CommandError(
                "--temperature: is that of --dominant soft; pass that too, or leave it out."
            )
        # The temperature of fitted settings goes with their smooth maximum.
        given["temperature"] = GuertinSettings.temperature
    settings = dataclasses.replace(usual, **given)
    if info.check is not None:
        info.check(settings)
    return info.name, checked_parameters(info, values), settings


def find_filter(reference: str) -> FilterInfo:
    """The filter that an option names: by its name, or by the file that registers it.

    Args:
        reference: a name, or ``path/to/file.py:name``.

    Returns:
        The record of the filter.

    Raises:
        ValueError: there is no such filter, or the file cannot be imported.
    """
    return load_filter(reference) if ":" in reference else filter_info(reference)


def filter_name(text: str) -> str:
    """Parse the name of a filter, or ``path/to/file.py:name``.

    Raises:
        ArgumentTypeError: there is no such filter; the message suggests and lists.
    """
    if ":" not in text and not text.endswith(".py"):
        return one_of(text, names(), "filter")
    try:
        load_filter(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    path, _, name = text.rpartition(":")
    # Workers of a sequence may stand in another folder.
    return f"{pathlib.Path(path).resolve()}:{name}"


def checked_parameters(info: FilterInfo, given: Mapping[str, float]) -> dict[str, float]:
    """Complete the parameters of a filter by their defaults.

    Args:
        info: the filter.
        given: values by parameter name.

    Returns:
        All parameters of the filter.

    Raises:
        CommandError: the filter has no such parameter, or a value is out of range.
    """
    check_names(info, given, "--param")
    for name, value in given.items():
        if not info.parameter_infos[name].allows(value):
            allowed = info.parameter_infos[name].range
            raise CommandError(f"--param: {name} must be {allowed}, got {value:g}.")
    return info.defaults | dict(given)


def check_names(info: FilterInfo, parameters: Iterable[str], source: str) -> None:
    """Reject parameters that a filter does not have.

    Args:
        info: the filter.
        parameters: their names.
        source: where they come from, for the message.

    Raises:
        CommandError: there is one.
    """
    table = info.parameter_infos
    for name in parameters:
        if name not in table:
            known = f"it has {', '.join(table)}" if table else "it has none"
            hint = did_you_mean(name, table)
            raise CommandError(f"{source}: {info.name} has no parameter {name!r}{hint}; {known}.")


def describe_filters(*chosen: str) -> str:
    """List filters, parameters and defaults for the help.

    Args:
        *chosen: their names; all if none are given.
    """
    lines = ["filters, with their default settings and --param names:"]
    for info in map(filter_info, chosen or names()):
        settings = info.settings
        lines += [
            f"  {info.name}: {info.summary}",
            f"      --samples {settings.samples} --radius {settings.radius} "
            f"--fetch {settings.fetch}",
        ]
        lines += [
            f"      {f'{name}={known.default:g}':<20} {known.meaning} ({known.range})"
            for name, known in info.parameter_infos.items()
        ]
    return "\n".join(lines)


def takes_neighbors(name: str) -> bool:
    """Whether a registered filter takes the frames before and after."""
    return filter_info(name).takes_neighbors


def require_neighbors(name: str, option: str) -> None:
    """Reject an option that gives neighbors to a filter that takes none.

    Args:
        name: of a registered filter.
        option: as on the command line.

    Raises:
        CommandError: the filter takes none; the message names those that do.
    """
    _require(name, takes_neighbors, f"{option}: {name} takes no neighbor frames")


def takes_shutter(name: str) -> bool:
    """Whether a registered filter takes another shutter than a centered box."""
    return filter_info(name).takes_shutter


def require_shutter(name: str, option: str) -> None:
    """Reject an option of the shutter for a filter that takes none.

    Args:
        name: of a registered filter.
        option: as on the command line.

    Raises:
        CommandError: the filter takes none; the message names those that do.
    """
    lacks = f"{option}: {name} knows only a box centered on the frame, whose length --shutter gives"
    _require(name, takes_shutter, lacks)


def takes_lens(name: str) -> bool:
    """Whether a registered filter takes a lens."""
    return filter_info(name).takes_lens


def require_lens(name: str, option: str) -> None:
    """Reject an option of the lens for a filter that takes none.

    Args:
        name: of a registered filter.
        option: as on the command line.

    Raises:
        CommandError: the filter takes none; the message names those that do.
    """
    lacks = f"{option}: {name} blurs by motion alone; add --then defocus to blur by the lens after"
    _require(name, takes_lens, lacks)


def _require(name: str, takes: Callable[[str], bool], lacks: str) -> None:
    if not takes(name):
        able = " or ".join(filter(takes, names()))
        raise CommandError(f"{lacks}; leave it out, or pass --filter {able}.")


def _radius(text: str) -> int | None:
    """Parse ``--radius``; 0 stands for auto."""
    return 0 if text == "auto" else positive_integer(text)


def _seed(text: str) -> int | str:
    """Parse ``--seed``: a whole number, or ``frame``.

    Raises:
        ArgumentTypeError: it is something else.
    """
    digits = text.removeprefix("-")
    if text != "frame" and not (digits.isascii() and digits.isdigit()):
        raise argparse.ArgumentTypeError(f"expected frame or a whole number, got {text!r}")
    return text if text == "frame" else int(text)


def _parameter(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"expected NAME=VALUE, got {text!r}")
    try:
        return name.strip(), float(value)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{name} must be a number, got {value!r}") from error
