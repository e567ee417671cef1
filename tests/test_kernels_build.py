"""How kernels are compiled and kept."""

import concurrent.futures
import os

import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur.kernels import Image, Outcome, each_pixel, sum_over
from jaxblur.kernels.cpp import build, emit
from jaxblur.kernels.tracing import trace
from tests.test_kernels_operations import Planes, sum_of

pytestmark = pytest.mark.skipif(build.find_compiler() is None, reason="needs a C++ compiler")


def scaled_sum(at, images, _, count):
    (a,) = images.a.here()
    return Outcome((sum_over(count, lambda i: a * i),))


def tiny_program(count):
    """A kernel that no other test compiles."""
    plane = Image(jnp.ones((2, 3, 1)))
    stages = trace(scaled_sum, Planes(plane, plane), None, count).stages
    return emit.emit_gather(stages, emit.Operands.of([plane.values], 1, 4)).source


def test_a_compiler_that_fails_is_reported_in_its_own_words(monkeypatch, tmp_path):
    broken = tmp_path / "c++"
    broken.write_text("#!/bin/sh\necho 'no such thing as vectors' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setattr(build, "find_compiler", lambda: str(broken))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(build, "_keeps_kernels", True)
    build.forget_failures()
    with pytest.raises(build.BuildFailed, match="no such thing as vectors"):
        build.register(tiny_program(101))
    assert list((tmp_path / "jaxblur" / "kernels").iterdir()) == []


def test_a_compiler_that_fails_is_asked_once_a_kernel_and_warned_of_once(
    monkeypatch, tmp_path, caplog
):
    broken = tmp_path / "c++"
    broken.write_text(
        "#!/bin/sh\necho x >> $0.calls\necho 'kernel.cc: In function' >&2\n"
        "echo 'kernel.cc:1: error: no such name' >&2\nexit 1\n"
    )
    broken.chmod(0o755)
    monkeypatch.setattr(build, "find_compiler", lambda: str(broken))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(build, "_keeps_kernels", True)
    build.forget_failures()

    def one(i, a, t, p):  # Kernels that no other test compiles.
        return a * 101 + i

    def other(i, a, t, p):
        return a * 103 + i

    np.testing.assert_array_equal(sum_of(one, backend="auto"), sum_of(one, backend="xla"))
    calls = (tmp_path / "c++.calls").read_text().splitlines()
    assert calls and len(calls) % len(build.MACHINE_FLAGS) == 0
    sum_of(one, backend="auto")
    assert (tmp_path / "c++.calls").read_text().splitlines() == calls, "a kernel is tried once"
    sum_of(other, backend="auto")
    assert len((tmp_path / "c++.calls").read_text().splitlines()) > len(calls)
    (warning,) = [record for record in caplog.records if record.levelname == "WARNING"]
    words = warning.getMessage()
    assert words.endswith("error: no such name; XLA does its work, several times as slow")
    with pytest.raises(ValueError, match=r"'native', but .*error: no such name; use"):
        sum_of(one)


def test_kernels_are_made_once_and_kept_for_this_user_only(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(build, "_keeps_kernels", True)
    source = tiny_program(102)
    with concurrent.futures.ThreadPoolExecutor(3) as pool:
        names = set(pool.map(build.register, [source] * 3))
    folder = tmp_path / "jaxblur" / "kernels"
    assert [path.name for path in folder.iterdir()] == [f"{name}.so" for name in names]
    assert folder.stat().st_mode & 0o077 == 0


def test_the_oldest_kernels_go_first(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(build, "_keeps_kernels", True)
    monkeypatch.setattr(build, "MOST_KERNELS", 2)
    folder = tmp_path / "jaxblur" / "kernels"
    folder.mkdir(parents=True, mode=0o700)
    for age, name in enumerate(("new", "old", "oldest")):
        (folder / f"{name}.so").touch()
        os.utime(folder / f"{name}.so", (0, 1000 - age))
    # What another process removes meanwhile has no age.
    (folder / "gone.so").symlink_to(folder / "nowhere")
    name = build.register(tiny_program(104))
    assert sorted(path.stem for path in folder.iterdir()) == sorted([name, "new"])


def test_a_cache_folder_that_cannot_be_used_is_no_obstacle(monkeypatch, tmp_path):
    (tmp_path / "jaxblur").write_text("a file where the folder should be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(build, "_keeps_kernels", True)
    assert build.register(tiny_program(103)).startswith("jaxblur_sum_")


def test_a_failure_is_remembered_for_its_program_alone(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(build, "_keeps_kernels", True)
    for _ in range(2):
        with pytest.raises(build.BuildFailed, match="error"):
            build.register("this is no program @NAME@")
    assert build.register(tiny_program(105)).startswith("jaxblur_sum_")


def test_a_second_size_compiles_nothing(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(build, "_keeps_kernels", True)
    compiled = []
    compile_ = build._compile
    monkeypatch.setattr(
        build, "_compile", lambda *arguments: (compiled.append(1), compile_(*arguments))
    )

    def blur(height, width):
        plane = Image(jnp.ones((height, width, 1)))
        planes = Planes(plane, plane)
        return each_pixel(scaled_sum, (height, width), planes, None, 106, backend="native")

    for size in ((5, 19), (7, 300), (1, 1)):
        np.testing.assert_array_equal(blur(*size), 106 * 105 / 2)
    assert len(compiled) == 1


def test_compiling_is_said_once(monkeypatch, tmp_path, caplog):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(build, "_keeps_kernels", True)
    monkeypatch.setattr(build, "_said", False)
    with caplog.at_level("INFO", logger="jaxblur"):
        for count in (107, 108):
            build.register(tiny_program(count))
    assert caplog.text.count("compiling native code") == 1
