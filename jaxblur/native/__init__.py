"""The sum over samples as machine code, where a C++ compiler is at hand."""

import logging
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from .build import BuildFailed, find_compiler, register
from .emit import Kernel, Unsupported, emit_kernel

LOG = logging.getLogger("jaxblur")

__all__ = ["BuildFailed", "Unsupported", "emit_kernel", "find_compiler", "native_sum"]


def _refuse(backend: str, reason: str) -> None:
    """Say why XLA does the work instead, or fail if the caller insists on native code."""
    if backend == "native":
        raise ValueError(f"`backend` is 'native', but {reason}; use 'auto' or 'xla'.")
    LOG.info("no native kernel: %s", reason)


def native_sum(
    sample: Callable[..., Any],
    count: int,
    size: tuple[int, int],
    local: Any,
    tables: Any,
    backend: str,
) -> Callable[..., tuple[jax.Array, ...]] | None:
    """A function (moving, local, tables) that sums the samples on the CPU in native code.

    Args:
        sample: see `jaxblur.sampling.sum_samples`.
        count: number of samples N.
        size: (H, W).
        local: pytree of (H, W, 1) planes and scalars; only shapes and types are used here.
        tables: pytree of (H * W,) arrays; only shapes and types are used here.
        backend: ``auto``, ``native`` or ``xla``.

    Returns:
        The function, or None where XLA has to do it.

    Raises:
        ValueError: the backend is ``native`` and there is no compiler, or no native form.
    """
    if backend == "xla":
        return None
    if find_compiler() is None:
        return _refuse(backend, "there is no C++ compiler")
    try:
        kernel = emit_kernel(sample, count, size, local, tables)
        target = register(kernel.source)
    except Unsupported as error:
        return _refuse(backend, f"the samples use {error}")
    except BuildFailed as error:
        return _refuse(backend, str(error))
    return _caller(target, kernel, size)


def _caller(target: str, kernel: Kernel, size: tuple[int, int]) -> Callable[..., Any]:
    """The call into the kernel, one after the other under vmap."""
    results = [jax.ShapeDtypeStruct(size, jnp.float32)] * kernel.outputs
    call = jax.ffi.ffi_call(target, results, vmap_method="sequential")

    def sums(moving: jax.Array, local: Any, tables: Any) -> tuple[jax.Array, ...]:
        leaves = [jnp.asarray(leaf) for leaf in jax.tree.leaves((local, tables))]
        return tuple(call(moving, *leaves))

    return sums
