"""Motion blur filters judged as clips: JOD beside PSNR and FLIP, grain fixed and animated, a fit.

    python -m experiments.020_jod.run -o OUT [--tables filters noise fit] [--quick]

Writes filters.csv and .md, noise.csv and .md, fit.csv and .md.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

import jaxblur
from experiments.common import output_parser, write_table
from jaxblur import metrics, scenes
from jaxblur.noise import make_noise
from jaxblur.settings import NoiseKind

SCENES = ("gears", "crossing", "flagpole")
SIZE = (90, 160)
FRAMES = 8
STEPS = 24
SHUTTER = 0.5
TRUTH_SAMPLES = 64
FRAMES_PER_SECOND = 24.0
CLIP: dict[str, Any] = {"frames_per_second": FRAMES_PER_SECOND, "display": "standard_fhd"}
SAMPLES = 15
SETTINGS = jaxblur.GuertinSettings(samples=SAMPLES, tile_choice="expected", fetch="bilinear")
FITTED = ("kappa", "tau", "depth_sharpness")
NOISES: tuple[tuple[NoiseKind, bool], ...] = (
    *(("none", False), ("ign", False), ("ign", True)),
    *(("halton", False), ("halton", True)),
)
"""Kind, and whether it is new in every frame."""

Blur = Callable[[jaxblur.Frame, int], Any]


class Shot(NamedTuple):
    """A clip: its sharp frames and their truth.

    Attributes:
        name: of the scene.
        frames: in their order.
        truth: (F, H, W, 3) linear light.
    """

    name: str
    frames: Sequence[jaxblur.Frame]
    truth: Any


def shot(name: str, size: tuple[int, int], frames: int) -> Shot:
    """Render a clip of a catalogue scene, sharp and with its truth."""
    scene = scenes.SCENES[name]()
    times = [float(number) for number in range(frames)]
    sharp = [scenes.render(scene, time, SHUTTER, size) for time in times]
    truth = [scenes.accumulate(scene, time, SHUTTER, TRUTH_SAMPLES, size) for time in times]
    return Shot(name, sharp, jnp.stack([metrics.rgb(image) for image in truth]))


def filters() -> Mapping[str, Blur]:
    """Filters by name, with their default settings and noise by the frame's number."""
    made: dict[str, Blur] = {"unblurred": lambda frame, number: frame.color}
    for name in ("pixel_velocity", "mcguire2012", "guertin2014", "layered"):
        made[name] = functools.partial(blurred, name)
    return made


def blurred(name: str, frame: jaxblur.Frame, number: int) -> Any:
    """One frame by a filter with its default parameters and settings, noise by its number."""
    info = jaxblur.filter_info(name)
    height, width = np.shape(frame.depth)
    noise = make_noise(info.settings.noise, height, width, number)
    parameters = None if info.parameters is None else info.parameters()
    return jaxblur.FILTERS[name](frame, parameters, settings=info.settings, noise=noise)


def clip_of(images: Sequence[Any]) -> jax.Array:
    """(F, H, W, 3) of images with any further channels."""
    return jnp.stack([metrics.rgb(image) for image in images])


def scores(images: jax.Array, truth: jax.Array) -> tuple[float, float, float, float]:
    """JOD of the clip, mean JOD of its frames as images, mean PSNR, mean FLIP."""
    pairs = list(zip(images, truth, strict=True))
    compared = [metrics.compare(image, expected) for image, expected in pairs]
    single = [float(metrics.cvvdp(*pair, display=CLIP["display"])) for pair in pairs]
    return (
        float(metrics.cvvdp(images, truth, **CLIP)),
        float(np.mean(single)),
        float(np.mean([score.psnr for score in compared])),
        float(np.mean([score.flip for score in compared])),
    )


TABLES = ("filters", "noise", "fit")
SCORES = ("JOD", "JOD of the frames", "PSNR", "FLIP")


def judge_filters(shots: Sequence[Shot]) -> list[tuple[Any, ...]]:
    """Every filter on every clip."""
    rows = []
    for each in shots:
        for name, run in filters().items():
            images = clip_of([run(frame, number) for number, frame in enumerate(each.frames)])
            rows.append((name, each.name, *scores(images, each.truth)))
    return rows


