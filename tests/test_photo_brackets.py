"""Brackets: exact on photographs whose codes are exact, as good as the noise allows on others."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError, ShapeError
from torchlight.photo.brackets import code_weights, exposed, exposed_linear, merge
from torchlight.photo.radiometry import Response, tabulated

LINEAR = tabulated("linear", 256)


def stored(codes: list[float]) -> Tensor:
    return (torch.tensor(codes, dtype=torch.float64) / 255).expand(3, 1, -1)


def test_exact_codes_give_the_exact_radiance() -> None:
    photos = [(exposed(stored([10, 20, 40, 100]), LINEAR), 1.0), (exposed(stored([20, 40, 80, 200]), LINEAR), 2.0)]
    found = merge(photos)
    assert_close(found.radiance, stored([10, 20, 40, 100]), rtol=1e-12, atol=0)
    assert bool(found.usable.all())


def test_saturated_and_black_codes_do_not_count() -> None:
    short, long = stored([10, 0, 100, 255, 0]), stored([80, 40, 255, 255, 0])
    found = merge([(exposed(short, LINEAR), 1.0), (exposed(long, LINEAR), 8.0)])
    assert_close(found.radiance, stored([10, 5, 100, 255, 0]), rtol=1e-12, atol=0)
    assert found.usable.tolist() == [[True, True, True, False, False]]


def test_pixels_too_bright_for_all_hold_the_largest_lower_bound_and_dark_ones_the_smallest_value() -> None:
    curve = Response((tabulated("linear", 256).exposure + 0.01) / 1.01)
    photos = [(exposed(stored([255, 0]), curve), time) for time in (4.0, 0.5, 2.0)]
    found = merge(photos)
    expected = torch.tensor([1 / 0.5, 0.01 / 1.01 / 4], dtype=torch.float64).expand(3, 1, 2)
    assert_close(found.radiance, expected, rtol=1e-12, atol=0)
    assert not bool(found.usable.any())


def test_one_unmeasured_channel_spoils_the_pixel() -> None:
    pixels = stored([100.0]).clone()
    pixels[1] = 1
    assert merge([(exposed(pixels, LINEAR), 1.0)]).usable.tolist() == [[False]]


def test_linear_float_photographs() -> None:
    radiance = torch.rand(3, 2, 2, dtype=torch.float64) + 0.1
    first, second = radiance * 0.5, radiance * 4
    second[:, 0, 0] = math.inf
    found = merge([(exposed_linear(first), 0.5), (exposed_linear(second), 4.0)])
    assert_close(found.radiance, radiance, rtol=1e-12, atol=0)
    assert bool(found.usable.all())


@pytest.mark.parametrize("encoding", ["linear", "srgb", "gamma"])
def test_no_other_weights_are_less_noisy(encoding: str) -> None:
    """The deviation under code noise is the Gauss-Markov bound 1 / sqrt(sum t^2 / (x' sigma)^2)."""
    curve = tabulated(encoding, 256)
    generator = torch.Generator().manual_seed(0)
    times = (0.125, 0.5, 1.0)
    radiance = float(curve.exposure[0, 200])
    middle = torch.tensor([float((curve.exposure[0] - radiance * time).abs().argmin()) for time in times])
    told = torch.stack([curve.exposure[0, int(code)] for code in middle]) / torch.tensor(times)
    slope = torch.gradient(curve.exposure[0])[0][middle.long()]
    sigma, trials = 1.5, 40_000
    photos = []
    for code, time, bias in zip(middle, times, told / radiance, strict=True):
        noise = sigma * torch.randn(1, trials, generator=generator, dtype=torch.float64)
        codes = (code + noise).round().expand(3, -1, -1)
        photos.append((exposed(codes / 255, curve), time * float(bias)))
    spread = merge(photos).radiance[0].std().item()
    scale = torch.tensor([time for _, time in photos])
    variance = slope**2 * (sigma**2 + 1 / 12)
    assert spread == pytest.approx((1 / (scale**2 / variance).sum()).sqrt().item(), rel=0.05)


def test_weights_of_codes() -> None:
    weight = code_weights(tabulated("srgb", 256))
    assert_close(weight[:, [0, 255]], torch.zeros(3, 2, dtype=torch.float64), rtol=0, atol=1e-12)
    assert bool((weight[:, 1:255] > 0).all())
    slope = torch.gradient(tabulated("srgb", 256).exposure[0])[0]
    assert_close(
        weight[:, 200] / weight[:, 100],
        ((slope[100] / slope[200]) ** 2 * (1 - (145 / 255) ** 12)).expand(3),
        rtol=1e-3,
        atol=0,
    )
    assert bool((weight.diff(dim=-1)[:, 20:] < 0).all())  # a brighter code stands for a wider range of exposures
    assert_close(code_weights(LINEAR)[:, 100:156], torch.ones(3, 56, dtype=torch.float64), rtol=0, atol=1e-7)


def test_what_cannot_be_merged() -> None:
    look = exposed(stored([1.0]), LINEAR)
    for exposure in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(ConfigError, match="exposure: expected a positive number"):
            merge([(look, exposure)])
    with pytest.raises(ConfigError, match="no photograph"):
        merge([])
    with pytest.raises(ShapeError, match="different size"):
        merge([(look, 1.0), (exposed(stored([1.0, 2.0]), LINEAR), 1.0)])
