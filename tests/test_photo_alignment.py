"""Shifts between two exposures of a random scene."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from torchlight.photo.alignment import shift_between


def scene(height: int, width: int) -> Tensor:
    """Smooth random radiance over several stops, larger than the frame on all sides by 100 pixels."""
    generator = torch.Generator().manual_seed(0)
    coarse = torch.randn(1, 1, height // 16 + 20, width // 16 + 20, generator=generator)
    size = (height + 200, width + 200)
    return (1.2 * torch.nn.functional.interpolate(coarse, size=size, mode="bicubic")[0, 0]).exp()


def exposed(radiance: Tensor, exposure: float, shift: tuple[int, int], size: tuple[int, int]) -> Tensor:
    x, y = 100 - shift[0], 100 - shift[1]
    view = radiance[y : y + size[0], x : x + size[1]]
    return ((0.3 * view * exposure).clamp(0, 1) ** (1 / 2.2) * 255).round() / 255


@pytest.mark.parametrize("shift", [(0, 0), (1, 0), (0, -2), (-7, 13), (60, -50)])
@pytest.mark.parametrize("stops", [1, 3])
def test_shifts_are_exact(shift: tuple[int, int], stops: int) -> None:
    radiance, size = scene(240, 320), (240, 320)
    first, second = exposed(radiance, 1.0, (0, 0), size), exposed(radiance, 2.0**-stops, shift, size)
    assert shift_between(first, second) == shift


def test_large_pictures_are_compared_at_a_coarser_step() -> None:
    radiance, size = scene(700, 2100), (700, 2100)
    found = shift_between(exposed(radiance, 1.0, (0, 0), size), exposed(radiance, 0.5, (12, -6), size))
    assert found == (12, -6)


def test_nothing_to_compare() -> None:
    assert shift_between(torch.zeros(40, 60), torch.rand(40, 60)) is None
    assert shift_between(torch.rand(40, 60), torch.ones(40, 60)) is None
