"""``jaxblur fit``: from frames with truth to a file of parameters."""

import argparse
import dataclasses
import fnmatch
import itertools
import logging
import pathlib
import re
from collections.abc import Mapping, Sequence
from typing import Any

from .. import sources
from ..arguments import (
    CommandError,
    add_command,
    add_compute_options,
    check_outputs,
    check_parent,
    describe_presets,
    from_zero,
    positive_integer,
    whole_from_zero,
)
from ..compute import start_jax
from ..console import print_line, print_table
from ..filtering import (
    FITTED_FILTER,
    add_filter_options,
    check_names,
    complete,
    describe_filters,
    find_filter,
)
from ..progress import stages
from ..sources import add_source_options, add_vector_options
from ..windows import in_window

LOG = logging.getLogger("jaxblur")

FILES_RULE = """\
--truth, --velocity-from and --depth-from each are either one file for each frame, paired in sorted
order, or a single pattern in which {stem} stands for the frame's name without extension, {number}
for the last digits in it, and {folder} for its folder: --truth '{folder}/truth_{number}.exr'."""

_CROP = re.compile(r"([1-9]\d*)x([1-9]\d*)\+(\d+)\+(\d+)")
_FIGURES = ("psnr", "ssim", "flip")


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands, "fit", "Fit parameters of a filter to frames whose true blur is known.", run
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.more_help = lambda: f"{FILES_RULE}\n\n{describe_filters()}\n\n{describe_presets()}"
    parser.add_argument("frames", type=pathlib.Path, nargs="+", help="sharp frames with vectors")
    parser.add_argument(
        "--truth", nargs="+", required=True, metavar="FILE", help="files or a pattern, see below"
    )
    parser.add_argument(
        "-o", "--output", type=pathlib.Path, required=True, metavar="OUT.toml", help="result"
    )
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace an existing output, and start anew after an interrupted fit",
    )
    parser.add_argument(
        "--holdout",
        nargs="+",
        default=[],
        metavar="PATTERN",
        help="frames that are only evaluated, not fitted: names or shell patterns such as "
        "'*rolling*', of the path as given or of the file",
    )
    parser.add_argument("--crop", type=crop, metavar="WxH+X+Y", help="use only this part")
    add_compute_options(parser)
    _add_fit_options(parser)
    add_filter_options(parser, default=FITTED_FILTER)
    add_vector_options(parser)
    add_source_options(parser, of_many="one for each frame, or a pattern, as --truth")
    # `fit` needs finite pixels.
    parser.set_defaults(nonfinite="error")


def _add_fit_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("fit")
    group.add_argument(
        "--free",
        type=lambda text: tuple(name.strip() for name in text.split(",")),
        metavar="A,B",
        help="parameters to fit (guertin2014: kappa,gamma,tau,phi); --param sets where they start",
    )
    group.add_argument(
        "--loss",
        choices=("auto", "expected", "mean"),
        default="auto",
        help="average over the random choice of tile: expected error, or error of the mean image "
        "(default auto: expected if the filter draws tiles at random)",
    )
    group.add_argument(
        "--pixel",
        choices=("mse", "relative", "display", "ssim"),
        default="mse",
        help="error of a pixel (default %(default)s)",
    )
    group.add_argument("--mask", choices=("moving",), help="count only pixels that motion reaches")
    group.add_argument(
        "--fit-noise",
        choices=("fresh", "fixed", "builtin"),
        default="fresh",
        help="jitter during the fit: new at each step, or always the same (default %(default)s)",
    )
    group.add_argument(
        "--noise-draws",
        type=positive_integer,
        default=1,
        metavar="N",
        help="draws of noise in each step (default %(default)s)",
    )
    group.add_argument(
        "--steps",
        type=positive_integer,
        default=100,
        metavar="N",
        help="steps at most (default %(default)s)",
    )
    group.add_argument(
        "--patience",
        type=whole_from_zero,
        default=20,
        metavar="N",
        help="stop when the loss has not improved for so many steps; 0 takes all steps "
        "(default %(default)s)",
    )
    group.add_argument(
        "--tolerance",
        type=from_zero,
        default=0.002,
        metavar="SHARE",
        help="share of the loss that counts as an improvement (default %(default)s)",
    )
    group.add_argument(
        "--prior",
        type=from_zero,
        default=0.0,
        metavar="STRENGTH",
        help="pull toward the default values: at 0.01 a value 2.7 times the default one costs "
        "as much as half a percent of the loss (default: none)",
    )
    group.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of all noise (default %(default)s)"
    )
    group.add_argument(
        "--resume", action="store_true", help="continue from OUT.state.npz, if it exists"
    )


