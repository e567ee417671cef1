"""Kernels are found again under the key of their program, before they are printed."""

import functools
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur.kernels import Image, Outcome, cpp, each_pixel, sum_over
from jaxblur.kernels.cpp import build
from jaxblur.kernels.keys import Keyed, key_of, key_of_jaxpr
from jaxblur.kernels.tracing import trace
from tests.test_kernels_operations import Planes


def scaled(at, images, _, factor):
    (a,) = images.a.here()
    return Outcome((sum_over(3, lambda i: factor * a * i),))


def key_of_scaled(factor):
    plane = Image(jnp.ones((2, 3, 1)))
    return key_of(tuple(trace(scaled, Planes(plane, plane), None, factor).stages))


@jax.custom_jvp
def ruled(x):
    return 2 * x


ruled.defjvp(lambda primals, tangents: (2 * primals[0], 3 * tangents[0]))


def of_function(function):
    closed = jax.make_jaxpr(function)(jnp.float32(1))
    return key_of_jaxpr(closed.jaxpr, closed.consts)


def test_a_key_is_that_of_another_process():
    words = "from tests.test_kernels_keys import key_of_scaled as k; print(k(0.5))"
    environment = os.environ | {"JAX_PLATFORMS": "cpu", "PYTHONHASHSEED": "7"}
    done = subprocess.run(
        [sys.executable, "-c", words], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split()[-1] == key_of_scaled(0.5)


def test_programs_that_differ_have_keys_that_differ():
    array, other = (np.array(values, np.float32) for values in ([1, 2], [1, 3]))
    keys = [
        key_of_scaled(0.5),
        key_of_scaled(np.nextafter(np.float32(0.5), np.float32(1)).item()),
        of_function(lambda x: x * 2),
        of_function(lambda x: x + 2),
        of_function(lambda x: x.astype(jnp.int32)),
        of_function(lambda x: x.astype(jnp.int16)),
        of_function(lambda x: x * array),
        of_function(lambda x: x * other),
        of_function(lambda x: jax.lax.fori_loop(0, 3, lambda _, y: y * 2, x)),
        of_function(lambda x: jax.lax.fori_loop(0, 3, lambda _, y: y * 3, x)),
    ]
    assert None not in keys
    assert len(set(keys)) == len(keys)


def test_what_no_text_describes_has_no_key():
    assert of_function(ruled) is None, "the rule is a function"
    assert key_of(("gather", lambda x: x)) is None
    assert key_of(("gather", Keyed(abs, None))) is None
    assert key_of(("gather", None, Keyed(abs, "abs"))) is not None


@pytest.fixture
def new_process(monkeypatch, tmp_path):
    """A function that forgets what this process has printed and looked up."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(build, "_keeps_kernels", True)
    printed = []
    emit_gather = cpp.emit_gather.__wrapped__

    def emit(stages, *rest):
        printed.append(stages)
        return emit_gather(stages, *rest)

    monkeypatch.setattr(cpp, "emit_gather", emit)

    def forget():
        monkeypatch.setattr(build, "_register", functools.cache(build._register.__wrapped__))
        return printed

    return forget


def of_plane(factor):
    plane = Image(jnp.arange(6.0).reshape(2, 3, 1))
    return each_pixel(scaled, (2, 3), Planes(plane, plane), None, factor, backend="native")


@pytest.mark.skipif(build.find_compiler() is None, reason="needs a C++ compiler")
def test_a_kernel_that_is_known_is_not_printed(new_process, tmp_path):
    new_process()
    first = of_plane(0.625)
    printed = new_process()
    assert len(printed) == 1
    np.testing.assert_array_equal(of_plane(0.625), first)
    assert len(printed) == 1
    (record,) = (tmp_path / "jaxblur" / "kernels").glob("jaxblur_*.json")
    assert record.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize(
    "damage", ["no library", "no record", "torn record", "changed record", "open record"]
)
@pytest.mark.skipif(build.find_compiler() is None, reason="needs a C++ compiler")
def test_a_kernel_whose_files_are_not_whole_is_printed_again(new_process, tmp_path, damage):
    new_process()
    first = of_plane(0.875)
    folder = tmp_path / "jaxblur" / "kernels"
    (record,), (library,) = folder.glob("*.json"), folder.glob("*.so")
    if damage == "no library":
        library.unlink()
        build._loaded.discard(library.stem)
    elif damage == "no record":
        record.unlink()
    elif damage == "torn record":
        record.write_text(record.read_text()[:9])
    elif damage == "changed record":
        # The kernel would write over the end of its result.
        record.write_text(record.read_text().replace(", 1, ", ", 0, "))
    else:
        record.chmod(0o666)
    printed = new_process()
    with pytest.MonkeyPatch.context() as patch:
        if damage == "no library":
            # XLA accepts a name once in a process.
            patch.setattr(build.jax.ffi, "register_ffi_target", lambda *_, **__: None)
        np.testing.assert_array_equal(of_plane(0.875), first)
    assert len(printed) == 2
