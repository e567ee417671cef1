"""Gain of each part of `layered`, and comparison with guertin2014 and Blender's Vector Blur.

    python -m experiments.012_layered.run --reference-data DIR -o OUT [--quick]

DIR holds scenes as ``experiments/blender/render_reference.py`` writes them. Each variant leaves one
part out, or has an advantage over the filter: exact vectors at pixel centers, or ten times the
samples. Writes ``steps.csv`` and ``steps.md`` (PSNR in dB of display values), ``peers.csv`` and
``peers.md`` (PSNR, FLIP, CPU time in turn), and ``errors.png``. ``--quick`` takes the first scene
only.
"""

import argparse
import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import jaxblur
from experiments import common, pictures
from jaxblur import exr, metrics
from jaxblur.filters import filter_info

REPEATS = 7
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


def read(truth: Path) -> tuple[jaxblur.Frame, jaxblur.Frame, Any, Any]:
    """Read the frame, the frame with exact vectors, the truth, and Blender's Vector Blur."""
    shutter = common.reference_shutter(truth)
    number = truth.stem.removeprefix("truth_")
    sharp, centers, peer = (
        truth.with_name(f"{kind}_{number}.exr") for kind in ("frame", "gbuf", "vectorblur")
    )
    frame = jaxblur.read_frame(sharp, shutter=shutter)
    exact = jaxblur.read_frame(sharp, shutter=shutter, velocity_from=centers, depth_from=centers)
    return frame, exact, exr.read_image(truth), exr.read_image(peer, layer="Composite")


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
    steps: dict[str, list[float]] = {}
    peers, sheet = [], []
    filters = {"layered": blur("layered"), "guertin2014": blur("guertin2014")}
    for path in truths[: 1 if options.quick else None]:
        frame, exact, truth, vector_blur = read(path)
        seconds = cpu_seconds(filters, frame)
        images = {name: np.asarray(function(frame)) for name, function in variants().items()}
        images["exact vectors"] = np.asarray(filters["layered"](exact))
        for name, image in images.items():
            steps.setdefault(name, []).append(psnr(image, truth))
        rivals = {
            "layered": images["layered"],
            "guertin2014": np.asarray(filters["guertin2014"](frame)),
            "Blender's Vector Blur": vector_blur,
        }
        for name, image in rivals.items():
            scores = metrics.compare(image, truth)
            peers.append(
                [path.parent.name, name, scores.psnr, scores.flip, 1000 * seconds.get(name, np.nan)]
            )
        error = pictures.error_image(images["layered"], truth)
        sheet.append([np.asarray(frame.color), images["layered"], truth, error])
    names = [path.parent.name for path in truths[: len(sheet)]]
    rows = [[name, *scores, float(np.mean(scores))] for name, scores in steps.items()]
    common.write_table(options.output, "steps", ["variant", *names, "mean"], rows)
    columns = ["scene", "method", "PSNR, dB", "FLIP", "CPU ms"]
    common.write_table(options.output, "peers", columns, peers)
    pictures.write_png(options.output / "errors.png", pictures.contact_sheet(sheet))


if __name__ == "__main__":
    main()
