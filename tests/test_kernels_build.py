"""How kernels are compiled and kept."""

import concurrent.futures
import functools
import os
import pathlib
import shlex
import time

import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur._util.cache import checksum_file, is_intact
from jaxblur._util.compiler import Compiler
from jaxblur.kernels import Image, Outcome, each_pixel, sum_over
from jaxblur.kernels.cpp import build, emit
from jaxblur.kernels.tracing import trace
from tests.test_kernels_operations import Planes, sum_of

pytestmark = pytest.mark.skipif(build.find_compiler() is None, reason="needs a C++ compiler")


@pytest.fixture
def kept_in(monkeypatch, tmp_path):
    """The folder of caches of a user who keeps kernels; this process has registered none."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(build, "_keeps_kernels", True)
    monkeypatch.setattr(build, "_register", functools.cache(build._register.__wrapped__))
    return tmp_path


@pytest.fixture
def unregistered(monkeypatch):
    """XLA accepts a name once in a process; with this a test can come back to a program."""
    monkeypatch.setattr(build.jax.ffi, "register_ffi_target", lambda *_, **__: None)


def scaled_sum(at, images, _, count):
    (a,) = images.a.here()
    return Outcome((sum_over(count, lambda i: a * i),))


def tiny_program(count):
    """A kernel that no other test compiles."""
    plane = Image(jnp.ones((2, 3, 1)))
    stages = trace(scaled_sum, Planes(plane, plane), None, count).stages
    return emit.emit_gather(stages, emit.Operands.of([plane.values], 1, 4)).source


def named(path, flags=()):
    """A compiler that somebody has installed."""
    return Compiler((str(path),), flags, (str(path), "--version"))


def test_a_compiler_that_fails_is_reported_in_its_own_words(monkeypatch, tmp_path):
    broken = tmp_path / "c++"
    broken.write_text("#!/bin/sh\necho 'no such thing as vectors' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setattr(build, "find_compiler", lambda: named(broken))
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
    monkeypatch.setattr(build, "find_compiler", lambda: named(broken))
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
    assert words.endswith("error: no such name; XLA does the work, several times as slow")
    with pytest.raises(ValueError, match=r"'native', but .*error: no such name; use"):
        sum_of(one)


def test_kernels_are_made_once_and_kept_for_this_user_only(kept_in):
    source = tiny_program(102)
    with concurrent.futures.ThreadPoolExecutor(3) as pool:
        (name,) = set(pool.map(build.register, [source] * 3))
    folder = kept_in / "jaxblur" / "kernels"
    assert {path.name for path in folder.iterdir()} == {f"{name}.so", f"{name}.so.sha256"}
    for path in (folder.parent, folder, *folder.iterdir()):
        assert path.stat().st_mode & 0o077 == 0


def test_the_umask_does_not_open_the_folder(kept_in):
    before = os.umask(0)
    try:
        name = build.register(tiny_program(109))
    finally:
        os.umask(before)
    folder = kept_in / "jaxblur" / "kernels"
    for path in (folder.parent, folder, folder / f"{name}.so", folder / f"{name}.so.sha256"):
        assert path.stat().st_mode & 0o077 == 0


def library_of(kept_in, source):
    """Compile a program, then forget that this process did."""
    name = build.register(source)
    build._register.cache_clear()
    library = kept_in / "jaxblur" / "kernels" / f"{name}.so"
    # A file of its own: this process has mapped the other one.
    (copy := library.with_name("copy")).write_bytes(library.read_bytes())
    copy.chmod(0o700)
    copy.rename(library)
    return library


def truncated(library):
    library.write_bytes(library.read_bytes()[:3000])


def zeroed(library):
    library.write_bytes(bytes(library.stat().st_size))


def one_bit_flipped(library):
    data = bytearray(library.read_bytes())
    data[len(data) // 2] ^= 1
    library.write_bytes(data)


def without_checksum(library):
    checksum_file(library).unlink()


def checksum_of_no_text(library):
    checksum_file(library).write_bytes(b"\xff" * 64)


def writable_by_others(library):
    library.chmod(0o777)


def another_library_behind_a_link(library):
    other = library.with_name("other.so")
    library.rename(other)
    library.symlink_to(other)


def a_pipe(library):
    library.unlink()
    os.mkfifo(library)


@pytest.fixture
def compiled(kept_in, unregistered, one_library, monkeypatch):
    """Programs compiled; instead of the compiler's work there is always a copy of one library."""
    programs = []

    def copy(source, library):
        programs.append(source)
        (made := kept_in / "kernel.so").write_bytes(one_library[1])
        build._keep(made, library)

    monkeypatch.setattr(build, "_compile", copy)
    return programs


