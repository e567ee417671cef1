"""Fragment shaders in GLSL ES 3.00, for WebGL 2 and hosts that draw passes: one text a pass."""

from .body import write_body
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
        self.taken = ("rem_int", *textures, *reads, *uniforms, *written)

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
        raise NotExpressible(f"glsl: {_marks_message(node)}")

    def parameter(self, name: str) -> str:
        return f"parameter_{name}"


def print_glsl(graph: Graph) -> dict[str, str]:
    """Print a filter as fragment shaders.

    Args:
        graph: the filter.

    Returns:
        For each pass, by name and in order, a shader that is drawn over all texels of its output.

    Raises:
        NotExpressible: a pass leaves marks, or does something else that has no form here.
    """
    for node in graph.nodes:
        if node.run.kind == "marks":
            raise NotExpressible(
                f"{graph.filter.name} cannot be exported as glsl: {_marks_message(node)}; use "
                "wgsl, hlsl or c."
            )
    return {node.name: _shader(graph, node) for node in graph.nodes}


def _marks_message(node: Node) -> str:
    return (
        f"the pass {node.name} keeps the largest of marks of 31 bits at places that it computes, "
        "which fragment shaders of GLSL ES 3.00 cannot"
    )


def _shader(graph: Graph, node: Node) -> str:
    body = write_body(node, _Host(graph), 1)
    lines = [
        "#version 300 es",
        _title(graph, "//"),
        "precision highp float;",
        "precision highp int;",
        "precision highp sampler2D;",
        "",
        "uniform int height;",
        "uniform int width;",
        *(f"uniform float parameter_{name};" for name in graph.parameters),
    ]
    reads = []
    for binding in body.bindings:
        for name in textures_of(binding.buffer):
            lines.append(f"uniform sampler2D {name};")
            columns = f"textureSize({name}, 0).x"
            reads += [
                f"vec4 texel_of_{name}(int texel) {{",
                f"    int columns = {columns};",
                f"    return texelFetch({name}, ivec2(texel % columns, texel / columns), 0);",
                "}",
                "",
            ]
    for number, name in enumerate(textures_of(node.output)):
        lines.append(f"layout(location = {number}) out vec4 write_{name};")
    lines += ["", "int rem_int(int a, int b) {", "    return a - b * (a / b);", "}", "", *reads]
    zeros = [f"    write_{name} = vec4(0.0);" for name in textures_of(node.output)]
    lines += [
        _comment(node.text, "//"),
        "void main() {",
        "    int row = int(gl_FragCoord.y);",
        "    int column = int(gl_FragCoord.x);",
        *zeros,
        *body.head,
        "    int pixel_index = row * columns + column;",
        *body.pixel,
        "}",
    ]
    return "\n".join([*lines, ""])
