"""``jaxblur export``: the folder that it writes, and what it refuses."""

import dataclasses
import json
import os
import re

import numpy as np
import pytest

import jaxblur
from jaxblur.export import package
from jaxblur.export.reference import SHARE, TOLERANCE

from .command_line import refused, run
from .ported import compile_c, run_library
from .test_fitting_result import RESULT


def files_in(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def check_port(folder, tmp_path):
    """Run an export in C on its own reference frame, and compare with what JAX gave for it."""
    reference, plan = folder / "reference", json.loads((folder / "plan.json").read_text())
    told = json.loads((reference / "reference.json").read_text())
    inputs = {
        name: np.fromfile(reference / f"{name}.bin", "<f4").reshape(shape)
        for name, shape in told["inputs"].items()
    }
    wanted = np.fromfile(reference / "blurred.bin", "<f4").reshape(told["expected"]["blurred"])
    name = f"jaxblur_{plan['filter']}"
    source, header = ((folder / f"{name}.{kind}").read_text() for kind in ("c", "h"))
    order = [buffer["name"] for buffer in plan["buffers"] if buffer["role"] == "input"]
    library = compile_c(name, source, header, tmp_path)
    found = run_library(library, name, [inputs[each] for each in order], wanted.shape)
    near = np.abs(found - wanted).max(axis=-1) <= told["tolerance"]
    assert near.mean() >= told["share_within_tolerance"]
    assert (told["tolerance"], told["share_within_tolerance"]) == (TOLERANCE, SHARE)
    assert np.abs(wanted - inputs["color"]).max() > 0.1


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """An export of mcguire2012 in C with a parameter and a setting of its own."""
    folder = tmp_path_factory.mktemp("export") / "port"
    options = ("--filter", "mcguire2012", "--language", "c", "--channels", 3)
    outcome = run("export", *options, "--param", "soft_z_extent=0.5", "--radius", 9, "-o", folder)
    assert outcome.status == 0, outcome
    assert outcome.out.split() == sorted(str(folder / name) for name in files_in(folder))
    return folder


def test_a_port_tests_itself_with_what_is_in_the_folder(exported, tmp_path):
    check_port(exported, tmp_path)


def test_noise_that_is_an_input_is_explained(exported, tmp_path):
    folder = tmp_path / "port"
    options = ("--filter", "pixel_velocity", "--noise", "halton", "--language", "wgsl")
    assert run("export", *options, "-o", folder).status == 0
    page = (folder / "README.md").read_text()
    assert "| 3 | `noise_tap` | 1 x float32 | height x width | input |" in page
    assert "`noise_tap` is 2 h(2) - 1" in page
    assert "radical inverse" not in (exported / "README.md").read_text()
    shape = (48, 64)
    given = np.fromfile(folder / "reference" / "noise_tap.bin", "<f4").reshape(shape)
    row, column = 5, 6
    digits = f"{64 * row + column:b}"[::-1]
    assert given[row, column] == 2 * int(digits, 2) / 2 ** len(digits) - 1


def test_the_reference_frame_as_exr_gives_the_expected_picture(exported, tmp_path):
    reference, blurred = exported / "reference", tmp_path / "blurred.exr"
    options = ("--filter", "mcguire2012", "--param", "soft_z_extent=0.5", "--radius", 9)
    outcome = run(
        *("blur", reference / "frame.exr", "-o", blurred, *options, "--shutter", 1, "--drop-extra")
    )
    assert outcome.status == 0, outcome
    found, wanted = (
        jaxblur.exr.read_image(path)[..., :3] for path in (blurred, reference / "expected.exr")
    )
    np.testing.assert_allclose(found, wanted, atol=2e-3)


def test_the_page_and_the_plan_name_everything(exported):
    page, plan = (
        (exported / "README.md").read_text(),
        json.loads((exported / "plan.json").read_text()),
    )
    assert [uniform["name"] for uniform in plan["uniforms"]] == ["height", "width", "soft_z_extent"]
    assert plan["uniforms"][2]["value"] == 0.5
    for buffer in plan["buffers"]:
        assert f"`{buffer['name']}`" in page
    for each in plan["passes"]:
        assert f"`{each['name']}`" in page
        assert each["does"].endswith(".") and "`" * 2 not in each["does"], each
    assert plan["hash"] in page and re.fullmatch(r"[0-9a-f]{64}", plan["hash"])
    assert "radius=9" in page


def test_the_hash_depends_on_parameters_and_settings(exported, tmp_path):
    hashes = set()
    for number, more in enumerate(((), ("--samples", 9), ("--param", "soft_z_extent=0.6"))):
        folder = tmp_path / str(number)
        options = ("--filter", "mcguire2012", "--language", "wgsl", *more)
        assert run("export", *options, "-o", folder).status == 0
        hashes.add(json.loads((folder / "plan.json").read_text())["hash"])
    assert len(hashes) == 3


def test_fitted_parameters_and_settings_are_exported(tmp_path):
    settings = {**RESULT.settings, "radius": 12}
    fitted = dataclasses.replace(RESULT, settings=settings)
    fitted.save(tmp_path / "fitted.toml")
    folder = tmp_path / "port"
    options = ("--parameters", tmp_path / "fitted.toml", "--language", "wgsl", "-o", folder)
    assert run("export", *options).status == 0
    plan = json.loads((folder / "plan.json").read_text())
    values = {u["name"]: u["value"] for u in plan["uniforms"] if "value" in u}
    assert plan["filter"] == RESULT.filter and values == pytest.approx(RESULT.parameters)
    assert "radius=12" in (folder / "README.md").read_text()


@pytest.mark.parametrize("language", ["wgsl", "glsl", "hlsl"])
def test_other_languages_are_written(language, tmp_path):
    folder = tmp_path / "port"
    options = ("--filter", "pixel_velocity", "--language", language, "-o", folder)
    assert run("export", *options).status == 0
    names = files_in(folder)
    expected = {
        "wgsl": ["jaxblur_pixel_velocity.wgsl"],
        "hlsl": ["jaxblur_pixel_velocity.hlsl"],
        "glsl": ["01_tap_noise.frag", "02_make_velocity.frag", "03_blur_pixel.frag"],
    }
    assert set(expected[language]) < set(names)
    assert {"README.md", "plan.json", "reference/blurred.bin", "reference/frame.exr"} <= set(names)


def test_errors_say_what_to_do(exported, tmp_path):
    c = ("export", "--language", "c", "-o")
    assert "is not empty; give a new folder, or pass --overwrite" in refused(*c, exported)
    other = tmp_path / "other"
    other.mkdir()
    (other / "notes.txt").write_text("mine")
    assert "holds no export" in refused(*c, other, "--overwrite")
    assert "is not a folder" in refused(*c, other / "notes.txt")
    assert "is that of a frame" in refused(*c, tmp_path / "new", "--radius", "auto")
    assert "--fetch must be nearest or bilinear" in refused(
        *c, tmp_path / "new", "--fetch", "blend"
    )
    line = refused(*c, tmp_path / "new", "--path", "--filter", "pixel_velocity")
    assert "--path: pixel_velocity does not read curved paths; leave it out." in line
    assert not (tmp_path / "new").exists()
    (other / "plan.json").write_text("[]")
    assert "holds no export (no plan.json with its files)" in refused(*c, other, "--overwrite")


def test_an_earlier_export_is_replaced(tmp_path):
    folder = tmp_path / "port"
    halton = ("--filter", "pixel_velocity", "--noise", "halton", "--language", "glsl")
    assert run("export", *halton, "-o", folder).status == 0
    first = json.loads((folder / "plan.json").read_text())
    assert first["files"] == files_in(folder)
    (folder / "mine.frag").write_text("mine")
    (folder / "reference" / "mine.txt").write_text("mine")
    options = ("--filter", "pixel_velocity", "--language", "wgsl", "--overwrite")
    assert run("export", *options, "-o", folder).status == 0
    second = json.loads((folder / "plan.json").read_text())
    assert second["hash"] != first["hash"]
    # What the first one alone had is gone: its shaders, and the noise of its frame.
    assert set(first["files"]) - set(second["files"]) >= {"reference/noise_tap.bin"}
    mine = {"mine.frag", "reference/mine.txt"}
    assert files_in(folder) == sorted(set(second["files"]) | mine)


def test_nothing_is_left_where_the_disk_refuses(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(package, "_write_reference", full)
    folder = tmp_path / "port"
    options = ("--filter", "pixel_velocity", "--language", "wgsl", "-o", folder)
    assert "No space left on device" in refused("export", *options)
    assert os.listdir(tmp_path) == []