@pytest.fixture(scope="module")
def one_library():
    """A program, and its library's bytes."""
    source = tiny_program(114)
    key = build.register(source)
    return source, (build._folder() / f"{key}.so").read_bytes()


@pytest.mark.parametrize(
    "damage",
    [
        *(truncated, zeroed, one_bit_flipped, without_checksum, checksum_of_no_text),
        *(writable_by_others, another_library_behind_a_link, a_pipe),
    ],
)
def test_a_library_that_is_not_as_it_was_compiled_is_compiled_again(
    kept_in, compiled, one_library, damage
):
    source, _ = one_library
    library = library_of(kept_in, source)
    damage(library)
    assert build.register(source) == library.stem
    assert compiled == [source.replace("@NAME@", library.stem)] * 2
    assert is_intact(library)


def test_an_intact_library_is_not_compiled_again(kept_in, compiled, one_library):
    library_of(kept_in, one_library[0])
    build.register(one_library[0])
    assert len(compiled) == 1


def test_another_compiler_does_not_share_libraries(kept_in, unregistered, monkeypatch, tmp_path):
    build._machine.cache_clear()
    own = build.find_compiler()
    assert own is not None
    names = []
    for version in ("12.1", "12.2"):
        compiler = tmp_path / "c++"
        compiler.write_text(
            f'#!/bin/sh\n[ "$1" = --version ] && echo {version} && exit\n'
            f'exec {shlex.join(own.command)} "$@"\n'
        )
        compiler.chmod(0o755)
        with monkeypatch.context() as patch:
            patch.setattr(build, "find_compiler", functools.partial(named, compiler, own.flags))
            names.append(build.register(tiny_program(114)))
        build._register.cache_clear()
        build._machine.cache_clear()
    assert names[0] != names[1]


def is_running(process):
    try:
        status = pathlib.Path("/proc", process, "stat").read_text()
    except OSError:
        return False
    return status.rsplit(")", 1)[1].split()[0] != "Z"


def test_a_compiler_that_hangs_is_ended_and_not_asked_again(kept_in, monkeypatch, tmp_path):
    hanging = tmp_path / "c++"
    hanging.write_text(
        '#!/bin/sh\n[ "$1" = --version ] && exit\nsleep 99 &\necho $! >> $0.calls\nsleep 99\n'
    )
    hanging.chmod(0o755)
    monkeypatch.setattr(build, "find_compiler", lambda: named(hanging))
    monkeypatch.setattr(build, "TIME_LIMIT", 0.5)
    build.forget_failures()
    try:
        start = time.monotonic()
        for count in (110, 111):
            with pytest.raises(build.BuildFailed, match=r"took more than 0.5 s"):
                build.register(tiny_program(count))
        assert time.monotonic() - start < 20
        (child,) = (tmp_path / "c++.calls").read_text().split()
        assert not is_running(child), "a process of the compiler is left"
    finally:
        build.forget_failures()
        build._machine.cache_clear()


def test_what_a_killed_compilation_left_is_removed(kept_in, unregistered):
    folder = library_of(kept_in, tiny_program(114)).parent
    for name, age in (("old", build.LEFT_OVER + 100), ("recent", 10)):
        left = folder / f"{build.BUILDING}{name}"
        left.mkdir()
        (left / "kernel.cc").touch()
        os.utime(left, (time.time() - age, time.time() - age))
    build.register(tiny_program(112))
    assert [path.name for path in folder.iterdir() if path.is_dir()] == [f"{build.BUILDING}recent"]


def test_a_cache_folder_that_cannot_be_used_is_no_obstacle(kept_in, caplog):
    (kept_in / "jaxblur").write_text("a file where the folder should be")
    for count in (103, 113):
        assert build.register(tiny_program(count)).startswith("jaxblur_sum_")
    (warning,) = caplog.messages
    assert warning == (
        f"native code is not kept between runs: {kept_in / 'jaxblur'} is not a folder; remove it"
    )
    assert (kept_in / "jaxblur").read_text() == "a file where the folder should be"


def test_a_failure_is_remembered_for_its_program_alone(kept_in, monkeypatch):
    for _ in range(2):
        with pytest.raises(build.BuildFailed, match="error"):
            build.register("this is no program @NAME@")
    assert build.register(tiny_program(105)).startswith("jaxblur_sum_")


def test_a_second_size_compiles_nothing(kept_in, monkeypatch):
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


def test_compiling_is_said_once(kept_in, monkeypatch, caplog):
    monkeypatch.setattr(build, "_said", False)
    with caplog.at_level("INFO", logger="jaxblur"):
        for count in (107, 108):
            build.register(tiny_program(count))
    assert caplog.text.count("compiling native code") == 1
