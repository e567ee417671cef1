"""Hooks of mkdocs: pages of the repository, notebooks, and the reference become pages of the site.

The site begins with ``docs/``. Whatever a page links to in the repository becomes a page too:
Markdown as it is, notebooks with their stored outputs, source code as text. Pictures and tables are
copied. So every text exists once, and relative links work in the repository and on the site.
"""

import argparse
import html
import importlib
import posixpath
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbconvert import MarkdownExporter

from jaxblur.cli.main import build_parser

ROOT = Path(__file__).parents[1]
DOCS = Path(__file__).parent
FIRST = "index.md"
COMMANDS = "reference/commands.md"
SOURCES = {".py": "python", ".pyi": "python", ".js": "javascript", ".yaml": "yaml", "": "text"}
"""Suffixes of files that are shown as text, with the language of their colors."""

PRIVATE = ("_util", "cli", "integrate")
"""Packages that are used by commands only."""
PARTS = (
    "jaxblur",
    *sorted(
        f"jaxblur.{path.parent.name}"
        for path in (ROOT / "jaxblur").glob("*/__init__.py")
        if path.parent.name not in PRIVATE
    ),
)
"""The package and its public parts."""

CODE = re.compile(r"(^ *```.*?^ *```$|`[^`\n]+`)", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"(?<=\]\()([^)\s#]+)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the reference, and everything that pages link to, from page to page."""
    known = {file.src_uri for file in files}
    waiting = ["README.md", *(f"docs/{name}" for name in known if name.endswith(".md"))]
    known.add(FIRST)
    files.append(File.generated(config, FIRST, abs_src_path=str(ROOT / "README.md")))
    for name, text in [(COMMANDS, commands_page()), *python_pages()]:
        files.append(File.generated(config, name, content=text))
    while waiting:
        name = waiting.pop()
        for target in linked(name):
            page = address(target)
            if page in known:
                continue
            known.add(page)
            for file in pages_of(target, config):
                files.append(file)
            if target.endswith((".md", ".ipynb")):
                waiting.append(target)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links of the repository lead to the pages that `on_files` made."""
    here = posixpath.dirname(page.file.src_uri)
    return with_links(
        markdown,
        repository_folder(page.file.src_uri),
        lambda target: posixpath.relpath(address(target), here),
    )


def repository_folder(page: str) -> str:
    """The folder, in the repository, of the file that a page of the site is made of."""
    folder = posixpath.dirname(page)
    return posixpath.join("docs", folder) if (DOCS / page).is_file() else folder


def linked(name: str) -> list[str]:
    """The files of the repository that a page of the repository links to."""
    found: list[str] = []

    def keep(target: str) -> str:
        found.append(target)
        return target

    with_links((ROOT / name).read_text(encoding="utf-8"), posixpath.dirname(name), keep)
    return found


def with_links(markdown: str, folder: str, replace: Callable[[str], str]) -> str:
    """Replace links that lead to files of the repository, outside of code.

    Args:
        markdown: text of a page.
        folder: where the page lies, relative to the root of the repository.
        replace: function of a path relative to the root, which gives the new link.

    Returns:
        The text; a link to a folder is one to its README.
    """

    def replaced(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(folder, match[0]))
        if (ROOT / target / "README.md").is_file():
            target = posixpath.join(target, "README.md")
        return replace(target) if (ROOT / target).is_file() else match[0]

    parts = CODE.split(markdown)
    parts[::2] = [LINK.sub(replaced, part) for part in parts[::2]]
    return "".join(parts)


def address(target: str) -> str:
    """The page or file of the site for a file of the repository."""
    if target == "README.md":
        return FIRST
    suffix = posixpath.splitext(target)[1]
    is_page_of_text = suffix == ".ipynb" or suffix in SOURCES
    return target.removeprefix("docs/") + (".md" if is_page_of_text else "")


def pages_of(target: str, config: MkDocsConfig) -> list[File]:
    """A page or file of the site for a file of the repository, with the pictures of a notebook."""
    path, suffix = ROOT / target, posixpath.splitext(target)[1]
    if suffix == ".ipynb":
        return notebook_pages(target, config)
    if suffix in SOURCES:
        text = path.read_text(encoding="utf-8")
        page = f"# {path.name}\n\n`{target}`\n\n````{SOURCES[suffix]}\n{text}\n````\n"
        return [File.generated(config, address(target), content=page)]
    return [File.generated(config, address(target), abs_src_path=str(path))]


def notebook_pages(target: str, config: MkDocsConfig) -> list[File]:
    """The page of an executed notebook, and the pictures that it holds."""
    pictures = f"{posixpath.splitext(posixpath.basename(target))[0]}_files"
    text, resources = MarkdownExporter().from_filename(
        str(ROOT / target), resources={"output_files_dir": pictures}
    )
    folder = posixpath.dirname(target)
    return [
        File.generated(config, address(target), content=text),
        *[
            File.generated(config, posixpath.join(folder, name), content=content)
            for name, content in resources["outputs"].items()
        ],
    ]


def commands_page() -> str:
    """The reference of the command line, from its parsers.

    Arguments are read from private fields: argparse has no public list of them.
    """
    parser = build_parser()
    (commands,) = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    summaries = {action.dest: action.help for action in commands._choices_actions}
    lines = [
        "# Command line",
        "",
        "Made from the parsers of the commands: the text of `--help`.",
        "",
    ]
    for name in commands.choices:
        lines += [f"- [`jaxblur {name}`](#{name}): {summaries[name]}"]
    for name, command in commands.choices.items():
        lines += ["", f"## {name}", "", command.description or "", ""]
        lines += ["```text", command.format_usage().strip(), "```", ""]
        for group in command._action_groups:
            if group._group_actions:
                lines += [f"<h3>{html.escape(group.title or '')}</h3>", "<dl>"]
                lines += [option(name, action) for action in group._group_actions]
                lines += ["</dl>", ""]
        for more in (command.epilog, command.more_help and command.more_help()):
            if more:
                lines += ["```text", more.strip("\n"), "```", ""]
    return "\n".join(lines)


def option(command: str, action: argparse.Action) -> str:
    """One argument of a command as an entry of a list."""
    values = "" if action.nargs == 0 else str(action.metavar or action.dest)
    if action.choices and not action.metavar:
        values = "{" + ",".join(map(str, action.choices)) + "}"
    names = [f"{name} {values}".strip() for name in action.option_strings] or [values]
    text = (action.help or "") % (vars(action) | {"prog": f"jaxblur {command}"})
    identifier = f"{command}-{action.dest}"
    term = ", ".join(f"<code>{html.escape(name)}</code>" for name in names)
    return f'<dt id="{identifier}">{term}</dt><dd>{html.escape(text)}</dd>'


def python_pages() -> Iterator[tuple[str, str]]:
    """A page for the package, and one for each of its public parts."""
    for module in PARTS:
        names = public_names(importlib.import_module(module))
        blocks = [f"::: {module}.{each}\n" for each in names]
        intro = f"::: {module}\n    options:\n      members: false\n      heading_level: 1\n"
        yield f"reference/python/{module}.md", "\n".join([intro, *blocks])
    module = "::: jaxblur.devices\n    options:\n      heading_level: 1\n"
    yield "reference/python/jaxblur.devices.md", module


def public_names(package: ModuleType) -> list[str]:
    """The names that a package exports, without the modules among them."""
    names = getattr(package, "__all__", None) or [n for n in vars(package) if n[0] != "_"]
    return [name for name in names if not isinstance(getattr(package, name), ModuleType)]
