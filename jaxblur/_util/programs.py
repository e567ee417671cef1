"""Programs that XLA has compiled, run by jaxlib alone: jax takes longer to import than they run.

What is run is the executable that jax has run, with the kernels that it calls, so that the results
have the same bits. jaxlib does not promise to keep the functions that are used here; whoever keeps
a program first compares what it gives with what jax gave.
"""

import ctypes
import json
import os
import pathlib
from collections.abc import Sequence
from typing import Any, NamedTuple

from .cache import intact_bytes, is_intact, keep_bytes


class Program(NamedTuple):
    """A program of arrays that gives one float32 array.

    Attributes:
        executable: as XLA serializes it.
        kernels: names of the kernels that it calls; their libraries are beside the program.
        shape: of the result.
    """

    executable: bytes
    kernels: tuple[str, ...]
    shape: tuple[int, ...]


def keep_program(path: pathlib.Path, program: Program) -> None:
    """Write a program, whole or not at all.

    Args:
        path: of the file.
        program: it.

    Raises:
        OSError: the disk refused.
    """
    head = json.dumps({"kernels": program.kernels, "shape": program.shape})
    keep_bytes(path, head.encode() + b"\n" + program.executable)


def read_program(path: pathlib.Path) -> Program | None:
    """Read a program; None if it or one of its kernels is not there as it was compiled.

    Args:
        path: of the file.
    """
    contents = intact_bytes(path)
    if contents is None:
        return None
    head, _, executable = contents.partition(b"\n")
    fields = json.loads(head)
    program = Program(executable, tuple(fields["kernels"]), tuple(fields["shape"]))
    return program if all(is_intact(_library(path, name)) for name in program.kernels) else None


def run_program(path: pathlib.Path, program: Program, inputs: Sequence[Any]) -> Any:
    """Run a program on the CPU.

    Args:
        path: of its file.
        program: it.
        inputs: NumPy arrays of the shapes and types for which it was compiled.

    Returns:
        A NumPy array.

    Raises:
        AttributeError: this jaxlib has other functions; TypeError, ValueError and RuntimeError
            likewise.
        OSError: a kernel cannot be loaded.
    """
    # The C++ part of jaxlib logs messages that a user can do nothing about.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    import numpy as np
    from jaxlib import _hlo, _jax  # pyright: ignore[reportAttributeAccessIssue]

    for name in program.kernels:
        if name not in _jax.custom_call_targets("cpu"):
            function = getattr(ctypes.CDLL(os.fspath(_library(path, name))), name)
            _jax.register_custom_call_target(name, _capsule(function), "cpu", api_version=1)
    client = _jax.get_tfrt_cpu_client(asynchronous=True)
    devices = _jax.DeviceList(tuple(client.local_devices()[:1]))
    executable = client.deserialize_executable(program.executable, executable_devices=devices)

    class OneDevice(_jax.SingleDeviceSharding):
        """What jaxlib asks of the sharding of an array, which jax defines otherwise."""

        memory_kind = None
        _internal_device_list = devices

        def _to_xla_hlo_sharding(self, _: int) -> Any:
            return _hlo.HloSharding.replicate()

    sharding = OneDevice(devices[0])
    buffers = [
        _jax.batched_device_put(_Type.of(array), sharding, [array], list(devices), enable_x64=False)
        for array in inputs
    ]
    handler = _jax.array_result_handler(
        _Type(program.shape, np.dtype(np.float32)), sharding, True, True
    )
    (result,) = executable.execute_sharded(buffers).consume_with_handlers([handler])
    return np.from_dlpack(_Exported(_jax.buffer_to_dlpack_managed_tensor(result))).copy()


class _Type(NamedTuple):
    """What jaxlib asks of the type of an array."""

    shape: tuple[int, ...]
    dtype: Any
    weak_type: bool = False

    @classmethod
    def of(cls, array: Any) -> "_Type":
        return cls(array.shape, array.dtype)


class _Exported:
    """An array of XLA as NumPy takes it."""

    def __init__(self, capsule: Any) -> None:
        self._capsule = capsule

    def __dlpack__(self, **_: Any) -> Any:
        return self._capsule

    def __dlpack_device__(self) -> tuple[int, int]:
        cpu = 1
        return cpu, 0


def _library(path: pathlib.Path, kernel: str) -> pathlib.Path:
    return path.with_name(f"{kernel}.so")


def _capsule(function: Any) -> Any:
    """A function of C as XLA takes it."""
    make = ctypes.pythonapi.PyCapsule_New
    make.restype = ctypes.py_object
    make.argtypes = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
    return make(ctypes.cast(function, ctypes.c_void_p), b"xla._CUSTOM_CALL_TARGET", None)
