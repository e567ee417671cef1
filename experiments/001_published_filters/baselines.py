"""The neighbors of the published filters, by the same truth: PSNR, FLIP, processor time.

    python -m experiments.001_published_filters.baselines --reference-data DIR -o OUT

Runs every filter of `experiments/baselines` beside the filters of the package, on frame 11 of
every scene in DIR. Writes baselines.csv with all scores, baselines.md, and baselines.png: in each
scene the window in which the sharp frame is farthest from the truth. Nothing is random.
"""

import csv
import importlib
from collections.abc import Mapping
from pathlib import Path
from statistics import mean
from typing import Any, NamedTuple

import jax
import numpy as np

from experiments import pictures
from experiments.common import output_parser
from jaxblur import exr, metrics
from jaxblur.bench.timing import time_in_turn
from jaxblur.filters import filter_info, load_filter
from jaxblur.filters.registry import FilterInfo

run = importlib.import_module("experiments.001_published_filters.run")

FOLDER = Path(__file__).parents[1] / "baselines"
PUBLISHED = ("pixel_velocity", "mcguire2012", "guertin2014", "layered")
REFERENCE = "guertin2014"
FRAME = 11
ROUNDS = 3
IDS = "ViewLayer.Object Index.X"


class Row(NamedTuple):
    """One picture: its scores, and processor time relative to guertin2014 on the same frame."""

    scene: str
    method: str
    psnr: float
    psnr_moving: float
    flip: float
    flip_moving: float
    milliseconds: float
    relative: float


def baselines() -> dict[str, FilterInfo]:
    """Every filter of `experiments/baselines`, by name; a file registers the one of its name."""
    return {file.stem: load_filter(f"{file}:{file.stem}") for file in sorted(FOLDER.glob("*.py"))}


def read_ids(truth: Path) -> np.ndarray:
    """The object index of every pixel of the sharp frame, (H, W, 1)."""
    sharp = truth.with_name(truth.name.replace("truth", "frame"))
    return exr.read_image(sharp, color_channels=[IDS])


def measure(truth: Path, methods: Mapping[str, FilterInfo]) -> tuple[list[Row], dict[str, Any]]:
    """Blur one frame by every method: rows of the table, and the pictures."""
    shot = run.read_shot(truth, run.scene_shutter(truth.parent))
    frames = {name: shot.sharp for name in methods}
    # layered looks at `guide` too, so that the ids go to the one filter that needs them.
    frames["object_id_gather"] = shot.sharp.replace(guide=read_ids(truth))

    def blur(name: str) -> Any:
        info = methods[name]
        parameters = info.make_parameters()
        return lambda: jax.block_until_ready(
            info.call(frames[name], parameters, settings=info.settings)
        )

    runs = {name: blur(name) for name in methods}
    images = {name: blurred() for name, blurred in runs.items()}
    times = time_in_turn(runs, ROUNDS)
    seconds = {name: timing.cpu_median for name, timing in times.items()}
    rows = []
    for name, image in images.items():
        whole, moving = (
            metrics.compare(image, shot.truth, area) for area in (None, shot.footprint)
        )
        rows.append(
            Row(
                *(truth.parent.name, name, whole.psnr, moving.psnr, whole.flip, moving.flip),
                *(1e3 * seconds[name], seconds[name] / seconds[REFERENCE]),
            )
        )
    return rows, {"sharp": shot.sharp.color, **images, "truth": shot.truth}


def table(rows: list[Row]) -> str:
    """A Markdown table: a line for each method, a column for each scene."""
    names = list(dict.fromkeys(row.scene for row in rows))
    lines = [
        f"| filter | {' | '.join(names)} | FLIP | time |",
        f"|{'---|' * (len(names) + 3)}",
    ]
    for method in dict.fromkeys(row.method for row in rows):
        own = [row for row in rows if row.method == method]
        scores = [f"{row.psnr:.2f} / {row.psnr_moving:.2f}" for row in own]
        flip = f"{mean(r.flip for r in own):.4f} / {mean(r.flip_moving for r in own):.4f}"
        times = sorted({float(f"{row.relative:.2g}") for row in own})
        ends = dict.fromkeys((times[0], times[-1]))
        cells = [method, *scores, flip, " to ".join(f"{time:g}" for time in ends)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure every scene, write table and picture."""
    purpose = "Judge the neighbors by rendered truth."
    parser = output_parser(purpose, reference_data="folder of rendered scenes")
    options = parser.parse_args()
    if options.reference_data is None:
        parser.error("--reference-data is needed: the folder of rendered scenes.")
    methods = {name: filter_info(name) for name in PUBLISHED} | baselines()
    rows: list[Row] = []
    crops: dict[str, list[Any]] = {}
    for truth in sorted(options.reference_data.glob(f"*/truth_{FRAME:04d}.exr")):
        measured, images = measure(truth, methods)
        rows += measured
        window = pictures.worst_window(images["sharp"], images["truth"], run.WINDOW)
        for name, image in images.items():
            crops.setdefault(name, []).append(np.asarray(image)[window])
    with (options.output / "baselines.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([Row._fields, *rows])
    (options.output / "baselines.md").write_text(table(rows), encoding="utf-8")
    pictures.write_png(
        options.output / "baselines.png", pictures.contact_sheet(list(crops.values()))
    )
    print(table(rows), end="")


if __name__ == "__main__":
    main()
