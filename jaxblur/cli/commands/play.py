"""``jaxblur play``: a page in which a frame is blurred live, by any filter, with sliders."""

import argparse
import dataclasses
import logging
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jaxblur._util.atomic import replacing
from jaxblur.filters.registry import FilterInfo, names
from jaxblur.settings import Settings

from .. import sources
from ..arguments import (
    CommandError,
    add_command,
    add_compute_options,
    check_outputs,
    check_parent,
    file_path,
    positive_integer,
    positive_number,
)
from ..compute import start_jax
from ..console import print_line
from ..filtering import (
    QUALITIES,
    add_filter_options,
    add_nonfinite_option,
    add_parameters_option,
    complete,
    describe_filters,
    filter_name,
    find_filter,
    read_fitted,
    samples_of,
)
from ..loading import read_truth
from ..sources import add_source_options, add_vector_options

LOG = logging.getLogger("jaxblur")

COUNTS = tuple(samples_of(Settings().samples, quality) for quality in QUALITIES)
"""Numbers of samples that a page offers."""


class Entry(NamedTuple):
    """A filter of a page.

    Attributes:
        info: its record.
        parameters: those that differ from its defaults.
        settings: with which it begins.
    """

    info: FilterInfo
    parameters: Mapping[str, float]
    settings: Settings


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands, "play", "Make one HTML page that blurs a frame live, by any filter.", run
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.more_help = describe_filters
    parser.add_argument("input", type=file_path, help="frame with color, depth and vectors")
    parser.add_argument(
        "-o", "--output", type=file_path, required=True, metavar="OUT.html", help="page to write"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an existing page")
    parser.add_argument(
        "--truth", type=file_path, metavar="FILE", help="true blur, for the error map and PSNR"
    )
    parser.add_argument("--truth-layer", metavar="NAME", help="layer of the truth to look in")
    parser.add_argument(
        "--color-space",
        metavar="NAME",
        help="color space of the frame and of the truth, where the files do not name it",
    )
    parser.add_argument(
        "--max-megabytes",
        type=positive_number,
        default=60.0,
        metavar="MB",
        help="reject a frame whose page would be larger (default %(default)g)",
    )
    add_compute_options(parser)
    group = add_filter_options(parser)
    group.add_argument(
        "--filters",
        type=_filters,
        metavar="NAME,...",
        help="those that the page offers beside --filter, with which it begins (default all)",
    )
    group.add_argument(
        "--sample-counts",
        type=_counts,
        default=COUNTS,
        metavar="N,...",
        help="numbers of samples that the page offers beside --samples "
        f"(default {','.join(map(str, COUNTS))})",
    )
    add_parameters_option(group)
    add_vector_options(parser)
    add_nonfinite_option(add_source_options(parser))
    parser.set_defaults(also=[], all_color=False)


def run(arguments: argparse.Namespace) -> int:
    """Write the page; see `add_parser`."""
    from jaxblur.sequence import has_frame_number

    output: pathlib.Path = arguments.output
    if output.suffix.lower() not in (".html", ".htm"):
        raise CommandError(f"{output}: can write .html only; change the extension.")
    check_parent(output)
    check_outputs([output], arguments.overwrite)
    if has_frame_number(arguments.input):
        raise CommandError(f"{arguments.input}: a page has one frame; give the file of one.")
    name, parameters, settings = complete(arguments, read_fitted(arguments))
    buffers = sources.read(arguments)
    page = _page(arguments, Entry(find_filter(name), parameters, settings), buffers)
    size = len(page.encode("utf-8")) / 1e6
    if size > arguments.max_megabytes:
        raise CommandError(
            f"{arguments.input}: the page would have {size:.0f} MB, more than --max-megabytes "
            f"{arguments.max_megabytes:g}; allow more, or render a smaller frame."
        )
    with replacing(output) as temporary:
        pathlib.Path(temporary).write_text(page, encoding="utf-8")
    print_line(output)
    return 0


def _page(arguments: argparse.Namespace, asked: Entry, buffers: Any) -> str:
    """The page of a frame."""
    import numpy as np

    start_jax(not arguments.no_compile_cache)
    from jaxblur import exr, vectors

    info = exr.inspect(arguments.input)
    colors = exr.conversion_of(info, buffers.color_channels[0], arguments.color_space, None)
    color = _light(buffers.color, colors)
    alpha = buffers.color[..., _without_alpha(buffers.color) :]
    if (alpha != 1).any():
        color = np.concatenate([color, alpha], axis=-1)
    if buffers.valid is not None:
        LOG.warning(
            "%s: the page takes the %d ignored pixels as black; `jaxblur blur` leaves them out.",
            arguments.input,
            np.count_nonzero(~buffers.valid),
        )
    # What the command line says holds for all filters that have the setting.
    common = [field.name for field in dataclasses.fields(Settings)]
    given = {key: value for key in common if (value := getattr(arguments, key, None))}
    if arguments.radius == 0:
        largest = asked.settings.radius
        given["radius"] = vectors.speed_statistics(buffers.velocity, largest).suggested_radius
        LOG.info("radius: %d px", given["radius"])
        asked = asked._replace(settings=dataclasses.replace(asked.settings, radius=given["radius"]))
    frame = {"color": color, "depth": buffers.depth, "velocity": buffers.velocity}
    if buffers.path is not None:
        frame["path"] = buffers.path
    truth = None
    if arguments.truth is not None:
        stored, colors = read_truth(arguments, buffers.windows, None)
        truth = _light(stored, colors)
    return page_of(
        [asked, *others(asked.info, given, arguments.filters)],
        frame,
        truth,
        title=arguments.input.name,
        shutter=arguments.shutter,
        counts=arguments.sample_counts,
    )


def _light(image: Any, colors: Any) -> Any:
    """(H, W, 3) float32 light as a screen shows it, without alpha; one channel becomes gray."""
    import numpy as np

    from jaxblur import metrics

    opaque = image[..., : _without_alpha(image)]
    return np.asarray(metrics.rgb(colors.light(opaque)), np.float32)


def _without_alpha(image: Any) -> int:
    """How many of an image's channels are color: three, or one of gray."""
    return 3 if image.shape[-1] >= 3 else 1


def others(
    asked: FilterInfo, given: Mapping[str, Any] | None = None, chosen: Sequence[str] | None = None
) -> list[Entry]:
    """The filters that a page offers beside the one that it begins with.

    Args:
        asked: that one.
        given: settings that replace those of each filter.
        chosen: their names, as `--filter` takes them; None for all.

    Returns:
        The filters with their own parameters.
    """
    infos = map(find_filter, names() if chosen is None else chosen)
    found = {info.name: info for info in infos if info.name != asked.name}
    return [Entry(info, {}, info.make_settings(**(given or {}))) for info in found.values()]


def page_of(
    entries: Sequence[Entry],
    frame: Mapping[str, Any],
    truth: Any,
    *,
    title: str,
    shutter: float,
    counts: Sequence[int] = COUNTS,
) -> str:
    """The page that blurs a frame.

    Args:
        entries: the filters, first the one that it begins with. Of the others those that have no
            form in the languages of a browser are left out, with a warning.
        frame: NumPy arrays by name: color (H, W, 3) as a screen shows it or (H, W, 4) with alpha,
            depth, velocity, and path where there is one.
        truth: (H, W, 3) likewise, or None.
        title: of the page.
        shutter: exposure in frames.
        counts: numbers of samples, beside those of the settings; a filter that cannot run with one
            is without it.

    Returns:
        HTML.
    """
    import numpy as np

    from jaxblur.export import PlayForms, build_play
    from jaxblur.noise import make_noise

    height, width = frame["depth"].shape
    noise = make_noise("halton", height, width)
    planes = {key: np.asarray(values, np.float32) for key, values in frame.items()}
    planes |= {"noise_tap": np.asarray(noise.tap), "noise_tile": np.asarray(noise.tile)}
    forms = PlayForms(planes["color"].shape[-1])
    for entry in entries:
        try:
            _add(forms, entry, counts, has_path="path" in frame)
        except (ValueError, TypeError) as error:
            # JAX says by a TypeError that a program cannot be traced.
            if entry is entries[0]:
                raise
            LOG.warning("%s is not on the page: %s", entry.info.name, error)
    return build_play(forms, planes, truth, title=title, shutter=shutter)


def _add(forms: Any, entry: Entry, counts: Sequence[int], has_path: bool) -> None:
    """Add a filter to the page, with all numbers of samples that it takes."""
    from jaxblur.export import graph_of

    info, parameters, settings = entry
    counts = [
        samples
        for samples in sorted({settings.samples, *counts})
        if _takes(info, settings, samples)
    ]
    values = info.make_parameters(**parameters)
    graphs = []
    # If there are none, the graph says why.
    for samples in counts or [settings.samples]:
        changed = dataclasses.replace(settings, samples=samples)
        graphs.append(graph_of(info, values, changed, channels=forms.channels, has_path=has_path))
    forms.add(graphs, counts.index(settings.samples) if settings.samples in counts else 0)


def _takes(info: FilterInfo, settings: Settings, samples: int) -> bool:
    try:
        changed = dataclasses.replace(settings, samples=samples)
        if info.check is not None:
            info.check(changed)
    except ValueError:
        return False
    return True


def _filters(text: str) -> list[str]:
    """Parse ``--filters``."""
    return [filter_name(part) for part in text.split(",")]


def _counts(text: str) -> list[int]:
    """Parse ``--sample-counts``."""
    return [positive_integer(part) for part in text.split(",")]
