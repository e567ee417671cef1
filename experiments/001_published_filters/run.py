"""How close do the published filters come to path-traced motion blur?

    python experiments/001_published_filters/run.py --reference-data DIR -o OUT --frame 11

DIR holds one folder per scene as ``experiments/blender/render_reference.py`` writes it. For each
scene and frame the script computes PSNR, SSIM and FLIP against the truth, over the whole frame and
over the blur footprint, and draws a sheet of pictures. Nothing is random: the filters' noise is a
fixed pattern.
"""

import argparse
import csv
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import jaxblur
from experiments import pictures
from jaxblur import exr, metrics, report
from jaxblur.filters import filter_info

WINDOW = (80, 120)
OVERVIEW_METHOD = "guertin2014"
Blur = Callable[[jaxblur.Frame], Any]


class Shot(NamedTuple):
    """One frame of a scene: inputs of the filters, the truth, and Blender's Vector Blur."""

    name: str
    sharp: jaxblur.Frame
    centers: jaxblur.Frame | None
    truth: np.ndarray
    peer: np.ndarray | None

    @property
    def footprint(self) -> np.ndarray:
        """The pixels that motion reaches, by the vectors at pixel centers if there are any."""
        return metrics.motion_footprint(self.centers or self.sharp)


class Result(NamedTuple):
    """One row of the table."""

    shot: str
    method: str
    vectors: str
    whole: metrics.Scores
    moving: metrics.Scores


def find_shots(folder: Path, frame: int | None, shutter: float | None) -> Iterator[Shot]:
    """Read every frame that has a truth, scene by scene.

    Raises:
        SystemExit: there is no such frame, or its shutter is not known.
    """
    number = "????" if frame is None else f"{frame:04d}"
    truths = sorted(folder.glob(f"*/truth_{number}.exr"))
    if not truths:
        raise SystemExit(f"{folder} holds no */truth_{number}.exr; see experiments/blender.")
    for truth in truths:
        yield read_shot(truth, scene_shutter(truth.parent) if shutter is None else shutter)


def scene_shutter(scene: Path) -> float:
    """The shutter that the scene was rendered with, in frames, from its camera.json.

    Raises:
        SystemExit: there is no such file.
    """
    path = scene / "camera.json"
    if not path.is_file():
        raise SystemExit(f"{path} is missing; give --shutter.")
    return json.loads(path.read_text(encoding="utf-8"))["shutter"]


def read_shot(truth: Path, shutter: float) -> Shot:
    """Read the frame of a truth; the ``gbuf`` and ``vectorblur`` files beside it are optional."""
    number = truth.stem.removeprefix("truth_")
    sharp, centers, peer = (
        truth.with_name(f"{kind}_{number}.exr") for kind in ("frame", "gbuf", "vectorblur")
    )
    return Shot(
        name=f"{truth.parent.name} {int(number)}",
        sharp=jaxblur.read_frame(sharp, shutter=shutter),
        centers=jaxblur.read_frame(
            sharp, shutter=shutter, velocity_from=centers, depth_from=centers
        )
        if centers.is_file()
        else None,
        truth=exr.read_image(truth),
        peer=exr.read_image(peer, layer="Composite") if peer.is_file() else None,
    )


def methods() -> dict[str, Blur]:
    """Every filter at its defaults, and mcguire2012 also with 35 taps as the newer filters have."""
    runs = {name: _blur(name) for name in ("pixel_velocity", "mcguire2012")}
    runs["mcguire2012, 35 taps"] = _blur("mcguire2012", jaxblur.Settings())
    return runs | {name: _blur(name) for name in ("guertin2014", "layered")}


def _blur(name: str, settings: jaxblur.Settings | None = None) -> Blur:
    info = filter_info(name)
    parameters, settings = info.make_parameters(), settings or info.settings
    return lambda frame: info.call(frame, parameters, settings=settings)


def blur_all(shot: Shot) -> dict[tuple[str, str], Any]:
    """Every picture to judge, by method and by source of its motion vectors."""
    images: dict[tuple[str, str], Any] = {("unblurred", "none"): shot.sharp.color}
    for label, blur in methods().items():
        images[label, "frame"] = blur(shot.sharp)
        if shot.centers is not None:
            images[label, "gbuf"] = blur(shot.centers)
    if shot.peer is not None:
        images["Blender Vector Blur", "frame"] = shot.peer
    return images


