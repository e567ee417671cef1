"""The Nuke extension outside of Nuke: its Python with stand-ins for the modules of Nuke."""

import importlib
import os
import re
import sys
import tempfile
import types
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

import jaxblur
from jaxblur.integrate.shared.command import FILTERS, POSITIONS
from jaxblur.integrate.shared.frames import Frames

from .command_line import refused, run

ROOT = Path(__file__).parents[1]
COPYING = """
import pathlib, shutil, sys
sharp, blurred = sys.argv[2], sys.argv[4]
pathlib.Path(sys.argv[0]).with_suffix(".log").write_text("|".join(sys.argv[1:]))
first, last = next(a for a in sys.argv if a.startswith("--frames="))[9:].split("-")
for number in range(int(first), int(last) + 1):
    shutil.copy(sharp % number, blurred % number)
    print(f"jaxblur: warning: frame {number}: dark", file=sys.stderr)
"""


class Knob:
    """A knob, of a node or of a panel."""

    def __init__(self, value: object = ""):
        self.stored, self.executed = value, 0

    def value(self):
        return self.stored

    evaluate = value

    def setValue(self, value):
        self.stored = value

    def execute(self):
        self.executed += 1


class Node(dict):
    """A node: knobs by name, channels, nodes inside."""

    def __init__(self, kind="", channels=(), inside=None, **values):
        super().__init__({name: Knob(value) for name, value in values.items()})
        self.kind, self.seen, self.inside = kind, list(channels), inside or {}

    def name(self):
        return "Blur1"

    def Class(self):
        return self.kind

    def channels(self):
        return self.seen

    def node(self, name):
        return self.inside[name]


class Task:
    """A bar of progress; ``cancel_at`` looks later it is cancelled."""

    cancel_at = -1

    def __init__(self, title):
        self.looks = 0

    def setMessage(self, text):
        assert re.fullmatch(r"\d+ of \d+ frames", text)

    def setProgress(self, share):
        assert 0 <= share <= 100

    def isCancelled(self):
        self.looks += 1
        return self.looks == self.cancel_at


class Panel:
    """The panel of Nuke: a dialog that is answered with yes."""

    def __init__(self, title):
        self.title, self.knobs = title, []

    def addKnob(self, knob):
        self.knobs.append(knob)

    def showModalDialog(self):
        return True


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("nuke") / "plugin"
    outcome = run("integrate", "nuke", "-o", folder, "--executable", "/nowhere/jaxblur")
    assert outcome.status == 0
    assert outcome.out.splitlines()[:3] == [
        str(folder / name) for name in ("README.md", "jaxblur.gizmo", "menu.py")
    ]
    return folder


@pytest.fixture
def nuke(folder, monkeypatch):
    """The module `nuke`, and what it was told."""
    module, scripts = types.ModuleType("nuke"), types.ModuleType("nukescripts")
    said: list[str] = []
    made: list[dict[str, object]] = []
    values = {
        **{"GUI": True, "message": said.append, "warning": said.append, "ProgressTask": Task},
        **{"said": said, "made": made, "selectedNodes": list},
        "nodes": types.SimpleNamespace(Read=lambda **knobs: made.append(knobs)),
    }
    for kind in ("File", "Int", "Double", "String"):
        values[f"{kind}_Knob"] = lambda name, label: Knob()
    values["Enumeration_Knob"] = lambda name, label, choices: Knob(choices[0])
    vars(module).update(values)
    vars(scripts).update(PythonPanel=Panel)
    monkeypatch.setitem(sys.modules, "nuke", module)
    monkeypatch.setitem(sys.modules, "nukescripts", scripts)
    monkeypatch.syspath_prepend(folder)
    yield module
    for name in [name for name in sys.modules if name.split(".")[0] == "jaxblur_nuke"]:
        del sys.modules[name]


@pytest.fixture
def extension(nuke):
    return importlib.import_module("jaxblur_nuke")


def program(folder, code=COPYING):
    path = folder / "command"
    path.write_text(f"#!{sys.executable}\n{code}\n")
    path.chmod(0o755)
    return path


