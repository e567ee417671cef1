"""``jaxblur vectors --conform PRESET``: test whether vectors keep a convention."""

import argparse
import dataclasses
import json
from typing import Any

from ..arguments import CommandError
from ..console import print_line, print_table


def run(arguments: argparse.Namespace) -> int:
    """Test the vectors of a frame by the rules of `jaxblur.vectors.conformance`.

    Args:
        arguments: of ``vectors``, with ``conform``.

    Returns:
        0 if no required rule fails, and direction and length of the vectors are decided; else 1.

    Raises:
        CommandError: the frames do not belong together, or no frame is given on the side that the
            vectors lead to.
    """
    from jaxblur import exr, vectors

    buffers = exr.read_buffers(
        arguments.file,
        arguments.conform,
        # Half of two frames: the displacements over one.
        2.0,
        depth=arguments.depth,
        depth_channel=arguments.depth_channel,
        file_shutter=arguments.shutter,
        max_displace=arguments.max_displace,
        layer=arguments.layer,
        velocity_channels=arguments.velocity_channels,
        nonfinite="keep",
    )
    others = {
        side: _read(path, arguments, buffers.color)
        for side, path in (("following", arguments.next), ("previous", arguments.previous))
        if path is not None
    }
    try:
        findings = vectors.check_convention(
            buffers.color, _displacements(buffers), depth=buffers.depth, **others
        )
    except ValueError:
        sides = ["previous" if pair.time < 0 else "next" for pair in buffers.guess.layout]
        raise CommandError(
            f"--{sides[-1]}: is missing; the vectors of {arguments.file} lead to the "
            f"{' and the '.join(sides)} frame, and one of them must be given."
        ) from None
    if arguments.json:
        found = {"preset": buffers.guess.preset.name, "channels": list(buffers.guess.channels)}
        rules = [dataclasses.asdict(f) | {"required": f.required} for f in findings]
        print(json.dumps(found | {"rules": rules}, indent=2))
    else:
        channels = ", ".join(buffers.guess.channels)
        print_line(f"{channels} as preset {buffers.guess.preset.name}, {buffers.depth_kind} depth")
        rows = [(f.rule, f.side, _word(f), f.found) for f in findings]
        print_table(("rule", "to", "", "found"), rows)
        print_line(_verdict(findings))
    return 0 if _decided(findings) and not _failed(findings) else 1


def _word(finding: Any) -> str:
    """The outcome; what does not follow advice does not fail."""
    return "not followed" if _ignores_advice(finding) else finding.outcome


def _ignores_advice(finding: Any) -> bool:
    return finding.outcome == "fails" and not finding.required


def _failed(findings: Any) -> list[str]:
    """Rules of which one side fails, without those that are advice."""
    failed = [
        finding.rule for finding in findings if finding.outcome == "fails" and finding.required
    ]
    return list(dict.fromkeys(failed))


def _decided(findings: Any) -> bool:
    """Whether the frames show the direction and length of vectors to one side at least."""
    held = {finding.rule[:2] for finding in findings if finding.outcome == "holds"}
    return held >= {"V2", "V3", "V4"}


def _verdict(findings: Any) -> str:
    if failed := _failed(findings):
        return f"does not keep the convention: {', '.join(failed)}"
    if not _decided(findings):
        return "inconclusive: give frames in which textured things move both across and down"
    advice = {finding.rule for finding in findings if _ignores_advice(finding)}
    return "keeps the convention" + (
        f"; advice not followed: {', '.join(advice)}" if advice else ""
    )


def _read(path: Any, arguments: argparse.Namespace, color: Any) -> Any:
    """The color of a frame beside, of the same size and channels."""
    from jaxblur import exr

    other = exr.read_image(path, arguments.layer)
    if other.shape != color.shape:
        raise CommandError(
            f"{path}: has the shape {other.shape}, but {arguments.file} has {color.shape}; give "
            "frames of one sequence."
        )
    return other


def _displacements(buffers: Any) -> Any:
    """Where the points of a frame go, read for an exposure of two frames."""
    from jaxblur import vectors

    if buffers.path is not None:
        return vectors.Displacements(buffers.path[..., 0, :], buffers.path[..., 1, :])
    if buffers.guess.layout[0].time < 0:
        return vectors.Displacements(-buffers.velocity, None)
    return vectors.Displacements(None, buffers.velocity)
