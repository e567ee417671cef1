"""Filters as source text for other hosts: plain C, WGSL, HLSL and GLSL, from the trace that JAX runs.

Imports nothing of jaxblur but `filters`, `frame`, `kernels`, `noise` and `settings`. The README
says how it works and what is not covered.
"""

from .graph import Graph as Graph, graph_of as graph_of
from .printer import NotExpressible as NotExpressible
