"""Rules that predict what each candidate of `jaxblur.plan` loses in JOD, for ``--plan perceptual``.

    python -m experiments.005_what_a_scene_needs.derive_perceptual -o OUT

Takes the candidates and their parameters from the constants of the package, blurs clips of the
same scenes with each, and judges them by ColorVideoVDP beside the true blur. The loss of a
candidate is the JOD of the full filter minus its own. Writes ``constants.json``, which belongs in
the package: the same with the rules for JOD; and perceptual.csv and .md: for each clip, the choice
by rules that have not seen its scene, and what it loses.
"""

import itertools
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from experiments import common
from jaxblur import metrics, planning, scenes
from jaxblur.filters import FILTERS, filter_info
from jaxblur.frame import Frame
from jaxblur.noise import make_noise

from .derive_plan import (
    DERIVED_FROM,
    RADIUS_STEP,
    SHUTTERS,
    SIZE,
    left_out_spread,
    regress,
)

FRAMES, TRUTH_SAMPLES = 4, 64
SHOWN: dict[str, Any] = {"frames_per_second": 24.0, "display": "standard_fhd"}
FULL = "layered, 35 samples"
COMMAND = "python -m experiments.005_what_a_scene_needs.derive_perceptual -o OUT"


class Shot(NamedTuple):
    """A clip of a scene.

    Attributes:
        name: of the scene.
        frames: sharp.
        truth: (F, H, W, 3) linear light.
        features: mean over the frames of those that the rules take.
        radius: largest half-spread in pixels, rounded up.
    """

    name: str
    frames: Sequence[Frame]
    truth: Any
    features: np.ndarray
    radius: int


def shot(name: str, shutter: float) -> Shot:
    """Render a clip, sharp and with its truth."""
    scene = scenes.SCENES[name]()
    times = [float(number) for number in range(FRAMES)]
    frames = [scenes.render(scene, time, shutter, SIZE) for time in times]
    truth = [scenes.accumulate(scene, time, shutter, TRUTH_SAMPLES, SIZE) for time in times]
    known = [planning.frame_statistics(frame) for frame in frames]
    largest = max(statistics.radius for statistics in known)
    return Shot(
        name,
        frames,
        jnp.stack([metrics.rgb(image) for image in truth]),
        np.mean([statistics.features for statistics in known], axis=0),
        -(-largest // RADIUS_STEP) * RADIUS_STEP,
    )


def jod(record: Mapping[str, Any], clip: Shot) -> float:
    """JOD of a clip that a candidate has blurred, beside the truth; noise is new in every frame."""
    info = filter_info(record["filter"])
    settings = info.kind(**record["settings"], radius=clip.radius)
    parameters = info.make_parameters(**record["parameters"])
    images = [
        FILTERS[info.name](
            frame, parameters, settings=settings, noise=make_noise(settings.noise, *SIZE, number)
        )
        for number, frame in enumerate(clip.frames)
    ]
    made = jnp.stack([metrics.rgb(image) for image in images])
    return float(metrics.cvvdp(made, clip.truth, **SHOWN))


def choices(
    known: Mapping[str, Any], clips: Sequence[Shot], lost: Mapping[str, np.ndarray]
) -> list[tuple[Any, ...]]:
    """For each clip, the fastest candidate within the tolerance by rules without its scene."""
    names, features = np.array([c.name for c in clips]), np.stack([c.features for c in clips])
    times = {label: record["milliseconds_per_megapixel"] for label, record in known.items()}
    rows = []
    for index, clip in enumerate(clips):
        others = names != clip.name
        expected = {}
        for label, loss in lost.items():
            rule = max(float(clip.features @ regress(features[others], loss[others])), 0.0)
            spread = left_out_spread(features[others], loss[others], list(names[others]))
            expected[label] = rule, spread
        able = [k for k, parts in expected.items() if sum(parts) <= planning.PERCEPTUAL_TOLERANCE]
        chosen = min(able, key=times.__getitem__)
        rule, spread = expected[chosen]
        measured = float(lost[chosen][index])
        rows.append((clip.name, chosen, rule, spread, measured, times[chosen] / times[FULL]))
    return rows


def main() -> None:
    """Render, blur, judge, derive, and write."""
    options = common.output_parser("Rules of jaxblur.plan in JOD.").parse_args()
    clips = [shot(name, s) for s, name in itertools.product(SHUTTERS, DERIVED_FROM)]
    known = planning.constants()
    judged = {
        label: np.array([jod(record, clip) for clip in clips])
        for label, record in known["candidates"].items()
    }
    lost = {label: judged[FULL] - scores for label, scores in judged.items()}
    features, names = np.stack([c.features for c in clips]), [c.name for c in clips]
    records = {
        label: record
        | {
            # Zero is added, so that no zero is negative.
            "jod": [float(f"{value:.4g}") + 0.0 for value in regress(features, lost[label])],
            "jod_spread": float(f"{left_out_spread(features, lost[label], names):.4g}"),
        }
        for label, record in known["candidates"].items()
    }
    written = known | {"jod_command": COMMAND, "candidates": records}
    text = json.dumps(written, indent=1) + "\n"
    (options.output / "constants.json").write_text(text, encoding="utf-8")
    columns = ("candidate", "JOD", "mean loss", "largest loss", "spread of the rule")
    table = [
        (label, judged[label].mean(), loss.mean(), loss.max(), records[label]["jod_spread"])
        for label, loss in lost.items()
    ]
    common.write_table(options.output, "jod", columns, table)
    columns = ("scene", "plan", "expected loss", "spread", "loss", "time of the full filter")
    common.write_table(options.output, "perceptual", columns, choices(records, clips, lost))


if __name__ == "__main__":
    main()
