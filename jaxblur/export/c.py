"""Plain C99: one source, one header, no library but the C one."""

import textwrap
from typing import NamedTuple

from .body import Body, write_body
from .dialects import C
from .expressions import Value
from .graph import Buffer, Graph, Node, Size
from .printer import Table

_TYPES = {"float32": "float", "int32": "int32_t"}

_HELPERS = """\
/* Maximum and minimum of floats: not a number if one of both is, as in JAX. */
static inline float larger(float a, float b) { return a > b || a != a ? a : b; }
static inline float smaller(float a, float b) { return a < b || a != a ? a : b; }
static inline int32_t larger_int(int32_t a, int32_t b) { return a > b ? a : b; }
static inline int32_t smaller_int(int32_t a, int32_t b) { return a < b ? a : b; }
static inline float sign_of(float a) { return a != a ? a : (float)((a > 0) - (a < 0)); }
static inline int32_t sign_of_int(int32_t a) { return (a > 0) - (a < 0); }
"""


class _Host:
    """See `.body.Host`."""

    dialect = C
    leave = "continue;"
    taken = ()

    def read(self, table: Table, index: Value) -> str:
        return f"{table.name}[{index.code}]"

    def store(self, node: Node, channel: int, code: str) -> str:
        channels = node.output.channels
        place = "pixel_index" if channels == 1 else f"{channels} * pixel_index"
        place = f"{place} + {channel}" if channel else place
        return f"{node.output.name}[{place}] = {code};"

    def mark(self, node: Node, place: str, mark: str) -> str:
        return f"keep_larger({node.output.name}, {place}, {mark});"

    def parameter(self, name: str) -> str:
        return f"parameters->{name}"


class Text(NamedTuple):
    """A printed filter.

    Attributes:
        source: of it.
        header: what callers include.
    """

    source: str
    header: str


def print_c(graph: Graph) -> Text:
    """Print a filter as plain C.

    Args:
        graph: the filter.

    Returns:
        Source and header.

    Raises:
        NotExpressible: the filter does something that has no form in C.
    """
    name = f"jaxblur_{graph.filter.name}"
    host = _Host()
    bodies = [write_body(node, host, 3) for node in graph.nodes]
    functions = [
        _function(node, body, name) for node, body in zip(graph.nodes, bodies, strict=True)
    ]
    marks = ""
    if any(node.run.kind == "marks" for node in graph.nodes):
        marks = (
            "static inline void keep_larger(int32_t *table, int32_t place, int32_t mark)\n{\n"
            "    if (mark > table[place]) {\n        table[place] = mark;\n    }\n}\n"
        )
    parts = [
        f"/* The filter {graph.filter.name} of jaxblur: {graph.filter.summary}.\n"
        "   Printed from the program that JAX runs; do not edit. */\n\n"
        f'#include "{name}.h"\n\n#include <math.h>\n#include <stdbool.h>\n#include <stdlib.h>\n'
        "#include <string.h>\n",
        _HELPERS + marks,
        *functions,
        _entry(graph, bodies, name),
    ]
    return Text("\n".join(parts), _header(graph, name))


def _comment(text: str) -> str:
    lines = textwrap.wrap(text.replace("*/", "* /"), 92)
    return "/* " + "\n   ".join(lines) + " */" if lines else ""


def _function(node: Node, body: Body, name: str) -> str:
    """A pass as a function over planes."""
    arguments = [f"const struct {name}_parameters *parameters", "int32_t height", "int32_t width"]
    arguments += [f"const {_TYPES[b.buffer.dtype]} *restrict {b.name}" for b in body.bindings]
    arguments.append(f"{_TYPES[node.output.dtype]} *restrict {node.output.name}")
    listed = ",\n    ".join(arguments)
    lines = [_comment(node.text), f"static void pass_{node.name}(\n    {listed})", "{"]
    lines += ["    (void)parameters;", *body.head]
    if node.run.kind == "marks":
        elements = f"(size_t){node.output.size.factor} * height * width"
        lines.append(f"    memset({node.output.name}, 0, {elements} * sizeof *{node.output.name});")
    lines += [
        "    for (int32_t row = 0; row < rows; row++) {",
        "        for (int32_t column = 0; column < columns; column++) {",
        "            const int32_t pixel_index = row * columns + column;",
        "            (void)pixel_index;",
        *body.pixel,
        "        }",
        "    }",
        "}\n",
    ]
    return "\n".join(lines)