def gizmo(command, folder="", channels=("rgba.red", "forward.u"), first=3, last=5, **changes):
    """The gizmo as its file makes it."""
    inside = {"Sharp": Node("Write"), "Blurred": Node("Read", reload=None)}
    values = {
        **{"filter": "layered", "shutter": 0.5, "position": "start", "samples": 9, "options": ""},
        **{"first": first, "last": last, "folder": str(folder), "command": str(command)},
        **{"sharp": "", "result": "", "show": False},
    }
    return Node("Gizmo", channels, inside, **values | changes)


def writes(node, make=None):
    """A stand-in for ``nuke.execute``."""

    def execute(write, first, last, step):
        assert write is node.node("Sharp") and step == 1
        for number in range(first, last + 1):
            path = Path(node["sharp"].value() % number)
            path.write_text(str(number)) if make is None else make(path, number)

    return execute


def test_the_button_blurs_the_input(extension, nuke, tmp_path):
    node = gizmo(program(tmp_path), tmp_path / "out")
    nuke.execute = writes(node)
    extension.blur(node)
    assert nuke.said == [f"jaxblur: frame {number}: dark" for number in (3, 4, 5)]
    assert [(tmp_path / f"out/Blur1.{number:04d}.exr").read_text() for number in (3, 4, 5)] == [
        *"345"
    ]
    given = (tmp_path / "command.log").read_text().split("|")
    assert given[:4] == ["blur", node["sharp"].value(), "-o", node["result"].value()]
    assert given[4:] == [
        *("--shutter=0.5frames", "--filter=layered", "--samples=9", "--shutter-position=start"),
        *("--frames=3-5", "--overwrite", "--preset", "nuke"),
    ]
    assert node["show"].value() is True
    assert node.node("Blurred")["reload"].executed == 1
    assert not os.path.exists(os.path.dirname(node["sharp"].value()))


