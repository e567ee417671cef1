"""Filters as source text for other hosts: C, WGSL, HLSL and GLSL, from the trace that JAX runs.

Imports nothing of jaxblur but `_util`, `exr`, `filters`, `frame`, `kernels`, `noise` and
`settings`. The README says how it works and what is not covered.
"""

from .expressions import NotExpressible as NotExpressible
from .graph import Graph as Graph, graph_of as graph_of
from .package import (
    LANGUAGES as LANGUAGES,
    Language as Language,
    check_empty as check_empty,
    sources_of as sources_of,
    write_package as write_package,
)
from .play import PlayForms as PlayForms, build_play as build_play
