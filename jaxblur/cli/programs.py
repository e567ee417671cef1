"""One frame blurred without importing jax, by the program that a former run has compiled.

The plain case is served: one frame, a filter of the package, the built-in noise, no other work that
needs jax. `serves` is the only place that says so; everything else goes through
`filtering.apply_filter`.
"""

import argparse
import contextlib
import functools
import hashlib
import importlib.util
import logging
import os
import pathlib
import re
import sys
from collections.abc import Mapping
from typing import Any

import jaxblur
from jaxblur._util.cache import UnsafeFolderError, private_folder
from jaxblur._util.compiler import find_compiler, machine_words
from jaxblur._util.programs import Program, keep_program, read_program, run_program
from jaxblur.filters.registry import filter_info

from .choice import Choice
from .compute import start_jax
from .loading import Loaded

LOG = logging.getLogger("jaxblur")
# What jaxlib raises if it does not know a program, or has other functions than this one knows.
CANNOT_RUN = (AttributeError, TypeError, ValueError, RuntimeError, OSError)
BUFFERS = ("color", "depth", "velocity", "path", "valid")


def serves(arguments: argparse.Namespace, chosen: Choice, loaded: Loaded) -> bool:
    """Whether `blur` may blur a frame.

    Args:
        arguments: of the command.
        chosen: filter, parameters and settings.
        loaded: the frame.
    """
    info, buffers = filter_info(chosen.name), loaded.buffers
    needs_jax = (
        *(arguments.no_compile_cache, arguments.plan, arguments.subframes),
        arguments.posts,
        *(loaded.neighbors, loaded.exposure, loaded.layers, loaded.ranks),
        loaded.disparity is not None,
        *(loaded.truth is not None, loaded.lens is not None),
        *(buffers.pass_colors is not None, buffers.guide is not None),
        chosen.settings.noise != "none"
        and (arguments.seed is not None or buffers.windows.origin != (0, 0)),
        # Nobody knows what a function from elsewhere depends on.
        not (isinstance(info.function, str) and info.function.startswith("jaxblur.")),
        # jax may choose another device than the CPU.
        importlib.util.find_spec("jax_plugins") is not None,
        os.environ.get("JAX_PLATFORMS", "cpu") != "cpu",
        "jax" in sys.modules,
    )
    return not any(needs_jax)


def blur(chosen: Choice, buffers: Any) -> Any:
    """Blur a frame by the program that a former run has kept, else compile and keep it.

    Args:
        chosen: filter, parameters and settings.
        buffers: as `jaxblur.exr.read_buffers` gives them.

    Returns:
        (H, W, C) NumPy array: to the bit what `filtering.apply_filter` gives.
    """
    import numpy as np

    found = {name: getattr(buffers, name) for name in BUFFERS}
    inputs = {name: np.ascontiguousarray(a) for name, a in found.items() if a is not None}
    inputs |= {name: np.asarray(value, np.float32) for name, value in chosen.parameters.items()}
    path = _path_of(chosen, inputs)
    program = None if path is None else read_program(path)
    if path is not None and program is not None:
        try:
            return run_program(path, program, list(inputs.values()))
        except CANNOT_RUN as error:
            LOG.info("%s cannot be run, and is compiled again: %s", path, error)
    return _compile(chosen, inputs, path)


def _path_of(chosen: Choice, inputs: Mapping[str, Any]) -> pathlib.Path | None:
    """The file of a program, beside its kernels; None if nothing can be kept."""
    try:
        folder = private_folder("kernels")
    except UnsafeFolderError:
        # `start_jax` warns of it.
        return None
    words = [
        *map(_version_of, ("jax", "jaxlib")),
        *machine_words(find_compiler()),
        # Variables change what is compiled.
        *(f"{k}={v}" for k, v in sorted(os.environ.items()) if k.startswith(("JAX", "XLA"))),
        _checksum_of_sources(),
        *(chosen.name, repr(chosen.settings)),
        *(f"{name} {array.dtype} {array.shape}" for name, array in inputs.items()),
    ]
    key = hashlib.sha256("\n".join(words).encode()).hexdigest()[:24]
    return folder / f"jaxblur_{chosen.name}_{key}.xla"


def _version_of(package: str) -> str:
    """The file that says the version of a package, which is not imported."""
    found = importlib.util.find_spec(package)
    assert found is not None and found.origin is not None
    return pathlib.Path(found.origin).with_name("version.py").read_text(encoding="utf-8")


@functools.cache
def _checksum_of_sources() -> str:
    """A checksum of all that a filter is made of."""
    package = pathlib.Path(jaxblur.__file__).parent
    digest = hashlib.sha256()
    folders = (package.glob("*"), *(package.joinpath(n).rglob("*") for n in ("filters", "kernels")))
    for path in sorted(path for folder in folders for path in folder):
        if path.suffix in (".py", ".cc", ".h"):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _compile(chosen: Choice, inputs: Mapping[str, Any], path: pathlib.Path | None) -> Any:
    """Blur through jax, and keep what it has compiled if jaxlib gives the same bits with it."""
    import numpy as np

    start_jax(compile_cache=True)
    import jax

    from jaxblur.frame import Frame

    # XLA cannot serialize what it has itself loaded from jax's cache, and this is kept anyway.
    jax.config.update("jax_enable_compilation_cache", False)
    info = filter_info(chosen.name)

    def blurred(*values: Any) -> Any:
        given = dict(zip(inputs, values, strict=True))
        frame = Frame(**{name: given.pop(name) for name in BUFFERS if name in given})
        return info.call(frame, info.make_parameters(**given), settings=chosen.settings)

    compiled = jax.jit(blurred, keep_unused=True).lower(*inputs.values()).compile()
    image = np.asarray(compiled(*inputs.values()))
    if path is None:
        return image
    try:
        executable: Any = compiled.runtime_executable()
        program = Program(
            executable.client.serialize_executable(executable),
            tuple(sorted(set(re.findall(r"jaxblur_sum_\w+", compiled.as_text() or "")))),
            image.shape,
        )
        again = run_program(path, program, list(inputs.values()))
    except CANNOT_RUN as error:
        LOG.debug("this jaxlib runs no programs without jax: %s", error)
        return image
    if again.tobytes() == image.tobytes():
        # What cannot be written is compiled again in the next run.
        with contextlib.suppress(OSError):
            keep_program(path, program)
    return image
