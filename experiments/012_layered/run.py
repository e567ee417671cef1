"""Gain of each part of `layered`, and comparison with guertin2014 and Blender's Vector Blur.

    python -m experiments.012_layered.run --reference-data DIR -o OUT [--quick]

DIR holds scenes as ``experiments/blender/render_reference.py`` writes them. Each variant leaves one
part out, or has an advantage over the filter: exact vectors at pixel centers, or ten times the
samples. Writes ``steps``, ``peers``, ``flip`` and ``times``, ``.csv`` and ``.md``: PSNR in dB of
display values of the variants and of the peers, FLIP of the peers, and processor time relative to
guertin2014, each the shortest of runs in turn. Writes ``errors.png``: in each scene the window in
which `layered` is farthest from the truth. ``--quick`` takes the first scene only.
"""

import argparse
import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import jaxblur
from experiments import common, pictures
from jaxblur import exr, metrics
from jaxblur.filters import filter_info

REPEATS = 7
WINDOW, ENLARGE = (80, 120), 2
Blur = Callable[[jaxblur.Frame], Any]


def blur(name: str, parameters: dict[str, float] | None = None, **settings: Any) -> Blur:
    """A filter as published, except for the given parameters and settings."""
    info = filter_info(name)
    record = info.make_parameters(**(parameters or {}))
    chosen = info.make_settings(**settings)
    return lambda frame: info.call(frame, record, settings=chosen)


def without_path(frame: jaxblur.Frame) -> Any:
    """`layered` with straight motion instead of curved paths."""
    return blur("layered")(dataclasses.replace(frame, path=None))


def variants() -> dict[str, Blur]:
    """The filter, and variants of it, by name."""
    return {
        "layered": blur("layered"),
        "no path": without_path,
        "nearest texels": blur("layered", fetch="nearest"),
        "thin vectors as they are": blur("layered", {"thin_coverage": 1.0}),
        "no tolerance within a surface": blur("layered", {"own_tolerance": 1e-3}),
        "other velocities are never others": blur("layered", {"distinct": 1e6}),
        "depths hardly told apart": blur("layered", {"front_sharpness": 1.0}),
        "no noise": blur("layered", noise="none"),
        "16 samples": blur("layered", samples=16),
        "350 samples": blur("layered", samples=350),
    }


class Shot(NamedTuple):
    """A frame of a rendered scene.

    Attributes:
        name: of the scene.
        shutter: in frames.
        frame: as Blender writes it.
        before: the frame before.
        after: the frame after.
        exact: the frame with vectors and depth at pixel centers.
        truth: its true blur.
        vector_blur: the result of Blender's compositor.
    """

    name: str
    shutter: float
    frame: jaxblur.Frame
    before: jaxblur.Frame
    after: jaxblur.Frame
    exact: jaxblur.Frame
    truth: Any
    vector_blur: Any


def read(truth: Path) -> Shot:
    """Read a frame with its neighbors and its truth."""
    shutter = common.reference_shutter(truth)
    number = truth.stem.removeprefix("truth_")
    sharp, centers, peer = (
        truth.with_name(f"{kind}_{number}.exr") for kind in ("frame", "gbuf", "vectorblur")
    )
    frame, before, after = (
        jaxblur.read_frame(truth.with_name(f"frame_{k:04d}.exr"), shutter=shutter)
        for k in (int(number), int(number) - 1, int(number) + 1)
    )
    exact = jaxblur.read_frame(sharp, shutter=shutter, velocity_from=centers, depth_from=centers)
    images = exr.read_image(truth), exr.read_image(peer, layer="Composite")
    return Shot(truth.parent.name, shutter, frame, before, after, exact, *images)


def with_neighbors(shot: Shot) -> Any:
    """`layered`, given the frames before and after."""
    near = {"before": shot.before, "after": shot.after, "shutter": shot.shutter}
    return jaxblur.layered(shot.frame, jaxblur.LayeredParameters(), **near)


def psnr(image: Any, truth: Any) -> float:
    """PSNR in dB of display values."""
    return float(metrics.psnr(metrics.display(image), metrics.display(truth)))


def cpu_seconds(blurs: dict[str, Blur], frame: jaxblur.Frame) -> dict[str, float]:
    """Shortest CPU time of each filter, timed in turn after a first run that compiles."""
    least = dict.fromkeys(blurs, np.inf)
    for turn in range(REPEATS + 1):
        for name, function in blurs.items():
            started = time.process_time()
            function(frame).block_until_ready()
            if turn:
                least[name] = min(least[name], time.process_time() - started)
    return least


def main() -> None:
    """Measure, and write tables and pictures."""
    parser = argparse.ArgumentParser(description="Measure the gain of each part of layered.")
    parser.add_argument("--reference-data", type=Path, required=True, metavar="DIR")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    truths = common.reference_truths(options.reference_data)
    shots = [read(path) for path in truths[: 1 if options.quick else None]]
    filters = {name: blur(name) for name in ("layered", "guertin2014")}
    steps: dict[str, list[float]] = {}
    peers: dict[str, list[metrics.Scores]] = {}
    times, sheet = [], []
    for shot in shots:
        seconds = cpu_seconds(filters, shot.frame)
        times.append([shot.name, seconds["layered"] / seconds["guertin2014"]])
        images = {name: np.asarray(function(shot.frame)) for name, function in variants().items()}
        images["exact vectors"] = np.asarray(filters["layered"](shot.exact))
        for name, image in images.items():
            steps.setdefault(name, []).append(psnr(image, shot.truth))
        rivals = {
            "layered": images["layered"],
            "layered, with the frames before and after": np.asarray(with_neighbors(shot)),
            "guertin2014": np.asarray(filters["guertin2014"](shot.frame)),
            "Blender's Vector Blur": shot.vector_blur,
        }
        for name, image in rivals.items():
            peers.setdefault(name, []).append(metrics.compare(image, shot.truth))
        window = pictures.worst_window(images["layered"], shot.truth, WINDOW)
        cells = [shot.frame.color, *list(rivals.values())[:2], shot.truth]
        cells += [pictures.error_image(cell, shot.truth) for cell in cells[1:3]]
        sheet.append([pictures.enlarged(np.asarray(cell)[window], ENLARGE) for cell in cells])
    tables = {
        "steps": steps,
        "peers": {name: [score.psnr for score in scores] for name, scores in peers.items()},
        "flip": {name: [score.flip for score in scores] for name, scores in peers.items()},
    }
    names = [shot.name for shot in shots]
    for table, scores in tables.items():
        rows = [[name, *values, float(np.mean(values))] for name, values in scores.items()]
        common.write_table(options.output, table, ["method", *names, "mean"], rows)
    columns = ["scene", "processor time of layered / guertin2014"]
    common.write_table(options.output, "times", columns, times)
    pictures.write_png(options.output / "errors.png", pictures.contact_sheet(sheet))


if __name__ == "__main__":
    main()
