"""Frames blurred without jax, by programs that a former run has compiled."""

import argparse
import dataclasses
import os
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxblur._util.programs import Program, keep_program, read_program
from jaxblur.cli import programs
from jaxblur.cli.choice import Choice
from jaxblur.filters import filter_info

from .command_line import spawn

DATA = Path(__file__).parent / "data"
CUBE = DATA / "cube_over_crates_frame_0011.exr"
BLUR = """
import sys
from jaxblur.cli import main
status = main(sys.argv[1:])
print("jax" in sys.modules)
sys.exit(status)
"""


def blurs(source, output, cache, *options):
    """Blur a frame in a process of its own; say whether it has imported jax."""
    environment = os.environ | {"XDG_CACHE_HOME": str(cache)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    arguments = ("blur", source, "-o", output, "--overwrite", *options)
    done = spawn(*arguments, code=BLUR, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1] == "True", done.stderr


def check_that_all_runs_agree(tmp_path, source, *options):
    plain, first, second = (tmp_path / f"{name}.exr" for name in ("plain", "first", "second"))
    assert blurs(source, plain, tmp_path, "--no-compile-cache", *options)[0]
    assert blurs(source, first, tmp_path, *options)[0]
    assert not blurs(source, second, tmp_path, *options)[0], "the second run has imported jax"
    assert plain.read_bytes() == first.read_bytes() == second.read_bytes()


@pytest.mark.slow
def test_a_second_run_needs_no_jax_and_writes_the_same_bytes(tmp_path):
    check_that_all_runs_agree(tmp_path, CUBE, "--filter", "pixel_velocity")
    kernels = tmp_path / "jaxblur" / "kernels"
    (program,) = kernels.glob("*.xla")
    assert program.stat().st_mode & 0o077 == 0
    # A program that is not as it was compiled is compiled again.
    program.write_bytes(program.read_bytes()[:-1])
    output = tmp_path / "third.exr"
    assert blurs(CUBE, output, tmp_path, "--filter", "pixel_velocity")[0]
    assert output.read_bytes() == (tmp_path / "first.exr").read_bytes()
    assert read_program(program) is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("falling_cubes", ()),
        ("falling_cubes", ("--filter", "guertin2014", "--param", "kappa=30", "--radius", "auto")),
        ("sky_car", ("--filter", "mcguire2012", "--backend", "xla")),
    ],
)
def test_the_bytes_are_those_of_jax_for_every_filter(tmp_path, name, options):
    check_that_all_runs_agree(tmp_path, DATA / f"{name}_frame_0011.exr", *options)


@pytest.mark.slow
def test_a_program_that_cannot_be_run_is_compiled_again_and_said(tmp_path):
    options = ("--filter", "pixel_velocity")
    first, second = tmp_path / "first.exr", tmp_path / "second.exr"
    blurs(CUBE, first, tmp_path, *options)
    (path,) = (tmp_path / "jaxblur" / "kernels").glob("*.xla")
    program = read_program(path)
    assert program is not None
    keep_program(path, program._replace(executable=b"of another jaxlib"))
    has_jax, said = blurs(CUBE, second, tmp_path, *options)
    assert has_jax and "cannot be run, and is compiled again" in said
    assert first.read_bytes() == second.read_bytes()


@pytest.fixture
def kept(tmp_path):
    """A program with one kernel, in a folder."""
    library = tmp_path / "kernel.so"
    keep_program(library, Program(b"", (), ()))
    path = tmp_path / "program.xla"
    keep_program(path, Program(b"machine\ncode", ("kernel",), (2, 3, 4)))
    return path


def test_a_program_is_read_as_it_was_kept(kept):
    assert read_program(kept) == Program(b"machine\ncode", ("kernel",), (2, 3, 4))


@pytest.mark.parametrize("name", ["kernel.so", "program.xla", "program.xla.sha256"])
def test_a_program_with_something_missing_or_damaged_is_not_read(kept, name):
    path = kept.with_name(name)
    contents = path.read_bytes()
    path.write_bytes(contents[:-1] + bytes([contents[-1] ^ 1]))
    assert read_program(kept) is None
    path.unlink()
    assert read_program(kept) is None


def test_a_program_that_others_can_write_is_not_read(kept):
    kept.chmod(0o666)
    assert read_program(kept) is None


PLAIN = {
    **dict.fromkeys(("no_compile_cache", "plan", "subframes", "seed")),
    "posts": (),
}


def plain_frame(origin: tuple[int, int] = (0, 0)) -> Any:
    windows = types.SimpleNamespace(origin=origin)
    buffers = types.SimpleNamespace(pass_colors=None, guide=None, windows=windows)
    absent = dict.fromkeys(("exposure", "lens", "truth", "disparity"))
    return types.SimpleNamespace(buffers=buffers, neighbors={}, layers=(), ranks=(), **absent)


@pytest.fixture
def serves(monkeypatch):
    """Whether a frame is served in a process that has not imported jax."""
    monkeypatch.delitem(sys.modules, "jax")
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    find = programs.importlib.util.find_spec
    monkeypatch.setattr(
        programs.importlib.util,
        "find_spec",
        lambda name: None if name == "jax_plugins" else find(name),
    )
    info = filter_info("layered")
    chosen = Choice(info.name, info.defaults, info.settings)

    def ask(arguments=None, loaded=None, choice=chosen):
        given = argparse.Namespace(**PLAIN | (arguments or {}))
        return programs.serves(given, choice, loaded or plain_frame())

    return ask


def test_the_plain_case_is_served(serves):
    assert serves()


def test_a_cropped_frame_is_not_served(serves):
    """Its noise starts elsewhere."""
    assert not serves(loaded=plain_frame((3, 0)))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("no_compile_cache", True), ("plan", "auto"), ("subframes", "s.####.exr")),
        *(("posts", ("fxaa",)), ("seed", 3)),
    ],
)
def test_options_that_need_jax_are_not_served(serves, name, value):
    assert not serves({name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("neighbors", {"before": None}), ("exposure", object()), ("layers", (1,))),
        *(("ranks", (1,)), ("truth", np.zeros(3)), ("lens", object())),
        ("disparity", np.zeros((2, 2))),
    ],
)
def test_frames_that_need_jax_are_not_served(serves, name, value):
    loaded = plain_frame()
    setattr(loaded, name, value)
    assert not serves(loaded=loaded)


def test_a_filter_from_elsewhere_is_not_served(serves, monkeypatch):
    own = dataclasses.replace(filter_info("layered"), function=lambda *_, **__: None)
    monkeypatch.setattr(programs, "filter_info", lambda name: own)
    assert not serves()


def test_another_device_is_not_served(serves, monkeypatch):
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    assert not serves()


def test_the_key_depends_on_filter_settings_sizes_and_variables(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    info = filter_info("layered")
    chosen = Choice(info.name, info.defaults, info.settings)
    fewer = dataclasses.replace(chosen, settings=dataclasses.replace(info.settings, samples=9))
    small, large = ({"color": np.zeros((n, 3, 3), np.float32)} for n in (2, 3))
    paths = [
        programs._path_of(chosen, small),
        programs._path_of(chosen, large),
        programs._path_of(fewer, small),
    ]
    assert programs._path_of(chosen, small) == paths[0]
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=true")
    paths.append(programs._path_of(chosen, small))
    assert len(set(paths)) == 4
