"""Do clips at half the cost look as good? Pairs of settings by ColorVideoVDP and by viewers.

    python -m experiments.003_perception.sequences -o OUT            # 8 minutes of processor time
    python -m experiments.003_perception.sequences -o OUT --quick    # two frames, small

Eight frames of `rolling_sphere` at 30 frames per second for each setting, with noise that is new in
every frame. Every setting of a study is compared with every other as a clip, in JOD; viewers tell a
pair apart if their votes differ significantly. The limit is the loss in JOD below which pairs count
as equal that agrees best with the viewers. Writes sequences.csv, half_cost.csv and limits.csv, each
with .md, and clips.png.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from experiments import common, pictures
from jaxblur import metrics, scenes

from .run import (
    LEVELS,
    MATERIALS,
    SHUTTERS,
    SIGNIFICANT_BOTH,
    SIGNIFICANT_LEVEL,
    SPEEDS,
    VOTES_BOTH,
    VOTES_LEVEL,
)

SIZE, FRAMES, QUICK = (90, 160), 8, ((36, 64), 2)
SPEED = "S2"
SHOWN: dict[str, Any] = {"frames_per_second": 30.0, "display": "standard_fhd"}
FIRST = -3
"""The time of the first frame, in frames: the sphere passes the middle of the picture."""
HALF_COST = (("T5A3", "T5A5"), ("T4A3", "T3A5"))
"""Settings of half the samples, and those that they may stand for."""


class Study(NamedTuple):
    """A study of the thesis.

    Attributes:
        name: for tables.
        material: key of `MATERIALS`.
        votes: how often each setting was preferred.
        significant: least difference of votes that is significant.
    """

    name: str
    material: str
    votes: Mapping[str, int]
    significant: int


STUDIES = (
    Study("levels", "M3", {f"T3{k}": v for k, v in VOTES_LEVEL.items()}, SIGNIFICANT_LEVEL),
    Study("shutter and level", "M2", VOTES_BOTH, SIGNIFICANT_BOTH),
)


class Pair(NamedTuple):
    """Two settings of a study.

    Attributes:
        study: its name.
        first: setting, such as T3A5.
        second: the other setting.
        loss: 10 - JOD of one beside the other, mean of both directions.
        votes: difference of their votes.
        told_apart: whether that is significant.
    """

    study: str
    first: str
    second: str
    loss: float
    votes: int
    told_apart: bool


def clip(study: Study, setting: str, size: tuple[int, int], frames: int) -> np.ndarray:
    """(F, H, W, 3) linear light of a setting; every frame and level has noise of its own."""
    scene = scenes.SCENES["rolling_sphere"](MATERIALS[study.material], SPEEDS[SPEED])
    shutter, level = setting[:2], setting[2:]
    images = [
        scenes.stochastic(
            scene,
            float(FIRST + number),
            shutter=SHUTTERS[shutter],
            samples=LEVELS[level],
            size=size,
            seed=1000 * LEVELS[level] + number,
        )
        for number in range(frames)
    ]
    return np.stack([np.asarray(image) for image in images])


def loss(one: np.ndarray, other: np.ndarray) -> float:
    """10 - JOD of one clip beside the other, mean of both directions."""
    sides = [float(metrics.cvvdp(*pair, **SHOWN)) for pair in ((one, other), (other, one))]
    return 10 - sum(sides) / 2


def compare(study: Study, clips: Mapping[str, np.ndarray]) -> list[Pair]:
    """All pairs of settings of a study."""
    pairs = []
    for first, second in itertools.combinations(clips, 2):
        votes = abs(study.votes[first] - study.votes[second])
        apart = votes >= study.significant
        between = loss(clips[first], clips[second])
        pairs.append(Pair(study.name, first, second, between, votes, apart))
    return pairs


def best_limit(pairs: Sequence[Pair]) -> tuple[float, float]:
    """The loss below which pairs count as equal that agrees best with viewers, and on what share.

    Limits midway between neighboring losses are tried; of equally good ones the smallest, which
    promises least, wins.
    """
    edges = np.sort([0.0, *(pair.loss for pair in pairs)])
    limits = np.append((edges[1:] + edges[:-1]) / 2, 2 * edges[-1])
    shares = [np.mean([(p.loss >= limit) == p.told_apart for p in pairs]) for limit in limits]
    best = int(np.argmax(shares))
    return float(limits[best]), float(shares[best])


def limits_of(pairs: Sequence[Pair]) -> list[tuple[Any, ...]]:
    """The best limit of each study, and of both; where losses of equal and other pairs lie."""
    rows = []
    for name in (*(study.name for study in STUDIES), "both"):
        mine = [pair for pair in pairs if name in (pair.study, "both")]
        same = [pair.loss for pair in mine if not pair.told_apart]
        apart = [pair.loss for pair in mine if pair.told_apart]
        rows.append((name, len(mine), *best_limit(mine), max(same), min(apart), max(apart)))
    return rows


def half_cost(pairs: Sequence[Pair]) -> list[tuple[Any, ...]]:
    """What the settings of half the cost lose beside those that they may stand for."""
    wanted = {frozenset(names): names for names in HALF_COST}
    found = [(wanted[key], p) for p in pairs if (key := frozenset((p.first, p.second))) in wanted]
    return [
        (cheap, dear, LEVELS[cheap[2:]] / LEVELS[dear[2:]], p.loss, p.votes, p.told_apart)
        for (cheap, dear), p in found
    ]


def draw(clips: Mapping[str, np.ndarray], target: Any) -> None:
    """Each pair of half the cost, a frame of both and 8 times their difference."""
    rows = []
    for cheap, dear in HALF_COST:
        shown = [clips[name][len(clips[name]) // 2] for name in (cheap, dear)]
        apart = np.abs(np.subtract(*(np.asarray(metrics.display(image)) for image in shown)))
        rows.append([*shown, np.minimum(8 * apart, 1) ** 2.2])
    pictures.write_png(target, pictures.contact_sheet(rows))


def main() -> None:
    """Render, compare, and write."""
    parser = common.output_parser("Clips at half the cost, by ColorVideoVDP and by viewers.")
    parser.add_argument("--quick", action="store_true", help="two small frames")
    arguments = parser.parse_args()
    size, frames = QUICK if arguments.quick else (SIZE, FRAMES)
    pairs: list[Pair] = []
    for study in STUDIES:
        clips = {setting: clip(study, setting, size, frames) for setting in study.votes}
        pairs += compare(study, clips)
        print(*pairs[-3:], sep="\n", flush=True)
        if {*itertools.chain(*HALF_COST)} <= clips.keys():
            draw(clips, arguments.output / "clips.png")
    common.write_table(arguments.output, "sequences", Pair._fields, pairs)
    columns = ("half the cost", "stands for", "cost", "loss, JOD", "votes apart", "told apart")
    common.write_table(arguments.output, "half_cost", columns, half_cost(pairs))
    columns = ("study", "pairs", "limit, JOD", "agreement")
    columns += ("largest of equal pairs", "least of others", "largest of others")
    common.write_table(arguments.output, "limits", columns, limits_of(pairs))


if __name__ == "__main__":
    main()
