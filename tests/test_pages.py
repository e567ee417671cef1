"""What the pages say works as they say: their commands, their code, their links, and the site."""

import dataclasses
import glob
import html
import importlib
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

import jaxblur
from jaxblur.cli.main import build_parser
from tests.command_line import run
from tests.page_files import write_folder
from tests.test_fitting_result import RESULT

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(
    path
    for folder in ("", "docs/**", "jaxblur/**", "experiments/**", "notebooks")
    for path in ROOT.glob(f"{folder}/*.md".removeprefix("/"))
    if "out" not in path.relative_to(ROOT).parts
)
RECIPES = [
    page for page in PAGES if page.is_relative_to(DOCS) or page.is_relative_to(ROOT / "jaxblur")
]
RECIPES.append(ROOT / "README.md")


def text_of(page):
    return page.read_text(encoding="utf-8")


def name_of(page):
    return page.relative_to(ROOT).as_posix()


def blocks(page, language):
    """The fenced blocks of a language; \"\" for those without one."""
    fences = re.findall(r"^ *```(\w*)\n(.*?)^ *```$", text_of(page), re.DOTALL | re.MULTILINE)
    return [code for name, code in fences if name == language]


def commands(page):
    """The lines of a page's blocks that call the command."""
    lines = "".join(blocks(page, "")).replace("\\\n", " ").splitlines()
    # OpenCue puts the frames of a task in this place.
    lines = [line.replace("#FRAMESPEC#", "1001-1240") for line in lines]
    return [line for line in lines if line.startswith("jaxblur ")]


every_page = pytest.mark.parametrize("page", PAGES, ids=name_of)


def test_pages_are_found():
    assert len(PAGES) > 60
    assert sum(len(commands(page)) for page in RECIPES) > 50


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The present folder, with the filters that pages name by their files."""
    (tmp_path / "experiments").symlink_to(ROOT / "experiments")
    known = set(jaxblur.FILTERS)
    writing = blocks(ROOT / "jaxblur/filters/WRITING_A_FILTER.md", "python")[0]
    (tmp_path / "bright.py").write_text(writing, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in set(jaxblur.FILTERS) - known:
        jaxblur.filters.unregister(name)


@every_page
def test_commands_parse(page, folder):
    for line in commands(page):
        arguments = shlex.split(line, comments=True)[1:]
        assert build_parser().parse_args(arguments).command == arguments[0]


@every_page
def test_links_lead_somewhere(page):
    without_code = re.sub(r"(?ms)^ *```.*?^ *```$|`[^`\n]+`", "", text_of(page))
    for target in re.findall(r"\]\(([^)#\s]+)", without_code):
        assert target.startswith("https://") or (page.parent / target).exists(), target


@every_page
def test_programs_of_experiments_exist(page):
    for module in re.findall(r"python -m (experiments[\w.]+)", text_of(page)):
        assert importlib.util.find_spec(module), module
    for program in re.findall(r"python (experiments/\S+\.py)", text_of(page)):
        assert (ROOT / program).is_file(), program


def test_every_experiment_is_linked_from_the_page_of_measurements():
    links = set(re.findall(r"\(\.\./(experiments/[^)]+)\)", text_of(DOCS / "measured.md")))
    pages = {name_of(path) for path in ROOT.glob("experiments/*/README.md")}
    assert pages <= links


PARTS = re.compile(r"<(pre|li|table|tr|h\d|ul|ol|img)\b")


@every_page
def test_a_page_means_the_same_on_a_code_host_and_on_the_site(page):
    """Python-Markdown makes the site, and wants more blanks and empty lines than CommonMark."""
    markdown = pytest.importorskip("markdown", reason="needs jaxblur[docs]")
    pytest.importorskip("pymdownx", reason="needs jaxblur[docs]")
    from markdown_it import MarkdownIt

    on_host = MarkdownIt("commonmark").enable("table").render(text_of(page))
    extensions = ["attr_list", "md_in_html", "sane_lists", "tables", "pymdownx.superfences"]
    on_site = markdown.markdown(text_of(page), extensions=extensions)
    assert Counter(PARTS.findall(on_site)) == Counter(PARTS.findall(on_host))


SMALLER = {
    "320x180": "64x36",
    "1001-1240": "1001-1002",
    "1-10": "1-2",
    "1-8": "1-2",
}
"""Sizes, ranges and lists of the pages, and those that the tests take instead."""

QUICKER = {"fit": ("--steps", "2")}
"""What the tests add to a command."""

ELSEWHERE = ("--scheduler", "jaxblur bench")
"""In commands that other tests run: tests/test_sequence_cluster.py and tests/test_cli_bench.py."""

MAY_FAIL = ("vectors",)
"""Commands whose exit status 1 is their answer."""


def words_of(line):
    """The arguments of a command as the shell gives them."""
    words = [SMALLER.get(word, word) for word in shlex.split(line, comments=True)[1:]]
    found = [sorted(glob.glob(word)) if "####" not in word else [] for word in words]
    given = [each for word, files in zip(words, found, strict=True) for each in files or [word]]
    return [*given, *QUICKER.get(given[0], ())]


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in RECIPES if commands(page)], ids=name_of)
def test_commands_run(page, folder):
    fitted_file(write_folder(folder) / "fitted.toml")
    for line in commands(page):
        if any(mark in line for mark in ELSEWHERE):
            continue
        words = words_of(line)
        output = words[words.index("-o") + 1] if "-o" in words else None
        if output:
            remove(output)
        outcome = run(*words)
        allowed = (0, 1) if words[0] in MAY_FAIL else (0,)
        assert outcome.status in allowed, (line, outcome.err)
        if output and "--dry-run" not in words:
            assert glob.glob(output.replace("####", "*")), line


def fitted_file(path):
    """What a fit of guertin2014 has written."""
    defaults = jaxblur.filters.filter_info("guertin2014").defaults
    values = {"parameters": defaults | {"kappa": 30.0}, "initial": defaults, "published": defaults}
    settings = dataclasses.asdict(jaxblur.GuertinSettings())
    assert RESULT.sensitivity is not None
    sensitivity = dataclasses.replace(RESULT.sensitivity, names=("kappa",))
    dataclasses.replace(
        RESULT,
        filter="guertin2014",
        free=("kappa",),
        settings=settings,
        sensitivity=sensitivity,
        history={"loss": (0.5, 0.4), "kappa": (40.0, 30.0)},
        **values,
    ).save(path)


def remove(name):
    """Remove what a former command has written; an empty folder was made for this one."""
    for path in map(Path, glob.glob(name.replace("####", "*"))):
        if not path.is_dir():
            path.unlink()
        elif any(path.iterdir()):
            shutil.rmtree(path)


WITH_CODE = [page for page in RECIPES if page.is_relative_to(DOCS) and blocks(page, "python")]


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_CODE, ids=name_of)
def test_code_runs(page, folder):
    write_folder(folder)
    names = {}
    for block in blocks(page, "python"):
        if "import bpy" in block:
            compile(block, name_of(page), "exec")
        else:
            exec(block, names)
    assert names


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built as CONTRIBUTING says."""
    pytest.importorskip("mkdocs", reason="needs jaxblur[docs]")
    folder = tmp_path_factory.mktemp("site")
    environment = os.environ | {"PYTHONPATH": str(ROOT), "NO_MKDOCS_2_WARNING": "1"}
    # No network: a proxy that nobody runs.
    environment |= dict.fromkeys(("http_proxy", "https_proxy"), "http://127.0.0.1:9")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