def run(arguments: argparse.Namespace) -> int:
    """Fit, report and write; see `add_parser`."""
    name, parameters, settings = complete(arguments)
    files = match_files(arguments)
    frames = [named["input"] for named in files]
    holdout = held_out(frames, arguments.holdout)
    check_names(find_filter(name), arguments.free or (), "--free")
    _check_output(arguments, [path for named in files for path in named.values()])
    pairs = [_read_pair(arguments, named) for named in files]
    settings = _with_radius(settings, arguments, pairs)
    state = arguments.output.with_suffix(".state.npz")
    _check_state(arguments, state)

    start_jax(not arguments.no_compile_cache)
    import jax

    from jaxblur.fitting import STAGES, fit

    LOG.info("starting; stages: %s", ", ".join(STAGES))

    with stages() as shown:
        result = fit(
            name,
            [(buffers.frame(), truth) for buffers, truth in pairs],
            initial=parameters,
            free=arguments.free,
            loss=arguments.loss,
            pixel=arguments.pixel,
            mask=arguments.mask,
            settings=settings,
            noise=arguments.fit_noise,
            noise_draws=arguments.noise_draws,
            steps=arguments.steps,
            patience=arguments.patience,
            tolerance=arguments.tolerance,
            prior=arguments.prior,
            holdout=holdout,
            key=jax.random.key(arguments.seed),
            names=[path.as_posix() for path in frames],
            notes={"shutter": arguments.shutter, "preset": pairs[0][0].guess.preset.name},
            callback=lambda progress: shown.detail(_step(progress)),
            on_stage=lambda stage: shown.stage(stage.name, stage.done, stage.total),
            state=state,
            resume=arguments.resume,
        )
    _leave(arguments.output, state, result)
    return 0


def _leave(output: pathlib.Path, state: pathlib.Path, result: Any) -> None:
    """Write and report the result; for an interrupted fit say how to continue."""
    if result.interrupted:
        raise KeyboardInterrupt(_farewell(result.steps, state))
    result.save(output)
    state.unlink(missing_ok=True)
    _report(output, result)


def _check_state(arguments: argparse.Namespace, state: pathlib.Path) -> None:
    """Reject a new start that would replace the state of an interrupted fit, unless requested."""
    if state.exists() and not arguments.resume and not arguments.overwrite:
        raise CommandError(
            f"{state}: is the state of an interrupted fit; pass --resume to continue from it, or "
            "--overwrite to start anew."
        )


def _farewell(steps: int, state: pathlib.Path) -> str:
    """The message after ctrl-C."""
    if steps == 0:
        state.unlink(missing_ok=True)
        return "interrupted before the first step; there is nothing to continue from"
    return f"interrupted; stopped after {steps} steps; --resume continues from {state}"


def match_files(arguments: argparse.Namespace) -> list[dict[str, pathlib.Path]]:
    """Find the files that belong to each frame; see `FILES_RULE`.

    Args:
        arguments: of the command.

    Returns:
        For each frame, in sorted order, the file of each role that there is: ``input``, ``truth``,
        ``velocity_from``, ``depth_from``.

    Raises:
        CommandError: the numbers differ, a frame is named twice, or a pattern does not apply.
    """
    ordered = sorted(arguments.frames)
    for first, second in itertools.pairwise(ordered):
        if first == second:
            raise CommandError(f"{first}: is given twice.")
    roles = {"input": ordered}
    for role in ("truth", "velocity_from", "depth_from"):
        given = getattr(arguments, role)
        if given is not None:
            roles[role] = _matched(f"--{role.replace('_', '-')}", given, ordered)
    return [dict(zip(roles, paths, strict=True)) for paths in zip(*roles.values(), strict=True)]


def _matched(
    option: str, given: Sequence[str], frames: Sequence[pathlib.Path]
) -> list[pathlib.Path]:
    if len(given) == 1 and "{" in given[0]:
        return [_from_pattern(option, given[0], frame) for frame in frames]
    if len(given) != len(frames):
        raise CommandError(
            f"{option}: {len(given)} files for {len(frames)} frames; give one for each, or a "
            "pattern such as '{folder}/truth_{number}.exr'."
        )
    return sorted(map(pathlib.Path, given))


def _from_pattern(option: str, pattern: str, frame: pathlib.Path) -> pathlib.Path:
    numbers = re.findall(r"\d+", frame.stem)
    fields = {"stem": frame.stem, "folder": str(frame.parent)}
    if numbers:
        fields["number"] = numbers[-1]
    try:
        return pathlib.Path(pattern.format(**fields))
    except (KeyError, IndexError, ValueError, AttributeError) as error:
        raise CommandError(
            f"{option}: {pattern!r} does not apply to {frame}; it may hold "
            f"{', '.join(f'{{{name}}}' for name in fields)}."
        ) from error


def held_out(frames: Sequence[pathlib.Path], patterns: Sequence[str]) -> list[int]:
    """Find the frames that are held out.

    Args:
        frames: all frames.
        patterns: names or shell patterns, of the path as given, of its end, or of the file.

    Returns:
        Indices of the frames.

    Raises:
        CommandError: a pattern matches none or all, or no frame is left; it lists the names.
    """
    found: set[int] = set()
    listing = ", ".join(map(str, frames))
    for pattern in patterns:
        matching = {k for k, frame in enumerate(frames) if _matches(frame, pattern)}
        if not matching:
            raise CommandError(
                f"--holdout: no frame matches {pattern!r}; * stands for any characters. The frames "
                f"are {listing}."
            )
        found |= matching
        if len(found) == len(frames):
            every = f"{pattern!r} matches every frame" if len(matching) == len(frames) else "all"
            raise CommandError(
                f"--holdout: no frame is left to fit, {every}; hold out fewer of {listing}."
            )
    return sorted(found)


