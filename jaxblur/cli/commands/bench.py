"""``jaxblur bench``: how long filters take and how wrong they are, on frames or scenes."""

import argparse
import dataclasses
import logging
import pathlib
from collections.abc import Callable, Sequence
from typing import Any

from jaxblur.filters.registry import names
from jaxblur.settings import Settings

from ..arguments import (
    CommandError,
    add_command,
    check_parent,
    file_path,
    one_of,
    positive_integer,
    positive_number,
)
from ..compute import start_jax
from ..console import print_line, print_table, track
from ..filtering import CHOICES, add_nonfinite_option, filter_name, find_filter
from ..loading import load
from ..sources import add_source_options, add_vector_options
from .scene import check_scene, image_size

LOG = logging.getLogger("jaxblur")

OTHERS = ("unblurred", "accumulate", "stochastic", "motion_paths")
"""Methods that are not filters."""
AXES = ("samples", "radius", "fetch", "tile_choice", "directions")
BATCH = 8
REGRESSION = 1

EXPLANATION = """\
Every row of RESULTS.csv is one method with its settings on one frame: median and interquartile
range of the time (compiled before, timed in turn with others, and with a fixed piece of work that
shows how busy the machine is), processor time, compile time, memory, and with a truth PSNR, SSIM
and FLIP on display values, whole and where motion reaches (moving_...). After an
interruption, run the command again: cases in the file are measured again only if the code changed.

--compare divides each time by that of the fixed work in the same rounds. A case is slower if
the ratio exceeds 1 + tolerance by more than three standard errors, larger if its temporary buffers
grew by more than the tolerance, worse if PSNR where motion reaches fell by more than 0.1 dB; any of
these gives exit status 1. All cases of OLD.csv for the given frames or scenes are measured again
(for all its scenes if none is given); options of the grid select among them."""


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(commands, "bench", "Measure speed against error.", run)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = EXPLANATION
    parser.add_argument("frames", nargs="*", type=file_path, metavar="FRAME", help="frames (EXR)")
    parser.add_argument(
        "--truth",
        type=file_path,
        action="append",
        default=[],
        metavar="FILE",
        help="truth of FRAME; one for each frame, in their order",
    )
    parser.add_argument("--truth-layer", metavar="NAME", help="layer of the truths to look in")
    parser.add_argument(
        "-o",
        "--output",
        type=file_path,
        required=True,
        metavar="RESULTS.csv",
        help="rows are added",
    )
    parser.add_argument(
        "--table", type=file_path, metavar="OUT.md", help="write the fronts here too"
    )
    _add_scene_options(parser)
    _add_grid_options(parser)
    group = parser.add_argument_group("regression guard")
    group.add_argument(
        "--compare", type=file_path, metavar="OLD.csv", help="an earlier RESULTS.csv"
    )
    group.add_argument(
        "--tolerance",
        type=positive_number,
        default=10.0,
        metavar="PERCENT",
        help="growth of time and memory that is allowed (default %(default)g)",
    )
    add_vector_options(parser)
    add_nonfinite_option(add_source_options(parser))


def _add_scene_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("scenes of the catalogue")
    group.add_argument(
        "--scene", type=_several(str), default=[], metavar="NAME,...", help="see `jaxblur scene`"
    )
    group.add_argument(
        "--size",
        type=_several(image_size),
        default=[(180, 320)],
        metavar="WxH,...",
        help="default 320x180",
    )
    group.add_argument(
        "--truth-samples",
        type=positive_integer,
        default=128,
        metavar="N",
        help="images averaged into a truth (default %(default)s)",
    )


