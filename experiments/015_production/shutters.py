"""Blur under shutters that are no centered box, against the truth of the same shutter.

    python -m experiments.015_production.shutters -o OUT

Five scenes of the catalogue at 320x180, 64 samples of truth, exposure half a frame. Writes
``shutters.csv`` and ``shutters.md``: PSNR in dB of display values, of ``layered`` with the shutter
and of ``guertin2014`` with the box that is all it can do; ``one_sided.csv`` and ``one_sided.md``:
what vectors to the previous frame alone cost, and what exposing where they hold gains back;
``double.csv`` and ``double.md``: a double exposure by one shutter, and as the mean of two;
``kernels.csv`` and ``kernels.md``: how near the blur of a lone line comes to a box and to a
trapezoid; and ``shutters.png``. Takes three minutes on two cores.
"""

import functools
from typing import Any

import numpy as np

import jaxblur
from experiments import common, pictures
from jaxblur import Shutter, metrics, scenes

SCENES = ("cube_between_crates", "gears", "crossing", "flagpole", "cubes_on_teapot")
CURVED = ("gears", "rotation_stress", "acceleration_from_rest")
"""Scenes in which velocities change."""
EXPOSURE, SIZE, SAMPLES = 0.5, (180, 320), 64
WINDOWS = ((-1.0, -0.4), (0.4, 1.0))
TWICE = Shutter.windows(WINDOWS)
SHUTTERS: dict[str, tuple[Shutter | None, dict[str, Any]]] = {
    "box": (None, {}),
    "trapezoid": (Shutter.trapezoid(), {"shutter_function": "trapezoid"}),
    "triangle": (Shutter.triangle(), {"shutter_function": "triangle"}),
    "gaussian": (Shutter.gaussian(), {"shutter_function": "gaussian"}),
    "opens at the frame": (Shutter.box(0, 2), {"placement": "leading"}),
    "rolling, 1/4 frame": (Shutter.box(readout=1), {"readout": EXPOSURE / 2}),
    "rolling, 1/2 frame": (Shutter.box(readout=2), {"readout": EXPOSURE}),
    "double exposure": (TWICE, {"shutter_function": np.asarray(TWICE.curve)}),
}
"""For each name the shutter of the filter, and the options of the truth."""


def psnr(image: Any, truth: Any) -> float:
    """PSNR in dB of display values."""
    return float(metrics.psnr(metrics.display(image), metrics.display(truth)))


def blurred(
    frame: jaxblur.Frame, exposure: Shutter | None = None, samples: int = 35
) -> jaxblur.metrics.Image:
    """The frame, blurred by `layered`."""
    settings = jaxblur.Settings(radius=160, fetch="bilinear", samples=samples)
    image = jaxblur.layered(
        frame, jaxblur.LayeredParameters(), settings=settings, exposure=exposure
    )
    return np.asarray(image)


@functools.cache
def frame_of(name: str) -> jaxblur.Frame:
    """The sharp frame of a scene."""
    return scenes.render(scenes.SCENES[name](), 0.0, EXPOSURE, SIZE)


def truth_of(name: str, time: float = 0.0, **options: Any) -> np.ndarray:
    """The true blur of a scene."""
    scene = scenes.SCENES[name]()
    return np.asarray(scenes.accumulate(scene, time, EXPOSURE, SAMPLES, SIZE, **options))


def compare() -> list[list[Any]]:
    """A row for each shutter and scene, and the mean of each shutter."""
    rows: list[list[Any]] = []
    for label, (exposure, options) in SHUTTERS.items():
        scores = []
        for name in SCENES:
            frame, truth = frame_of(name), truth_of(name, **options)
            guertin = jaxblur.guertin2014(frame, jaxblur.GuertinParameters())
            images = frame.color, guertin, blurred(frame), blurred(frame, exposure)
            scores.append([psnr(image, truth) for image in images])
            rows.append([label, name, *scores[-1], scores[-1][3] - scores[-1][1]])
        mean = np.mean(scores, axis=0)
        rows.append([label, "mean", *mean, mean[3] - mean[1]])
    return rows


def double_exposures() -> list[list[Any]]:
    """One shutter with two windows, and the mean of two with one window and half the samples."""
    rows = []
    for name in ("gears", "crossing"):
        frame = frame_of(name)
        truth = truth_of(name, shutter_function=np.asarray(TWICE.curve))
        halves = [blurred(frame, Shutter.box(*window), 18) for window in WINDOWS]
        whole = blurred(frame, TWICE, 36)
        rows.append([name, psnr(whole, truth), psnr(np.mean(halves, axis=0), truth)])
    return rows


