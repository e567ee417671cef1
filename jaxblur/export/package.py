"""The folder that `jaxblur export` writes: sources, plan, README, a frame to test a port with."""

import hashlib
import json
import os
import pathlib
import shutil
import tempfile
from typing import Any, Literal

import numpy as np

from .. import exr
from .._util.errors import JaxblurIOError
from .c import print_c
from .compute import print_hlsl, print_wgsl
from .fragments import POINTS_FRAGMENT, print_glsl, textures_of
from .graph import Buffer, Graph
from .plan import GROUP, plan_of
from .reference import SHARE, TOLERANCE, expected_of, frame_of, reference_planes

Language = Literal["c", "wgsl", "glsl", "hlsl"]
"""A language that filters are printed in."""
LANGUAGES: tuple[Language, ...] = ("c", "wgsl", "glsl", "hlsl")
"""All languages."""
PLAN = "plan.json"


def sources_of(graph: Graph, language: Language) -> dict[str, str]:
    """Print a filter.

    Args:
        graph: the filter.
        language: C, or a language of shaders.

    Returns:
        Text by file name.

    Raises:
        NotExpressible: the filter does something that has no form in the language.
        ValueError: there is no such language.
    """
    name = f"jaxblur_{graph.filter.name}"
    if language == "c":
        text = print_c(graph)
        return {f"{name}.h": text.header, f"{name}.c": text.source}
    if language == "wgsl":
        return {f"{name}.wgsl": print_wgsl(graph)}
    if language == "hlsl":
        return {f"{name}.hlsl": print_hlsl(graph)}
    if language == "glsl":
        found = {}
        for number, (node, text) in enumerate(
            zip(graph.nodes, print_glsl(graph).values(), strict=True), 1
        ):
            file = f"{number:02}_{node.name}"
            if node.run.kind == "marks":
                found |= {f"{file}.vert": text, f"{file}.frag": POINTS_FRAGMENT}
            else:
                found[f"{file}.frag"] = text
        return found
    raise ValueError(f"`language` must be one of {', '.join(LANGUAGES)}, got {language!r}.")


def write_package(
    graph: Graph, language: Language, folder: pathlib.Path, *, overwrite: bool = False
) -> list[pathlib.Path]:
    """Write a printed filter with all that belongs to it, whole or not at all.

    Args:
        graph: the filter.
        language: to print it in.
        folder: to write to; new or empty, unless files are to be replaced.
        overwrite: whether files of an earlier export may be replaced.

    Returns:
        The files.

    Raises:
        NotExpressible: the filter does something that has no form in the language.
        JaxblurIOError: the folder is not empty, or the disk refused.
    """
    check_empty(folder, overwrite)
    sources = sources_of(graph, language)
    digest = hash_of(graph, sources)
    texts = sources | {"README.md": readme_of(graph, language, list(sources), digest)}
    planes = reference_planes(graph)
    expected = expected_of(graph, planes)
    temporary = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = pathlib.Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        temporary.chmod(0o755)
        for name, text in texts.items():
            (temporary / name).write_text(text, encoding="utf-8")
        _write_reference(graph, temporary / "reference", planes, expected)
        files = sorted([PLAN, *(p.relative_to(temporary).as_posix() for p in _files(temporary))])
        plan = {"language": language, "hash": digest, "files": files, **plan_of(graph)}
        (temporary / PLAN).write_text(json.dumps(plan, indent=1) + "\n", encoding="utf-8")
        return _move(temporary, folder)
    except OSError as error:
        raise JaxblurIOError(folder, f"cannot be written: {error.strerror or error}.") from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)


def check_empty(folder: pathlib.Path, overwrite: bool = False) -> None:
    """Reject a folder that holds something else.

    Raises:
        JaxblurIOError: it is a file, or not empty and not to be replaced.
    """
    if folder.exists() and not folder.is_dir():
        raise JaxblurIOError(folder, "is a file; give the name of a folder.")
    if folder.is_dir() and any(folder.iterdir()):
        if not overwrite:
            raise JaxblurIOError(
                folder, "is not empty; give a new folder, or pass --overwrite to replace an export."
            )
        try:
            _earlier_files(folder)
        except (OSError, ValueError, KeyError, TypeError):
            raise JaxblurIOError(
                folder, f"holds no export (no {PLAN} with its files); give a new folder."
            ) from None


