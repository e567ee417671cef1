"""Filters compiled ahead of time, and the machine that they run on."""

import dataclasses
import os
import platform
import time
from typing import Any

import jax
import jax.numpy as jnp

from ..filters.registry import filter_info
from ..frame import Frame
from ..settings import Settings


@dataclasses.dataclass(frozen=True)
class Program:
    """A filter, compiled for one size.

    Attributes:
        compiled: function of `parameter_leaves` and a frame.
        compile_seconds: of tracing and compiling.
        temporary_bytes: peak of the temporary buffers by the compiler's account, or None.
    """

    compiled: Any
    compile_seconds: float
    temporary_bytes: int | None


class Programs:
    """Compiled filters. Settings that give the same program share it, and its figures."""

    def __init__(self):
        self._by_case: dict[Any, Program] = {}
        self._by_text: dict[str, Program] = {}

    def get(self, method: str, settings: Settings, frame: Frame) -> Program:
        """The program for a frame of this size, compiled if it is new.

        Raises:
            ValueError: the filter rejects the settings.
        """
        shapes = tuple(buffer.shape for buffer in jax.tree.leaves(frame))
        key = method, settings, shapes
        if key not in self._by_case:
            self._by_case[key] = self._compile(method, settings, frame)
        return self._by_case[key]

    def _compile(self, method: str, settings: Settings, frame: Frame) -> Program:
        info = filter_info(method)
        structure = jax.tree.structure(info.make_parameters())

        def blur(leaves: list[jax.Array], frame: Frame) -> jax.Array:
            return info.call(frame, jax.tree.unflatten(structure, leaves), settings=settings)

        started = time.perf_counter()
        lowered = jax.jit(blur).lower(parameter_leaves(method), frame)
        text = lowered.as_text()
        if text not in self._by_text:
            compiled = lowered.compile()
            seconds = time.perf_counter() - started
            analysis = compiled.memory_analysis()
            temporary = None if analysis is None else int(analysis.temp_size_in_bytes)
            self._by_text[text] = Program(compiled, seconds, temporary)
        return self._by_text[text]


def parameter_leaves(method: str) -> list[jax.Array]:
    """The default parameters of a filter, float32, in the order of their record."""
    parameters = filter_info(method).make_parameters()
    return [jnp.asarray(leaf, jnp.float32) for leaf in jax.tree.leaves(parameters)]


def machine() -> str:
    """The version of jax, the kind of device and the number of processors, in a few words."""
    device = jax.devices()[0].device_kind
    return f"jax {jax.__version__} {device} {platform.machine()} x{os.cpu_count()}"
