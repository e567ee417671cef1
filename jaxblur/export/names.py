"""Names for values: those that the author of a program gave them.

An equation knows the lines that it comes from. The innermost one that assigns gives the name.
"""

import ast
import functools
import pathlib
import re
from typing import Any, NamedTuple

_PACKAGE = pathlib.Path(__file__).parents[1]
_ENGINE = (str(_PACKAGE / "kernels") + "/", str(_PACKAGE / "export" / "between.py"))
_LIBRARY = str(pathlib.Path(functools.__file__).parent) + "/"

RESERVED = frozenset(
    """
    abs active alias all and any array asm atan atomic auto bitcast bool boolean break buffer case
    cast ceil centroid char clamp clip class column_major common compile const const_assert continue
    continuing cos cosh cross cull default degrees delete diagnostic discard distance do dot double
    dst else enable end enum exp export extern external f16 f32 fallthrough false filter final fixed
    flat float floor fn for fract frexp friend from function generic get goto half half_float highp
    hvec i32 if image import in inf inline inout input int int32_t interface invariant isinf isnan
    layout length let line lod log long loop lowp main mat matrix max mediump mesh min mix mod
    module modf nan namespace new nil noinline none norm normalize not null nullptr of on operator
    or out output override packed params partition pass pi pixel pixelfragment point pow precise
    precision private public quat radians ref register requires require resource restrict return
    row_major round sample sampler sampler2d self set shared short sign signed sin sinh size sizeof
    smooth sqrt src stage static step storage string struct subroutine super superp switch tan tanh
    target technique template texture this true trunc try type typedef typename u32 uint union
    unless unsigned until use using var varying vec vector vertex void volatile when where while
    with workgroup writable yield
    """.split()
)


class Origin(NamedTuple):
    """Where a value comes from.

    Attributes:
        names: that the statement assigns; one, or one for each part of a tuple.
        statement: file and lines, to tell statements apart.
    """

    names: tuple[str, ...]
    statement: tuple[Any, ...]


def origin_of(equation: Any) -> Origin:
    """The statement of the program that an equation is part of."""
    traceback = equation.source_info.traceback
    if traceback is None:
        return Origin(("value",), ())
    frames = [frame for frame in traceback.frames if _is_of_author(frame.file_name)]
    return _of_frames(tuple((f.file_name, f.line_num, f.function_name) for f in frames[:6]))


def place_of(equation: Any) -> str:
    """``FILE:LINE`` of the statement that an equation is part of; empty if unknown."""
    statement = origin_of(equation).statement
    return f"{statement[0]}:{statement[1]}" if statement else ""


@functools.cache
def _is_of_author(file: str) -> bool:
    """Whether a file may hold the program, rather than what runs it."""
    if file.startswith(str(_PACKAGE)):
        return not file.startswith(_ENGINE)
    return not (file.startswith(("<", _LIBRARY)) or "site-packages" in file)


@functools.cache
def _of_frames(frames: tuple[tuple[str, int, str], ...]) -> Origin:
    for depth, (file, line, _) in enumerate(frames):
        found = _assignments(file).get(line)
        if found:
            outer = tuple(frame[:2] for frame in frames[depth + 1 : depth + 3])
            return Origin(found[1], (file, found[0], outer))
    if frames:
        file, line, function = frames[0]
        parts = [part for part in function.split(".") if not part.startswith("<")]
        name = parts[-1] if parts else "value"
        return Origin((_clean(name),), (file, line))
    return Origin(("value",), ())


@functools.cache
def _assignments(file: str) -> dict[int, tuple[int, tuple[str, ...]]]:
    """For each line of a file that is part of an assignment, its first line and its names."""
    try:
        tree = ast.parse(pathlib.Path(file).read_text(encoding="utf-8"))
    except (OSError, SyntaxError, ValueError):
        return {}
    lines: dict[int, tuple[int, tuple[str, ...]]] = {}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign):
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = tuple(name for target in targets for name in _targets(target))
        if names:
            for line in range(node.lineno, (node.end_lineno or node.lineno) + 1):
                lines[line] = node.lineno, names
    return lines


def _targets(target: ast.expr) -> list[str]:
    if isinstance(target, ast.Name):
        return [_clean(target.id)]
    if isinstance(target, ast.Tuple | ast.List):
        return [name for part in target.elts for name in _targets(part)]
    if isinstance(target, ast.Starred):
        return _targets(target.value)
    return []


def _clean(name: str) -> str:
    name = re.sub(r"\W", "", name).strip("_").lower()
    name = re.sub("__+", "_", name)
    return name or "value"


class Names:
    """Gives out names, each once."""

    def __init__(self, taken: Any = ()) -> None:
        """Start with names that are taken."""
        self._taken = set(taken) | RESERVED

    def new(self, wanted: str) -> str:
        """A name like the one wanted that is free, and taken from now on."""
        wanted = _clean(wanted)
        if wanted in RESERVED:
            wanted = f"{wanted}_value"
        name, number = wanted, 1
        while name in self._taken:
            number += 1
            name = f"{wanted}_{number}"
        self._taken.add(name)
        return name
