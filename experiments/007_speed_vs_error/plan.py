"""The cases that are measured, and their order: default run, quick run, full product."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

import jaxblur
from jaxblur import bench, exr
from jaxblur.bench import Case, Subject, make_case
from jaxblur.filters import FILTERS

Job = tuple[Subject, Case]

SAMPLES = (5, 9, 15, 19, 27, 35, 47, 64)
AXES = {
    "samples": SAMPLES,
    "radius": ("auto", 20, 40, 80),
    "fetch": ("nearest", "bilinear"),
    "tile_choice": ("stochastic", "own", "expected"),
}
SIZES = ((180, 320), (360, 640), (540, 960), (720, 1280), (1080, 1920))
SHUTTER = 1.0
MOVING_SCENE = "camera_turn"
"""A scene in which everything moves, as in the frames that the papers timed."""
NO_TRUTH = "accumulate 0"
REFERENCE_FRAME = "0011"
SPEED_SAMPLES = (15, 35)
GUERTIN_RADIUS = 40
MCGUIRE_SAMPLES = 15
EVERY_TILE = "every tile moves"


@dataclasses.dataclass(frozen=True)
class Extent:
    """The extent of a run. Sizes are (height, width) in pixels.

    Attributes:
        scenes: catalogue scenes that are judged against their truth.
        size: size of these scenes.
        truth_samples: images averaged for a truth.
        axes: values by setting, changed one at a time.
        combined: values by setting, measured in all combinations.
        sizes: sizes at which all filters are timed.
        growth: values by setting, timed at the second of the sizes.
        claim_sizes: the two sizes of the paper's table, or smaller ones of the same ratio.
        claim_samples: samples of guertin2014 in table 3.I.
        claim_radii: radii of mcguire2012 in section 3 of its paper.
        renderers: numbers of samples by renderer.
        reference_samples: numbers of samples on rendered reference frames.
        reference_scenes: number of rendered reference scenes.
        alternatives_size: size of the frame that other libraries blur.
        repeats: number of times that each case is timed.
    """

    scenes: Sequence[str]
    size: tuple[int, int]
    truth_samples: int
    axes: dict[str, Sequence]
    combined: dict[str, Sequence]
    sizes: Sequence[tuple[int, int]]
    growth: dict[str, Sequence]
    claim_sizes: Sequence[tuple[int, int]]
    claim_samples: Sequence[int]
    claim_radii: Sequence[int]
    renderers: dict[str, Sequence[int]]
    reference_samples: Sequence[int]
    reference_scenes: int
    alternatives_size: tuple[int, int]
    repeats: int


DEFAULT = Extent(
    scenes=("cube_between_crates", "rotation_stress", "camera_dolly", "crossing"),
    size=(180, 320),
    truth_samples=128,
    axes=AXES,
    combined={
        "samples": (15, 35),
        "radius": (20,),
        "fetch": AXES["fetch"],
        "tile_choice": AXES["tile_choice"],
    },
    sizes=SIZES,
    growth={"samples": (5, 9, 15, 27, 47, 64), "radius": (10, 20, 40, 80)},
    claim_sizes=((720, 1280), (1080, 1920)),
    claim_samples=(19, 27, 35, 47),
    claim_radii=(5, 7, 15, 31),
    renderers={
        "accumulate": (2, 4, 8, 16, 32, 64),
        "stochastic": (2, 4, 8, 16, 32, 64),
        "motion_paths": (1, 2, 4),
    },
    reference_samples=(5, 9, 15, 27, 47, 64),
    reference_scenes=4,
    alternatives_size=(720, 1280),
    repeats=9,
)
QUICK = Extent(
    scenes=("crossing", "camera_turn"),
    size=(90, 160),
    truth_samples=32,
    axes={"samples": (9,), "fetch": ("bilinear",)},
    combined={},
    sizes=((90, 160), (180, 320)),
    growth={"samples": (63,), "radius": (80,)},
    claim_sizes=((180, 320), (270, 480)),
    claim_samples=(19, 47),
    claim_radii=(5, 15, 31),
    renderers={"accumulate": (2, 8, 32)},
    reference_samples=(),
    reference_scenes=1,
    alternatives_size=(360, 640),
    repeats=5,
)
FULL = dataclasses.replace(
    DEFAULT,
    scenes=(*DEFAULT.scenes, "gears", "opposed"),
    combined=AXES,
    growth={"samples": SAMPLES, "radius": (10, 20, 40, 80)},
    reference_samples=SAMPLES,
)
"""The product of all values, on more scenes; takes about a day instead of an hour."""


def _acceptable(case: Case) -> Case:
    """The case, with one more sample if mcguire2012 has an even number, which it rejects."""
    settings = case.settings
    if case.method != "mcguire2012" or settings.samples % 2:
        return case
    odd = dataclasses.replace(settings, samples=settings.samples + 1)
    return dataclasses.replace(case, settings=odd)


def scene_jobs(extent: Extent) -> list[Job]:
    """Every filter on scenes with truth: settings changed one at a time, and a small product."""
    methods = [bench.UNBLURRED, *FILTERS]
    cases = bench.one_at_a_time(methods, extent.axes)
    if extent.combined:
        cases += bench.product(FILTERS, extent.combined)
    for method, numbers in extent.renderers.items():
        cases += bench.product([method], {"samples": numbers})
    cases = list(dict.fromkeys(map(_acceptable, cases)))
    return [(_scene(name, extent), case) for name in extent.scenes for case in cases]


def _scene(name: str, extent: Extent) -> Subject:
    return bench.catalogue_subject(name, extent.size, SHUTTER, extent.truth_samples)


def claim_jobs(extent: Extent) -> list[Job]:
    """The cases that the papers timed, at their sizes."""
    samples = extent.claim_samples
    cases = bench.product(["guertin2014"], {"directions": ("two", "one"), "samples": samples})
    same = {"samples": samples, "radius": (GUERTIN_RADIUS,)}
    cases += bench.product(["mcguire2012"], same)
    cases += bench.product(
        ["mcguire2012"], {"samples": (MCGUIRE_SAMPLES,), "radius": extent.claim_radii}
    )
    return [(_timed(size), case) for size in extent.claim_sizes for case in cases]


def growth_jobs(extent: Extent) -> list[Job]:
    """Every filter at every size, and at one size with every number of samples and every radius."""
    by_size = bench.product(FILTERS, {"samples": SPEED_SAMPLES})
    jobs = [(_timed(size), case) for size in extent.sizes for case in by_size]
    varied = bench.one_at_a_time(FILTERS, extent.growth)
    return jobs + [(_timed(extent.sizes[1]), _acceptable(case)) for case in varied]


def _timed(size: tuple[int, int]) -> Subject:
    return bench.catalogue_subject(MOVING_SCENE, size, SHUTTER, truth_samples=0)


def reference_jobs(extent: Extent, folder: Path) -> list[Job]:
    """Every filter on rendered reference frames at full size."""
    methods = [bench.UNBLURRED, *FILTERS]
    cases = bench.one_at_a_time(methods, {"samples": extent.reference_samples})
    truths = sorted(folder.glob(f"*/truth_{REFERENCE_FRAME}.exr"))[: extent.reference_scenes]
    if not truths:
        raise SystemExit(
            f"{folder} holds no */truth_{REFERENCE_FRAME}.exr; see experiments/blender."
        )
    subjects = [_reference_subject(truth) for truth in truths]
    return [(subject, _acceptable(case)) for subject in subjects for case in cases]


def _reference_subject(truth: Path) -> Subject:
    camera = json.loads(truth.with_name("camera.json").read_text(encoding="utf-8"))
    sharp = truth.with_name(truth.name.replace("truth", "frame"))
    frame = jaxblur.read_frame(sharp, shutter=camera["shutter"])
    frame = dataclasses.replace(frame, color=frame.color[..., :3])
    image = exr.read_image(truth)[..., :3]
    return bench.frame_subject(truth.parent.name, frame, image, camera["shutter"])


def alternative_jobs(extent: Extent, alternatives: Sequence[str]) -> list[Job]:
    """guertin2014 with each of our backends and in other libraries, on one frame."""
    subject = bench.frame_subject(EVERY_TILE, bench.moving_frame(*extent.alternatives_size))
    plain = {"noise": "none"}
    cases = [
        make_case("guertin2014", samples=samples, backend=backend, **plain)
        for samples in SPEED_SAMPLES
        for backend in ("auto", "xla")
    ]
    cases += [
        make_case(name, samples=samples, **plain)
        for name in alternatives
        for samples in SPEED_SAMPLES
    ]
    return [(subject, case) for case in cases]