def test_results_have_a_folder_of_their_own_where_none_is_named(
    extension, nuke, tmp_path, monkeypatch
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    nodes = [gizmo(program(tmp_path), first=1, last=2) for _ in range(2)]
    for node in nodes:
        nuke.execute = writes(node)
        extension.blur(node)
    folders = {os.path.dirname(node["result"].value()) for node in nodes}
    assert len(folders) == 2 and all(os.path.isdir(folder) for folder in folders)


@pytest.mark.parametrize(
    ("code", "changes", "message"),
    [
        (COPYING, {"channels": ["rgba.red"]}, "neither the layer forward nor backward"),
        (COPYING, {"last": 1}, "the last frame, 1, is before the first, 3"),
        ("", {}, "was not written; is the command really jaxblur?"),
        ("import sys; sys.exit('jaxblur: error: no depth')", {}, "no depth"),
        (COPYING, {"command": "/nowhere/mine"}, "/nowhere/mine: no such command"),
        (COPYING, {"options": "--layer 'a"}, "No closing quotation"),
    ],
)
def test_errors_are_shown(extension, nuke, tmp_path, code, changes, message):
    node = gizmo(**{"command": program(tmp_path, code), "folder": tmp_path, **changes})
    nuke.execute = writes(node)
    extension.blur(node)
    assert message in nuke.said[-1] and node["show"].value() is False
    nuke.GUI = False
    with pytest.raises(RuntimeError, match=re.escape(message)):
        extension.blur(node)


def test_it_can_be_cancelled(extension, nuke, tmp_path, monkeypatch):
    node = gizmo(program(tmp_path, "import time; time.sleep(60)"), tmp_path)
    nuke.execute = writes(node)
    monkeypatch.setattr(Task, "cancel_at", 2)
    extension.blur(node)
    assert nuke.said == [] and node["show"].value() is False


def test_the_panel_blurs_the_files_of_a_read(extension, nuke, tmp_path, monkeypatch):
    for number in (1, 2):
        (tmp_path / f"a.{number:04d}.exr").write_text(str(number))
    file = str(tmp_path / "a.%04d.exr")
    nuke.selectedNodes = lambda: [Node("Read", file=file, first=1, last=2)]
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    program(tmp_path).rename(tmp_path / "jaxblur")
    extension.show_panel()
    assert nuke.made == [{"file": str(tmp_path / "blurred/a.%04d.exr"), "first": 1, "last": 2}]
    assert (tmp_path / "blurred/a.0002.exr").read_text() == "2"
    assert "--radius|auto" in (tmp_path / "jaxblur.log").read_text()
    nuke.selectedNodes = list
    extension.show_panel()
    assert nuke.said[-1] == "jaxblur: : no such frames from 1 to 1."


def test_names_of_nuke_are_understood(extension, tmp_path):
    panel = importlib.import_module("jaxblur_nuke.nuke.panel")
    (tmp_path / "a.0003.exr").touch()
    for names in ("a.%04d.exr", "a.####.exr"):
        found = panel.frames_of(str(tmp_path / names), 1, 9)
        assert (found.names, found.numbers) == (str(tmp_path / "a.%04d.exr"), (3,))
    still = panel.frames_of(str(tmp_path / "a.0003.exr"), 1, 9)
    assert (still.names, still.digits) == (str(tmp_path / "a.0003.exr"), 0)


def test_the_menu_offers_both(folder, nuke):
    commands = {}
    menu = types.SimpleNamespace(addCommand=lambda name, code: commands.update({name: code}))
    nuke.menu = lambda name: types.SimpleNamespace(addMenu=lambda name: menu)
    exec((folder / "menu.py").read_text(), {})
    assert commands["Motion blur (jaxblur)"] == "nuke.createNode('jaxblur')"
    assert "jaxblur_nuke.show_panel()" in commands["Motion blur of files (jaxblur)"]


def test_the_gizmo_has_the_knobs_that_its_button_reads(folder):
    text = (folder / "jaxblur.gizmo").read_text()
    assert text.count("{") == text.count("}")
    knobs = set(re.findall(r"addUserKnob \{\d+ (\w+)", text))
    assert set(gizmo("").keys()) < knobs
    for name, choices in (("filter", FILTERS), ("position", POSITIONS)):
        assert f"M {{{' '.join(choices)}}}" in next(
            line for line in text.splitlines() if f"addUserKnob {{4 {name} " in line
        )
    for name in re.findall(r"parent\.(\w+)", text):
        assert name in knobs
    assert {"Sharp", "Blurred"} < set(re.findall(r"^  name (\w+)", text, re.MULTILINE))


def test_files_are_not_replaced_unasked(folder):
    assert "README.md: exists; pass --overwrite" in refused("integrate", "nuke", "-o", folder)


@pytest.mark.slow
def test_the_command_takes_the_channels_that_the_gizmo_writes(extension, nuke, tmp_path):
    rng = np.random.default_rng(0)
    layers = ("forward.u", "forward.v", "backward.u", "backward.v", "depth.Z")
    names = ("R", "G", "B", "A", *layers)

    def make(path, number):
        pixels = rng.uniform(0.1, 1.0, (32, 48, len(names))).astype(np.float32)
        pixels[..., 4:8] = (8.0, 0.0, -8.0, 0.0)
        spec = oiio.ImageSpec(48, 32, len(names), "float")
        spec.channelnames = names
        output = oiio.ImageOutput.create(str(path))
        assert output is not None and output.open(str(path), spec)
        output.write_image(pixels)
        output.close()
        make.sharp = pixels

    command = tmp_path / "jaxblur"
    command.write_text(f'#!/bin/sh\nPYTHONPATH="{ROOT}" exec "{sys.executable}" -m jaxblur "$@"\n')
    command.chmod(0o755)
    node = gizmo(command, tmp_path / "out", first=1, last=1, position="center")
    node["filter"].setValue("pixel_velocity")
    nuke.execute = writes(node, make)
    extension.blur(node)
    result = Frames(str(tmp_path / "out/Blur1."), 4, ".exr", (1,))
    assert node["result"].value() == result.names, nuke.said
    blurred = jaxblur.exr.read_image(result.paths()[0])
    assert blurred[..., :3].std() < 0.8 * make.sharp[..., :3].std()
