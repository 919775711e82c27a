"""What stands where nothing was determined: means, harmonic functions, and never a change of what is known."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.light.environment import EnvironmentMap, irradiance
from torchlight.light.filling import constant_fill, smooth_fill

HEIGHT = 128
LOWER = torch.zeros(HEIGHT, 2 * HEIGHT, dtype=torch.bool)
LOWER[HEIGHT // 2 :] = True


def noise(height: int = HEIGHT) -> Tensor:
    return torch.rand(3, height, 2 * height, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


@pytest.mark.parametrize("fill", [constant_fill, smooth_fill])
def test_what_is_known_stays_and_the_plane_sees_no_difference(fill: object) -> None:
    radiance = torch.where(LOWER, 0.0, noise())
    filled = fill(radiance, LOWER)  # pyright: ignore[reportCallIssue]
    assert torch.equal(filled[:, ~LOWER], radiance[:, ~LOWER])
    assert_close(irradiance(EnvironmentMap(filled)), irradiance(EnvironmentMap(radiance)), rtol=0, atol=0)
    assert bool((filled[:, LOWER] > 0).all())


def test_the_constant_is_the_mean_over_solid_angle() -> None:
    theta = (torch.arange(HEIGHT, dtype=torch.float64) + 0.5) * math.pi / HEIGHT
    radiance = theta.cos().clamp(min=0)[None, :, None].expand(3, HEIGHT, 2 * HEIGHT)
    filled = constant_fill(radiance, LOWER)
    assert_close(filled[:, -1, 0], torch.full((3,), 0.5, dtype=torch.float64), rtol=1e-3, atol=0)


@pytest.mark.parametrize("order", [0, 1, 2, 4])
def test_below_the_horizon_the_smooth_fill_is_the_harmonic_function_of_its_rim(order: int) -> None:
    """In the stereographic picture of the lower half, r = tan((pi - theta) / 2), it is r^m cos(m phi)."""
    theta = (torch.arange(HEIGHT, dtype=torch.float64) + 0.5) * math.pi / HEIGHT
    phi = math.pi * (1 - (torch.arange(2 * HEIGHT, dtype=torch.float64) + 0.5) / HEIGHT)
    exact = 2 + torch.tan((math.pi - theta) / 2)[:, None] ** order * (order * phi).cos()
    rim = exact[HEIGHT // 2 - 1].expand(HEIGHT // 2, -1)
    known = torch.cat([rim, torch.zeros_like(rim)]).expand(3, -1, -1)
    filled = smooth_fill(known, LOWER)
    error = filled[0, HEIGHT // 2 :] - exact[HEIGHT // 2 :]
    assert_close(error, torch.zeros_like(error), rtol=0, atol=0.02 + 0.02 * order)  # half a row of 64


def test_it_continues_round_the_seam_and_over_the_pole() -> None:
    radiance = torch.ones(3, 64, 128, dtype=torch.float64)
    unknown = torch.zeros(64, 128, dtype=torch.bool)
    unknown[20:30, :6] = unknown[20:30, -6:] = unknown[:4] = True
    filled = smooth_fill(torch.where(unknown, 0.0, radiance), unknown)
    assert_close(filled, radiance, rtol=1e-4, atol=0)


def test_its_values_lie_between_those_of_the_rim() -> None:
    filled = smooth_fill(torch.where(LOWER, 0.0, noise()), LOWER)[:, LOWER]
    assert 0 < filled.min() < filled.max() < 1


@pytest.mark.parametrize("fill", [constant_fill, smooth_fill])
def test_nothing_known_stays_black_and_nothing_unknown_stays(fill: object) -> None:
    radiance = noise(32)
    everything = torch.ones(32, 64, dtype=torch.bool)
    assert torch.equal(fill(radiance, ~everything), radiance)  # pyright: ignore[reportCallIssue]
    assert int(fill(0 * radiance, everything).count_nonzero()) == 0  # pyright: ignore[reportCallIssue]
