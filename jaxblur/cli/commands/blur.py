"""``jaxblur blur``: sharp frames in, blurred frames out."""

import argparse
import dataclasses
import logging
import pathlib
import re
import time
from collections.abc import Sequence
from typing import Any

from .. import isolation, mattes, posts, results, sequence, stack, stages, strength
from ..arguments import (
    PNG_TRANSFORM,
    CommandError,
    add_command,
    add_compute_options,
    add_view_option,
    check_outputs,
    describe_presets,
    file_path,
    positive_number,
)
from ..compute import add_threads_option, limited_threads, start_jax
from ..console import print_line, print_table
from ..filtering import (
    CHOICES,
    add_filter_options,
    add_nonfinite_option,
    add_quality_option,
    add_seed_option,
    complete,
    describe_filters,
    report_ignored,
    require_neighbors,
    require_shutter,
    takes_neighbors,
)
from ..progress import remarks_once
from ..shutter import add_shutter_options, option_of, settle
from ..sources import add_source_options, add_vector_options

LOG = logging.getLogger("jaxblur")


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands, "blur", "Blur a frame, or a sequence of frames, along motion vectors.", run
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.more_help = lambda: f"{describe_filters()}\n\n{describe_presets()}"
    parser.instead_of_more = _as_sequence
    parser.add_argument(
        "input",
        type=file_path,
        help="frame with color, depth and vectors, or frames: name.####.exr, name.%%04d.exr",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=file_path,
        required=True,
        metavar="OUT",
        help=f".exr, or .png ({PNG_TRANSFORM}); never an input",
    )
    existing = parser.add_mutually_exclusive_group()
    existing.add_argument("--overwrite", action="store_true", help="replace existing outputs")
    sequence.add_options(parser, existing)
    parser.add_argument("--png", action="store_true", help="write OUT.png beside OUT.exr too")
    parser.add_argument(
        "--drop-extra", action="store_true", help="write the color alone, not the other channels"
    )
    strength.add_pass_options(parser)
    mattes.add_option(parser)
    parser.add_argument(
        "--truth", type=file_path, metavar="FILE", help="print PSNR, SSIM and FLIP against it"
    )
    parser.add_argument("--truth-layer", metavar="NAME", help="layer of the truth to look in")
    results.add_option(parser)
    _add_neighbor_options(parser)
    add_color_options(parser)
    add_compute_options(parser)
    add_threads_option(parser)
    group = add_filter_options(parser)
    add_quality_option(group)
    add_seed_option(group)
    group.add_argument(
        "--parameters",
        type=pathlib.Path,
        metavar="FILE",
        help="filter, parameters and settings as `jaxblur fit` wrote them; options override them",
    )
    _add_plan_options(parser)
    add_vector_options(parser)
    add_shutter_options(parser)
    parser.add_argument(
        "--require-motion",
        action="store_true",
        help="fail, rather than warn, if the vectors move nothing by half a pixel",
    )
    strength.add_options(parser)
    posts.add_options(parser, "--then")
    add_nonfinite_option(add_source_options(parser))
    isolation.add_options(parser, memory=16384, seconds=24 * 3600)


def _add_neighbor_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "more renders, for a single frame (a sequence uses its frames by itself)"
    )
    for side in ("before", "after"):
        group.add_argument(
            f"--{side}",
            type=file_path,
            metavar="FILE",
            help=f"the frame {side}, which shows some of what the frame hides; read by the same "
            "options",
        )
    group.add_argument(
        "--subframes",
        type=file_path,
        metavar="NAMES",
        help="sub.####.exr: K sharp renders at the centers of K equal parts of the exposure, each "
        "blurred over its part, and their mean; the frame gives the other channels",
    )