def one_sided() -> list[list[Any]]:
    """What vectors cost that know the previous frame alone [Guertin 2014, eq. 2.3].

    Such a vector is the motion of the frame before, so that it is exact in the middle of the two.
    """
    rows = []
    for name in CURVED:
        scene, frame = scenes.SCENES[name](), frame_of(name)
        # Displacements to the previous and to the next frame.
        ends = np.asarray(scenes.render(scene, 0.0, 2.0, SIZE, path=True, subpixels=1).path)
        both = EXPOSURE / 2 * (ends[..., 1, :] - ends[..., 0, :]) / 2
        before = -EXPOSURE / 2 * ends[..., 0, :]
        early = Shutter.from_frames(-0.5 - EXPOSURE / 2, -0.5 + EXPOSURE / 2, exposure=EXPOSURE)
        centered, at_end, half_early = (
            truth_of(name),
            truth_of(name, placement="trailing"),
            truth_of(name, -0.5),
        )
        two, one = frame.replace(velocity=both), frame.replace(velocity=before)
        rows.append(
            [
                name,
                psnr(blurred(two), centered),
                psnr(blurred(one), centered),
                psnr(blurred(two, Shutter.box(-2, 0)), at_end),
                psnr(blurred(one, Shutter.box(-2, 0)), at_end),
                psnr(blurred(two, early), half_early),
                psnr(blurred(one, early), half_early),
            ]
        )
    return [*rows, ["mean", *np.mean([row[1:] for row in rows], axis=0)]]


def kernels() -> list[list[Any]]:
    """How near each filter's blur of a lone line in a uniform pan comes to a box and a trapezoid.

    The distance is that of the amplitudes of the spectra, weighted by 1 / frequency^2, which is
    the spectrum of pictures.
    """
    height, width, trapezoid = 90, 240, Shutter.trapezoid()
    rows = []
    for speed in (5.0, 10.0, 20.0):
        color = np.zeros((height, width, 1), np.float32)
        color[:, width // 2] = 1
        velocity = np.zeros((height, width, 2), np.float32)
        velocity[..., 0] = speed
        frame = jaxblur.Frame(color, np.ones((height, width), np.float32), velocity)
        time = (np.arange(width) - width // 2) / speed
        shapes = [np.where(np.abs(time) <= 1, 1.0, 0.0), np.clip(2 - 2 * np.abs(time), 0, 1)]
        images = {
            "guertin2014": jaxblur.guertin2014(frame, jaxblur.GuertinParameters()),
            "layered, box": blurred(frame),
            "layered, trapezoid": blurred(frame, trapezoid),
        }
        for name, image in images.items():
            line = np.asarray(image)[20:-20, :, 0].mean(axis=0)
            deviation = float(np.sqrt(np.sum(line * time**2) / np.sum(line)))
            rows.append([name, speed, deviation, *(_apart(line, shape) for shape in shapes)])
    return rows


def _apart(first: np.ndarray, second: np.ndarray) -> float:
    """The distance of `kernels`."""
    one, other = (np.abs(np.fft.rfft(line / line.sum()))[1:] for line in (first, second))
    weight = 1.0 / np.arange(1, len(one) + 1) ** 2
    return float(np.sqrt(np.sum(weight * (one - other) ** 2) / np.sum(weight)))


def main() -> None:
    """Measure, and write tables and the picture."""
    folder = common.output_parser("Blur under other shutters than a centered box.").parse_args()
    columns = ["shutter", "scene", "sharp", "guertin2014, box", "layered, box", "layered", "gain"]
    common.write_table(folder.output, "shutters", columns, compare())
    columns = ["scene", "one shutter, 36 samples", "mean of two, 18 samples each"]
    common.write_table(folder.output, "double", columns, double_exposures())
    columns = ["scene"] + [
        f"{sides}, {where}"
        for where in ("centered", "ends at the frame", "half a frame early")
        for sides in ("two-sided", "one-sided")
    ]
    common.write_table(folder.output, "one_sided", columns, one_sided())
    columns = ["filter", "half-spread, px", "standard deviation", "from a box", "from a trapezoid"]
    common.write_table(folder.output, "kernels", columns, kernels())
    sheet = [
        [blurred(frame_of(name), exposure), truth_of(name, **options)]
        for label, name in (("rolling, 1/2 frame", "crossing"), ("double exposure", "gears"))
        for exposure, options in [SHUTTERS[label]]
    ]
    pictures.write_png(folder.output / "shutters.png", pictures.contact_sheet(sheet))


if __name__ == "__main__":
    main()
