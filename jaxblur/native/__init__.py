"""Gathers along lines as machine code, where a C++ compiler is at hand."""

import functools
import logging
from collections.abc import Callable, Sequence
from typing import Any

import jax

from .build import BuildFailed, find_compiler, keep_kernels, register
from .emit import Kernel, Stages, emit_gather, emit_marks, emit_pull, no_samples
from .operations import Unsupported

LOG = logging.getLogger("jaxblur")

__all__ = [
    "Stages",
    "keep_kernels",
    "native_gather",
    "native_marks",
    "native_pull",
    "no_samples",
]

Sample = Callable[..., Any]


def native_gather(
    stages: Stages,
    count: int,
    size: tuple[int, int],
    operands: tuple[Any, Any],
    backend: str,
    kept: int = 0,
) -> Callable[..., tuple[jax.Array, ...]] | None:
    """A function that gathers the samples of every pixel on the CPU in native code.

    Args:
        stages: what happens at a pixel.
        count: number of samples N.
        size: (H, W).
        operands: (local, tables); only shapes and types are used here.
        backend: ``auto``, ``native`` or ``xla``.
        kept: channels of an image that pixels keep which do not move; 0 if there is none.

    Returns:
        A function of the leaves of the operands, and of the image kept if there is one; None where
        XLA has to do it. See `emit_gather` for its results.

    Raises:
        ValueError: the backend is ``native`` and there is no compiler, or no native form.
    """
    return _build(lambda: emit_gather(stages, count, size, *operands, kept), backend)


def native_pull(
    sample: Sample,
    limit: Callable[..., Any] | None,
    count: int,
    size: tuple[int, int],
    operands: tuple[Any, Any],
    active: Sequence[int],
    terms: Sequence[Any],
    backend: str,
) -> Callable[..., tuple[jax.Array, ...]] | None:
    """A function that carries derivatives of the sums back to what the samples read.

    Args:
        sample: maps (sample indices (n,), local, tables) to a tuple of (H, W, n) arrays.
        limit: as that of `Stages`, from local.
        count: as `native_gather`.
        size: as `native_gather`.
        operands: as `native_gather`.
        active: positions of the leaves that are differentiated.
        terms: shapes and types of the sums.
        backend: as `native_gather`.

    Returns:
        A function of the moving pixels, the leaves of the operands and one (H, W, 1) image a sum;
        it returns a plane for each active plane or scalar and for each channel of an active image,
        a table for each active table. None where XLA has to do it.

    Raises:
        ValueError: the backend is ``native`` and there is no compiler, or no native form.
    """
    return _build(lambda: emit_pull(sample, limit, count, size, operands, active, terms), backend)


def native_marks(
    sample: Sample,
    limit: Callable[..., Any],
    size: tuple[int, int],
    operands: tuple[Any, Any],
    length: int,
    backend: str,
) -> Callable[..., tuple[jax.Array, ...]] | None:
    """A function that finds the largest mark that samples leave at each place of a table.

    Args:
        sample: see `emit_marks`.
        limit: as above.
        size: (H, W).
        operands: (local, tables); only shapes and types are used here.
        length: of the table.
        backend: as `native_gather`.

    Returns:
        A function of the leaves of the operands, which returns the table; None where XLA has to do
        it.

    Raises:
        ValueError: the backend is ``native`` and there is no compiler, or no native form.
    """
    return _build(lambda: emit_marks(sample, limit, size, operands, length), backend)


def _build(emit: Callable[[], Kernel], backend: str) -> Callable[..., tuple[jax.Array, ...]] | None:
    """Compile what `emit` writes."""
    if backend == "xla":
        return None
    if find_compiler() is None:
        return _refuse(backend, "there is no C++ compiler")
    try:
        kernel = emit()
        target = register(kernel.source)
    except Unsupported as error:
        return _refuse(backend, f"the samples use {error}")
    except BuildFailed as error:
        _warn_once(f"{error}; XLA does its work, several times as slow")
        return _refuse(backend, str(error))
    return _caller(target, kernel)


def _refuse(backend: str, reason: str) -> None:
    """Say why XLA does the work instead, or fail if the caller insists on native code."""
    if backend == "native":
        raise ValueError(f"`backend` is 'native', but {reason}; use 'auto' or 'xla'.")
    LOG.info("no native kernel: %s", reason)


@functools.cache
def _warn_once(message: str) -> None:
    """A compiler that is there and fails is a fault, unlike one that is missing."""
    LOG.warning("%s", message)


def _caller(target: str, kernel: Kernel) -> Callable[..., Any]:
    """The call into the kernel, one after the other under vmap."""
    # The kernel returns its sums first, then its tables.
    order = sorted(range(len(kernel.shapes)), key=lambda k: len(kernel.shapes[k]) == 1)
    results = [jax.ShapeDtypeStruct(kernel.shapes[k], kernel.dtype) for k in order]
    call = jax.ffi.ffi_call(target, results, vmap_method="sequential")

    def run(*leaves: jax.Array) -> tuple[jax.Array, ...]:
        # Flat, so that a plane that is both local and a table is one operand in memory.
        flat = (leaf.reshape(-1) if leaf.ndim else leaf for leaf in leaves)
        values = dict(zip(order, call(*flat), strict=True))
        return tuple(values[position] for position in range(len(order)))

    return run