def hash_of(graph: Graph, sources: dict[str, str]) -> str:
    """A checksum of the printed program and of the values of the parameters."""
    content = json.dumps([sources, graph.parameters], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


def _files(folder: pathlib.Path) -> list[pathlib.Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _earlier_files(folder: pathlib.Path) -> set[pathlib.Path]:
    """Files of the export that a folder holds, but not others that lie beside them."""
    listed = json.loads((folder / PLAN).read_text(encoding="utf-8"))["files"]
    return {path for path in _files(folder) if path.relative_to(folder).as_posix() in listed}


def _move(temporary: pathlib.Path, folder: pathlib.Path) -> list[pathlib.Path]:
    """Move complete files into place, and remove those of an earlier export."""
    moves = {folder / path.relative_to(temporary): path for path in _files(temporary)}
    if not folder.exists() or not any(folder.iterdir()):
        os.replace(temporary, folder)
        return list(moves)
    for stale in _earlier_files(folder) - set(moves):
        stale.unlink()
    for place, path in moves.items():
        place.parent.mkdir(exist_ok=True)
        os.replace(path, place)
    return list(moves)


def _write_reference(
    graph: Graph, folder: pathlib.Path, planes: dict[str, np.ndarray], expected: np.ndarray
) -> None:
    """Raw float32 values, their shapes, and the frame and the result as EXR."""
    folder.mkdir()
    height, width = expected.shape[:2]
    inputs = {buffer.name: planes[buffer.name] for buffer in graph.inputs}
    arrays = inputs | {graph.output.name: expected}
    for name, array in arrays.items():
        (folder / f"{name}.bin").write_bytes(array.astype("<f4").tobytes())
    description: dict[str, Any] = {
        "height": height,
        "width": width,
        "type": "float32, little-endian, row by row from the top, channels together",
        "inputs": {name: list(array.shape) for name, array in inputs.items()},
        "expected": {graph.output.name: list(expected.shape)},
        "parameters": graph.parameters,
        "tolerance": TOLERANCE,
        "share_within_tolerance": SHARE,
    }
    text = json.dumps(description, indent=1) + "\n"
    (folder / "reference.json").write_text(text, encoding="utf-8")
    exr.write_frame(folder / "frame.exr", frame_of(planes), 1.0)
    exr.write_image(folder / "expected.exr", expected, dtype="float")


_HOW = {
    "c": """\
Compile the source with any C99 compiler and link the C library of mathematics (-lm):
`cc -O3 -c {first}`. Include the header, allocate
what `jaxblur_{filter}_scratch_bytes` says, and call `jaxblur_{filter}`. It keeps no state, and
threads may call it at once, each with scratch memory of its own.""",
    "wgsl": """\
One module, a compute entry point `pass_NAME` for each pass. Group 0, binding 0 is a uniform buffer:
height and width as i32, then the parameters as f32, in the order of `plan.json`. The other
bindings are storage buffers of f32 or i32. Dispatch `ceil(columns / {group})` by
`ceil(rows / {group})` groups for the grid of each pass, in their order. Buffers marked *clear*
must be all 0 before the pass that writes them.""",
    "hlsl": """\
One file, a compute entry point `pass_NAME` for each pass, shader model 5 or later. The constant
buffer `Uniforms` (b0) holds height and width as int, then the parameters as float. Buffers that a
pass reads are `StructuredBuffer` (t), those that it writes `RWStructuredBuffer` named `write_...`
(u), both at the number of the binding below. Dispatch `ceil(columns / {group})` by
`ceil(rows / {group})` groups for the grid of each pass, in their order. Buffers marked *clear* must
be all 0 before the pass that writes them. Unity: declare each entry point by `#pragma kernel`.
Direct3D 11.0 has u0 to u7 alone: leave out `: register(...)` there, and its compiler numbers the
buffers of each pass by itself.""",
    "glsl": """\
One fragment shader in GLSL ES 3.00 for each pass, in the order of the files. Draw each over all
texels of its output (a triangle that covers the viewport), into float textures (RGBA32F; WebGL 2
needs EXT_color_buffer_float). A buffer of up to four channels is one texture; more channels are
several, in outputs of one framebuffer. Row 0 of a texture is the top row of the frame. Set the
uniforms `height`, `width` (of the frame) and `parameter_NAME`. A buffer of int32 is a texture R32I
(RGBA32I if it has channels). What is taller than the frame may be a texture of any width: its
elements follow one another row by row.

A pass with a `.vert` draws points: as many vertices as the frame has pixels, as many instances as
`marks` of the pass in `plan.json`. Draw it twice into R32I textures of the size of its output
(uniform `table_size`, columns and rows) with a depth buffer of 24 bits, both cleared to 0, and the
depth test "greater or equal": first with `low_bits` false, then with `low_bits` true into the
output, the first result bound as `high_bits`. It keeps the largest mark at each place.""",
}


_INPUTS = {
    "path": "Path is the displacement at opening (x, y) and closing (x, y).",
    "noise_tap": """
Noise is yours to make, the same in every frame or with an offset of its own. Halton noise, which
`reference/` has: with h(b) the radical inverse in base b of 64 (row mod 64) + column mod 64,
`noise_tap` is 2 h(2) - 1, and `noise_tile`, where it is read, (h(3) - 1/2, h(5) - 1/2).""",
}
"""What inputs hold that not every filter reads."""


def readme_of(graph: Graph, language: Language, sources: list[str], digest: str) -> str:
    """The page about bindings, formats and passes."""
    info = graph.filter
    how = _HOW[language].format(filter=info.name, first=sources[-1], group=GROUP)
    lines = [
        f"# {info.name} in {language.upper()}",
        "",
        f"{info.summary[:1].upper()}{info.summary[1:]}.",
        "",
        "Printed by jaxblur from the program that JAX runs. Do not edit; export again.",
        "",
        how,
        "",
        "## Settings",
        "",
        "Fixed when it was exported:",
        "",
        f"`{graph.settings}`, {graph.channels} channels of color.",
        "",
        "## Parameters",
        "",
        *_table(
            ("name", "value", "range", "meaning"),
            [
                (
                    f"`{name}`",
                    f"{value:.7g}",
                    info.parameter_infos[name].range,
                    info.parameter_infos[name].meaning,
                )
                for name, value in graph.parameters.items()
            ],
            "The filter has none.",
        ),
        "",
        "## Buffers",
        "",
        *_table(
            ("binding", "name", "format", "size", "role"),
            [
                (str(number), f"`{b.name}`", _format(b, language), _size(b), _role(graph, b))
                for number, b in enumerate(graph.buffers, 1)
            ],
        ),
        "",
        "Images are row by row from the top, the channels of a pixel together. Color is linear,",
        "alpha premultiplied. Velocity is half of the motion while the shutter is open, pixels, x",
        "to the right and y down. Depth is positive along the view axis; write 1e18 for the sky,",
        "since shaders may not count on infinity. Inputs must not be NaN.",
        *(text for name, text in _INPUTS.items() if any(b.name == name for b in graph.inputs)),
        "",
        "## Passes",
        "",
        *_table(
            ("pass", "grid", "reads", "writes", "what it does"),
            [
                (
                    f"`{part['name']}`",
                    _size_text(part["grid"]),
                    ", ".join(part["reads"]) or "nothing",
                    part["writes"],
                    part["does"].replace("|", "\\|"),
                )
                for part in plan_of(graph)["passes"]
            ],
        ),
        "",
        "## Test",
        "",
        "`reference/` holds a frame, its expected result by JAX (raw float32 and EXR), and their",
        f"shapes in `reference.json`. At least {SHARE:.1%} of the pixels must be within",
        f"{TOLERANCE:g} of it; a tap that falls between two texels may take the other one.",
        "",
        f"Program and parameters: sha256 {digest}",
        "",
    ]
    return "\n".join(lines)


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]], empty: str = "") -> list[str]:
    if not rows:
        return [empty]
    lines = [head, tuple("---" for _ in head), *rows]
    return [f"| {' | '.join(line)} |" for line in lines]


def _format(buffer: Buffer, language: Language) -> str:
    if language == "glsl":
        texels = "R32I" if buffer.dtype == "int32" else "RGBA32F"
        return " and ".join(f"`{name}` {texels}" for name in textures_of(buffer))
    return f"{buffer.channels} x {buffer.dtype}"


def _size(buffer: Buffer) -> str:
    return _size_text({"of": buffer.size.of, "factor": buffer.size.factor})


def _size_text(size: dict[str, Any]) -> str:
    factor = size["factor"]
    if size["of"] == "tiles":
        return f"ceil(height / {factor}) x ceil(width / {factor})"
    return "height x width" if factor == 1 else f"{factor} height x width"


def _role(graph: Graph, buffer: Buffer) -> str:
    marked = any(n.run.kind == "marks" and n.output is buffer for n in graph.nodes)
    return buffer.role + (", *clear*" if marked else "")