def judge(shot: Shot, images: dict[tuple[str, str], Any]) -> list[Result]:
    """Score every picture against the truth, over the whole frame and over the footprint."""
    footprint = shot.footprint
    return [
        Result(
            shot.name,
            method,
            vectors,
            metrics.compare(image, shot.truth),
            metrics.compare(image, shot.truth, footprint),
        )
        for (method, vectors), image in images.items()
    ]


def report_shot(
    shot: Shot, images: dict[tuple[str, str], Any], judged: list[Result]
) -> report.Shot:
    """The pictures and scores in the form that ``jaxblur report`` reads."""
    found = []
    for result in judged:
        moving = {f"{name}, moving": value for name, value in result.moving._asdict().items()}
        label = result.method if result.vectors != "gbuf" else f"{result.method}, centers"
        image = images[result.method, result.vectors]
        scores = result.whole._asdict() | moving
        found.append(report.Picture(label, image, scores=scores, group=result.method))
    return report.Shot(shot.name, shot.truth, found)


def picture_row(shot: Shot, image: Any, area: tuple[slice, slice]) -> list[Any]:
    """Input, output, truth and 4 times the error of the output, cropped to an area."""
    row = [np.asarray(picture)[area] for picture in (shot.sharp.color, image, shot.truth)]
    return [*row, pictures.error_image(row[1], row[2])]


def sheet(shot: Shot, images: dict[tuple[str, str], Any]) -> Any:
    """One row of uncropped pictures for every method, in the order of the table."""
    outputs = [image for (_, vectors), image in images.items() if vectors == "frame"]
    everything = (slice(None), slice(None))
    return pictures.contact_sheet([picture_row(shot, image, everything) for image in outputs])


def overview_row(shot: Shot, images: dict[tuple[str, str], Any]) -> list[Any]:
    """The pictures of `OVERVIEW_METHOD` in the window where its error is largest."""
    output = images[OVERVIEW_METHOD, "frame"]
    return picture_row(shot, output, pictures.worst_window(output, shot.truth, WINDOW))


def write_csv(path: Path, results: list[Result]) -> None:
    """Write one row per picture and area."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["shot", "method", "vectors", "area", *metrics.Scores._fields])
        for result in results:
            head = [result.shot, result.method, result.vectors]
            writer.writerow([*head, "whole", *result.whole])
            writer.writerow([*head, "footprint", *result.moving])


def table(results: list[Result]) -> str:
    """A Markdown table: whole frame / footprint, and PSNR with vectors at pixel centers."""
    centers = {(r.shot, r.method): r for r in results if r.vectors == "gbuf"}
    lines = [
        "| shot | method | PSNR dB | SSIM | FLIP | PSNR dB, vectors at pixel centers |",
        "|---|---|---|---|---|---|",
    ]
    for result in results:
        if result.vectors == "gbuf":
            continue
        other = centers.get((result.shot, result.method))
        cells = [
            result.shot,
            result.method,
            f"{result.whole.psnr:.2f} / {result.moving.psnr:.2f}",
            f"{result.whole.ssim:.4f} / {result.moving.ssim:.4f}",
            f"{result.whole.flip:.4f} / {result.moving.flip:.4f}",
            f"{other.whole.psnr:.2f} / {other.moving.psnr:.2f}" if other else "",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description="Judge the published filters by rendered truth.")
    parser.add_argument("--reference-data", type=Path, required=True, metavar="DIR")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT")
    parser.add_argument("--frame", type=int, help="one frame number; default: all")
    parser.add_argument("--shutter", type=float, help="in frames; default: from camera.json")
    return parser.parse_args()


def main() -> None:
    """Judge every shot, print the table, write tables and pictures."""
    options = parse_arguments()
    options.output.mkdir(parents=True, exist_ok=True)
    results: list[Result] = []
    overview, shots = [], []
    for shot in find_shots(options.reference_data, options.frame, options.shutter):
        images = blur_all(shot)
        judged = judge(shot, images)
        results += judged
        shots.append(report_shot(shot, images, judged))
        overview.append(overview_row(shot, images))
        pictures.write_png(
            options.output / f"{shot.name.replace(' ', '_')}.png", sheet(shot, images)
        )
    report.write_result(options.output / "result", "The published filters", shots)
    write_csv(options.output / "results.csv", results)
    (options.output / "results.md").write_text(table(results), encoding="utf-8")
    pictures.write_png(options.output / "overview.png", pictures.contact_sheet(overview))
    print(table(results), end="")


if __name__ == "__main__":
    main()
