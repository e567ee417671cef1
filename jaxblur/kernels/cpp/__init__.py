"""Programs as machine code, where a C++ compiler is at hand."""

import functools
import logging
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from ..._util.compiler import NO_COMPILER, find_compiler, loads_kernels
from ..keys import key_of
from ..stages import Grid, Stages
from .build import BuildFailed, Known, find_known, keep_kernels, keep_known, register
from .emit import Kernel, Operands, emit_gather, emit_marks, emit_pull
from .values import Unsupported

LOG = logging.getLogger("jaxblur")

__all__ = ["keep_kernels", "native_gather", "native_marks", "native_pull"]

Call = Callable[..., tuple[jax.Array, ...]]


def native_gather(
    stages: Stages,
    leaves: Sequence[jax.Array],
    locals_: int,
    grid: Grid,
    backend: str,
    kept: int | None = None,
) -> Call | None:
    """A function that runs the stages of a program for every pixel in native code.

    Args:
        stages: of the program.
        leaves: local inputs, then tables; only shapes and types are used here.
        locals_: how many of them are local.
        grid: sizes.
        backend: ``auto``, ``native`` or ``xla``.
        kept: channels of the image that pixels keep whose results are not wanted, 0 if there is
            none: the result is one image then. None for a plane a result.

    Returns:
        A function of the leaves, and of the image kept if there is one; None where XLA has to do
        the work.

    Raises:
        ValueError: the backend is ``native`` and there is no compiler, or no native form.
    """
    operands = Operands.of(leaves, locals_, len(grid.sizes))

    def emit() -> Kernel:
        return emit_gather(stages, operands, kept or 0, kept is not None)

    key = key_of(("gather", tuple(stages), repr(operands), kept))
    return _build(emit, key, grid, (), backend)


def native_pull(
    sample: Callable[..., Any],
    limit: Callable[..., Any] | None,
    count: int,
    leaves: Sequence[jax.Array],
    locals_: int,
    active: Sequence[int],
    terms: Sequence[Any],
    grid: Grid,
    backend: str,
) -> Call | None:
    """A function that carries derivatives of the sums back to the inputs of the samples.

    Args:
        sample: maps (index, place, local, tables) to a tuple of terms.
        limit: maps local to the number of samples, or None.
        count: number of samples N.
        leaves: as `native_gather`.
        locals_: as `native_gather`.
        active: positions of the leaves that are differentiated.
        terms: types of the sums.
        grid: sizes.
        backend: as `native_gather`.

    Returns:
        A function of the wanted pixels (H, W, 1), the leaves and one (H, W, 1) image a sum; it
        returns a plane for each active scalar and for each channel of an active local image, a
        flat table for each active table. None where XLA has to do the work.

    Raises:
        ValueError: the backend is ``native`` and there is no compiler, or no native form.
    """
    operands = Operands.of(leaves, locals_, len(grid.sizes))
    lengths = [leaves[k].size for k in active if k >= locals_]
    names = tuple(np.dtype(term).name for term in terms)

    def emit() -> Kernel:
        return emit_pull(sample, limit, count, operands, tuple(active), names)

    key = key_of(("pull", sample, limit, count, repr(operands), tuple(active), names))
    return _build(emit, key, grid, lengths, backend)


def native_marks(
    stages: Stages,
    leaves: Sequence[jax.Array],
    locals_: int,
    grid: Grid,
    length: int,
    backend: str,
    apart: int,
) -> Call | None:
    """A function that finds the largest mark at each place of a table.

    Args:
        stages: of a program whose samples are marks.
        leaves: as `native_gather`.
        locals_: as `native_gather`.
        grid: sizes.
        length: of the table.
        backend: as `native_gather`.
        apart: as `jaxblur.kernels.largest_marks`.

    Returns:
        A function of the leaves, which returns the table; None where XLA has to do the work.

    Raises:
        ValueError: the backend is ``native`` and there is no compiler, or no native form.
    """
    operands = Operands.of(leaves, locals_, len(grid.sizes))
    key = key_of(("marks", tuple(stages), repr(operands), apart))

    def emit() -> Kernel:
        return emit_marks(stages, operands, apart)

    return _build(emit, key, grid, [length], backend, np.int32)


def _build(
    emit: Callable[[], Kernel],
    key: str | None,
    grid: Grid,
    lengths: Sequence[int],
    backend: str,
    element: Any = np.float32,
) -> Call | None:
    """Compile the kernel that `emit` prints, whose tables have these lengths.

    Where a former run has done so under the same key, it is not printed again.
    """
    if backend == "xla":
        return None
    if not loads_kernels():
        return _refuse(backend, "native code runs on Linux and macOS only")
    if find_compiler() is None:
        return _refuse(backend, NO_COMPILER, warn=jax.default_backend() == "cpu")
    try:
        known = find_known(key)
        if known is None:
            kernel = emit()
            known = Known(register(kernel.source), kernel.planes, kernel.is_image)
            keep_known(key, known)
    except Unsupported as error:
        return _refuse(backend, f"the program uses {error}")
    except BuildFailed as error:
        return _refuse(backend, str(error), warn=True)
    return _caller(known, grid, lengths, element)


def _refuse(backend: str, reason: str, warn: bool = False) -> None:
    """Say why XLA does the work instead, or fail if the caller insists on native code."""
    if backend == "native":
        raise ValueError(f"`backend` is 'native', but {reason}; use 'auto' or 'xla'.")
    if warn:
        _warn_once(f"{reason}; XLA does the work, several times as slow")
    else:
        LOG.info("no native kernel: %s", reason)


@functools.cache
def _warn_once(message: str) -> None:
    LOG.warning("%s", message)


def _caller(kernel: Known, grid: Grid, lengths: Sequence[int], element: Any) -> Call:
    """The call into the kernel, one after the other under vmap."""
    plane = grid.height, grid.width
    shapes = [(*plane, kernel.planes)] if kernel.is_image else [plane] * kernel.planes
    results = [jax.ShapeDtypeStruct(shape, np.float32) for shape in shapes]
    results += [jax.ShapeDtypeStruct((length,), element) for length in lengths]
    call = jax.ffi.ffi_call(kernel.target, results, vmap_method="sequential")
    sizes = np.asarray([*plane, *grid.sizes], np.int32)

    def run(*leaves: jax.Array) -> tuple[jax.Array, ...]:
        # Flat, so that an image that is both local and a table is one operand in memory.
        flat = (leaf.reshape(-1) if leaf.ndim else leaf for leaf in leaves)
        return tuple(call(*flat, sizes=sizes))

    return run
