"""The folder of one photograph, as `torchlight estimate` wrote it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load
from torch import Tensor

from torchlight.errors import FormatError
from torchlight.io.files import one_line, read_bytes
from torchlight.io.lights import read_light
from torchlight.light.environment import EnvironmentMap


@dataclass(frozen=True, eq=False)
class ResultFolder:
    """What a result holds.

    Attributes:
        result: result.json.
        light: light.exr.
        tensors: estimate.safetensors.
    """

    result: dict[str, Any]
    light: EnvironmentMap
    tensors: dict[str, Tensor]


def read_result(folder: str | Path) -> ResultFolder:
    """Returns the result in a folder.

    Raises:
        FormatError: it holds none, or a file of it is missing or damaged.
    """
    folder = Path(folder)
    path = folder / "result.json"
    if not path.is_file():
        inside = sorted(child.name for child in folder.iterdir() if (child / "result.json").is_file())
        there = f"; name one of its folders: {', '.join(inside[:3])}" if inside else "; torchlight estimate writes one"
        raise FormatError(f"{folder}: holds no result.json{there}")
    try:
        result = json.loads(read_bytes(path))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: not JSON: {one_line(str(error))}; it was changed by hand?") from error
    if not isinstance(result, dict):
        raise FormatError(f"{path}: expected a JSON object; it was changed by hand?")
    stored = folder / "estimate.safetensors"
    try:
        tensors = load(read_bytes(stored))
    except SafetensorError as error:
        raise FormatError(f"{stored}: cannot be read: {one_line(str(error))}; run torchlight estimate again") from error
    return ResultFolder(result, read_light(folder / "light.exr"), tensors)
