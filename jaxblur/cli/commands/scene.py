"""``jaxblur scene``: frames of a catalogue scene, with their truth beside them."""

import argparse
import inspect
import logging
import pathlib
import re
import time
from collections.abc import Callable, Mapping
from typing import Any

import jaxblur

from ..arguments import (
    CommandError,
    add_command,
    add_compute_options,
    check_folder,
    check_outputs,
    did_you_mean,
    file_path,
    frame_numbers,
    positive_integer,
)
from ..compute import start_jax
from ..console import print_line, print_table
from ..progress import Stages, stages
from ..shutter import add_exposure, add_fps
from . import scene_smoke

LOG = logging.getLogger("jaxblur")

FILE_LAYOUT = """\
NAME.####.exr holds linear color (R, G, B), planar depth (Z, +inf for sky) and the vectors
velocity.previous.X, .Y and velocity.next.X, .Y in pixels per frame, x right, y down, exact for
the given shutter; `jaxblur blur` reads it as it is. Frame k is centered on time k; the unit of
time is one frame. The scene `smoke` also has NAME_layerK.####.exr, premultiplied color and alpha,
depth and vectors of each layer from the front (1) to the back: smoke in front of a ball, the ball,
smoke behind it, the wall; `jaxblur.blur_layers` takes them in this order."""


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(commands, "scene", "Render frames of a catalogue scene.", run)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = FILE_LAYOUT
    parser.add_argument("name", nargs="?", help="scene; see --list")
    parser.add_argument("--list", action="store_true", help="list the scenes")
    parser.add_argument("-o", "--output", type=file_path, metavar="DIR", help="folder")
    parser.add_argument("--overwrite", action="store_true", help="replace existing files")
    parser.add_argument(
        "--frames",
        type=frame_numbers,
        default=[0],
        metavar="A-B[xN]",
        help="such as 1-8, 1-100x10 or 1,3,7 (default 0); --frames=-4-4 for negative ones",
    )
    add_exposure(parser, "--shutter", "exposure above 0", default=0.5)
    add_fps(parser)
    parser.add_argument(
        "--size", type=image_size, default=(720, 1280), metavar="WxH", help="default 1280x720"
    )
    parser.add_argument(
        "--layers",
        type=positive_integer,
        metavar="N",
        help=f"of smoke only: layers of smoke, 1 or an even number (default {scene_smoke.LAYERS})",
    )
    parser.add_argument("--ids", action="store_true", help="write NAME_id.####.exr, object numbers")
    parser.add_argument("--truth", action="store_true", help="write NAME_truth.####.exr too")
    parser.add_argument(
        "--truth-samples",
        type=positive_integer,
        default=256,
        metavar="N",
        help="images averaged into a truth (default %(default)s)",
    )
    add_compute_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Render a scene, or list them; see `add_parser`."""
    if arguments.list:
        start_jax(not arguments.no_compile_cache)
        _print_catalogue()
        return 0
    if arguments.name is None or arguments.output is None:
        raise CommandError("give a scene and a folder, NAME -o DIR, or --list.")
    if not arguments.shutter > 0:
        raise CommandError(f"--shutter must be above 0, got {arguments.shutter:g}.")
    check_folder(arguments.output)
    is_smoke = arguments.name == scene_smoke.NAME
    kinds = [""] + ["_id"] * arguments.ids + ["_truth"] * arguments.truth
    kinds = scene_smoke.kinds(arguments) if is_smoke else kinds
    check_outputs(
        (_path(arguments, kind, frame) for frame in arguments.frames for kind in kinds),
        arguments.overwrite,
    )
    height, width = arguments.size
    start_jax(not arguments.no_compile_cache)
    scene = None if is_smoke else make_scene(arguments.name, (scene_smoke.NAME,))
    if arguments.layers and not is_smoke:
        raise CommandError(
            f"--layers: only {scene_smoke.NAME} has layers, {arguments.name} has none."
        )
    LOG.info("%s at %dx%d; the first frame compiles the scene", arguments.name, width, height)
    count = len(arguments.frames)
    with stages() as show:
        for done, number in enumerate(arguments.frames):
            show.stage("rendering", done, count)
            started = time.perf_counter()
            _make_frame(scene, arguments, number, show)
            print_line(_path(arguments, "", number))
            LOG.info("frame %d ok %.2f s", number, time.perf_counter() - started)
        show.stage("rendering", count, count)
    return 0


def _make_frame(scene: Any, arguments: argparse.Namespace, number: int, show: Stages) -> None:
    """Render and write one frame, of smoke if there is no other scene."""

    def tell(what: str) -> None:
        show.detail(f"frame {number}: {what}")

    def file(kind: str) -> pathlib.Path:
        # Made with the first file: what ends earlier leaves no empty folder.
        arguments.output.mkdir(parents=True, exist_ok=True)
        return _path(arguments, kind, number)

    notes = _notes(arguments, number)
    if scene is None:
        scene_smoke.write_smoke(arguments, file, number, notes, tell)
    else:
        _write_frame(scene, arguments, file, number, notes, tell)


def make_scene(name: str, more: tuple[str, ...] = ()) -> Any:
    """Build a scene of the catalogue.

    Args:
        name: of the scene.
        more: names outside the catalogue that the command knows too, for the message.

    Raises:
        CommandError: no scene has that name.
    """
    from jaxblur.scenes import SCENES

    check_scene(name, more)
    return SCENES[name]()


def check_scene(name: str, more: tuple[str, ...] = ()) -> None:
    """Reject a name that is not in the catalogue; see `make_scene`.

    Raises:
        CommandError: no scene has that name.
    """
    from jaxblur.scenes import SCENES

    if name not in SCENES:
        known = (*SCENES, *more)
        raise CommandError(
            f"no scene {name!r}{did_you_mean(name, known)}; there are {', '.join(known)}."
        )


def image_size(text: str) -> tuple[int, int]:
    """Parse ``1280x720`` to (height, width).

    Raises:
        ArgumentTypeError: it is something else.
    """
    match = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT such as 1280x720, got {text!r}")
    return int(match[2]), int(match[1])


def _print_catalogue() -> None:
    from jaxblur.scenes import SCENES

    print_table(
        ("scene", "what it shows"),
        [(name, (inspect.getdoc(make) or "").partition("\n")[0]) for name, make in SCENES.items()]
        + [(scene_smoke.NAME, scene_smoke.line_about_it())],
    )


def _path(arguments: argparse.Namespace, kind: str, frame: int) -> pathlib.Path:
    return arguments.output / f"{arguments.name}{kind}.{frame:04d}.exr"


def _notes(arguments: argparse.Namespace, number: int) -> dict[str, str | float]:
    """Metadata of every file."""
    return {
        "jaxblur:version": jaxblur.__version__,
        "jaxblur:scene": arguments.name,
        "jaxblur:time": float(number),
        "jaxblur:shutter": arguments.shutter,
    }


def _write_frame(
    scene: Any,
    arguments: argparse.Namespace,
    file: Callable[[str], pathlib.Path],
    number: int,
    notes: Mapping[str, str | float],
    tell: Callable[[str], None],
) -> None:
    """Render and write one frame; the arguments are those of `scene_smoke.write_smoke`."""
    import numpy as np

    from jaxblur import exr, scenes

    shutter, size = arguments.shutter, arguments.size
    if arguments.truth:
        tell(f"truth, the mean of {arguments.truth_samples} images")
        truth = np.asarray(scenes.accumulate(scene, number, shutter, arguments.truth_samples, size))
        samples = {"jaxblur:samples": arguments.truth_samples}
        exr.write_image(file("_truth"), truth, attributes={**notes, **samples})
    if arguments.ids:
        ids = np.asarray(scenes.object_ids(scene, number, size))
        exr.write_channels(file("_id"), {"id": ids}, attributes=notes)
    tell("sharp")
    sharp = scenes.render(scene, number, shutter, size, path=True)
    exr.write_frame(file(""), sharp, shutter, attributes=notes)
