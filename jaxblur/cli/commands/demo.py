"""``jaxblur demo``: make a frame, blur it, compare it with its truth."""

import argparse
import logging
import pathlib
from collections.abc import Mapping
from typing import Any

import jaxblur
from jaxblur._util.atomic import replacing
from jaxblur.filters.registry import filter_info

from ..arguments import add_command, add_compute_options, check_folder, check_outputs, file_path
from ..blurring import apply_filter
from ..compute import start_jax
from ..console import print_line, print_table
from ..filtering import DEFAULT_FILTER
from ..scores import SCORE_COLUMNS, score_rows, scores
from .play import Entry, others, page_of
from .report import write_page
from .scene import image_size, make_scene

LOG = logging.getLogger("jaxblur")

SHUTTER = 0.5
TRUTH_SAMPLES = 64


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands, "demo", "Make a frame and its true motion blur, and blur the frame.", run
    )
    parser.add_argument(
        "-o",
        "--output",
        type=file_path,
        default=pathlib.Path("jaxblur_demo"),
        metavar="DIR",
        help="folder to write to (default %(default)s)",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace existing files")
    parser.add_argument(
        "--scene", default="gears", metavar="NAME", help="see `jaxblur scene --list`"
    )
    parser.add_argument(
        "--size", type=image_size, default=(360, 640), metavar="WxH", help="default 640x360"
    )
    add_compute_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Write frame, result and truth; see `add_parser`."""
    from jaxblur import exr
    from jaxblur.report import MANIFEST

    folder, name = arguments.output, DEFAULT_FILTER
    check_folder(folder)
    images = {kind: folder / f"{kind}.exr" for kind in ("sharp", "blurred", "truth")}
    pngs = {kind: path.with_suffix(".png") for kind, path in images.items()}
    result, page, play = folder / "result", folder / "report.html", folder / "play.html"
    outputs = [*images.values(), *pngs.values(), page, play, result / MANIFEST]
    check_outputs(outputs, arguments.overwrite)
    height, width = arguments.size
    LOG.info("rendering %s at %dx%d, and its truth", arguments.scene, width, height)
    LOG.info("the first run compiles the scene and the filter, which takes most of its time")
    start_jax(not arguments.no_compile_cache)
    import numpy as np

    from jaxblur import scenes

    scene = make_scene(arguments.scene)
    frame = scenes.render(scene, 0.0, SHUTTER, arguments.size, path=True)
    LOG.info("truth: the mean of %d images", TRUTH_SAMPLES)
    truth = np.asarray(scenes.accumulate(scene, 0.0, SHUTTER, TRUTH_SAMPLES, arguments.size))
    LOG.info("blur: %s", name)
    blurred = apply_filter(name, frame, {}, filter_info(name).settings)

    notes = {"jaxblur:version": jaxblur.__version__, "jaxblur:scene": arguments.scene}
    # Not before: an interruption while scene and filter compile leaves no empty folder.
    folder.mkdir(parents=True, exist_ok=True)
    exr.write_frame(images["sharp"], frame, SHUTTER, attributes=notes)
    exr.write_image(images["truth"], truth, attributes=notes)
    exr.write_image(
        images["blurred"], blurred, images["sharp"], attributes=notes | {"jaxblur:filter": name}
    )
    sharp = np.asarray(frame.color)
    for kind, image in (("sharp", sharp), ("blurred", blurred), ("truth", truth)):
        exr.write_image(pngs[kind], image)
        print_line(f"{images[kind]}, {pngs[kind].name}")
    print_table(SCORE_COLUMNS, score_rows(scores({"sharp": sharp, name: blurred}, truth)))
    _write_page(result, page, arguments.scene, truth, {"sharp": sharp, name: blurred})
    print_line(f"{page}: to compare them in a browser")
    buffers = {"color": sharp, "depth": frame.depth, "velocity": frame.velocity, "path": frame.path}
    info = filter_info(name)
    html = page_of(
        [Entry(info, {}, info.settings), *others(info)],
        buffers,
        truth,
        title=arguments.scene,
        shutter=SHUTTER,
    )
    with replacing(play) as temporary:
        pathlib.Path(temporary).write_text(html, encoding="utf-8")
    print_line(f"{play}: to blur it in a browser, by any filter, with sliders")
    print_line(f"try: jaxblur blur {images['sharp']} -o again.exr --truth {images['truth']}")
    return 0


def _write_page(
    result: pathlib.Path, page: pathlib.Path, scene: str, truth: Any, images: Mapping[str, Any]
) -> None:
    """Write a result folder and its page."""
    from jaxblur.report import Picture, Shot, write_result

    pictures = [Picture(name, image) for name, image in images.items()]
    write_result(result, "A demo of jaxblur", [Shot(scene, truth, pictures)])
    write_page(result, page)
