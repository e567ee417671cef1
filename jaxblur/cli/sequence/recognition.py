"""What the vectors of a sequence mean: measured on two of its frames, where no name settles it.

A convention that is given is used, and compared with the same frames.
"""

import argparse
import dataclasses
import itertools
import logging
import pathlib
import shlex
from collections.abc import Mapping
from typing import Any

LOG = logging.getLogger("jaxblur")

PAIRS = 3
"""Pairs of frames that are tried; in the first ones of a shot nothing may move yet."""
USUAL_SPANS = (0.5, 1.0, 0.25, 0.75)
"""Exposures in frames that are taken for what was measured, if they are near."""
NEAR = 0.05
"""Share by which a measured span may differ from the true one."""
SURELY = 0.5
"""A given convention is wrong if it explains less than this share of what the best reading does."""
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

    Nothing changes if names identify a verified convention, or if the frames do not decide, or if a
    preset is given: if another convention clearly fits the frames better, one line says so. The
    frames are the first ones on disk between which something moves, so that chunks of one sequence
    agree.

    Args:
        arguments: of the command; preset, channels, exposure of the file and kind of depth may
            change.
        sources: names of the inputs by role, as `jaxblur.sequence.plan_jobs` takes them.
    """
    from jaxblur import exr

    is_given = arguments.preset != "auto"
    pairs = _pairs(sources)
    try:
        # Without a pair, what the first frame says is said when it is read.
        known = _known(arguments, pairs[0]) if pairs else None
        if not pairs or (is_given and known is None):
            return
        if not is_given and known and known.preset.verified:
            return
        channels = list(known.channels) if known else _unnamed(arguments, pairs[0])
        if not channels:
            return
        if any(_decides(arguments, pair, channels, known) for pair in pairs):
            return
    except exr.JaxblurIOError as error:
        # The frame is reported again when it is its turn.
        LOG.debug("vectors: not compared with the next frame: %s", error)
        return
    if is_given:
        return
    first = pairs[0]
    LOG.info(
        "vectors: what they mean does not show between frames %d and %d; check it with: %s",
        *first.numbers,
        _check_of(arguments, first),
    )


def _decides(arguments: argparse.Namespace, pair: _Pair, channels: list[str], known: Any) -> bool:
    """Whether frames tell what the vectors mean; what they tell is taken over, or said."""
    ranking, left = _ranked(arguments, pair, channels, known)
    if left is not None and left < 1 - SURELY:
        # No other reading can explain twice as much.
        return True
    if ranking is None or not ranking.is_explained:
        return False
    if arguments.preset != "auto":
        _compare(arguments, pair, known, ranking, left)
        return True
    if not ranking.undecided:
        _adopt(arguments, pair, known, ranking)
    return not ranking.undecided


def _check_of(arguments: argparse.Namespace, pair: _Pair) -> str:
    """The command line that ranks the readings of the vectors of a frame."""
    words = ["jaxblur", "vectors", pair.now, "--next", pair.following]
    if arguments.velocity_channels:
        words += ["--velocity-channels", ",".join(arguments.velocity_channels)]
    if arguments.layer:
        words += ["--layer", arguments.layer]
    if arguments.max_displace:
        words += ["--max-displace", f"{arguments.max_displace:g}"]
    if arguments.file_shutter:
        words += ["--shutter", f"{arguments.file_shutter:g}"]
    return shlex.join(map(str, words))


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


def _known(arguments: argparse.Namespace, pair: _Pair) -> Any:
    """The `jaxblur.vectors.Guess` of the convention that is given or that names say, or None."""
    from jaxblur import exr

    info, layer = exr.inspect(pair.vectors), None if arguments.velocity_from else arguments.layer
    try:
        return exr.choose_vectors(info, arguments.preset, layer, arguments.velocity_channels)
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


def _ranked(
    arguments: argparse.Namespace, pair: _Pair, channels: list[str], known: Any
) -> tuple[Any, float | None]:
    """Rank the readings of the vectors by one pair of frames.

    Returns:
        The ranking, None if the pair cannot tell, or if the convention that is given is as good as
        right; and the `jaxblur.vectors.difference_left` by that convention, if there is one.
    """
    from jaxblur import exr, vectors

    now, following = (
        exr.read_image(path, arguments.layer, arguments.color_channels)
        for path in (pair.now, pair.following)
    )
    info = exr.inspect(pair.vectors)
    *_, width, height = info.parts[info.channel(channels[0]).part].display_window
    raw, size = exr.read_channels(pair.vectors, channels), (height, width)
    left = None
    if now.shape != following.shape:
        LOG.debug("vectors: frames %d and %d have other sizes", *pair.numbers)
        return None, None
    try:
        if arguments.preset != "auto":
            span = arguments.file_shutter
            motion = _to_next(raw, known, size, arguments.max_displace, span)
            left = vectors.difference_left(now, following, motion)
            if left is not None and left < 1 - SURELY:
                return None, left
        ranking = vectors.rank_conventions(
            now,
            following,
            raw,
            channels,
            shutter=_span(arguments, known, now, following, raw, size),
            size=size,
            max_displace=arguments.max_displace,
        )
        return ranking, left
    except ValueError as error:
        LOG.debug("vectors: frames %d and %d: %s", *pair.numbers, error)
        return None, None


def _to_next(raw: Any, known: Any, size: Any, displace: float | None, span: float | None) -> Any:
    """(H, W, 2) motion to the next frame, or the opposite of that to the previous one."""
    from jaxblur import vectors

    found: Any = vectors.to_displacements(
        raw, known, size=size, max_displace=displace, file_shutter=span
    )
    return -found.previous if found.next is None else found.next


def _span(
    arguments: argparse.Namespace, known: Any, now: Any, following: Any, raw: Any, size: Any
) -> float:
    """The exposure that the vectors may span; measured where names say that they span one."""
    from jaxblur import vectors

    given = arguments.file_shutter or arguments.shutter or 0.5
    if not known or known.preset.span != "shutter":
        return given
    motion = _to_next(raw, known, size, arguments.max_displace, 1.0)
    measured = vectors.measure_span(now, following, motion)
    if measured is None:
        return given
    # The measurement is known to a few percent.
    near = (span for span in (given, *USUAL_SPANS) if abs(measured / span - 1) <= NEAR)
    return next(near, round(measured, 3))


def _adopt(arguments: argparse.Namespace, pair: _Pair, known: Any, ranking: Any) -> None:
    """Take over the best reading, and say which it is and why."""
    from jaxblur import vectors

    best, why = ranking.candidates[0], _why(pair, ranking)
    if _contradicts(arguments, known, best):
        _warn_of_span(arguments, best, why)
        return
    if known and known.preset.name in best.presets:
        LOG.info("vectors: %s by name, and by measurement: %s", known.preset.name, why)
        name = known.preset.name
    elif not best.presets:
        LOG.warning("vectors: %s, which no preset decodes: %s", _reading(best), why)
        return
    else:
        name = min(best.presets, key=_preference)
        by_name = f" (their names alone say {known.preset.name})" if known else ""
        channels = ", ".join(best.channels)
        LOG.info("vectors: %s for %s%s: %s", name, channels, by_name, why)
        arguments.preset = name
        arguments.velocity_channels = _channels_to_name(arguments, pair, name, best)
        if known and arguments.depth == "auto":
            # Only the vectors were measured; depth is what names say.
            arguments.depth = known.preset.depth
    if vectors.PRESETS[name].span == "shutter" and arguments.file_shutter is None:
        arguments.file_shutter = best.span
        LOG.info("vectors: --file-shutter %g (measured)", best.span)


def _channels_to_name(
    arguments: argparse.Namespace, pair: _Pair, preset: str, best: Any
) -> list[str] | None:
    """The channels of the best reading; None where a preset finds them by itself."""
    from jaxblur import exr

    layer = None if arguments.velocity_from else arguments.layer
    try:
        found = exr.choose_vectors(exr.inspect(pair.vectors), preset, layer).channels
    except exr.JaxblurIOError:
        found = ()
    return None if tuple(found) == tuple(best.channels) else list(best.channels)


def _compare(
    arguments: argparse.Namespace, pair: _Pair, known: Any, ranking: Any, left: float | None
) -> None:
    """Say in one line if the best reading fits the frames clearly better than the given one."""
    best, why = ranking.candidates[0], _why(pair, ranking)
    still = ranking.still_error
    if left is None or (1 - left) * still > SURELY * (still - best.error):
        return
    if _contradicts(arguments, known, best):
        _warn_of_span(arguments, best, why)
        return
    if ranking.undecided:
        other = f"another convention, see `{_check_of(arguments, pair)}`"
    elif best.presets:
        name = min(best.presets, key=_preference)
        channels = _channels_to_name(arguments, pair, name, best)
        other = f"--preset {name}" + (
            f" --velocity-channels {','.join(channels)}" if channels else ""
        )
    else:
        other = _reading(best)
    LOG.warning(
        "vectors: --preset %s is used as given, but they fit %s: %s, and %.4f by %s",
        arguments.preset,
        other,
        why,
        left * still,
        arguments.preset,
    )


def _why(pair: _Pair, ranking: Any) -> str:
    """Why the best reading is that, in words."""
    return (
        f"it brings frame {pair.numbers[1]} onto {pair.numbers[0]} best, error "
        f"{ranking.candidates[0].error:.4f} against {ranking.still_error:.4f} if nothing moved"
    )


def _reading(best: Any) -> str:
    """A reading without a preset, in words."""
    return (
        f"motion to the next frame in x right, y down is ({best.sign_x:+d} x, {best.sign_y:+d} y) "
        f"of {', '.join(best.channels)} in {best.unit}"
    )


def _warn_of_span(arguments: argparse.Namespace, best: Any, why: str) -> None:
    LOG.warning(
        "vectors: --file-shutter %g is used as given, but they fit --file-shutter %g: at that span "
        "%s",
        arguments.file_shutter,
        best.span,
        why,
    )


def _contradicts(arguments: argparse.Namespace, known: Any, best: Any) -> bool:
    """Whether the best reading is that of the names, but for the ``--file-shutter`` given."""
    from jaxblur import vectors

    given = arguments.file_shutter
    if not known or known.preset.span != "shutter" or given is None:
        return False
    pairs = [known.channels[k : k + 2] for k in range(0, len(known.channels), 2)]
    if best.channels not in pairs or abs(best.span / given - 1) <= NEAR:
        return False
    pair = known.layout[pairs.index(best.channels)]
    signs = pair.time * pair.sign_x, pair.time * pair.sign_y
    same_unit = vectors.UNITS[best.unit] == known.preset.scale
    return same_unit and signs == (best.sign_x, best.sign_y)


def _preference(name: str) -> tuple[bool, bool]:
    """Order of presets that read the vectors alike: by definition, verified, others."""
    from jaxblur import vectors

    return name not in BY_DEFINITION, not vectors.PRESETS[name].verified
