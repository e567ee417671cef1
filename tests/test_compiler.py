"""Which C++ compiler compiles kernels, and the one of the package ziglang."""

import json
import os
import subprocess
import sys
import textwrap
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from jaxblur._util import compiler
from jaxblur.kernels.cpp import build

REPOSITORY = Path(__file__).parents[1]


def executable(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("#!/bin/sh\n")
    path.chmod(0o755)
    return path


@pytest.fixture
def choose(monkeypatch, tmp_path):
    """The choice, where `PATH` holds nothing and the newest package ziglang is in a folder."""
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.syspath_prepend(tmp_path)
    return compiler.find_compiler.__wrapped__


def ziglang(tmp_path):
    """Install a package."""
    executable(tmp_path / "ziglang" / "__init__.py")
    return executable(tmp_path / "ziglang" / "zig")


def test_ziglang_is_found_by_itself(choose, tmp_path):
    zig = ziglang(tmp_path)
    found = choose()
    assert found.command == (str(zig), "c++")
    assert found.version == (str(zig), "version")
    assert "-nostdlib" in found.flags


@pytest.mark.parametrize("name", ["c++", "g++", "clang++"])
def test_a_compiler_on_the_path_comes_before_ziglang(choose, tmp_path, name):
    ziglang(tmp_path)
    path = str(executable(tmp_path / "bin" / name))
    assert choose() == ((path,), (), (path, "--version"))


def test_a_package_without_its_program_is_no_compiler(choose, tmp_path):
    ziglang(tmp_path).unlink()
    assert choose() is None


def test_there_may_be_no_compiler(choose, monkeypatch):
    monkeypatch.setattr(compiler.importlib.util, "find_spec", lambda name: None)
    assert choose() is None


def test_where_kernels_cannot_be_loaded_no_compiler_is_looked_for(choose, monkeypatch, tmp_path):
    ziglang(tmp_path)
    monkeypatch.setattr(compiler.platform, "system", lambda: "Windows")
    assert choose() is None


BLUR = """
    import json, logging, sys
    import numpy as np
    import jaxblur
    from jaxblur.kernels.cpp import build

    logging.basicConfig(level="INFO", format="%(message)s", stream=sys.stderr)
    generator = np.random.default_rng(0)
    frame = jaxblur.Frame(
        color=generator.random((32, 48, 3), np.float32),
        depth=generator.uniform(1, 9, (32, 48)).astype(np.float32),
        velocity=generator.uniform(-8, 8, (32, 48, 2)).astype(np.float32),
    )
    results = {}
    for backend in ("native", "xla"):
        settings = jaxblur.GuertinSettings(samples=9, radius=20, backend=backend)
        blurred = jaxblur.guertin2014(frame, jaxblur.GuertinParameters(), settings=settings)
        results[backend] = np.asarray(blurred).tolist()
    json.dump({"compiler": build.find_compiler().command, **results}, sys.stdout)
"""


@pytest.mark.slow
def test_ziglang_compiles_kernels_that_agree_with_xla(tmp_path):
    if not compiler.loads_kernels() or find_spec("ziglang") is None:
        pytest.skip("needs ziglang: pip install ziglang")
    environment = os.environ | {
        "PATH": str(tmp_path / "no_compilers"),
        "XDG_CACHE_HOME": str(tmp_path),
        "HOME": str(tmp_path / "home"),
        # In what Clang compiles for debugging, it adds checks that need a library.
        build.MORE_FLAGS: "",
    }
    runs = []
    for _ in range(2):
        command = [sys.executable, "-c", textwrap.dedent(BLUR)]
        done = subprocess.run(
            command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=True
        )
        runs.append((json.loads(done.stdout), "compiling native code" in done.stderr))
    (first, compiled), (second, compiled_again) = runs
    assert compiled and not compiled_again, "the second run takes the kernels from the cache"
    assert first == second
    assert first["compiler"][1] == "c++" and Path(first["compiler"][0]).name == "zig"
    difference = np.abs(np.subtract(first["native"], first["xla"]))
    assert np.mean(difference < 1e-5) > 0.99

    kernels = tmp_path / "jaxblur" / "kernels"
    libraries = list(kernels.glob("*.so"))
    assert libraries
    for path in libraries:
        # 1.5 MB with a C++ library linked in.
        assert path.stat().st_size < 100_000
        assert path.stat().st_mode & 0o077 == 0
        assert path.with_name(f"{path.name}.sha256").exists()
    assert {path.suffix for path in kernels.iterdir()} == {".so", ".sha256", ".json"}
    assert not (tmp_path / "home").exists(), "ziglang keeps nothing elsewhere"