def _matches(frame: pathlib.Path, pattern: str) -> bool:
    """Whether a shell pattern matches a path, its end, or its last part."""
    wholes = frame.as_posix(), frame.name
    return frame.match(pattern) or any(fnmatch.fnmatchcase(whole, pattern) for whole in wholes)


def crop(text: str) -> tuple[slice, slice]:
    """Parse ``WxH+X+Y`` to rows and columns.

    Raises:
        ArgumentTypeError: it is something else.
    """
    match = _CROP.fullmatch(text)
    if match is None:
        raise argparse.ArgumentTypeError(f"expected WxH+X+Y such as 320x180+0+90, got {text!r}")
    width, height, x, y = map(int, match.groups())
    return slice(y, y + height), slice(x, x + width)


def _check_output(arguments: argparse.Namespace, inputs: Sequence[pathlib.Path]) -> None:
    from jaxblur import exr

    output = arguments.output
    if output.suffix != ".toml":
        raise CommandError(f"{output}: can write .toml only; change the extension.")
    for path in inputs:
        exr.inspect(path)
    check_outputs([output], arguments.overwrite)
    check_parent(output)


def _read_pair(arguments: argparse.Namespace, named: Mapping[str, pathlib.Path]) -> tuple[Any, Any]:
    from jaxblur import exr

    frame, truth = named["input"], named["truth"]
    LOG.info("%s: truth %s", frame, truth)
    buffers = sources.read(argparse.Namespace(**vars(arguments) | dict(named)))
    image = in_window(
        exr.read_image(truth),
        truth,
        exr.choose_color(exr.inspect(truth)).channels[0],
        frame,
        buffers.windows,
        what="the truth",
    )
    return _cropped(arguments.crop, frame, buffers, image)


def _cropped(
    part: tuple[slice, slice] | None, frame: pathlib.Path, buffers: Any, truth: Any
) -> tuple[Any, Any]:
    if part is None:
        return buffers, truth
    height, width = truth.shape[:2]
    if part[0].stop > height or part[1].stop > width:
        raise CommandError(f"--crop: reaches beyond {frame}, which has {width}x{height} pixels.")
    names = ("color", "depth", "velocity", "path")
    cut = {name: whole[part] for name in names if (whole := getattr(buffers, name)) is not None}
    return dataclasses.replace(buffers, **cut), truth[part]


def _with_radius(settings: Any, arguments: argparse.Namespace, pairs: Sequence[Any]) -> Any:
    """Take the radius from the fastest frame under ``--radius auto``."""
    from jaxblur import vectors

    if arguments.radius != 0:
        return settings
    speeds = [vectors.speed_statistics(buffers.velocity) for buffers, _ in pairs]
    radius = max(speed.suggested_radius for speed in speeds)
    LOG.info("radius: %d px", radius)
    return dataclasses.replace(settings, radius=radius)


def _step(progress: Any) -> str:
    listing = _listing(progress.parameters)
    return f"step {progress.step}/{progress.steps} loss {progress.loss:.5g} {listing}"


def _listing(parameters: dict[str, float]) -> str:
    return " ".join(f"{name}={value:.4g}" for name, value in parameters.items())


def _report(output: pathlib.Path, result: Any) -> None:
    print_line(output)
    LOG.info("minimized: %s", result.minimized)
    if result.plateau is not None:
        LOG.info(
            "stopped on a plateau after step %d: the loss no longer improved; --patience and "
            "--tolerance say when.",
            result.plateau,
        )
    sensitivity = result.sensitivity
    errors = dict(zip(sensitivity.names, sensitivity.standard_error, strict=True))
    print_table(
        ("parameter", ">default", ">fitted", ">± standard error"),
        [
            (
                name,
                f"{result.published[name]:.4g}",
                f"{value:.4g}",
                _certainty(name, errors, sensitivity.undetermined),
            )
            for name, value in result.parameters.items()
        ],
    )
    parts = dict.fromkeys(score.part for score in result.scores)
    print_table(
        ("moving pixels", "parameters", ">PSNR dB", ">SSIM", ">FLIP"),
        [
            (part, words, *(_mean(result, figure, part, label) for figure in _FIGURES))
            for part in parts
            for label, words in (("published", "default"), ("fitted", "fitted"))
        ],
    )
    for warning in result.warnings:
        LOG.warning("%s", warning)
    if result.losses_by_fitting():
        LOG.warning("fit to more frames, for longer, or with another --pixel error or a --prior.")


def _certainty(name: str, errors: Mapping[str, float], undetermined: Sequence[str]) -> str:
    if name not in errors:
        return "held"
    return "not determined" if name in undetermined else f"{errors[name]:.2g}"


def _mean(result: Any, figure: str, part: str, label: str) -> str:
    digits = 2 if figure == "psnr" else 4
    return f"{result.mean_score(figure, part, label, 'moving'):.{digits}f}"
