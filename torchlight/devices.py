"""Data on another device."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar, cast

import torch
from torch import Tensor

Data = TypeVar("Data")


def moved(data: Data, device: torch.device | str) -> Data:
    """Returns frozen data, a dataclass of tensors, of other such data and of plain values, with its tensors there."""
    return cast(Data, _moved(data, device))


def _moved(data: Any, device: torch.device | str) -> Any:
    if isinstance(data, Tensor):
        return data.to(device)
    if is_dataclass(data) and not isinstance(data, type):
        return replace(data, **{field.name: _moved(getattr(data, field.name), device) for field in fields(data)})
    return data
