"""The plan of a printed filter: buffers, passes and uniforms as data, for those who run shaders."""

from typing import Any

from .body import bindings_of
from .graph import Buffer, Graph, Size

GROUP = 8
"""Invocations of a compute shader along each axis."""


def plan_of(graph: Graph) -> dict[str, Any]:
    """Everything that a host must know to run the passes.

    Args:
        graph: the filter.

    Returns:
        A tree for JSON. ``buffers`` in the order of their bindings, which count from 1; binding 0
        holds the uniforms: height and width as int32, then the parameters as float32. ``passes``
        in their order; ``marks`` is the number of marks that a pixel leaves, 0 if it leaves none or
        any number.
    """
    return {
        "filter": graph.filter.name,
        "channels": graph.channels,
        "group": GROUP,
        "uniforms": [
            {"name": "height", "type": "int32"},
            {"name": "width", "type": "int32"},
            *(
                {"name": name, "type": "float32", "value": value}
                for name, value in graph.parameters.items()
            ),
        ],
        "buffers": [
            {
                "name": buffer.name,
                "binding": number,
                "type": buffer.dtype,
                "channels": buffer.channels,
                "size": _size(buffer.size),
                "role": buffer.role,
                "clear": _is_marked(graph, buffer),
            }
            for number, buffer in enumerate(graph.buffers, 1)
        ],
        "passes": [
            {
                "name": node.name,
                "does": node.text,
                "grid": _size(node.size),
                "reads": [buffer.name for buffer in bindings_of(node)],
                "writes": node.output.name,
                "marks": node.run.apart,
            }
            for node in graph.nodes
        ],
    }


def _size(size: Size) -> dict[str, Any]:
    return {"of": size.of, "factor": size.factor}


def _is_marked(graph: Graph, buffer: Buffer) -> bool:
    """Whether a buffer must be all 0 before a pass leaves marks in it."""
    return any(node.run.kind == "marks" and node.output is buffer for node in graph.nodes)
