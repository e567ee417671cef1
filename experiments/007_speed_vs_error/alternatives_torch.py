"""guertin2014 in PyTorch, eager: the functions of `alternatives_numpy` on tensors.

pip install torch
python -m experiments.007_speed_vs_error.alternatives_torch [--size WIDTHxHEIGHT]
"""

from typing import Any

import numpy as np
import torch  # pyright: ignore[reportMissingImports]

from . import alternatives_numpy
from .alternatives import Inputs, check_and_time


class _Torch:
    """PyTorch, with NumPy's names for functions that it names differently."""

    def __getattr__(self, name: str) -> Any:
        return getattr(torch, name)

    take_along_axis = staticmethod(torch.take_along_dim)

    @staticmethod
    def ascontiguousarray(tensor: torch.Tensor) -> torch.Tensor:
        """The tensor, copied if it is not in row-major order."""
        return tensor.contiguous()

    @staticmethod
    def zeros(shape: Any, dtype: Any) -> torch.Tensor:
        """A tensor of zeros, with `bool` meaning `torch.bool`."""
        return torch.zeros(shape, dtype=torch.bool if dtype is bool else dtype)


def _prepare(inputs: Inputs) -> Inputs:
    buffers = {
        name: torch.from_numpy(value)
        for name, value in inputs._asdict().items()
        if isinstance(value, np.ndarray)
    }
    return inputs._replace(**buffers)


def guertin2014(inputs: Inputs) -> np.ndarray:
    """The filter on tensors that share the memory of the inputs.

    Args:
        inputs: frame, noise, parameters and settings as NumPy arrays and numbers.

    Returns:
        (H, W, 3) linear light.
    """
    with torch.inference_mode():
        return alternatives_numpy.guertin2014(_prepare(inputs), _Torch()).numpy()


if __name__ == "__main__":
    check_and_time("PyTorch", guertin2014)
