"""What ``jaxblur blur --quality`` gains and costs, and what moving noise does to a shot.

    python -m experiments.012_layered.quality --reference-data DIR -o OUT

DIR holds scenes as ``experiments/blender/render_reference.py`` writes them. Writes ``quality.csv``
and ``quality.md``: for each quality the PSNR in dB of display values on each scene and in the mean,
and the time of the filter relative to ``standard``, by wall clock and by processor time, timed in
turn. Writes ``grain.csv`` and ``grain.md``: the PSNR of the mean of 8 frames of one picture, which
the eye sees of a shot, with noise that stands still and with noise that moves with the frame.
"""

import functools
from typing import Any

import numpy as np

import jaxblur
from experiments import common
from jaxblur import metrics
from jaxblur.bench.timing import time_in_turn
from jaxblur.cli.filtering import QUALITIES, samples_of
from jaxblur.filters import filter_info
from jaxblur.noise import make_noise

FRAMES = range(1001, 1009)
ROUNDS = 15


def psnr(image: Any, truth: Any) -> float:
    """PSNR in dB of display values."""
    return float(metrics.psnr(metrics.display(image), metrics.display(truth)))


def settings_of(quality: str) -> jaxblur.Settings:
    """Settings of the default filter at a quality."""
    info = filter_info("layered")
    return info.make_settings(samples=samples_of(info.settings.samples, quality))


def waited_for(frame: jaxblur.Frame, quality: str) -> Any:
    """The frame, blurred at a quality."""
    parameters, settings = jaxblur.LayeredParameters(), settings_of(quality)
    return jaxblur.layered(frame, parameters, settings=settings).block_until_ready()


def grain(frame: jaxblur.Frame, truth: Any, settings: jaxblur.Settings) -> list[float]:
    """PSNR of the mean over a shot, with still noise and with moving noise."""
    parameters = jaxblur.LayeredParameters()
    still = jaxblur.layered(frame, parameters, settings=settings)
    height, width = frame.depth.shape
    noises = (make_noise(settings.noise, height, width, number) for number in FRAMES)
    moving = [jaxblur.layered(frame, parameters, settings=settings, noise=n) for n in noises]
    # All frames with still noise are equal, and so is their mean.
    return [psnr(still, truth), psnr(np.mean([np.asarray(image) for image in moving], 0), truth)]


def main() -> None:
    """Measure, and write the tables."""
    parser = common.output_parser("Measure the qualities of blur.", "folder of rendered scenes")
    options = parser.parse_args()
    examples = common.full_size_examples(options.reference_data)
    rows: dict[str, list[float]] = {quality: [] for quality in QUALITIES}
    times: dict[str, list[tuple[float, float]]] = {quality: [] for quality in QUALITIES}
    grains = []
    for example in examples:
        runs = {name: functools.partial(waited_for, example.frame, name) for name in QUALITIES}
        timed = time_in_turn(runs, ROUNDS, settle=True)
        for quality in QUALITIES:
            rows[quality].append(psnr(waited_for(example.frame, quality), example.truth))
            times[quality].append((timed[quality].median, timed[quality].cpu_median))
            seen = grain(example.frame, example.truth, settings_of(quality))
            grains.append([example.name, quality, *seen])
    usual = np.array(times["standard"])
    table = [
        [
            quality,
            settings_of(quality).samples,
            *rows[quality],
            float(np.mean(rows[quality])),
            *np.mean(np.array(times[quality]) / usual, axis=0).tolist(),
            *(1000 * np.mean(times[quality], axis=0)).tolist(),
        ]
        for quality in QUALITIES
    ]
    names = [example.name for example in examples]
    columns = ["quality", "samples", *names, "mean", "time", "CPU time", "ms", "CPU ms"]
    common.write_table(options.output, "quality", columns, table)
    columns = ["scene", "quality", "still noise", "moving noise, mean of 8 frames"]
    common.write_table(options.output, "grain", columns, grains)


if __name__ == "__main__":
    main()
