"""Recognize a motion-vector convention by channel names."""

import dataclasses
import functools
import re
from collections.abc import Sequence

from .presets import PRESETS, Layout, Preset


class NoVectorsError(ValueError):
    """No channels match."""


@dataclasses.dataclass(frozen=True)
class Guess:
    """A convention matched to the channels of a file.

    Attributes:
        preset: the convention.
        layout: the alternative of ``preset.layouts`` that was found.
        channels: full channel names, x and y of each pair of ``layout`` in turn.
        reason: the decision and the reason for it, in one line.
    """

    preset: Preset
    layout: Layout
    channels: tuple[str, ...]
    reason: str


def guess_preset(channel_names: Sequence[str]) -> Guess:
    """Recognize the convention of the vectors in a file by its channel names.

    Only conventions that are identified by their channel names are considered (`Preset.named`).

    Args:
        channel_names: full names, such as ``ViewLayer.Vector.X``.

    Returns:
        The single match.

    Raises:
        NoVectorsError: no convention matches.
        ValueError: several match; the message lists the candidates.

    Examples:
        >>> names = ["R", "G", "B", "forward.u", "forward.v", "backward.u", "backward.v"]
        >>> guess_preset(names).preset.name
        'nuke'
    """
    guesses = [
        guess
        for preset in PRESETS.values()
        if preset.named
        for guess in _matches(preset, channel_names)
    ]
    if not guesses:
        raise NoVectorsError(
            f"no motion vectors recognized among {describe_names(channel_names)}; render the "
            "pass, name the file that has them with `velocity_from`, or, if they are among these "
            "channels, name them with `velocity_channels` and their convention with `preset`."
        )
    return _only(guesses)


def match_preset(preset: str, channel_names: Sequence[str]) -> Guess:
    """Find the channels of a given convention.

    Args:
        preset: a key of `PRESETS`.
        channel_names: full names of the channels in the file.

    Returns:
        The match of the first layout of the preset that the file holds.

    Raises:
        NoVectorsError: its channels are missing.
        ValueError: unknown preset, or several layers have its channels.
    """
    guesses = _matches(known_preset(preset), channel_names)
    if not guesses:
        first = PRESETS[preset].layouts[0]
        wanted = ", ".join(f"{pair.x}, {pair.y}" for pair in first)
        raise NoVectorsError(
            f"no channels of preset `{preset}` (such as {wanted}) among "
            f"{describe_names(channel_names)}; give their names with `velocity_channels`."
        )
    return _only(guesses)


def assign_channels(preset: str, velocity_channels: Sequence[str]) -> Guess:
    """Assign the given channels to a given convention, whatever their names.

    Args:
        preset: a key of `PRESETS`.
        velocity_channels: x and y of each pair, in the order of the preset's layout.

    Returns:
        The assignment.

    Raises:
        ValueError: unknown preset, or no layout has this number of channels.
    """
    layouts = known_preset(preset).layouts
    names = tuple(velocity_channels)
    for layout in layouts:
        if 2 * len(layout) == len(names):
            reason = f"{preset}: channels {', '.join(names)} as given"
            return Guess(PRESETS[preset], layout, names, reason)
    counts = " or ".join(str(count) for count in sorted({2 * len(layout) for layout in layouts}))
    raise ValueError(
        f"`velocity_channels` must name {counts} channels for preset `{preset}`, got {len(names)}."
    )


def known_preset(name: str) -> Preset:
    """Look up a preset.

    Args:
        name: a key of `PRESETS`.

    Returns:
        The preset.

    Raises:
        ValueError: there is no preset of that name; the message lists all presets.
    """
    if name not in PRESETS:
        raise ValueError(f"`preset` must be auto or one of {', '.join(PRESETS)}; got {name!r}.")
    return PRESETS[name]


def find_channels(pattern: str, channel_names: Sequence[str]) -> list[str]:
    """List the channels called ``pattern`` in any layer.

    Args:
        pattern: a name or its dotted ending; ``*`` matches any characters except a dot.
        channel_names: full names to search.

    Returns:
        Full names, in the order given.

    Examples:
        >>> find_channels("Depth.Z", ["ViewLayer.Depth.Z", "ViewLayer.MyDepth.Z"])
        ['ViewLayer.Depth.Z']
    """
    ending = _ending(pattern)
    return [name for name in channel_names if ending.fullmatch(name)]


def describe_names(channel_names: Sequence[str], limit: int = 40) -> str:
    """Join channel names for a message, cut short after ``limit`` of them.

    Args:
        channel_names: full names.
        limit: largest number of names shown.

    Returns:
        The names separated by commas, or ``no channels``.
    """
    shown = ", ".join(channel_names[:limit]) or "no channels"
    rest = len(channel_names) - limit
    return f"{shown} and {rest} more" if rest > 0 else shown


@functools.lru_cache(maxsize=4096)
def _ending(pattern: str) -> re.Pattern[str]:
    wild = re.escape(pattern).replace(r"\*", "([^.]*)")
    return re.compile(rf"((?:.*\.)?){wild}")


def _matches(preset: Preset, names: Sequence[str]) -> list[Guess]:
    """Find every layer that holds the preset's first layout of which the file has any."""
    for layout in preset.layouts:
        patterns = [pattern for pair in layout for pattern in (pair.x, pair.y)]
        layers = _layers(patterns, names)
        if layers:
            return [_guess(preset, layout, channels) for channels in layers]
    return []


def _layers(patterns: list[str], names: Sequence[str]) -> list[tuple[str, ...]]:
    """Group the matches of all patterns by their layer and the text that ``*`` matched."""
    found: list[dict[tuple[str, ...], str]] = []
    for pattern in patterns:
        matches = [_ending(pattern).fullmatch(name) for name in names]
        found.append({match.groups(): match.string for match in matches if match})
    return [
        tuple(by_layer[layer] for by_layer in found)
        for layer in found[0]
        if all(layer in by_layer for by_layer in found)
    ]


def _guess(preset: Preset, layout: Layout, channels: tuple[str, ...]) -> Guess:
    note = (
        "" if preset.verified else "; this convention is unverified, check it on a pair of frames"
    )
    sides = {-1: "previous", 1: "next"}
    what = " and ".join(sides[pair.time] for pair in layout)
    reason = f"{preset.name}: found {', '.join(channels)} (vectors to the {what} frame){note}"
    return Guess(preset, layout, channels, reason)


def _only(guesses: list[Guess]) -> Guess:
    if len(guesses) > 1:
        options = "; ".join(f"{g.preset.name} with {', '.join(g.channels)}" for g in guesses)
        raise ValueError(
            f"several sets of motion vectors match: {options}; "
            "choose with `preset`, `layer` or `velocity_channels`."
        )
    return guesses[0]