def judge_noise(shots: Sequence[Shot]) -> list[tuple[Any, ...]]:
    """guertin2014 with few samples: no noise, the same in every frame, and new in every frame."""
    published, rows = jaxblur.GuertinParameters(), []
    for each in shots:
        for kind, animated in NOISES:
            seeds = [number if animated else 0 for number in range(len(each.frames))]
            height, width = np.shape(each.frames[0].depth)
            noises = [make_noise(kind, height, width, seed) for seed in seeds]
            images = clip_of(
                [
                    jaxblur.guertin2014(frame, published, settings=SETTINGS, noise=noise)
                    for frame, noise in zip(each.frames, noises, strict=True)
                ]
            )
            label = kind if kind == "none" else f"{kind}, {'animated' if animated else 'fixed'}"
            rows.append((label, each.name, *scores(images, each.truth)))
    return rows


def fit(train: Sequence[Shot], loss: str, steps: int) -> jaxblur.GuertinParameters:
    """Fit parameters of guertin2014 to clips by Adam, in their logarithms.

    Args:
        train: clips.
        loss: ``jod`` (10 - JOD of the clip) or ``squared`` (of display values).
        steps: of Adam.

    Returns:
        The parameters of the last step.
    """
    published = jaxblur.GuertinParameters()

    def parameters(logarithms: dict[str, jax.Array]) -> jaxblur.GuertinParameters:
        return dataclasses.replace(published, **{k: jnp.exp(v) for k, v in logarithms.items()})

    @jax.jit
    @jax.value_and_grad
    def error(logarithms: dict[str, jax.Array], frames: jaxblur.Frame, truth: jax.Array):
        run = functools.partial(
            jaxblur.guertin2014, parameters=parameters(logarithms), settings=SETTINGS
        )
        images = jax.lax.map(lambda frame: metrics.rgb(run(frame)), frames)
        if loss == "jod":
            return 10 - metrics.cvvdp(images, truth, **CLIP)
        shown, expected = (jax.vmap(metrics.display)(clip) for clip in (images, truth))
        return jnp.mean(jnp.square(shown - expected))

    stacked = [(jax.tree.map(lambda *b: jnp.stack(b), *each.frames), each.truth) for each in train]
    free: Any = {
        name: jnp.log(jnp.asarray(getattr(published, name), jnp.float32)) for name in FITTED
    }
    optimizer = optax.adam(0.1)
    state = optimizer.init(free)
    for step in range(steps):
        value, slope = error(free, *stacked[step % len(stacked)])
        print(f"{loss}, step {step}: {float(value):.6f}", flush=True)
        change, state = optimizer.update(slope, state)
        free = optax.apply_updates(free, change)
    return parameters(free)


def judge_fits(shots: Sequence[Shot], steps: int) -> list[tuple[Any, ...]]:
    """Published and fitted parameters of guertin2014 on clips that the fit has seen and not."""
    train, rows = shots[:-1], []
    candidates = {"published": jaxblur.GuertinParameters()}
    candidates |= {f"fit of {loss}": fit(train, loss, steps) for loss in ("squared", "jod")}
    for label, found in candidates.items():
        values = [float(getattr(found, name)) for name in FITTED]
        for place, each in enumerate(shots):
            images = [jaxblur.guertin2014(f, found, settings=SETTINGS) for f in each.frames]
            part = "seen" if place < len(train) else "new"
            rows.append((label, each.name, part, *values, *scores(clip_of(images), each.truth)))
    return rows


def main() -> None:
    """Run the experiment."""
    parser = output_parser("Motion blur filters in JOD.")
    parser.add_argument("--tables", nargs="+", choices=TABLES, default=TABLES, help="which to make")
    parser.add_argument("--quick", action="store_true", help="two frames, two steps of the fit")
    arguments = parser.parse_args()
    frames, steps = (2, 2) if arguments.quick else (FRAMES, STEPS)
    shots = [shot(name, SIZE, frames) for name in SCENES]
    if "filters" in arguments.tables:
        columns = ("filter", "scene", *SCORES)
        write_table(arguments.output, "filters", columns, judge_filters(shots))
    if "noise" in arguments.tables:
        columns = ("noise", "scene", *SCORES)
        write_table(arguments.output, "noise", columns, judge_noise(shots))
    if "fit" in arguments.tables:
        columns = ("parameters", "scene", "part", *FITTED, *SCORES)
        write_table(arguments.output, "fit", columns, judge_fits(shots, steps))


if __name__ == "__main__":
    main()
