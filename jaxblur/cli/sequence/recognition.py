"""What the vectors of a sequence mean: measured on two of its frames, where no name settles it."""

import argparse
import dataclasses
import itertools
import logging
import pathlib
from collections.abc import Mapping
from typing import Any

LOG = logging.getLogger("jaxblur")

PAIRS = 3
"""Pairs of frames that are tried; in the first ones of a shot nothing may move yet."""
BY_DEFINITION = ("pixel", "uv", "ndc")


@dataclasses.dataclass(frozen=True)
class _Pair:
    """Two consecutive frames, and the vectors of the first.

    Attributes:
        numbers: of the frames.
        now: file with the first picture.
        following: file with the second one.
        vectors: file with the vectors of the first.
    """

    numbers: tuple[int, int]
    now: pathlib.Path
    following: pathlib.Path
    vectors: pathlib.Path


def settle_convention(arguments: argparse.Namespace, sources: Mapping[str, Any]) -> None:
    """Replace ``--preset auto`` by the convention that fits the frames, and say so in one line.

    Nothing changes if a preset is given, if names identify a verified convention, or if the frames
    do not decide. The frames are the first ones on disk between which something moves, so that
    chunks of one sequence agree.

    Args:
        arguments: of the command; preset, channels, exposure of the file and kind of depth may
            change.
        sources: names of the inputs by role, as `jaxblur.sequence.plan_jobs` takes them.
    """
    from jaxblur import exr

    if arguments.preset != "auto":
        return
    pairs = _pairs(sources)
    try:
        # Without a pair, what the first frame says is said when it is read.
        known = _by_name(arguments, pairs[0]) if pairs else None
        if not pairs or (known and known.preset.verified):
            return
        channels = list(known.channels) if known else _unnamed(arguments, pairs[0])
        if not channels:
            return
        for pair in pairs:
            ranking = _ranked(arguments, pair, channels)
            if ranking is not None and ranking.is_explained and not ranking.undecided:
                _adopt(arguments, pair, known, ranking)
                return
    except exr.JaxblurIOError as error:
        # The frame is reported again when it is its turn.
        LOG.debug("vectors: not compared with the next frame: %s", error)
        return
    first = pairs[0]
    LOG.info(
        "vectors: what they mean does not show between frames %d and %d; check it with: jaxblur "
        "vectors %s --next %s",
        *(*first.numbers, first.now, first.following),
    )


def _pairs(sources: Mapping[str, Any]) -> list[_Pair]:
    """List the first pairs of consecutive frames on disk."""
    from jaxblur.sequence import at_frame

    names = {role: name for role, name in sources.items() if role in ("input", "velocity_from")}
    try:
        frames = sources["input"].frames_on_disk()
    except OSError:
        return []
    found = []
    for now, following in itertools.pairwise(frames):
        if following == now + 1 and len(found) < PAIRS:
            files = at_frame(names, now)
            vectors = files.get("velocity_from", files["input"])
            after = at_frame(names, following)["input"]
            found.append(_Pair((now, following), files["input"], after, vectors))
    return found


def _by_name(arguments: argparse.Namespace, pair: _Pair) -> Any:
    """The convention that names identify, or None."""
    from jaxblur import exr

    if arguments.velocity_channels:
        return None
    layer = None if arguments.velocity_from else arguments.layer
    try:
        return exr.choose_vectors(exr.inspect(pair.vectors), "auto", layer)
    except exr.JaxblurIOError:
        return None


def _unnamed(arguments: argparse.Namespace, pair: _Pair) -> list[str]:
    """Channels that are vectors by the look of their names, or nothing."""
    from jaxblur import exr

    info = exr.inspect(pair.vectors)
    layer = None if arguments.velocity_from else arguments.layer
    try:
        found = exr.choose_vectors(info, "pixel", layer, arguments.velocity_channels).channels
    except exr.JaxblurIOError:
        if arguments.velocity_channels:
            raise
        return []
    if not arguments.velocity_from and not arguments.velocity_channels:
        # R and G are called like vectors of some files, but here they are the picture.
        color = exr.choose_color(info, arguments.layer, arguments.color_channels).channels
        return [] if set(found) & set(color) else list(found)
    return list(found)


def _ranked(arguments: argparse.Namespace, pair: _Pair, channels: list[str]) -> Any:
    """Rank the readings of the vectors by one pair of frames; None if it cannot tell."""
    from jaxblur import exr, vectors

    now, following = (
        exr.read_image(path, arguments.layer, arguments.color_channels)
        for path in (pair.now, pair.following)
    )
    info = exr.inspect(pair.vectors)
    *_, width, height = info.parts[info.channel(channels[0]).part].display_window
    raw = exr.read_channels(pair.vectors, channels)
    try:
        return vectors.rank_conventions(
            *(now, following, raw, channels),
            shutter=_span(arguments),
            size=(height, width),
            max_displace=arguments.max_displace,
        )
    except ValueError as error:
        LOG.debug("vectors: frames %d and %d: %s", *pair.numbers, error)
        return None


def _span(arguments: argparse.Namespace) -> float:
    """The exposure that the vectors may span."""
    return arguments.file_shutter or arguments.shutter or 0.5


def _adopt(arguments: argparse.Namespace, pair: _Pair, known: Any, ranking: Any) -> None:
    """Take over the best reading, and say which it is and why."""
    from jaxblur import exr, vectors

    best = ranking.candidates[0]
    why = (
        f"it brings frame {pair.numbers[1]} onto {pair.numbers[0]} best, error {best.error:.4f} "
        f"against {ranking.still_error:.4f} if nothing moved"
    )
    if known and known.preset.name in best.presets:
        LOG.info("vectors: %s by name, and by measurement: %s", known.preset.name, why)
        name = known.preset.name
    elif not best.presets:
        LOG.warning(
            "vectors: motion to the next frame in x right, y down is (%+d x, %+d y) of %s in %s, "
            "which no preset decodes: %s",
            *(best.sign_x, best.sign_y, ", ".join(best.channels), best.unit, why),
        )
        return
    else:
        name = min(best.presets, key=_preference)
        by_name = f" (their names alone say {known.preset.name})" if known else ""
        channels = ", ".join(best.channels)
        LOG.info("vectors: %s for %s%s: %s", name, channels, by_name, why)
        arguments.preset = name
        arguments.velocity_channels = None
        layer = None if arguments.velocity_from else arguments.layer
        try:
            found = exr.choose_vectors(exr.inspect(pair.vectors), name, layer).channels
        except exr.JaxblurIOError:
            found = ()
        if tuple(found) != tuple(best.channels):
            arguments.velocity_channels = list(best.channels)
        if known and arguments.depth == "auto":
            # Only the vectors were measured; depth is what names say.
            arguments.depth = known.preset.depth
    if vectors.PRESETS[name].span == "shutter":
        arguments.file_shutter = best.span


def _preference(name: str) -> tuple[bool, bool]:
    """Order of presets that read the vectors alike: by definition, verified, others."""
    from jaxblur import vectors

    return name not in BY_DEFINITION, not vectors.PRESETS[name].verified
