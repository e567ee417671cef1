"""Printed text of a small filter in all languages, without a compiler.

``python -m tests.test_export_golden`` writes the expected texts anew: read the difference before
you commit it.
"""

import dataclasses
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import pytest

import jaxblur
from jaxblur.export import graph_of, sources_of
from jaxblur.filters.registry import FilterInfo
from jaxblur.kernels import Image, Outcome, each_pixel, largest_marks, mark_over, sum_over

from .helpers import registered

FOLDER = Path(__file__).parent / "data" / "export"
LANGUAGES = ("c", "wgsl", "hlsl", "glsl")


class Images(NamedTuple):
    """What the programs read."""

    color: Image
    speed: Image


def smear(at, images, numbers, _):
    """The mean of a few texels to the right, for pixels that move."""
    (speed,) = images.speed.here()
    reach = jnp.minimum(speed, numbers[0])

    def sample(i):
        column = jnp.clip(at.column + i, 0, images.color.width - 1)
        weight = jnp.where(i < reach, 1.0, 0.0)
        return [weight * value for value in images.color.read_inside(at.row, column)], weight

    colors, total = sum_over(4, sample)
    return Outcome(tuple(color / total for color in colors), where=speed > 0.5)


def draw(at, images, _, __):
    """Leaves the row of a pixel below it."""
    (speed,) = images.speed.here()
    below = jnp.minimum(at.row + 1, images.speed.height - 1)

    def mark(k):
        return ((below * images.speed.width + at.column, at.row + k),)

    return Outcome(mark_over(speed, mark), where=speed > 0)


@dataclasses.dataclass(frozen=True)
class Reach:
    """Parameters."""

    reach: float = jaxblur.parameter(3.0, above=0.0, meaning="longest smear", unit="px")


jax.tree_util.register_dataclass(Reach)


def smearing(frame, parameters, *, settings=None, noise=None):
    """A filter with arithmetic before its pass."""
    speed = jnp.abs(frame.velocity[..., :1])
    images = Images(Image(frame.color), Image(speed))
    size = frame.depth.shape
    return each_pixel(smear, size, images, (parameters.reach / 2,), kept=frame.color)


def drawing(frame, parameters, *, settings=None, noise=None):
    """A filter with a scatter-max."""
    height, width = frame.depth.shape
    images = Images(Image(frame.color), Image(frame.velocity[..., :1]))
    found = largest_marks(draw, (height, width), images, height * width)
    return found.reshape(height, width, 1).astype(jnp.float32)


def stamp(at, images, _, __):
    """Leaves its column in the row below."""
    (speed,) = images.speed.here()
    below = jnp.minimum(at.row + 1, images.speed.height - 1)

    def mark(k):
        return ((below * images.speed.width + at.column, jnp.where(k < 1, at.column, 0)),)

    return Outcome(mark_over(jnp.float32(1), mark), where=speed > 0)


def stamping(frame, parameters, *, settings=None, noise=None):
    """A filter with a scatter-max of a known number of marks, one."""
    height, width = frame.depth.shape
    images = Images(Image(frame.color), Image(frame.velocity[..., :1]))
    found = largest_marks(stamp, (height, width), images, height * width, apart=1)
    return found.reshape(height, width, 1).astype(jnp.float32)


INFOS = {
    "smearing": FilterInfo(name="golden", summary="a test", function=smearing, parameters=Reach),
    "drawing": FilterInfo(name="golden", summary="a test", function=drawing),
    "stamping": FilterInfo(name="golden", summary="a test", function=stamping),
}
CASES = [
    (name, language)
    for name in INFOS
    for language in LANGUAGES
    # Only a known number of marks has a form in GLSL.
    if (name == "stamping") == (language == "glsl") or name == "smearing"
]


def printed(name, language):
    """The text of all files of a filter."""
    with registered(INFOS[name]) as info:
        files = sources_of(graph_of(info, channels=2), language)
    return "".join(f"==== {file}\n{text}" for file, text in files.items())


@pytest.mark.parametrize(("name", "language"), CASES)
def test_the_text_is_the_expected_one(name, language):
    expected = (FOLDER / f"{name}_{language}.txt").read_text(encoding="utf-8")
    assert printed(name, language) == expected


def main():
    """Write the expected texts."""
    FOLDER.mkdir(exist_ok=True)
    for name, language in CASES:
        (FOLDER / f"{name}_{language}.txt").write_text(printed(name, language), encoding="utf-8")


if __name__ == "__main__":
    main()
