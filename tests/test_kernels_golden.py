"""Printed text of kernels, without a compiler; all passes of all filters have such text.

``python -m tests.test_kernels_golden`` writes the expected texts anew: read the difference before
you commit it.
"""

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import pytest

import jaxblur
from jaxblur.kernels import Image, Outcome, each_pixel, mark_over, recorded_passes, sum_over
from jaxblur.kernels.cpp import emit
from jaxblur.kernels.stages import Kind
from jaxblur.kernels.tracing import trace
from tests.helpers import random_frame

FOLDER = Path(__file__).parent / "data" / "kernels"
PARTS = ("ARGUMENTS", "MOVING", "PIXEL", "CHOICE", "SAMPLE", "TAP", "FINISH")


class Images(NamedTuple):
    color: Image
    speed: Image


def gather(at, images, weight, _):
    """A sum over samples that reads neighbors, for pixels that move."""
    (speed,) = images.speed.here()
    scaled = speed * weight

    def sample(i):
        column = jnp.clip(at.column + i, 0, images.color.width - 1)
        return [scaled * value for value in images.color.read_inside(at.row, column)]

    sums = sum_over(4, sample)
    own = images.color.here()
    return Outcome(tuple(s + o for s, o in zip(sums, own, strict=True)), where=speed > 0.5)


def loop(at, images, _, __):
    """A loop, a read in it, and the next element in memory after it."""
    index = at.row * images.color.width + at.column
    zero = images.speed.here()[0] * 0
    total = jax.lax.fori_loop(0, 3, lambda k, s: s + images.color.read_texel(index)[0], zero)
    return Outcome((total, images.color.read_texel(index)[1]))


def choice(at, images, _, __):
    """Results of pixels that meet a condition, and of the others."""
    (speed,) = images.speed.here()
    return Outcome((jnp.sqrt(speed),), where=speed > 1, otherwise=(-speed,))


def left_out(at, images, _, __):
    """A sum in which only some samples count."""
    (speed,) = images.speed.here()

    def counts(i):
        return speed > i

    def sample(i):
        return jnp.where(counts(i), images.color.read_inside(at.row, i)[0], 0)

    return Outcome((sum_over(3, sample, where=counts),), where=speed > 0)


def chains(at, images, _, __):
    """Places that are read, at places that are read, twice: the chains lie side by side."""

    def color_after_two_reads(column):
        (across,) = images.speed.read_inside(at.row, column)
        (across,) = images.speed.read_inside(at.row, across.astype(jnp.int32))
        return images.color.read_inside(at.row, across.astype(jnp.int32))[0]

    middle = at.column * 2
    return Outcome((color_after_two_reads(middle - 1) - color_after_two_reads(middle + 1),))


def marks(at, images, _, __):
    """A scatter-max."""
    (speed,) = images.speed.here()
    return Outcome(mark_over(speed, lambda i: ((at.column + i, at.row + 1),)), where=speed > 0)


OPERANDS = emit.Operands((Kind("float32", 2), Kind("float32", 1)), (Kind("float32", 2),), 4)


def stages_of(program, parameters=None):
    images = Images(Image(jnp.ones((2, 3, 2))), Image(jnp.ones((2, 3))))
    traced = trace(program, images, parameters, None)
    local = tuple(traced.kinds[k] for k in traced.local)
    tables = tuple(traced.kinds[k] for k in traced.tables)
    return traced.stages, emit.Operands(local, tables, 4)


def transpose():
    """The derivative of the samples of `gather` with respect to what they read."""
    stages, operands = stages_of(gather, jnp.float32(2))

    def sample(index, place, local, tables):
        assert stages.sample is not None
        return stages.sample(index, place, [value for (value,) in local], tables)

    prepared = emit.Operands((Kind("float32", 1),), operands.tables, 4)
    return emit.emit_pull(sample, None, 4, prepared, (0, 1), ("float32", "float32"))


KERNELS = {
    "gather": lambda: emit.emit_gather(*stages_of(gather, jnp.float32(2)), kept=2),
    "loop": lambda: emit.emit_gather(*stages_of(loop)),
    "choice": lambda: emit.emit_gather(*stages_of(choice)),
    "left_out": lambda: emit.emit_gather(*stages_of(left_out), kept=1),
    "chains": lambda: emit.emit_gather(*stages_of(chains)),
    "marks": lambda: emit.emit_marks(*stages_of(marks)),
    "transpose": transpose,
}


def text_of(name):
    parts = KERNELS[name]().parts
    return "\n".join(f"// {part}\n{parts[part]}".rstrip() for part in PARTS) + "\n"


@pytest.mark.parametrize("name", KERNELS)
def test_printed_text_is_as_expected(name):
    assert text_of(name) == (FOLDER / f"{name}.txt").read_text(encoding="utf-8")


def test_sizes_do_not_stand_in_the_text():
    def source(height, width):
        size = height, width
        images = Images(Image(jnp.ones((*size, 2))), Image(jnp.ones(size)))
        with recorded_passes() as passes:
            jax.eval_shape(
                lambda: each_pixel(
                    gather, size, images, jnp.float32(2), kept=jnp.ones((*size, 2)), backend="xla"
                )
            )
        return emit.emit_pass(passes[0]).source

    assert source(4, 7) == source(300, 11)


PASSES = {
    "guertin2014": ["clamp_motion", "_search_tile", "tile_velocity", "ring_velocity", "blur_pixel"],
    "mcguire2012": ["clamp_motion", "_search_tile", "tile_velocity", "ring_velocity", "blur_pixel"],
    "pixel_velocity": ["blur_pixel"],
    "layered": [
        "purest_motion",
        "path_of_pixel",
        "draw_pixel",
        "state_of_pixel",
        "background_of_pixel",
        "blur_pixel",
    ],
}


@pytest.mark.parametrize("name", PASSES)
def test_every_pass_of_every_filter_prints(name):
    info = jaxblur.filter_info(name)
    jax.clear_caches()
    with recorded_passes() as passes:
        jax.eval_shape(
            lambda frame: info.call(frame, info.make_parameters(), settings=info.settings),
            random_frame((11, 23)),
        )
    assert sorted(each.traced.name for each in passes) == sorted(PASSES[name])
    for each in passes:
        kernel = emit.emit_pass(each)
        assert "@NAME@" in kernel.source and "@TAP@" not in kernel.source


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for kernel_name in KERNELS:
        (FOLDER / f"{kernel_name}.txt").write_text(text_of(kernel_name), encoding="utf-8")