def _elements(buffer: Buffer) -> str:
    """The number of elements of a buffer."""
    size = buffer.size
    if size.of == "tiles":
        rows, columns = (
            f"((size_t){side} + {size.factor - 1}) / {size.factor}" for side in ("height", "width")
        )
        return f"({rows}) * ({columns}) * {buffer.channels}"
    return f"(size_t)height * width * {buffer.channels * size.factor}"


def _arguments(graph: Graph, name: str) -> str:
    listed = [f"const struct {name}_parameters *parameters", "int width", "int height"]
    listed += [f"const float *{buffer.name}" for buffer in graph.inputs]
    return ",\n    ".join([*listed, f"float *{graph.output.name}", "void *scratch"])


def _entry(graph: Graph, bodies: list[Body], name: str) -> str:
    """The functions that callers see."""
    lines = [
        f"const struct {name}_parameters {name}_defaults = {{",
        *(f"    .{k} = {C.literal(_float32(v)).code}," for k, v in graph.parameters.items()),
        *([] if graph.parameters else ["    .unused = 0"]),
        "};\n",
        f"size_t {name}_scratch_bytes(int width, int height)",
        "{",
        "    size_t elements = 0;",
        *(f"    elements += {_elements(buffer)}; /* {buffer.name} */" for buffer in graph.work),
        "    (void)width;",
        "    (void)height;",
        "    return 4 * elements;",
        "}\n",
        f"int {name}(\n    {_arguments(graph, name)})",
        "{",
        "    if (width < 1 || height < 1 || width > 1 << 20 || height > 1 << 20 ||",
        f"        {_largest(graph)} > INT32_MAX) {{",
        "        return 1;",
        "    }",
        "    if (!parameters) {",
        f"        parameters = &{name}_defaults;",
        "    }",
    ]
    if graph.work:
        lines.append("    char *next = scratch;")
    for buffer in graph.work:
        kind = _TYPES[buffer.dtype]
        lines.append(f"    {kind} *{buffer.name} = ({kind} *)next;")
        lines.append(f"    next += 4 * ({_elements(buffer)});")
    if graph.work:
        lines.append("    (void)next;")
    else:
        lines.append("    (void)scratch;")
    for node, body in zip(graph.nodes, bodies, strict=True):
        given = ["parameters", "height", "width", *(b.buffer.name for b in body.bindings)]
        lines.append(f"    pass_{node.name}({', '.join([*given, node.output.name])});")
    return "\n".join([*lines, "    return 0;", "}\n"])


def _largest(graph: Graph) -> str:
    """The size of the largest buffer, whose indices must fit 32 bits."""
    factor = max(b.channels * (b.size.factor if b.size.of == "stack" else 1) for b in graph.buffers)
    return f"(int64_t)height * width * {factor}"


def _float32(value: float):
    import numpy as np

    return np.float32(value)


def _header(graph: Graph, name: str) -> str:
    infos = graph.filter.parameter_infos
    fields = [
        f"    float {parameter}; /* {infos[parameter].meaning}; fitted: {value:g} */"
        for parameter, value in graph.parameters.items()
    ] or ["    float unused; /* the filter has no parameters */"]
    shapes = [f"   {b.name}: {_shape(b)}" for b in [*graph.inputs, graph.output]]
    guard = f"{name.upper()}_H"
    return "\n".join(
        [
            f"/* The filter {graph.filter.name} of jaxblur: {graph.filter.summary}. */\n",
            f"#ifndef {guard}\n#define {guard}\n",
            "#include <stddef.h>\n#include <stdint.h>\n",
            '#ifdef __cplusplus\nextern "C" {\n#endif\n',
            f"#define {name.upper()}_CHANNELS {graph.channels}\n",
            f"struct {name}_parameters {{",
            *fields,
            "};\n",
            "/* The values that were fitted, or the defaults of the filter. */",
            f"extern const struct {name}_parameters {name}_defaults;\n",
            "/* Bytes of working memory for a frame. */",
            f"size_t {name}_scratch_bytes(int width, int height);\n",
            "/* Blur a frame. Images are row-major, row 0 is the top, channels lie together:",
            *shapes,
            "   Velocity is half of what a point moves while the shutter is open, pixels, x to the",
            "   right and y down. Depth is positive along the view axis, 1e18 for the sky.",
            "   Parameters may be NULL for the defaults. No image may overlap another one.",
            "   Returns 0, or 1 if the frame is empty or too large. */",
            f"int {name}(\n    {_arguments(graph, name)});\n",
            "#ifdef __cplusplus\n}\n#endif\n\n#endif\n",
        ]
    )


def _shape(buffer: Buffer) -> str:
    size = {Size("frame"): "height x width"}[buffer.size]
    return f"{size} x {buffer.channels} float32"
