"""``jaxblur blur``: one sharp frame in, one blurred frame out."""

import argparse
import dataclasses
import logging
import pathlib
import time
from collections.abc import Mapping
from typing import Any

import jaxblur
from jaxblur.settings import CHOICES, Settings

from . import published
from .arguments import (
    PNG_TRANSFORM,
    CommandError,
    add_command,
    add_compute_options,
    add_vector_options,
    channel_names,
    check_folder,
    check_outputs,
    describe_presets,
    file_path,
    positive_number,
)
from .compute import start_jax
from .console import print_line, print_table
from .filtering import (
    add_filter_options,
    add_nonfinite_option,
    apply_filter,
    complete,
    report_ignored,
)

LOG = logging.getLogger("jaxblur")

SCORE_COLUMNS = ("against truth", ">PSNR dB", ">SSIM", ">FLIP")


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(commands, "blur", "Blur a frame along its motion vectors.", run)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.more_help = lambda: f"{published.describe_filters()}\n\n{describe_presets()}"
    parser.add_argument("input", type=file_path, help="frame with color, depth and vectors")
    parser.add_argument(
        "-o",
        "--output",
        type=file_path,
        required=True,
        metavar="OUT",
        help=f".exr, or .png ({PNG_TRANSFORM}); never an input",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an existing output")
    parser.add_argument("--png", action="store_true", help="write OUT.png beside OUT.exr too")
    parser.add_argument(
        "--drop-extra", action="store_true", help="write the color alone, not the other channels"
    )
    parser.add_argument(
        "--truth", type=file_path, metavar="FILE", help="print PSNR, SSIM and FLIP against it"
    )
    parser.add_argument("--truth-layer", metavar="NAME", help="layer of the truth to look in")
    add_compute_options(parser)
    group = add_filter_options(parser)
    group.add_argument(
        "--parameters",
        type=pathlib.Path,
        metavar="FILE",
        help="filter, parameters and settings as `jaxblur fit` wrote them; options override",
    )
    _add_plan_options(parser)
    add_vector_options(parser)
    _add_source_options(parser)


def _add_plan_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("plan")
    group.add_argument(
        "--plan",
        choices=("auto",),
        help="choose filter, settings and parameters by statistics of the frame, and say why; "
        "takes the place of all filter options, which are refused beside it",
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


def _add_source_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("where color, vectors and depth are")
    group.add_argument("--color-channels", type=channel_names, metavar="R,G,B[,A]")
    group.add_argument("--velocity-from", type=file_path, metavar="FILE")
    group.add_argument("--depth-from", type=file_path, metavar="FILE")
    group.add_argument("--depth-channel", metavar="NAME")
    group.add_argument(
        "--depth",
        default="auto",
        metavar="KIND",
        help="auto, z, 1/z, normalized-near1, flat (no occlusion), or --depth=-z",
    )
    add_nonfinite_option(group)


def run(arguments: argparse.Namespace) -> int:
    """Blur one frame; see `add_parser`."""
    from jaxblur import exr

    _check_plan(arguments)
    name, parameters, settings = complete(arguments, _fitted(arguments.parameters))
    outputs = _outputs(arguments)
    for source in _sources(arguments):
        earlier = exr.inspect(source).parts[0].attributes.get("jaxblur:filter")
        if earlier and source == arguments.input:
            LOG.warning("%s: was blurred by %s before; this blurs it again.", source, earlier)
        for output in outputs:
            exr.refuse_overwrite(output, source)
    check_outputs(outputs, arguments.overwrite)
    started = time.perf_counter()
    buffers = read_buffers(arguments)
    truth = _read_truth(arguments, buffers.color.shape)
    read = time.perf_counter()

    start_jax(not arguments.no_compile_cache)
    if arguments.plan:
        name, parameters, settings = _planned(arguments, buffers)
    settings = _with_radius(settings, arguments, buffers)
    blurred = apply_filter(name, buffers, parameters, settings)
    done = time.perf_counter()
    images = {"input": buffers.color, name: blurred}
    scores = [] if truth is None else score_rows(images, truth)
    notes = _provenance(arguments, name, buffers, parameters, settings)
    for output in outputs:
        _write(output, blurred, arguments, notes)
    LOG.debug("read in %.2f s, started and blurred in %.2f s", read - started, done - read)
    for output in outputs:
        print_line(f"{output}")
    report_ignored(arguments.input, buffers.ignored)
    if scores:
        print_table(SCORE_COLUMNS, scores)
    return 0


def read_buffers(arguments: argparse.Namespace) -> Any:
    """Read the frame that the arguments of this command name, and say how it was read."""
    from jaxblur import exr

    buffers = exr.read_buffers(
        arguments.input,
        arguments.preset,
        arguments.shutter,
        depth=arguments.depth,
        velocity_from=arguments.velocity_from,
        depth_from=arguments.depth_from,
        file_shutter=arguments.file_shutter,
        max_displace=arguments.max_displace,
        layer=arguments.layer,
        color_channels=arguments.color_channels,
        velocity_channels=arguments.velocity_channels,
        depth_channel=arguments.depth_channel,
        nonfinite=arguments.nonfinite,
    )
    LOG.info("color: %s", ", ".join(buffers.color_channels))
    LOG.info("vectors: %s", buffers.guess.reason)
    LOG.info("depth: %s, read as %s", buffers.depth_channel or "none", buffers.depth_kind)
    return buffers


def _fitted(path: pathlib.Path | None) -> Any:
    if path is None:
        return None
    from jaxblur.fitting import FitResult

    return FitResult.load(path)


def _check_plan(arguments: argparse.Namespace) -> None:
    names = ("filter", "samples", "radius", "param", "parameters", *CHOICES)
    excluded = names if arguments.plan else ("tolerance", "budget")
    for name in excluded:
        # A radius of 0 stands for auto, and is given too.
        if getattr(arguments, name) not in (None, []):
            option = f"--{name.replace('_', '-')}"
            reason = "--plan auto chooses that" if arguments.plan else "only --plan auto takes it"
            raise CommandError(f"{option}: {reason}; leave out one of the two.")


def _planned(arguments: argparse.Namespace, buffers: Any) -> tuple[str, dict[str, float], Settings]:
    """Choose by the frame what `complete` takes from the options, and say why."""
    from jaxblur.frame import Frame
    from jaxblur.planning import plan

    frame = Frame(buffers.color, buffers.depth, buffers.velocity)
    try:
        chosen = plan(frame, arguments.budget, arguments.tolerance)
    except ValueError as error:
        raise CommandError(f"--plan auto: {error}") from error
    LOG.info("plan: %s", chosen.reason)
    values = {} if chosen.parameters is None else dataclasses.asdict(chosen.parameters)
    return chosen.filter, values, chosen.settings


def _outputs(arguments: argparse.Namespace) -> list[pathlib.Path]:
    output = arguments.output
    suffix = output.suffix.lower()
    if suffix not in (".exr", ".png"):
        raise CommandError(f"{output}: can write .exr and .png only; change the extension.")
    if not output.parent.is_dir():
        raise CommandError(f"{output}: no folder {output.parent}; create it first.")
    check_folder(output.parent)
    beside = [output.with_suffix(".png")] if arguments.png and suffix == ".exr" else []
    return [output, *beside]


def _sources(arguments: argparse.Namespace) -> list[pathlib.Path]:
    files = (arguments.input, arguments.velocity_from, arguments.depth_from, arguments.truth)
    return [path for path in files if path is not None]


def _with_radius(settings: Settings, arguments: argparse.Namespace, buffers: Any) -> Settings:
    """Take the radius from the frame if asked to; say how many vectors it cuts otherwise."""
    from jaxblur import vectors

    statistics = vectors.speed_statistics(buffers.velocity, settings.radius)
    if arguments.radius == 0:
        fastest = statistics.percentiles[100.0]
        LOG.info(
            "radius: %d px, for half-spreads up to %.1f px", statistics.suggested_radius, fastest
        )
        return dataclasses.replace(settings, radius=statistics.suggested_radius)
    if statistics.beyond_share > 0:
        LOG.warning(
            "%.2g %% of the vectors are longer than the radius of %d px and are cut to it; "
            "--radius auto would take %d",
            100 * statistics.beyond_share,
            settings.radius,
            statistics.suggested_radius,
        )
    return settings


def _read_truth(arguments: argparse.Namespace, shape: tuple[int, ...]) -> Any:
    from jaxblur import exr

    if arguments.truth is None:
        return None
    truth = exr.read_image(arguments.truth, arguments.truth_layer)
    if truth.shape[:2] != shape[:2]:
        (rows, columns), (height, width) = truth.shape[:2], shape[:2]
        raise CommandError(
            f"{arguments.truth}: the truth has {columns}x{rows} pixels, but {arguments.input} has "
            f"{width}x{height}; render both with the same data window."
        )
    return truth


def score_rows(images: Mapping[str, Any], truth: Any) -> list[tuple[str, ...]]:
    """Score images against a truth.

    Args:
        images: (H, W, C) linear light by name.
        truth: (H, W, C) linear light.

    Returns:
        Rows for `SCORE_COLUMNS`.
    """
    from jaxblur import metrics

    rows = []
    for name, image in images.items():
        score = metrics.compare(metrics.rgb(image), metrics.rgb(truth))
        rows.append((name, f"{score.psnr:.2f}", f"{score.ssim:.4f}", f"{score.flip:.4f}"))
    return rows


def _provenance(
    arguments: argparse.Namespace,
    name: str,
    buffers: Any,
    parameters: dict[str, float],
    settings: Settings,
) -> dict[str, str]:
    """Give what must be known to make the output again; names of files, without folders."""
    used = dataclasses.asdict(settings) | {
        "shutter": arguments.shutter,
        "preset": buffers.guess.preset.name,
        "depth": buffers.depth_kind,
    }
    inputs = [arguments.input, arguments.velocity_from, arguments.depth_from]
    return {
        "jaxblur:version": jaxblur.__version__,
        "jaxblur:filter": name,
        "jaxblur:parameters": _toml(parameters),
        "jaxblur:settings": _toml(used),
        "jaxblur:inputs": ", ".join(path.name for path in inputs if path is not None),
    }


def _toml(values: dict[str, Any]) -> str:
    return "\n".join(
        f'{name} = "{value}"' if isinstance(value, str) else f"{name} = {value}"
        for name, value in values.items()
    )


def _write(
    output: pathlib.Path, image: Any, arguments: argparse.Namespace, provenance: dict[str, str]
) -> None:
    from jaxblur import exr

    from_exr = arguments.input.suffix.lower() == ".exr"
    exr.write_image(
        output,
        image,
        like=arguments.input if from_exr else None,
        extra="drop" if arguments.drop_extra else "keep",
        attributes=provenance,
        layer=arguments.layer,
        color_channels=arguments.color_channels,
    )
    if output.suffix.lower() == ".png":
        LOG.info("%s: %s", output, PNG_TRANSFORM)
