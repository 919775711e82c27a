"""Half precision is refused in one line wherever tensors come in."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

import torchlight as tl
from torchlight.errors import ShapeError

SCENE = tl.Scene(torch.zeros(0, 3, 3, dtype=torch.float64), tl.Receiver((0.0, 0.0), (4.0, 4.0), (4, 4)))
TRANSFER = tl.Transfer(torch.rand(16, 12, generator=torch.Generator().manual_seed(0)), 2)
PHOTO, SAMPLES, ONES, TEXELS = torch.ones(3, 4, 4), torch.ones(3, 16), torch.ones(16), torch.ones(3, 12)
SKY = torch.ones(3, 4, 8)
ENTRIES: dict[str, Callable[[torch.dtype], object]] = {
    "estimate, photograph": lambda half: tl.estimate(PHOTO.to(half), SCENE, tl.Texels(2), transfer=TRANSFER),
    "estimate, adaptive": lambda half: tl.estimate(PHOTO.to(half), SCENE, solver=tl.AdaptiveHaar(2), transfer=TRANSFER),
    "LinearPhoto": lambda half: tl.LinearPhoto(PHOTO.to(half), torch.ones(4, 4, dtype=torch.bool)),
    "Observation": lambda half: tl.Observation(SAMPLES.to(half), ONES),
    "Transfer": lambda half: tl.Transfer(TRANSFER.transport.to(half), 2),
    "Transfer.to": lambda half: TRANSFER.to(dtype=half),
    "solve": lambda half: tl.solve(TRANSFER.transport.to(half), tl.Observation(SAMPLES, ONES), tl.NNLS()),
    "stream, matrix": lambda half: next(tl.stream(TRANSFER.transport.to(half), iter([SAMPLES[None]]))),
    "stream, frames": lambda half: next(tl.stream(TRANSFER.transport, iter([SAMPLES[None].to(half)]))),
    "irradiance, matrix": lambda half: tl.irradiance(TRANSFER.transport.to(half), TEXELS.to(half)),
    "irradiance, coefficients": lambda half: tl.irradiance(TRANSFER.transport, TEXELS.to(half)),
    "relight": lambda half: tl.relight(SCENE, tl.EnvironmentMap(SKY.to(half)), 100),
    "relight_by": lambda half: tl.relight_by(TRANSFER, SCENE, tl.EnvironmentMap(SKY.to(half))),
}


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16], ids=str)
@pytest.mark.parametrize("entry", ENTRIES)
def test_half_precision_is_refused(entry: str, dtype: torch.dtype) -> None:
    with pytest.raises(ShapeError, match=rf"expected (torch\.)?float32.*, got {dtype}") as raised:
        ENTRIES[entry](dtype)
    assert "\n" not in str(raised.value)
    assert "convert" in str(raised.value)
