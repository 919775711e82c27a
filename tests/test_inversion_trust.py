"""How much photographs count beside each other."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.inversion.trust import distrusted, own_noise, rms_residual, weighted_by
from torchlight.photo.noise import LEAST_NOISE
from torchlight.photo.observation import Observation

GRID = (40, 30)
POINTS = 1200


def noisy(deviation: float, level: float = 1.0, seed: int = 0) -> Observation:
    drawn = torch.randn(3, POINTS, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return Observation(level + deviation * drawn, torch.ones(POINTS, dtype=torch.float64))


def flat(level: float = 1.0) -> Tensor:
    return torch.full((3, POINTS), level, dtype=torch.float64)


def test_noise_is_measured_in_the_unit_of_the_samples_whatever_they_show() -> None:
    quiet, loud, none = noisy(0.02), noisy(0.1, level=3.0, seed=1), noisy(0.0, level=2.0)
    found = own_noise([quiet, loud, none], [GRID] * 3, None)
    assert_close(found, torch.tensor([0.02, 0.1, 2 * LEAST_NOISE], dtype=torch.float64), rtol=0.1, atol=0)


def test_stated_noise_is_a_share_of_each_brightest_sample() -> None:
    seen = [noisy(0.0, level=2.0), noisy(0.0, level=0.5)]
    assert_close(own_noise(seen, [GRID] * 2, 0.01), torch.tensor([0.02, 0.005], dtype=torch.float64))


def test_weighted_samples_all_have_the_least_noise() -> None:
    noise = torch.tensor([0.03, 0.01, 0.02], dtype=torch.float64)
    seen = [noisy(0.0), noisy(0.0), noisy(0.0)]
    seen[2].weights[:5] = 0.0
    kept = weighted_by(seen, noise)
    assert [part.weights.max().item() for part in kept] == pytest.approx([1 / 9, 1.0, 1 / 4])
    assert (kept[2].weights[:5] == 0).all()
    for part, own in zip(kept, noise, strict=True):
        assert part.weights[-1].sqrt() * own == pytest.approx(0.01)


def test_what_is_explained_worse_than_its_noise_is_distrusted() -> None:
    """Residuals of 1, 1.4 and 3 times the noise: the second is left alone, the third counts by its residual."""
    seen = [noisy(0.0), noisy(0.0), noisy(0.0)]
    noise = torch.tensor([0.01, 0.02, 0.01], dtype=torch.float64)
    shown = [flat(1.01), flat(1.0 + 1.4 * 0.02), flat(1.03)]
    assert_close(distrusted(noise, seen, shown), torch.tensor([0.01, 0.02, 0.03], dtype=torch.float64))


def test_a_light_that_explains_none_of_them_distrusts_none() -> None:
    noise = torch.tensor([0.01, 0.02], dtype=torch.float64)
    assert torch.equal(distrusted(noise, [noisy(0.0), noisy(0.0)], [flat(1.05), flat(1.1)]), noise)


def test_residuals_are_of_used_samples() -> None:
    seen = noisy(0.0)
    seen.weights[0] = 0.0
    seen.samples[:, 0] = math.nan
    assert rms_residual(flat(1.5), seen).item() == pytest.approx(0.5)
