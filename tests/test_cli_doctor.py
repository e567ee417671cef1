"""``jaxblur doctor``: its report of a working installation, and of broken ones."""

import importlib
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import jaxblur
from jaxblur._util import compiler
from jaxblur.cli.commands import doctor

from .command_line import run

HAS_COMPILER = compiler.find_compiler() is not None


@pytest.fixture(autouse=True)
def small(monkeypatch, tmp_path):
    """A test frame that compiles fast, and a cache of the test's own."""
    monkeypatch.setattr(doctor, "FILTER", "pixel_velocity")
    monkeypatch.setattr(doctor, "WIDTH", 48)
    monkeypatch.setattr(doctor, "HEIGHT", 32)
    monkeypatch.setattr(doctor, "SQUARE", 8)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


def found(status):
    """What the command finds, and what it says on stderr."""
    outcome = run("doctor", "--json")
    assert outcome.status == status, outcome.err
    return json.loads(outcome.out), outcome.err


def test_it_says_what_is_installed_and_blurs_a_frame(small):
    report, said = found(0)
    assert report["jaxblur"]["version"] == jaxblur.__version__
    assert report["packages"]["numpy"] == np.__version__
    assert re.fullmatch(r"3[.][0-9.]+", report["packages"]["OpenEXR"])
    assert report["cache"]["folder"] == str(small / "jaxblur")
    assert report["cache"]["refused"] is None
    assert report["devices"]
    backends = ["native", "xla"] if HAS_COMPILER else ["xla"]
    assert list(report["test"]) == backends and report["backend"] == backends[0]
    assert all(seconds > 0 for times in report["test"].values() for seconds in times.values())
    assert report["problems"] == []
    assert "error" not in said


def test_the_text_names_everything(small):
    for name, size in (("kernels/jaxblur_sum_1.so", 2_000_000), ("jit_1-cache", 1_000_000)):
        (small / "jaxblur" / "kernels").mkdir(parents=True, exist_ok=True, mode=0o700)
        (small / "jaxblur" / name).write_bytes(bytes(size))
    lines = run("doctor").out.splitlines()
    rows = {line[:16].strip(): line[16:] for line in lines}
    assert rows["jaxblur"].startswith(f"{jaxblur.__version__} in ")
    assert rows["cache"].endswith("1 kernels, 2.0 MB; 1 programs of XLA, 1.0 MB")
    assert " (used): 1 kernels" in rows["cache"]
    assert ", OpenEXR inside OpenImageIO 3." in rows["packages"]
    assert {"Python", "system", "packages", "compiler", "devices", "browser"} <= set(rows)
    assert {f"extra {name}" for name in doctor.EXTRAS} <= set(rows)
    assert "pixel_velocity, 48x32" in rows["xla test"]


def test_a_missing_extra_comes_with_its_remedy(monkeypatch):
    monkeypatch.setitem(doctor.EXTRAS, "plot", ("numpy", "no-such-package"))
    assert found(0)[0]["extras"]["plot"] == {"numpy": np.__version__, "no-such-package": None}
    row = doctor._text_of_extra("plot", {"numpy": "2", "no-such-package": None})
    assert row == 'missing: no-such-package; pip install "jaxblur[plot]"'


def test_a_cache_that_cannot_be_used_is_a_remark(small):
    (small / "jaxblur").write_text("a file where the folder should be")
    report, said = found(0)
    assert report["cache"]["refused"] == f"{small / 'jaxblur'} is not a folder; remove it"
    assert "warning: compiled code is not kept between runs" in said


def test_a_missing_compiler_is_a_remark_that_names_the_remedy(monkeypatch):
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    report, said = found(0)
    assert list(report["test"]) == ["xla"] and report["backend"] == "xla"
    assert report["compiler"] is None
    assert 'pip install "jaxblur[compiler]"' in said


@pytest.mark.skipif(not compiler.loads_kernels(), reason="needs a system that loads kernels")
def test_a_compiler_that_fails_is_a_problem(tmp_path):
    broken = tmp_path / "c++"
    broken.write_text("#!/bin/sh\necho 'error: no license' >&2\nexit 1\n")
    broken.chmod(0o755)
    # A process of its own, since this one may have compiled the kernels.
    script = (
        "from jaxblur.cli import main\nfrom jaxblur.cli.commands import doctor\n"
        "doctor.FILTER, doctor.WIDTH, doctor.HEIGHT = 'pixel_velocity', 48, 32\n"
        "doctor.SQUARE = 8\nraise SystemExit(main(['doctor', '--json']))\n"
    )
    outcome = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | {"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert outcome.returncode == 1, outcome.stderr
    report = json.loads(outcome.stdout)
    assert "no license" in report["problems"][0]
    assert list(report["test"]) == ["xla"] and report["backend"] == "xla"
    assert "error: native: the test frame cannot be blurred" in outcome.stderr


def test_a_package_that_cannot_be_imported_is_a_problem(monkeypatch):
    def importing(name):
        if name == "jaxlib":
            raise ImportError("no such library: libfoo.so")
        return imported(name)

    imported = importlib.import_module
    monkeypatch.setattr(doctor.importlib, "import_module", importing)
    report, said = found(1)
    assert report["test"] == {} and report["packages"]["numpy"] == np.__version__
    assert "libfoo.so; pip install --force-reinstall jaxlib" in said


def test_a_device_that_is_missing_is_a_problem(monkeypatch):
    def devices():
        raise RuntimeError("no backend cuda")

    monkeypatch.setattr(doctor, "_devices", devices)
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    assert found(1)[0]["problems"] == [
        "jax cannot be used: no backend cuda; JAX_PLATFORMS is 'cuda', unset it"
    ]


@pytest.mark.parametrize(
    ("native", "words"),
    [(np.ones((9, 9)), "native and xla differ"), (np.full((9, 9), np.nan), "is not finite")],
)
def test_a_wrong_result_is_a_problem(monkeypatch, native, words):
    images = {"native": native, "xla": np.zeros((9, 9))}
    monkeypatch.setattr(doctor, "_timed_blur", lambda backend: (images[backend], {}))
    problems = []
    doctor._blur_test_frame(True, problems)
    assert any(words in problem for problem in problems)


def test_the_extras_are_those_of_the_project():
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    extras = tomllib.loads(text)["project"]["optional-dependencies"]

    def packages(extra):
        for requirement in extras[extra]:
            other = re.fullmatch(r"jaxblur\[(.*)\]", requirement)
            if other:
                yield from packages(other[1])
            else:
                yield re.split("[><=]", requirement)[0]

    expected = {name: tuple(packages(name)) for name in extras if name not in NOT_LISTED}
    assert doctor.EXTRAS == expected


NOT_LISTED = ("cuda12", "cuda13", "dev")
"""Devices are listed by themselves; `dev` is all of the others, and what the tests need."""
