"""The response of a known camera, and the published least-squares system written out in full."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from jaxtyping import Int
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.photo.response import DATA_PIXELS, SMOOTHNESS, estimate_response, increasing

TIMES = 2.0 ** torch.arange(-5, 4, dtype=torch.float64)


def film(exposure: Tensor) -> Tensor:
    """Stored value of a film-like S curve: its logarithmic slope is 1 / 2.2 in the middle and falls at both ends."""
    return 1 / (1 + exposure ** (-2 / 2.2))


def photographed(pixels: int, seed: int = 0) -> Int[Tensor, "9 3 pixels"]:
    generator = torch.Generator().manual_seed(seed)
    radiance = (8 * torch.rand(3, pixels, generator=generator, dtype=torch.float64) - 5).exp()
    return (film(TIMES[:, None, None] * radiance) * 255).round().int()


def published(codes: np.ndarray, times: np.ndarray, smoothness: float) -> np.ndarray:
    """gsolve of the paper's appendix, every ln E an unknown: g of the codes 0 to 255."""
    pixels, photos = codes.shape
    hat = np.minimum(np.arange(256), 255 - np.arange(256)) / 127
    rows = np.zeros((pixels * photos + 255, 256 + pixels))
    right = np.zeros(len(rows))
    row = 0
    for i in range(pixels):
        for j in range(photos):
            weight = hat[codes[i, j]]
            rows[row, codes[i, j]], rows[row, 256 + i], right[row] = weight, -weight, weight * np.log(times[j])
            row += 1
    rows[row, 128] = 1
    row += 1
    for z in range(1, 255):
        rows[row, z - 1 : z + 2] = smoothness * hat[z] * np.array([1, -2, 1])
        row += 1
    return np.linalg.lstsq(rows, right, rcond=None)[0][:256]


def test_equals_the_published_system_with_every_unknown() -> None:
    codes = photographed(DATA_PIXELS)
    found = estimate_response(codes, TIMES).exposure.log()
    for channel in range(3):
        expected = torch.from_numpy(published(codes[:, channel].T.numpy(), TIMES.numpy(), SMOOTHNESS))
        expected = increasing(expected)
        assert_close(found[channel], expected - expected[-1], rtol=0, atol=1e-8)


def test_the_response_of_a_known_camera() -> None:
    found = estimate_response(photographed(2000), TIMES).exposure.log()
    value = torch.arange(1, 255, dtype=torch.float64) / 255
    truth = -(1 / value - 1).log() * 1.1
    middle = slice(15, 240)
    error = found[:, 1:255] - truth
    error = error - error[:, middle].mean(dim=1, keepdim=True)
    assert float(error[:, middle].abs().max()) < 0.02


def test_the_unit_of_time_does_not_matter() -> None:
    codes = photographed(300)
    assert_close(estimate_response(codes, TIMES).exposure, estimate_response(codes, 1000 * TIMES).exposure)


def test_one_exposure_says_nothing() -> None:
    codes = photographed(10)[:2]
    for times in (torch.ones(2), torch.ones(1)):
        with pytest.raises(ConfigError, match="cannot be estimated from photographs of one exposure"):
            estimate_response(codes[: len(times)], times)


def test_increasing_is_the_nearest_increasing_curve() -> None:
    curve = torch.tensor([0.0, 2.0, 1.0, 3.0], dtype=torch.float64)
    assert_close(increasing(curve), torch.tensor([0, 1.5, 1.5, 3], dtype=torch.float64), rtol=0, atol=2e-4)
    assert bool((increasing(torch.randn(256, dtype=torch.float64)).diff() > 0).all())
