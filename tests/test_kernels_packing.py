"""Pixels and samples that native code leaves out, and vectors that it fills with others."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur.kernels import Image, Outcome, each_pixel, sum_over
from jaxblur.kernels.cpp import build
from tests.test_kernels_operations import BACKENDS, SIZE, Planes

pytestmark = pytest.mark.skipif(build.find_compiler() is None, reason="needs a C++ compiler")

OPERATIONS = str(Path(__file__).with_name("test_kernels_operations.py"))


def counting_program(at, images, _, __):
    (a,) = images.a.here()
    return Outcome((sum_over(9, lambda i: a + 0.0 * i, where=lambda i: (i < 3) | (a > 1)),))


def test_samples_that_do_not_count_for_a_pixel_are_left_out_of_values_alone():
    # Their terms should be 0; these are not, so that one sees how many were summed.
    def total(plane, backend="native"):
        images = Planes(Image(plane), Image(plane))
        return each_pixel(counting_program, SIZE, images, backend=backend)

    ones = jnp.ones((*SIZE, 1), jnp.float32)
    np.testing.assert_array_equal(total(ones), 3)
    np.testing.assert_array_equal(total(ones, "xla"), 9)
    # Each pixel has its own.
    mixed = np.asarray(total(ones.at[2, 1].set(2)))
    assert mixed[2, 1, 0] == 18 and (mixed == 3).sum() == mixed.size - 1
    _, change = jax.jvp(total, (ones,), (ones,))
    np.testing.assert_array_equal(change, 9)


def sparse_program(at, images, _, kind):
    """Some samples of some pixels, which read their own values and those beside them."""
    (a,) = images.a.here()
    table = images.t
    if kind == "otherwise":
        value = table.read_inside(at.row, table.width - 1 - at.column)[0]
        return Outcome((value * a, a + at.row), where=a > 1, otherwise=(a, -a))
    count = 70 if kind == "many samples" else 9

    def term(i):
        column = jnp.minimum(at.column + i, table.width - 1)
        value = table.read_inside(at.row, column)[0] * a
        return jnp.where(counts(i), value, 0), jnp.where(counts(i), 1.0, 0)

    def counts(i):
        return (at.column * 3 + at.row + i) % 4 == 0

    total, number = sum_over(count, term, where=counts if kind != "all samples" else None)
    return Outcome((total, number + at.row), where=a > 1)


@pytest.mark.parametrize("kept", [1, 2])
@pytest.mark.parametrize("kind", ["all samples", "some samples", "many samples", "otherwise"])
def test_pixels_among_others_that_do_not_move(kind, kept):
    """They are computed together with others of their kind, wherever these are."""
    random = np.random.default_rng(3)
    for width, share in [(1, 0.5), (15, 0.3), (16, 0.9), (70, 0.1), (70, 0.6), (131, 0.02)]:
        size = (11, width)
        values = np.where(random.random(size) < share, 2.0, 0.5) * random.uniform(0.9, 1.1, size)
        plane = jnp.asarray(values[..., None], jnp.float32)
        images = Planes(Image(plane), Image(plane[::-1]))
        old = None if kind == "otherwise" else jnp.concatenate([plane, 3 * plane], -1)[..., :kept]
        ours, theirs = (
            each_pixel(sparse_program, size, images, None, kind, kept=old, backend=backend)
            for backend in BACKENDS
        )
        np.testing.assert_allclose(ours, theirs, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="flags of x86")
@pytest.mark.parametrize("flags", ["-mno-avx512f", "-mno-avx512f -mno-avx2 -mno-avx"])
def test_narrower_vectors(flags, tmp_path):
    """The code for other processors, on this one."""
    more = {"JAXBLUR_KERNEL_FLAGS": f"-Og {flags}", "XDG_CACHE_HOME": str(tmp_path)}
    words = "mean_the_same or among_others or samples"
    options = ("-q", "-p", "no:cacheprovider", "-k", words, "-m", "not slow")
    command = [sys.executable, "-m", "pytest", *options, __file__, OPERATIONS]
    ran = subprocess.run(command, env=os.environ | more, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout[-2000:]
