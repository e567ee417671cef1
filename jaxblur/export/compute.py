"""Compute shaders: WGSL for WebGPU, HLSL for Direct3D engines. One entry point a pass."""

import textwrap

from .body import Body, write_body
from .dialects import HLSL, WGSL
from .expressions import Dialect, Value
from .graph import Graph, Node
from .plan import GROUP
from .printer import Table


class _Host:
    """See `.body.Host`."""

    leave = "return;"

    def __init__(self, dialect: Dialect, graph: Graph) -> None:
        self.dialect = dialect
        written = [f"write_{buffer.name}" for buffer in graph.buffers]
        passes = [f"pass_{node.name}" for node in graph.nodes]
        buffers = [buffer.name for buffer in graph.buffers]
        self.taken = ("id", "uniforms", "sign_of", "sign_of_int", *buffers, *written, *passes)

    def read(self, table: Table, index: Value) -> str:
        return f"{table.name}[{index.code}]"

    def store(self, node: Node, channel: int, code: str) -> str:
        channels = node.output.channels
        place = "pixel_index" if channels == 1 else f"{channels} * pixel_index"
        place = f"{place} + {channel}" if channel else place
        return f"write_{node.output.name}[{place}] = {code};"

    def mark(self, node: Node, place: str, mark: str) -> str:
        if self.dialect is WGSL:
            return f"atomicMax(&write_{node.output.name}[{place}], {mark});"
        return f"InterlockedMax(write_{node.output.name}[{place}], {mark});"

    def parameter(self, name: str) -> str:
        return f"uniforms.{name}" if self.dialect is WGSL else f"parameter_{name}"


def print_wgsl(graph: Graph) -> str:
    """Print a filter as WGSL.

    Args:
        graph: the filter.

    Returns:
        A module with one entry point a pass.

    Raises:
        NotExpressible: the filter does something that has no form in WGSL.
    """
    marked = {node.output for node in graph.nodes if node.run.kind == "marks"}
    lines = [_title(graph, "//"), "struct Uniforms {", "    height: i32,", "    width: i32,"]
    lines += [f"    {name}: f32," for name in graph.parameters]
    lines += ["}", "", "@group(0) @binding(0) var<uniform> uniforms: Uniforms;"]
    for number, buffer in enumerate(graph.buffers, 1):
        kind = WGSL.type_of(buffer.dtype)
        at = f"@group(0) @binding({number})"
        if buffer.role != "output":
            lines.append(f"{at} var<storage, read> {buffer.name}: array<{kind}>;")
        if buffer.role != "input":
            kind = f"atomic<{kind}>" if buffer in marked else kind
            lines.append(f"{at} var<storage, read_write> write_{buffer.name}: array<{kind}>;")
    for node in graph.nodes:
        body = write_body(node, _Host(WGSL, graph), 1)
        lines += [
            "",
            _comment(node.text, "//"),
            f"@compute @workgroup_size({GROUP}, {GROUP})",
            f"fn pass_{node.name}(@builtin(global_invocation_id) id: vec3<u32>) {{",
            "    let height = uniforms.height;",
            "    let width = uniforms.width;",
            "    let row = i32(id.y);",
            "    let column = i32(id.x);",
            *_pixel(body, "let"),
            "}",
        ]
    return "\n".join([*lines, ""])


def print_hlsl(graph: Graph) -> str:
    """Print a filter as HLSL.

    Args:
        graph: the filter.

    Returns:
        A file with one compute entry point a pass, for shader model 5 or later.

    Raises:
        NotExpressible: the filter does something that has no form in HLSL.
    """
    lines = [_title(graph, "//"), "cbuffer Uniforms : register(b0)", "{"]
    lines += ["    int height;", "    int width;"]
    lines += [f"    float parameter_{name};" for name in graph.parameters]
    lines += ["};", ""]
    for number, buffer in enumerate(graph.buffers, 1):
        kind = HLSL.type_of(buffer.dtype)
        if buffer.role != "output":
            lines.append(f"StructuredBuffer<{kind}> {buffer.name} : register(t{number});")
        if buffer.role != "input":
            name = f"write_{buffer.name}"
            lines.append(f"RWStructuredBuffer<{kind}> {name} : register(u{number});")
    for kind, name, one in (("float", "sign_of", "1.0f"), ("int", "sign_of_int", "1")):
        zero = one.replace("1", "0", 1)
        code = f"a > {zero} ? {one} : (a < {zero} ? -{one} : {zero})"
        lines += ["", f"{kind} {name}({kind} a)", "{", f"    return {code};", "}"]
    for node in graph.nodes:
        body = write_body(node, _Host(HLSL, graph), 1)
        lines += [
            "",
            _comment(node.text, "//"),
            f"[numthreads({GROUP}, {GROUP}, 1)]",
            f"void pass_{node.name}(uint3 id : SV_DispatchThreadID)",
            "{",
            "    const int row = int(id.y);",
            "    const int column = int(id.x);",
            *_pixel(body, "const int"),
            "}",
        ]
    return "\n".join([*lines, ""])


def _pixel(body: Body, declares: str) -> list[str]:
    return [
        *body.head,
        "    if (row >= rows || column >= columns) {",
        "        return;",
        "    }",
        f"    {declares} pixel_index = row * columns + column;",
        *body.pixel,
    ]


def _title(graph: Graph, mark: str) -> str:
    text = f"The filter {graph.filter.name} of jaxblur: {graph.filter.summary}. Printed from the "
    text += "program that JAX runs; do not edit. The README beside it lists buffers and passes."
    order = ", ".join(f"pass_{node.name}" for node in graph.nodes)
    return f"{_comment(text, mark)}\n{_comment(f'In this order: {order}.', mark)}\n"


def _comment(text: str, mark: str) -> str:
    return "\n".join(f"{mark} {line}" for line in textwrap.wrap(text, 92))
