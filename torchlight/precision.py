"""Half precision is refused where tensors come in: sums over thousands of samples would keep two digits of them."""

from __future__ import annotations

import torch
from torch import Tensor

from torchlight.errors import ShapeError


def check_precision(name: str, tensor: Tensor) -> None:
    """Raises ShapeError unless a tensor is float32 or float64."""
    if tensor.dtype not in (torch.float32, torch.float64):
        raise ShapeError(f"{name}: expected float32 or float64, got {tensor.dtype}; convert it with .float()")
