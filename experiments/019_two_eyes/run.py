"""Blur of both eyes: what differs between them, by where the noise is shared.

    python -m experiments.019_two_eyes.run -o OUT

Four scenes of the catalogue at 320x180, seen by two eyes; exposure half a frame; 128 samples of
truth. The right view is warped to the left by the disparity, at pixels that both see, and
subtracted. What is left of a true pair is highlights, and blur across other things; a filter should
leave the same. Its excess is ``(L - R) - (true L - true R)``, root mean square of display values
times 1000. Writes
``two_eyes.csv``, ``two_eyes.md`` and ``two_eyes.png``.
"""

from typing import Any, NamedTuple

import numpy as np

import jaxblur
from experiments import common, pictures
from jaxblur import metrics, scenes
from jaxblur.filters import filter_info
from jaxblur.noise import make_noise

SCENES = ("gears", "crossing", "flagpole", "cube_between_crates")
EXPOSURE, SIZE, TRUTH = 0.5, (180, 320), 128
SEPARATION = 0.065
NOISE = ("same pixels", "in the scene", "independent")
FILTERS = ("guertin2014", "layered")


class Pair(NamedTuple):
    """A scene by both eyes.

    Attributes:
        frames: left and right.
        truths: linear light of the true blur.
        column: (H, W) for each pixel of the left view, the column of the right that shows it.
        seen: (H, W) whether the right view does show it.
        right_disparity: (H, W) pixels, of the right view.
    """

    frames: tuple[jaxblur.Frame, jaxblur.Frame]
    truths: tuple[np.ndarray, np.ndarray]
    column: np.ndarray
    seen: np.ndarray
    right_disparity: np.ndarray


def pair_of(name: str) -> Pair:
    """Render both views of a scene, and where they agree."""
    eyes = scenes.stereo(scenes.SCENES[name](), SEPARATION)
    frames = tuple(scenes.render(eye, 0.0, EXPOSURE, SIZE) for eye in eyes)
    truths = tuple(np.asarray(scenes.accumulate(eye, 0.0, EXPOSURE, TRUTH, SIZE)) for eye in eyes)
    left, right = (
        np.asarray(scenes.disparity(eyes[0], frame.depth, SEPARATION)) for frame in frames
    )
    column = np.arange(SIZE[1]) - left
    inside = (column >= 0) & (column <= SIZE[1] - 1)
    column = np.clip(column, 0, SIZE[1] - 1)
    there = np.take_along_axis(right, np.rint(column).astype(int), 1)
    seen = inside & (np.abs(there - left) < 0.25)
    return Pair((frames[0], frames[1]), (truths[0], truths[1]), column, seen, right)


def difference(left: np.ndarray, right: np.ndarray, pair: Pair) -> np.ndarray:
    """(P, 3) left minus right, display values, at the pixels that both see."""
    left, right = (np.asarray(metrics.display(image)) for image in (left, right))
    first = np.floor(pair.column).astype(int)
    share = (pair.column - first)[..., None]
    after = np.minimum(first + 1, SIZE[1] - 1)
    rows = np.arange(SIZE[0])[:, None]
    warped = right[rows, first] * (1 - share) + right[rows, after] * share
    return (left - warped)[pair.seen]


def noises(kind: str, pair: Pair) -> tuple[jaxblur.Noise, jaxblur.Noise]:
    """The noise of both eyes."""
    left = make_noise("ign", *SIZE)
    if kind == "same pixels":
        return left, left
    if kind == "in the scene":
        return left, jaxblur.shared_noise(left, pair.right_disparity)
    return left, make_noise("ign", *SIZE, seed=7)


def blurred(
    name: str, pair: Pair, kind: str, samples: tuple[int, int] = (35, 35)
) -> tuple[np.ndarray, np.ndarray]:
    """Linear light of both eyes by a filter."""
    info = filter_info(name)
    images = []
    for frame, noise, count in zip(pair.frames, noises(kind, pair), samples, strict=True):
        settings = info.make_settings(samples=count)
        made = info.call(frame, info.make_parameters(), settings=settings, noise=noise)
        images.append(np.asarray(made))
    return images[0], images[1]


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    """PSNR in dB of display values."""
    return float(metrics.psnr(metrics.display(image), metrics.display(truth)))


def root_mean_square(values: np.ndarray) -> float:
    """Of all entries, times 1000."""
    return 1000 * float(np.sqrt(np.mean(values**2)))


def measure(name: str, pair: Pair, filter_name: str, kind: str, samples: Any) -> dict[str, Any]:
    """One row of the table."""
    left, right = blurred(filter_name, pair, kind, samples)
    true = difference(*pair.truths, pair)
    made = difference(left, right, pair)
    return {
        "scene": name,
        "filter": filter_name,
        "noise": kind,
        "samples": f"{samples[0]} and {samples[1]}",
        "left, dB": psnr(left, pair.truths[0]),
        "right, dB": psnr(right, pair.truths[1]),
        "between the eyes": root_mean_square(made),
        "of the truth": root_mean_square(true),
        "excess": root_mean_square(made - true),
    }


def draw(pair: Pair, target: Any) -> None:
    """Truth and `layered` of both eyes, and 8 times the excess by where noise is shared."""
    true = difference(*pair.truths, pair)
    errors = []
    for kind in NOISE:
        made = difference(*blurred("layered", pair, kind, (17, 17)), pair)
        error = np.zeros((*SIZE, 3))
        error[pair.seen] = np.minimum(np.abs(made - true) * 8, 1) ** 2.2
        errors.append(error)
    both = blurred("layered", pair, NOISE[0], (17, 17))
    sheet = pictures.contact_sheet([[pair.truths[0], *both], errors])
    pictures.write_png(target, sheet)


def main() -> None:
    """Measure and write."""
    arguments = common.output_parser("Blur of both eyes.").parse_args()
    rows = []
    for name in SCENES:
        pair = pair_of(name)
        for filter_name in FILTERS:
            for kind in NOISE:
                rows.append(measure(name, pair, filter_name, kind, (35, 35)))
            rows.append(measure(name, pair, filter_name, NOISE[0], (35, 15)))
        print(name, flush=True)
        if name == "crossing":
            draw(pair, arguments.output / "two_eyes.png")
    means = []
    for filter_name in FILTERS:
        for kind, samples in [*((kind, "35 and 35") for kind in NOISE), (NOISE[0], "35 and 15")]:
            mine = [
                r
                for r in rows
                if (r["filter"], r["noise"], r["samples"]) == (filter_name, kind, samples)
            ]
            numbers = {k: float(np.mean([r[k] for r in mine])) for k in list(rows[0])[4:]}
            head = {"filter": filter_name, "noise": kind, "samples": samples}
            means.append({"scene": "mean", **head, **numbers})
    columns = list(rows[0])
    cells = [[row[column] for column in columns] for row in rows + means]
    common.write_table(arguments.output, "two_eyes", columns, cells)


if __name__ == "__main__":
    main()
