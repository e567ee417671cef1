"""What all groups of claims share: the row of the table, the extent of a run, frames, scores."""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import mean
from typing import Any

import jax
import numpy as np

import jaxblur
from experiments.common import Example, catalogue_example, cycles_examples
from jaxblur import metrics
from jaxblur.filters import filter_info
from jaxblur.fitting.objective import draw_noise

AGREES, DIFFERS, PARTLY = "agrees", "differs", "partly"
NOT_COMPARABLE = "not comparable"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Row:
    """A claim beside what was measured here.

    Attributes:
        claim: in a few words.
        source: author, year, section.
        tested: on what, and by which measure.
        theirs: the number or statement of the source.
        ours: the same here.
        verdict: one of the words above, with a reason where it needs one.
        measured: every number behind `ours`, for the results file.
    """

    claim: str
    source: str
    tested: str
    theirs: str
    ours: str
    verdict: str
    measured: Mapping[Any, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Extent:
    """The extent of a run.

    Attributes:
        size: (height, width) of a scene; other sizes are its multiples.
        truth_samples: images averaged for the truth of a catalogue scene.
        scenes: catalogue scenes that stand for rendered ones where there are none.
        rounds: number of times that a time is measured.
        reference: folder of rendered scenes as `experiments/blender` writes them.
    """

    size: tuple[int, int] = (180, 320)
    truth_samples: int = 64
    scenes: tuple[str, ...] = ("cube_between_crates", "cubes_on_teapot", "flagpole", "tracked_car")
    rounds: int = 7
    reference: Path | None = None

    @property
    def large(self) -> tuple[int, int]:
        """Twice the size."""
        return 2 * self.size[0], 2 * self.size[1]

    @property
    def small(self) -> tuple[int, int]:
        """Half the size."""
        return self.size[0] // 2, self.size[1] // 2


TINY = Extent(size=(72, 128), truth_samples=8, scenes=("crossing", "flagpole"), rounds=3)

Claim = Callable[[Extent], Row]
"""Measures a claim; its name is that of the row in the results."""


@functools.cache
def example(name: str, size: tuple[int, int], shutter: float, samples: int) -> Example:
    """A catalogue scene, sharp and true; rendered once in a run."""
    return catalogue_example(name, size, shutter, samples)


@functools.cache
def examples(extent: Extent, size: tuple[int, int] | None = None) -> list[Example]:
    """The scenes of an extent, in its size or another: rendered ones if there are any."""
    size = size or extent.size
    if extent.reference is not None:
        return cycles_examples(extent.reference, size[1])
    return [example(name, size, 1.0, extent.truth_samples) for name in extent.scenes]


def named(examples: Sequence[Example], name: str) -> Example:
    """The example of a name."""
    return next(one for one in examples if one.name == name)


def blur(
    name: str,
    frame: jaxblur.Frame,
    parameters: dict[str, float] | None = None,
    seed: int | None = None,
    **settings: Any,
) -> jax.Array:
    """Blur a frame by a filter with its defaults and some changes.

    Args:
        name: of the filter.
        frame: to blur.
        parameters: that differ from the defaults.
        seed: of white noise in place of the built-in noise.
        **settings: that differ from the defaults.

    Returns:
        (H, W, C) linear light.
    """
    info = filter_info(name)
    height, width = frame.depth.shape
    noise = None if seed is None else draw_noise(jax.random.key(seed), (height, width))
    made = info.make_parameters(**(parameters or {}))
    return info.call(frame, made, settings=info.make_settings(**settings), noise=noise)


def psnr(image: Any, example: Example) -> float:
    """PSNR of display values where motion reaches, dB."""
    area = metrics.motion_footprint(example.frame)
    pair = metrics.display(image), metrics.display(example.truth)
    return float(metrics.psnr(*pair, mask=area))


def mean_psnr(examples: Sequence[Example], run: Callable[[jaxblur.Frame], Any]) -> float:
    """Mean of `psnr` over examples."""
    return mean(psnr(run(one.frame), one) for one in examples)


def flip(image: Any, truth: Any, example: Example) -> float:
    """FLIP of display values where motion reaches."""
    pair = metrics.display(image), metrics.display(truth)
    return metrics.flip(*pair, mask=metrics.motion_footprint(example.frame))


def mean_flip(examples: Sequence[Example], run: Callable[[jaxblur.Frame], Any]) -> float:
    """Mean of `flip` over examples."""
    return mean(flip(run(one.frame), one.truth, one) for one in examples)


def noise_level(examples: Sequence[Example], run: Callable[[jaxblur.Frame, int], Any]) -> float:
    """Standard deviation of the noise where motion reaches, in 255ths of display values.

    Two pictures with independent noise differ by sqrt(2) times as much.

    Args:
        examples: the frames.
        run: blurs a frame with white noise from a seed.

    Returns:
        The mean over examples.
    """
    return mean(difference(run(one.frame, 0), run(one.frame, 1), one) / 2**0.5 for one in examples)


def difference(image: Any, other: Any, example: Example) -> float:
    """Root mean square difference where motion reaches, in 255ths of display values."""
    area = metrics.motion_footprint(example.frame)
    squares = np.square(np.asarray(metrics.display(image)) - np.asarray(metrics.display(other)))
    return float(255 * np.sqrt(squares[area].mean()))


def listed(values: dict[Any, float], digits: int = 1) -> str:
    """Values by what they belong to, as text: ``5: 1.2, 9: 3.4``."""
    return ", ".join(f"{key}: {value:.{digits}f}" for key, value in values.items())
