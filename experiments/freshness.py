"""Whether the figures of each experiment are of the code as it is; each page says so at its top.

    python -m experiments.freshness                     # bring the lines of all pages up to date
    python -m experiments.freshness --made 016_order    # its figures have just been made
    python -m experiments.freshness --same kernels --as TREE    # gives the numbers of that checkout

``made.json`` holds, for each experiment, when its figures were made (the oldest, where they are of
several times), and digests of the code that made them. A digest leaves out comments, docstrings and
blanks. A part that was rewritten and gives the same numbers (`010_fast_paths.guard` compares two
trees) does not make figures older: ``same_numbers.json`` holds, for such parts, the digests that
count as one. Numbers are the same if they differ by the rounding of float32 at most. Times may
differ, and the line says so.
"""

import argparse
import ast
import datetime
import functools
import hashlib
import io
import json
import re
import tokenize
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
RECORD = FOLDER / "made.json"
SAME_NUMBERS = FOLDER / "same_numbers.json"
PACKAGE = FOLDER.parent / "jaxblur"

PARTS = {
    "filters": ("filters/*.py", r"guertin|mcguire|pixel_velocity|FILTERS|filter_info|GUERTIN"),
    "layered": ("filters/layered/*.py", r"layered|blur_layers|FILTERS"),
    "kernels": ("kernels/**/*.*", r"guertin|mcguire|pixel_velocity|FILTERS|layered|\bkernels\b"),
    "posts": ("posts/*.py", r"\bposts\b"),
    "scenes": ("scenes/**/*.py", r"\bscenes\b|catalogue_example"),
    "metrics": ("metrics/**/*.*", r"\bmetrics\b|\bbench\b"),
}
"""Parts of the package: their files, and the words by which a program shows that it uses them."""

PROGRAMS = "its programs"
"""The digest of the programs of the experiment itself."""

NOT_RUN = ("011_gpu",)
"""Experiments whose pages say that nothing was measured yet."""

SUFFIXES = (".py", ".cc", ".h", ".json")
"""Files that compute; others of a part, such as its README, do not count."""

LINE = re.compile(r"^\*Measured on .*\*$", re.MULTILINE)


def main(argv: Sequence[str] | None = None) -> None:
    """Record an experiment, or not, and write the line of every page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--made", nargs="+", default=[], metavar="NAME", choices=names())
    parser.add_argument("--same", metavar="PART", choices=PARTS, help="see --as")
    parser.add_argument(
        "--as",
        dest="former",
        type=Path,
        metavar="TREE",
        help="the part --same gives the numbers that it gave in this checkout",
    )
    options = parser.parse_args(argv)
    if (options.same is None) != (options.former is None):
        parser.error("--same and --as belong together")
    if options.same is not None:
        record_same(options.same, options.former)
    made = options.made
    record = read_record()
    today = f"{datetime.date.today():%-d %B %Y}"
    record |= {name: {"date": today, "code": digests(name)} for name in made}
    RECORD.write_text(json.dumps(dict(sorted(record.items())), indent=1) + "\n", encoding="utf-8")
    for name, entry in record.items():
        page = FOLDER / name / "README.md"
        text = page.read_text(encoding="utf-8")
        page.write_text(with_line(text, line_of(name, entry)), encoding="utf-8")
        print(f"{name}: {line_of(name, entry).strip('*')}")


def record_same(part: str, former: Path) -> None:
    """Record that a part gives the numbers that it gave in another checkout."""
    pattern, _ = PARTS[part]
    pair = {digest(tree, pattern) for tree in (former / "jaxblur", PACKAGE)}
    sets = read_same_numbers()
    of_part = sets.get(part, [])
    joined = pair.union(*(known for known in of_part if pair & set(known)))
    apart = [known for known in of_part if not pair & set(known)]
    sets[part] = [*apart, sorted(joined)]
    SAME_NUMBERS.write_text(json.dumps(sets, indent=1) + "\n", encoding="utf-8")


def read_same_numbers() -> dict[str, list[list[str]]]:
    """For each part, sets of digests of code that gives the same numbers."""
    return json.loads(SAME_NUMBERS.read_text(encoding="utf-8"))


def names() -> list[str]:
    """The experiments with figures: folders with a number."""
    found = {path.parent.name for path in FOLDER.glob("[0-9]*/README.md")}
    return sorted(found - set(NOT_RUN))


def read_record() -> dict[str, Any]:
    """Date and digests of each experiment, by name."""
    return json.loads(RECORD.read_text(encoding="utf-8"))


def used_by(name: str) -> list[str]:
    """The parts that the programs of an experiment use, by `PARTS`."""
    programs = [path.read_text(encoding="utf-8") for path in (FOLDER / name).glob("*.py")]
    code = "\n".join(programs)
    return [part for part, (_, words) in PARTS.items() if re.search(words, code)]


def digests(name: str) -> dict[str, str]:
    """Digests of the code that an experiment runs.

    Args:
        name: of the experiment.

    Returns:
        Twelve hexadecimal digits for each part that it uses, and for its programs.
    """
    parts = {part: digest(PACKAGE, PARTS[part][0]) for part in used_by(name)}
    return parts | {PROGRAMS: digest(FOLDER / name, "*.py")}


def digest(folder: Path, pattern: str) -> str:
    """Twelve hexadecimal digits of the code of files in a folder."""
    total = hashlib.sha256()
    for path in sorted(folder.glob(pattern)):
        if path.suffix in SUFFIXES:
            text = path.read_text(encoding="utf-8")
            code = without_words(text) if path.suffix == ".py" else text
            total.update(f"{path.relative_to(folder).as_posix()}\n{code}\n".encode())
    return total.hexdigest()[:12]


@functools.cache
def without_words(source: str) -> str:
    """Python without comments, docstrings and blanks: the same for all versions of Python."""
    lines = source.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            row = token.start[0] - 1
            lines[row] = lines[row][: token.start[1]]
    for first, last in _strings_alone(ast.parse(source)):
        lines[first - 1 : last] = [""] * (last - first + 1)
    return "".join("".join(lines).split())


def _strings_alone(tree: ast.AST) -> Iterator[tuple[int, int]]:
    """First and last line of each string that is a statement."""
    for node in ast.walk(tree):
        value = node.value if isinstance(node, ast.Expr) else None
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            yield value.lineno, value.end_lineno or value.lineno


def line_of(name: str, entry: dict[str, Any]) -> str:
    """What the page of an experiment says of its figures.

    Args:
        name: of the experiment.
        entry: its date and digests.

    Returns:
        One line of Markdown.
    """
    now, then, same = digests(name), entry["code"], read_same_numbers()
    differs = [part for part in now if then.get(part) != now[part]]
    rewritten = [
        part
        for part in differs
        if any({then.get(part), now[part]} <= set(known) for known in same.get(part, []))
    ]
    changed = [part for part in differs if part not in rewritten]
    measured = f"*Measured on {entry['date']}"
    if changed:
        return f"{measured}. Code changed since then: {', '.join(changed)}.*"
    if rewritten:
        since = f"Code changed since then ({', '.join(rewritten)})"
        return f"{measured}. {since}: results are the same, times may differ.*"
    return f"{measured}, with the code as it is.*"


def with_line(page: str, line: str) -> str:
    """A page with its line, which stands below the title or replaces the former one."""
    if LINE.search(page):
        return LINE.sub(lambda _: line, page, count=1)
    title, rest = page.split("\n", 1)
    return f"{title}\n\n{line}\n{rest}"


if __name__ == "__main__":
    main()
