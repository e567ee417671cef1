"""One tree's side of `guard`: runs filters and measures programs.

    python guard_worker.py serve NUMBER   # answers requests from the pipe of that descriptor
    python guard_worker.py fresh FILTER   # blurs a frame as the first thing of a process

Runs by its path under either tree, so that it uses only jax, NumPy and public names of both.
"""

import functools
import gc
import math
import os
import resource
import sys
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur

PUBLISHED = {
    "guertin2014": ("GuertinParameters", 35, 40),
    "mcguire2012": ("McGuireParameters", 15, 20),
    "pixel_velocity": (None, 35, 40),
    "layered": ("LayeredParameters", 35, 160),
}
"""Class of the parameters, samples and radius of each filter as published."""
FRAMES = ("dense", "30 % moves", "silhouettes", "random")
VALUES_SIZE = (181, 317)
VISIT_SECONDS, MOST_RUNS = 0.15, 8
"""One visit repeats a program for about that long, but at most so many times."""


class Case(NamedTuple):
    """A filter with its choices; the tile choice is empty but for guertin2014."""

    filter: str
    fetch: str
    backend: str
    tile_choice: str = ""

    def __str__(self) -> str:
        return ", ".join(word for word in self if word)


def make_settings(case: Case) -> Any:
    """The published settings of a filter with the choices of a case."""
    _, samples, radius = PUBLISHED[case.filter]
    choices: dict[str, Any] = {"fetch": case.fetch, "backend": case.backend}
    kind = jaxblur.Settings
    if case.tile_choice:
        # Older trees have one class of settings for all filters.
        kind = getattr(jaxblur, "GuertinSettings", kind)
        choices["tile_choice"] = case.tile_choice
    return kind(samples=samples, radius=radius, **choices)


def make_parameters(name: str) -> Any:
    """The published parameters of a filter as float32 arrays, None if it has none."""
    kind = PUBLISHED[name][0]
    return None if kind is None else jax.tree.map(jnp.float32, getattr(jaxblur, kind)())


@functools.cache
def make_frame(kind: str, size: tuple[int, int], path: bool = False) -> jaxblur.Frame:
    """A made-up frame of one of `FRAMES`, (height, width), the same in every process."""
    generator = np.random.default_rng(0)
    y, x = np.mgrid[: size[0], : size[1]].astype(np.float32)
    color = generator.random((*size, 3), np.float32)
    depth = 5 + np.sin(x / 33) + np.cos(y / 21)
    velocity = np.stack([25 * np.cos(y / 80) + 8 * np.sin(x / 50), 20 * np.sin(x / 90)], axis=-1)
    if kind == "30 % moves":
        velocity[:, round(0.3 * size[1] / 40) * 40 :] = 0
    elif kind == "silhouettes":
        velocity *= 0.1
        sky = y < size[0] / 4
        velocity[sky], depth[sky] = 0, np.inf
        # Overlapping discs, each nearer than the last, that move against each other.
        for k, motion in enumerate(((30, 4), (-30, -4), (0, 25), (-12, 18))):
            center_x, center_y = (0.2 + 0.2 * k) * size[1], (0.3 + 0.13 * k) * size[0]
            disc = np.hypot(x - center_x, y - center_y) < 0.2 * size[0]
            velocity[disc], depth[disc] = motion, 4 - 0.8 * k
    elif kind == "random":
        depth = generator.uniform(1, 10, size)
        depth[generator.random(size) < 0.1] = np.inf
        velocity = generator.normal(size=(*size, 2)) * 4.5
        velocity[generator.random(size) < 0.2] = 0
    buffers = [color, depth, velocity]
    if path:
        bend = 0.2 * velocity[..., ::-1]
        buffers.append(np.stack([bend - velocity, bend + velocity], axis=-2))
    return jaxblur.Frame(*(jnp.asarray(buffer, jnp.float32) for buffer in buffers))