def _add_grid_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("what is measured")
    group.add_argument(
        "--methods",
        type=_several(_method),
        metavar="NAME,...",
        help=f"filters (see `jaxblur blur --help`) or {', '.join(OTHERS)} (default: the filters, "
        "and unblurred); FILE.py:NAME for a filter of your own",
    )
    group.add_argument(
        "--samples", type=_several(positive_integer), metavar="N,...", help="default 9,15,27,35"
    )
    group.add_argument("--radius", type=_several(_radius), metavar="auto|PX,...")
    for name in ("fetch", "tile_choice", "directions"):
        group.add_argument(
            f"--{name.replace('_', '-')}",
            type=_several(_choice(name)),
            metavar="NAME,...",
            help=f"of {', '.join(CHOICES[name])}",
        )
    group.add_argument(
        "--grid",
        choices=("product", "axes"),
        default="product",
        help="every combination, or one departure from the published settings at a time",
    )
    group.add_argument(
        "--repeats",
        type=positive_integer,
        default=9,
        metavar="N",
        help="timed runs of each case (default %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure the cases that the file lacks, print the fronts, compare; see `add_parser`."""
    _check(arguments)
    # Compile times are part of the results.
    start_jax(compile_cache=False)
    from jaxblur import bench

    old = _read(arguments.compare) if arguments.compare else []
    known = _read(arguments.output) if arguments.output.exists() else []
    jobs = _jobs(arguments, old)
    rows = _measure(arguments, jobs, known)
    wanted = {bench.identity(subject, case) for subject, case in jobs}
    current = [row for row in bench.latest(rows) if row.identity in wanted]
    text = bench.report(current)
    for line in text.splitlines():
        print_line(line)
    if arguments.table:
        arguments.table.write_text(text, encoding="utf-8")
    return _compare(arguments, old, current) if arguments.compare else 0


def _check(arguments: argparse.Namespace) -> None:
    if arguments.output.suffix.lower() != ".csv":
        raise CommandError(f"{arguments.output}: results are CSV; change the extension.")
    for output in (arguments.output, arguments.table):
        if output is not None:
            check_parent(output)
    if not (arguments.frames or arguments.scene or arguments.compare):
        raise CommandError("give frames, --scene NAME, or --compare OLD.csv.")
    if arguments.truth and len(arguments.truth) != len(arguments.frames):
        raise CommandError(
            f"--truth: {len(arguments.truth)} for {len(arguments.frames)} frames; give one each."
        )
    if arguments.compare and arguments.compare.resolve() == arguments.output.resolve():
        raise CommandError(
            f"{arguments.output}: would be compared with itself; choose another file."
        )


def _read(path: pathlib.Path) -> list[Any]:
    from jaxblur import bench

    return bench.read_rows(path)


def _jobs(arguments: argparse.Namespace, old: Sequence[Any]) -> list[tuple[Any, Any]]:
    """Subjects with their cases: those requested, or those of them in the older file."""
    subjects = _subjects(arguments)
    if not arguments.compare:
        return [(subject, case) for subject in subjects for case in _cases(arguments)]
    from jaxblur import bench

    try:
        rows = [row for row in bench.latest(old) if _is_asked_for(arguments, row.case)]
        if not subjects:
            jobs = bench.catalogue_jobs(rows)
        else:
            jobs = [
                (subject, row.case)
                for subject in subjects
                for row in rows
                if bench.identity(subject, row.case) == row.identity
            ]
    except ValueError as error:
        raise CommandError(f"{arguments.compare}: {error}") from error
    if not jobs:
        asked = ", ".join(subject.name for subject in subjects) or "scenes of the catalogue"
        raise CommandError(
            f"{arguments.compare}: holds no requested case of {asked}; give the frames "
            "that it measured, or other settings."
        )
    return jobs


def _is_asked_for(arguments: argparse.Namespace, case: Any) -> bool:
    """Whether the options of the grid select a case of an older file."""
    if arguments.methods and case.method not in arguments.methods:
        return False
    if not case.has_settings:
        return True
    values = vars(case.settings) | ({"radius": "auto"} if case.auto_radius else {})
    asked = {name: given for name in AXES if (given := getattr(arguments, name)) is not None}
    return all(values[name] in given for name, given in asked.items() if name in values)


def _subjects(arguments: argparse.Namespace) -> list[Any]:
    from jaxblur import bench

    for name in arguments.scene:
        check_scene(name)
    subjects = [
        bench.catalogue_subject(name, size, arguments.shutter, arguments.truth_samples)
        for name in arguments.scene
        for size in arguments.size
    ]
    truths = arguments.truth or [None] * len(arguments.frames)
    for path, truth in zip(arguments.frames, truths, strict=True):
        subjects.append(_file_subject(arguments, path, truth))
    return subjects


def _file_subject(
    arguments: argparse.Namespace, path: pathlib.Path, truth: pathlib.Path | None
) -> Any:
    from jaxblur import bench

    colors = {"color_space": None, "view": None, "png": False, "bits": None}
    named = argparse.Namespace(**vars(arguments) | colors | {"input": path, "truth": truth})
    loaded = load(named, Settings())
    buffers = loaded.buffers
    if not loaded.colors.is_identity:
        # Filters commute with the conversion, which is linear.
        buffers = dataclasses.replace(buffers, color=loaded.colors.light(buffers.color))
    return bench.frame_subject(path.name, buffers.frame(), loaded.truth, arguments.shutter)


def _cases(arguments: argparse.Namespace) -> list[Any]:
    from jaxblur import bench

    axes = {name: values for name in AXES if (values := getattr(arguments, name))}
    axes.setdefault("samples", [9, 15, 27, 35])
    grid = {"product": bench.product, "axes": bench.one_at_a_time}[arguments.grid]
    return grid(arguments.methods or [*names(), "unblurred"], axes)


def _measure(
    arguments: argparse.Namespace, jobs: list[tuple[Any, Any]], known: list[Any]
) -> list[Any]:
    """Measure the cases that the file lacks, and write it after every batch."""
    from jaxblur import bench

    batches = bench.batches(jobs, known, BATCH)
    programs, rows = bench.Programs(), list(known)
    for number in track(range(len(batches)), "bench"):
        measured = bench.measure(*batches[number], programs, arguments.repeats)
        rows += measured
        bench.write_rows(arguments.output, rows)
        for row in measured:
            LOG.info("%s %s: %s", row["scene"], row.case.label, _summary(row.figures))
    return rows


def _summary(figures: Any) -> str:
    text = f"{figures.ms:.3g} ms (IQR {figures.ms_iqr:.2g})"
    if figures.moving_flip is not None:
        text += (
            f", FLIP {figures.moving_flip:.4f}, PSNR {figures.moving_psnr:.2f} dB where it moves"
        )
    return text


def _compare(arguments: argparse.Namespace, old: Sequence[Any], new: Sequence[Any]) -> int:
    from jaxblur import bench

    changes = bench.compare(old, new, arguments.tolerance / 100)
    columns = ("scene", "case", ">time ratio", ">noise", ">memory", ">PSNR dB", "verdict")
    print_table(columns, [_change_cells(change) for change in changes])
    worse = [change for change in changes if change.is_regression]
    LOG.info("%d of %d cases regressed", len(worse), len(changes))
    return REGRESSION if worse else 0


def _change_cells(change: Any) -> tuple[str, ...]:
    memory, psnr = change.memory_ratio, change.psnr_change
    return (
        f"{change.row['scene']} {change.row['width']}x{change.row['height']}",
        change.row.case.label,
        f"{change.ratio:.3f}",
        f"{100 * change.noise:.1f} %",
        "" if memory is None else f"{memory:.2f}",
        "" if psnr is None else f"{psnr:+.2f}",
        change.verdict,
    )


def _several(parse: Callable[[str], Any]) -> Callable[[str], list[Any]]:
    """A parser of values separated by commas."""

    def parse_all(text: str) -> list[Any]:
        return [parse(item.strip()) for item in text.split(",")]

    return parse_all


def _method(text: str) -> str:
    if ":" in text:
        return find_filter(filter_name(text)).name
    return one_of(text, (*names(), *OTHERS), "method")


def _radius(text: str) -> int | str:
    return text if text == "auto" else positive_integer(text)


def _choice(name: str) -> Callable[[str], str]:
    return lambda text: one_of(text, CHOICES[name], name.replace("_", " "))
