"""Which module may import which: the layers, the independence of the judges, a light start."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import jaxblur

PACKAGE = Path(__file__).parents[1] / "jaxblur"

# Frames, numbers and light: what every layer may know.
FRAMES = {
    *("camera", "frame", "lens", "noise", "nonfinite", "optics", "safe_math", "settings"),
    *("shutter", "srgb", "strength"),
}
CORE = FRAMES | {"kernels", "filters", "posts"}
# Ground truth and metrics share no code with the filters: a shared mistake would pass.
JUDGES = {"scenes", "metrics"}

MAY_IMPORT: dict[str, set[str]] = {
    "_util": set(),
    "camera": set(),
    "frame": {"camera"},
    "safe_math": set(),
    "lens": set(),
    "optics": {"frame", "lens"},
    "settings": set(),
    "shutter": {"frame"},
    "strength": {"frame", "safe_math"},
    "srgb": set(),
    "nonfinite": {"frame"},
    "noise": {"frame", "settings"},
    "metrics": {"frame", "srgb"},
    "scenes": {"frame", "srgb"},
    "kernels": {"_util", "safe_math", "settings"},
    "filters": {
        *("frame", "kernels", "lens", "noise", "nonfinite", "optics", "safe_math", "settings"),
        "shutter",
    },
    "posts": {"frame", "kernels", "lens", "noise", "optics", "safe_math", "settings"},
    "vectors": {"frame", "safe_math"},
    "exr": {"_util", "frame", "nonfinite", "srgb", "vectors"},
    "sequence": {"exr"},
    "batch": {"filters", "frame", "noise", "settings"},
    "devices": {"batch", "filters", "frame", "noise", "settings"},
    "gradient_check": {"_util", "filters", "frame", "noise", "settings"},
    "planning": {"filters", "frame", "settings", "vectors"},
    "show": {"_util", "filters", "frame", "metrics", "noise", "safe_math", "settings"},
    "integrate": set(),
    "report": {"_util", "exr", "metrics"},
    "perception": {"_util", "exr", "report", "srgb"},
    "bench": {"_util", "exr", "filters", "frame", "metrics", "scenes", "settings", "vectors"},
    "__main__": {"cli"},
}
MAY_IMPORT["fitting"] = {"_util", "batch", "exr", "show", "vectors"} | {
    *("filters", "frame", "metrics", "noise", "settings"),
}
MAY_IMPORT["export"] = {"_util", "exr", "filters", "frame", "kernels", "noise", "settings"}
MAY_IMPORT["cli"] = MAY_IMPORT.keys() - {"__main__"}

SOURCES = sorted(PACKAGE.rglob("*.py"))
PACKAGES = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))


def home(source):
    """The top-level module or sub-package that a file belongs to."""
    return source.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(source):
    """Every module that a file imports anywhere, absolute, down to imported names."""
    folder = ("jaxblur", *source.relative_to(PACKAGE).parts[:-1])
    names = set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = folder[: len(folder) - node.level + 1] if node.level else ()
            module = ".".join((*base, *([node.module] if node.module else [])))
            names |= {f"{module}.{alias.name}" for alias in node.names}
    return names


def own_modules(source):
    """The top-level modules and names of jaxblur that a file imports, or loads from `jaxblur`."""
    loaded = {
        f"jaxblur.{node.attr}"
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "jaxblur"
    }
    known = {name for name in imported(source) | loaded if name.startswith("jaxblur.")}
    return {name.split(".")[1] for name in known} - {"__version__", "__file__"}


def test_relative_imports_are_resolved(tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "PACKAGE", tmp_path)
    source = tmp_path / "filters" / "new.py"
    source.parent.mkdir()
    source.write_text(
        "from ..frame import Frame\nfrom . import other\nfrom .. import cli\nimport jax\n"
        "import jaxblur\nversion = jaxblur.__version__\nblur = jaxblur.layered\n"
    )
    assert imported(source) == {
        "jaxblur.frame.Frame",
        "jaxblur.filters.other",
        "jaxblur.cli",
        "jaxblur",
        "jax",
    }
    assert own_modules(source) == {"frame", "filters", "cli", "layered"}


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_every_module_imports_only_what_its_layer_may(source):
    module = home(source)
    if module == "__init__":
        assert own_modules(source) == set(), "public names load lazily, through __init__.pyi"
        return
    assert module in MAY_IMPORT, f"give {module} its place in the layers of this test"
    # The command line may load every public name from `jaxblur`.
    public = set(jaxblur.__all__) if module == "cli" else set()
    forbidden = own_modules(source) - MAY_IMPORT[module] - {module} - public
    assert not forbidden, f"{module} must not import {', '.join(sorted(forbidden))}"


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_says_in_five_lines_what_it_may_import(package):
    tree = ast.parse((PACKAGE / package / "__init__.py").read_text(encoding="utf-8"))
    start = " ".join((ast.get_docstring(tree) or "").splitlines()[:5])
    if package == "cli":
        assert "Imports any part of jaxblur." in start
        return
    sentence = re.search(r"Imports nothing of jaxblur(?: but ((?:`\w+`(?:, | and )?)+))?", start)
    assert sentence, "one sentence about imports, in the first five lines"
    assert set(re.findall(r"\w+", (sentence[1] or "").replace(" and ", " "))) == MAY_IMPORT[package]


@pytest.mark.parametrize(
    "source",
    [source for source in SOURCES if home(source) in CORE | JUDGES | {"_util"}],
    ids=lambda path: path.relative_to(PACKAGE).as_posix(),
)
def test_kernels_and_judges_need_neither_optimizer_nor_files(source):
    outside = {name.split(".")[0] for name in imported(source)}
    assert not outside & {"optax", "OpenImageIO", "matplotlib", "rich"}


SHARED_BY_COMMANDS = [
    source
    for source in SOURCES
    if home(source) == "cli" and source.parent.name != "commands" and source.name != "main.py"
]


@pytest.mark.parametrize(
    "source", SHARED_BY_COMMANDS, ids=lambda path: path.relative_to(PACKAGE).as_posix()
)
def test_what_commands_share_imports_no_command(source):
    assert not {name for name in imported(source) if name.startswith("jaxblur.cli.commands")}


@pytest.mark.parametrize(
    "arguments",
    [
        ["-c", "import jaxblur"],
        ["-c", "import jaxblur.vectors"],
        ["-c", "import jaxblur._util.atomic, jaxblur._util.cache, jaxblur._util.pareto"],
        ["-m", "jaxblur", "--help"],
        ["-m", "jaxblur", "--version"],
    ],
    ids=["import", "vectors", "util", "help", "version"],
)
def test_a_start_that_computes_nothing_does_not_load_jax(arguments):
    result = subprocess.run(
        [sys.executable, "-X", "importtime", *arguments],
        cwd=PACKAGE.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = {line.split("|")[-1].strip() for line in result.stderr.splitlines()}
    assert "jaxblur" in loaded
    assert not loaded & {"jax", "jaxlib", "OpenImageIO", "scipy"}


def test_every_public_name_loads_after_import_jaxblur_alone():
    program = "import jaxblur\nfor name in jaxblur.__all__: getattr(jaxblur, name)\n"
    subprocess.run([sys.executable, "-c", program + "jaxblur.filters.unregister"], check=True)