def make_programs(case: Case) -> dict[str, Callable[..., Any]]:
    """Functions of a frame and parameters, by name."""
    settings = make_settings(case)

    def blur(frame, parameters):
        return jaxblur.FILTERS[case.filter](frame, parameters, settings=settings)

    def loss(frame, parameters):
        return jnp.mean(jnp.square(blur(frame, parameters) - 0.5)) * frame.depth.size

    def derivatives(*inputs):
        generator = np.random.default_rng(1)
        direction = jax.tree.map(
            lambda leaf: jnp.asarray(generator.normal(size=leaf.shape), jnp.float32), inputs
        )
        return jax.jvp(blur, inputs, direction)[1], jax.grad(loss, (0, 1))(*inputs)

    return {
        "forward": blur,
        "gradient of scalars": jax.value_and_grad(loss, 1),
        "gradient of every input": jax.value_and_grad(loss, (0, 1)),
        "derivatives": derivatives,
    }


def values(case: Case) -> dict[str, dict[str, np.ndarray]]:
    """By frame: the image, a forward-mode derivative, and the gradient by each input."""
    jax.clear_caches()
    programs, parameters = make_programs(case), make_parameters(case.filter)
    forward, derivatives = jax.jit(programs["forward"]), jax.jit(programs["derivatives"])
    results = {}
    for kind in FRAMES:
        frame = make_frame(kind, VALUES_SIZE, kind == "random" and case.filter == "layered")
        tangent, gradients = derivatives(frame, parameters)
        results[kind] = {"image": forward(frame, parameters), "forward mode": tangent}
        for path, gradient in jax.tree.leaves_with_path(gradients):
            results[kind][jax.tree_util.keystr(path[1:])[1:]] = gradient
    return jax.tree.map(np.asarray, results)


@functools.cache
def compiled(case: Case, program: str, size: tuple[int, int]) -> Any:
    """A program of `make_programs`, compiled for frames of (height, width)."""
    arguments = make_frame("dense", size), make_parameters(case.filter)
    return jax.jit(make_programs(case)[program]).lower(*arguments).compile()


def build(case: Case, program: str, size: tuple[int, int]) -> tuple[float, float]:
    """Compile a program: processor seconds, and its temporaries in MB."""
    jax.block_until_ready(make_frame("dense", size))
    start = clocks()
    memory = compiled(case, program, size).memory_analysis()
    return elapsed(start)[1], memory.temp_size_in_bytes / 1e6


def visit(case: Case, program: str, size: tuple[int, int], frame: str) -> tuple[float, float]:
    """Mean wall-clock and processor seconds of a few runs, after one to settle."""
    run = functools.partial(
        compiled(case, program, size), make_frame(frame, size), make_parameters(case.filter)
    )
    start = clocks()
    jax.block_until_ready(run())
    runs = min(MOST_RUNS, math.ceil(VISIT_SECONDS / elapsed(start)[0]))
    start = clocks()
    for _ in range(runs):
        jax.block_until_ready(run())
    wall, processor = elapsed(start)
    return wall / runs, processor / runs


def clocks() -> tuple[float, float]:
    """Wall-clock and processor seconds, the latter with threads and ended child processes."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.perf_counter(), time.process_time() + children.ru_utime + children.ru_stime


def elapsed(start: tuple[float, float]) -> tuple[float, float]:
    """Seconds since `clocks` gave its times."""
    wall, processor = clocks()
    return wall - start[0], processor - start[1]


def serve(connection: Connection) -> None:
    """Say where jaxblur is, then answer requests (function, case, arguments) until they end."""
    functions = {"values": values, "build": build, "visit": visit}
    connection.send(os.path.dirname(jaxblur.__file__))
    while True:
        try:
            name, case, arguments = connection.recv()
        except EOFError:
            return
        connection.send(functions[name](Case(*case), *arguments))


def fresh(name: str) -> None:
    """Blur a frame of 1280x720 and keep compiled code, as the command line does."""
    gc.freeze()
    jax.config.update("jax_compilation_cache_dir", f"{os.environ['XDG_CACHE_HOME']}/jaxblur")
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    fetch = "bilinear" if name == "layered" else "nearest"
    settings = make_settings(Case(name, fetch, "native"))
    frame = make_frame("dense", (720, 1280))
    blurred = jaxblur.FILTERS[name](frame, make_parameters(name), settings=settings)
    blurred.block_until_ready()


if __name__ == "__main__":
    command, argument = sys.argv[1:]
    serve(Connection(int(argument))) if command == "serve" else fresh(argument)