def add_color_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of how colors are shown; `check_colors` reads them."""
    group = parser.add_argument_group(
        "colors of previews, scores and reports; an EXR keeps its own"
    )
    add_view_option(group, "PNG, scores and --result")
    group.add_argument(
        "--color-space",
        metavar="NAME",
        help="color space of the frame and of a truth in EXR, such as ACEScg, where the files do "
        "not name it or name a wrong one (default: as in the file, else linear sRGB)",
    )


def _as_sequence(given: Sequence[str], left: Sequence[str]) -> str:
    """How to give several frames, which a shell pattern may have listed."""
    names = {
        re.sub(r"\d+(?=\D*$)", lambda m: "#" * len(m[0]), name) for name in (*left, *given[:1])
    }
    pattern = names.pop() if len(names) == 1 else ""
    layers = "; layers of one frame: `jaxblur layers FRONT.exr BACK.exr -o OUT.exr`"
    more = "" if "#" in pattern else layers
    example = pattern if "#" in pattern else "name.####.exr"
    return (
        "`jaxblur blur` takes one frame, or the names of a sequence as one pattern, in quotes: "
        f"'{example}'{more}"
    )


def _add_plan_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("plan")
    group.add_argument(
        "--plan",
        choices=("auto",),
        help="choose filter, settings and parameters by statistics of the frame, and say why; "
        "replaces all filter options, which are rejected beside it",
    )
    group.add_argument(
        "--tolerance",
        type=positive_number,
        metavar="DB",
        help="with --plan: PSNR that may be lost against the full filter (0.5 without --budget)",
    )
    group.add_argument(
        "--budget", type=positive_number, metavar="MS", help="with --plan: time for the filter"
    )


def run(arguments: argparse.Namespace) -> int:
    """Blur one frame, or a sequence; see `add_parser`."""
    if arguments.isolate and not isolation.in_child:
        return isolation.run(arguments)
    settle(arguments)
    _check_plan(arguments)
    check_motion(arguments)
    check_colors(arguments)
    strength.check(arguments)
    mattes.check(arguments)
    posts.check(arguments)
    results.check(arguments)
    asked = stages.Choice(*complete(arguments, _fitted(arguments.parameters)))
    if arguments.exposure is not None:
        require_shutter(asked.name, option_of(arguments))
    with limited_threads(arguments.threads):
        if sequence.is_asked_for(arguments):
            return sequence.run(arguments, asked)
        sequence.refuse_options(arguments)
        return run_single(arguments, asked)


def run_single(arguments: argparse.Namespace, asked: stages.Choice) -> int:
    """Blur one frame.

    Args:
        arguments: of the command.
        asked: filter, parameters and settings from the options.

    Returns:
        0.

    Raises:
        CommandError: an option is wrong or an output must not be replaced.
        JaxblurIOError: a file cannot be read or written.
    """
    from jaxblur import exr

    arguments.in_sequence = False
    if arguments.seed == "frame":
        arguments.seed = _number_in(arguments.input)
    outputs = _outputs(arguments)
    _check_neighbors(arguments, asked)
    for source in _sources(arguments):
        exr.inspect(source)
        for output in outputs:
            exr.refuse_overwrite(output, source)
    stages.warn_of_double_blur(arguments)
    check_outputs(outputs, arguments.overwrite)
    mattes.warn_of_sharp(arguments, arguments.input)
    started = time.perf_counter()
    with remarks_once():
        loaded = _load(arguments, asked)
        parts = _load_subframes(arguments, asked, loaded)
    read = time.perf_counter()
    if not loaded.selects:
        raise CommandError(f"{strength.SELECTS_NOTHING} of {arguments.input}.")

    start_jax(not arguments.no_compile_cache)
    chosen, blurred = _blur(arguments, asked, parts or [loaded])
    changes = mattes.blur(chosen, loaded, arguments.seed, parts or [loaded])
    loaded = dataclasses.replace(loaded, changes=changes)
    blurred = stages.after_blur(arguments, chosen, loaded, blurred, arguments.seed)
    done = time.perf_counter()
    images = {"input": loaded.buffers.color, chosen.name: loaded.picture(blurred)}
    scored = stages.scores_of(images, loaded)
    provenance = stages.provenance(arguments, chosen, loaded)
    if parts:
        names = ", ".join(path.name for path in _subframe_files(arguments))
        provenance = {**provenance, stages.SUBFRAMES: names}
    stages.write(arguments, outputs, blurred, provenance, loaded)
    LOG.debug("read in %.2f s, started and blurred in %.2f s", read - started, done - read)
    for output in outputs:
        print_line(f"{output}")
    report_ignored(arguments.input, loaded.buffers.ignored)
    if scored:
        print_table(stages.SCORE_COLUMNS, stages.score_rows(scored))
    if arguments.result:
        settings = results.settings_of(chosen)
        name, sources = arguments.input.name, vars(arguments)
        picture = loaded.picture(blurred)
        shot = results.make_shot(name, loaded, picture, chosen.name, settings, sources)
        results.write(arguments, [shot])
    return 0


def _load(arguments: argparse.Namespace, asked: stages.Choice) -> stages.Loaded:
    """Read the frame, and its neighbors by the same options."""
    loaded = stages.load(arguments, asked.settings)
    neighbors = {
        side: stages.read(argparse.Namespace(**vars(arguments) | files))
        for side in ("before", "after")
        if (files := stack.files_of(arguments, side))
    }
    for side, source in neighbors.items():
        if differs := stages.mismatch(loaded, source):
            raise CommandError(f"--{side}: {source.path} {differs}; render both alike.")
    return loaded.with_neighbors(neighbors)


def _load_subframes(
    arguments: argparse.Namespace, asked: stages.Choice, loaded: stages.Loaded
) -> list[stages.Loaded]:
    """Read the sub-frames, each with the motion of its part of the exposure and its neighbors."""
    files = _subframe_files(arguments)
    shutter = arguments.shutter / max(len(files), 1)
    changes = {"shutter": shutter, "exposure": None, "truth": None}
    parts = [argparse.Namespace(**vars(arguments) | changes | {"input": path}) for path in files]
    sources = [stages.read(part) for part in parts]
    for source in sources:
        if differs := stages.mismatch(loaded, source):
            raise CommandError(f"--subframes: {source.path} {differs}; render all alike.")
    frames = []
    for index, (part, source) in enumerate(zip(parts, sources, strict=True)):
        near = {
            "before": sources[max(index - 1, 0) : index],
            "after": sources[index + 1 : index + 2],
        }
        found = {side: one[0] for side, one in near.items() if one}
        frame = stages.load(part, asked.settings, source).with_neighbors(found)
        # From one sub-frame to the next it takes as long as its part of the exposure.
        frames.append(dataclasses.replace(frame, shutter=1.0))
    return frames


def _subframe_files(arguments: argparse.Namespace) -> list[pathlib.Path]:
    """The sub-frames on disk in the order of their numbers; none without the option."""
    from jaxblur.sequence import parse_names

    if arguments.subframes is None:
        return []
    names = parse_names(arguments.subframes)
    return [names.path(number) for number in names.frames_on_disk()]


def _blur(
    arguments: argparse.Namespace, asked: stages.Choice, parts: list[stages.Loaded]
) -> tuple[stages.Choice, Any]:
    """Blur the parts of the exposure, or the one frame of all of it, and take the mean."""
    fastest = max(parts, key=lambda part: part.speeds.suggested_radius)
    chosen = stages.choose(arguments, asked, fastest)
    if parts[0].neighbors and not takes_neighbors(chosen.name) and not arguments.subframes:
        LOG.warning("%s takes no neighbors: --before and --after are not used.", chosen.name)
    total = stages.blur(chosen, parts[0], arguments.seed)
    for part in parts[1:]:
        total = total + stages.blur(chosen, part, arguments.seed)
    return chosen, total / len(parts) if len(parts) > 1 else total


def _check_neighbors(arguments: argparse.Namespace, asked: stages.Choice) -> None:
    """Reject neighbors and sub-frames that cannot be used, before any work."""
    sides = [side for side in ("before", "after") if getattr(arguments, side) is not None]
    more = [*sides, *(["subframes"] if arguments.subframes is not None else [])]
    if not more:
        return
    if arguments.shutter == 0:
        raise CommandError(f"--{more[0]}: --shutter 0 blurs nothing; leave out one of the two.")
    for option in ("velocity_from", "depth_from", "matte_from"):
        if getattr(arguments, option) is not None:
            raise CommandError(
                f"--{more[0]}: such frames bring their own vectors, depth and mattes; leave out "
                f"--{option.replace('_', '-')}, or give the frames as a sequence: name.####.exr."
            )
    if sides and arguments.subframes is not None:
        raise CommandError(
            f"--{sides[0]}: sub-frames are neighbors of each other; leave out one of the two."
        )
    if arguments.subframes is not None and arguments.exposure is not None:
        raise CommandError(
            f"{option_of(arguments)}: sub-frames are equal parts of an exposure centered on the "
            "frame; leave out one of the two."
        )
    if sides and arguments.plan is None:
        require_neighbors(asked.name, f"--{sides[0]}")
    if arguments.subframes is not None and not _subframe_files(arguments):
        raise CommandError(f"--subframes: {arguments.subframes}: no such files.")


def _number_in(path: pathlib.Path) -> int:
    """The number of a frame, which is the last one in its name, for ``--seed frame``."""
    numbers = re.findall(r"\d+", path.stem)
    if not numbers:
        raise CommandError(f"--seed frame: {path.name} has no frame number; give a number.")
    return int(numbers[-1])


def _fitted(path: pathlib.Path | None) -> Any:
    if path is None:
        return None
    from jaxblur.fitting import FitResult

    return FitResult.load(path)


def _check_plan(arguments: argparse.Namespace) -> None:
    numbers = "samples", "quality", "radius", "spacing", "temperature"
    names = ("filter", *numbers, "param", "parameters", *CHOICES)
    excluded = names if arguments.plan else ("tolerance", "budget")
    if arguments.plan and arguments.exposure is not None:
        raise CommandError(
            f"{option_of(arguments)}: --plan auto may choose a filter that takes no shutter; leave "
            "out one of the two."
        )
    for name in excluded:
        # A radius of 0 stands for auto, and is given too.
        if getattr(arguments, name) not in (None, []):
            option = f"--{name.replace('_', '-')}"
            reason = "--plan auto chooses that" if arguments.plan else "only --plan auto takes it"
            raise CommandError(f"{option}: {reason}; leave out one of the two.")


def check_motion(arguments: argparse.Namespace) -> None:
    """Reject a shutter that leaves every frame sharp where motion is required.

    Raises:
        CommandError: it does.
    """
    if arguments.require_motion and arguments.shutter == 0:
        raise CommandError(
            "--require-motion: at --shutter 0 nothing moves; give an exposure above 0, or leave "
            "out one of the two."
        )


def check_colors(arguments: argparse.Namespace) -> None:
    """Reject colors that nothing would be shown in, or that the configuration lacks.

    Raises:
        CommandError: nothing would be shown in them.
        ValueError: the configuration lacks them.
    """
    if arguments.view is None and arguments.color_space is None:
        return
    from jaxblur import exr

    exr.check_view(arguments.view)
    exr.check_color_space(arguments.color_space)
    png = arguments.png or arguments.output.suffix.lower() == ".png"
    if not png and arguments.truth is None:
        option = "--view" if arguments.view else "--color-space"
        raise CommandError(
            f"{option}: is for previews and scores, and an EXR keeps its colors; add --png or "
            "--truth, or leave it out."
        )


def _outputs(arguments: argparse.Namespace) -> list[pathlib.Path]:
    output = arguments.output
    stages.check_output(output)
    beside = (
        [output.with_suffix(".png")] if arguments.png and output.suffix.lower() == ".exr" else []
    )
    return [output, *beside]


def _sources(arguments: argparse.Namespace) -> list[pathlib.Path]:
    files = [getattr(arguments, role) for role in stack.roles(arguments)]
    files += [arguments.velocity_from, arguments.depth_from, arguments.truth]
    near = [path for s in ("before", "after") for path in stack.files_of(arguments, s).values()]
    more = (arguments.matte_from, *near, *_subframe_files(arguments))
    return [path for path in (*files, *more) if path is not None]
