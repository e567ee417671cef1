"""Shaders in GLSL ES 3.00, for WebGL 2 and hosts that draw passes: one text a pass.

A pass is a fragment shader, drawn over all texels of its output. A pass that leaves marks is a
vertex shader: it draws a point for each mark, and depth tests keep the largest.
"""

from typing import NamedTuple

from .body import Body, write_body
from .compute import _comment, _title
from .dialects import GLSL
from .expressions import NotExpressible, Value
from .graph import Buffer, Graph, Node
from .printer import Table

_LETTERS = "xyzw"


def textures_of(buffer: Buffer) -> list[str]:
    """The names of the textures that hold a buffer, four channels each."""
    count = -(-buffer.channels // 4)
    return [buffer.name] if count == 1 else [f"{buffer.name}_{k}" for k in range(count)]


class _Host:
    """See `.body.Host`."""

    dialect = GLSL
    leave = "return;"

    def __init__(self, graph: Graph) -> None:
        textures = [name for buffer in graph.buffers for name in textures_of(buffer)]
        reads = [f"texel_of_{name}" for name in textures]
        uniforms = [f"parameter_{name}" for name in graph.parameters]
        written = [f"write_{name}" for name in textures]
        own = ("rem_int", "keep", "kept", "low_bits", "table_size", "high_bits")
        self.taken = (*own, *textures, *reads, *uniforms, *written)

    def read(self, table: Table, index: Value) -> str:
        base, channel = index, 0
        if index.place is not None:
            base, factor, channel = index.place
            if factor != table.channels:
                raise NotExpressible("glsl: a read of an image other than by pixel and channel.")
        elif table.channels > 1:
            raise NotExpressible("glsl: a read of an image other than by pixel and channel.")
        suffix = f"_{channel // 4}" if table.channels > 4 else ""
        return f"texel_of_{table.name}{suffix}({base.code}).{_LETTERS[channel % 4]}"

    def store(self, node: Node, channel: int, code: str) -> str:
        name = textures_of(node.output)[channel // 4]
        return f"write_{name}.{_LETTERS[channel % 4]} = {code};"

    def mark(self, node: Node, place: str, mark: str) -> str:
        return f"keep({place}, {mark});"

    def parameter(self, name: str) -> str:
        return f"parameter_{name}"


def print_glsl(graph: Graph) -> dict[str, str]:
    """Print a filter as shaders.

    Args:
        graph: the filter.

    Returns:
        For each pass, by name and in order, a fragment shader that is drawn over all texels of its
        output; for a pass that leaves marks a vertex shader, to be drawn with `POINTS_FRAGMENT`.

    Raises:
        NotExpressible: a pass does something that has no form here.
    """
    return {
        node.name: (_points if node.run.kind == "marks" else _shader)(graph, node)
        for node in graph.nodes
    }


POINTS_FRAGMENT = """\
#version 300 es
precision highp int;
flat in int kept;
layout(location = 0) out ivec4 write_marks;

void main() {
    write_marks = ivec4(kept, 0, 0, 0);
}
"""
"""The fragment shader of the points that a pass with marks draws."""

_KEEP = """\
uniform bool low_bits;
uniform ivec2 table_size;
uniform highp isampler2D high_bits;
flat out int kept;

// The point of a mark. Drawn twice: first the high bits of marks compete by depth, which gives the
// texture high_bits, then the low 16 bits of the marks that have these.
void keep(int place, int mark) {
    ivec2 texel = ivec2(place % table_size.x, place / table_size.x);
    kept = low_bits ? mark : mark >> 16;
    if (mark <= 0 || (low_bits && texelFetch(high_bits, texel, 0).x != mark >> 16)) {
        return;
    }
    float depth = float(low_bits ? mark & 65535 : mark >> 16) / 32768.0 - 1.0;
    gl_Position = vec4((2.0 * vec2(texel) + 1.0) / vec2(table_size) - 1.0, depth, 1.0);
}
"""


def _points(graph: Graph, node: Node) -> str:
    """A pass that leaves marks as a vertex shader: instance i of vertex k is mark i of pixel k."""
    if not node.run.apart:
        raise NotExpressible(
            f"glsl: the pass {node.name} leaves any number of marks; `apart` must say how many."
        )
    body = write_body(node, _Host(graph), 1, step="gl_InstanceID")
    reads = _reads(body)
    return "\n".join(
        [
            *_head(graph),
            *reads.uniforms,
            _KEEP,
            *reads.functions,
            _comment(node.text, "//"),
            "void main() {",
            "    // Outside of the picture, unless there is a mark.",
            "    gl_Position = vec4(2.0, 2.0, 0.0, 1.0);",
            "    gl_PointSize = 1.0;",
            "    kept = 0;",
            *body.head,
            "    int pixel_index = gl_VertexID;",
            "    int row = pixel_index / columns;",
            "    int column = pixel_index - row * columns;",
            *body.pixel,
            "}",
            "",
        ]
    )


def _shader(graph: Graph, node: Node) -> str:
    body = write_body(node, _Host(graph), 1)
    reads = _reads(body)
    kind = _vector(node.output)
    names = textures_of(node.output)
    return "\n".join(
        [
            *_head(graph),
            *reads.uniforms,
            *(f"layout(location = {k}) out {kind} write_{name};" for k, name in enumerate(names)),
            "",
            *reads.functions,
            _comment(node.text, "//"),
            "void main() {",
            "    int row = int(gl_FragCoord.y);",
            "    int column = int(gl_FragCoord.x);",
            *(f"    write_{name} = {kind}(0);" for name in names),
            *body.head,
            "    int pixel_index = row * columns + column;",
            *body.pixel,
            "}",
            "",
        ]
    )


def _head(graph: Graph) -> list[str]:
    return [
        "#version 300 es",
        _title(graph, "//"),
        "precision highp float;",
        "precision highp int;",
        "precision highp sampler2D;",
        "precision highp isampler2D;",
        "",
        "uniform int height;",
        "uniform int width;",
        *(f"uniform float parameter_{name};" for name in graph.parameters),
    ]


class _Reads(NamedTuple):
    """The textures that a pass reads: their declarations, and functions that read texels."""

    uniforms: list[str]
    functions: list[str]


def _reads(body: Body) -> _Reads:
    remainder = ["int rem_int(int a, int b) {", "    return a - b * (a / b);", "}", ""]
    reads = _Reads([], remainder)
    for binding in body.bindings:
        kind = _vector(binding.buffer)
        sampler = "isampler2D" if kind == "ivec4" else "sampler2D"
        for name in textures_of(binding.buffer):
            reads.uniforms.append(f"uniform {sampler} {name};")
            reads.functions.extend(
                [
                    f"{kind} texel_of_{name}(int texel) {{",
                    f"    int columns = textureSize({name}, 0).x;",
                    f"    return texelFetch({name}, ivec2(texel % columns, texel / columns), 0);",
                    "}",
                    "",
                ]
            )
    return reads


def _vector(buffer: Buffer) -> str:
    """The type of a texel."""
    return "ivec4" if buffer.dtype == "int32" else "vec4"