@pytest.mark.slow
def test_the_site_loads_nothing_from_elsewhere(site):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 80
    loads = re.compile(
        r"<(?:script|link|img|iframe|source|video)\b[^>]*https?://[^>]*>|@import|url\(.?https?:"
    )
    for page in [*pages, *site.rglob("*.css")]:
        assert not loads.search(page.read_text(encoding="utf-8")), page


@pytest.mark.slow
def test_the_reference_has_every_name(site):
    for part in ("", "filters", "scenes", "metrics", "exr", "fitting", "posts", "show"):
        module = f"jaxblur.{part}".strip(".")
        page = (site / f"reference/python/{module}.html").read_text(encoding="utf-8")
        found = importlib.import_module(module)
        for name in getattr(found, "__all__", ()):
            if not isinstance(getattr(found, name), type(jaxblur)):
                assert f'id="{module}.{name}"' in page, f"{module}.{name}"


@pytest.mark.slow
def test_the_reference_has_every_option(site):
    page = (site / "reference/commands.html").read_text(encoding="utf-8")
    (choice,) = (a for a in build_parser()._actions if a.choices)
    assert choice.choices
    for name, command in dict(choice.choices).items():
        assert f'<h2 id="{name}">' in page
        if command.more_help:
            assert html.escape(command.more_help().split("\n")[0], quote=False) in page
        for action in command._actions:
            assert f'id="{name}-{action.dest}"' in page, (name, action.dest)


@pytest.mark.slow
def test_notebooks_keep_their_pictures(site):
    for notebook in ROOT.glob("notebooks/*.ipynb"):
        page = (site / "notebooks" / f"{notebook.name}.html").read_text(encoding="utf-8")
        pictures = re.findall(r'<img[^>]* src="([^"]+)"', page)
        assert len(pictures) >= 2 and all((site / "notebooks" / p).is_file() for p in pictures)
