"""The noise of a photograph's samples, found from the photograph."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ShapeError
from torchlight.photo.noise import sample_noise
from torchlight.photo.observation import Observation

COLUMNS, ROWS = 64, 48


def noisy(deviations: tuple[float, ...], seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    drawn = torch.randn(len(deviations), COLUMNS * ROWS, generator=generator, dtype=torch.float64)
    return drawn * torch.tensor(deviations, dtype=torch.float64)[:, None]


def everywhere(samples: Tensor) -> Observation:
    return Observation(samples, torch.ones(samples.shape[-1], dtype=samples.dtype))


def test_noise_is_found_per_channel() -> None:
    found = sample_noise(everywhere(0.5 + noisy((0.001, 0.01, 0.05))), (COLUMNS, ROWS))
    assert_close(found, torch.tensor([0.001, 0.01, 0.05], dtype=torch.float64), rtol=0.08, atol=0)  # 1.3 deviations


def test_what_the_mask_annihilates_is_no_noise() -> None:
    y, x = torch.meshgrid(torch.arange(ROWS).double(), torch.arange(COLUMNS).double(), indexing="ij")
    picture = torch.sin(x) + torch.cos(0.3 * y) + x * torch.cos(y) + y * x**2
    found = sample_noise(everywhere(picture.reshape(1, -1)), (COLUMNS, ROWS))
    assert_close(found, torch.zeros(1, dtype=torch.float64), atol=1e-9, rtol=0)


def test_shadow_edges_and_hidden_samples_do_not_count() -> None:
    y, x = torch.meshgrid(torch.arange(ROWS).double(), torch.arange(COLUMNS).double(), indexing="ij")
    shadow = ((x - 20).abs() + (y - 20).abs() < 9).double().reshape(-1)
    hidden = ((x - 45).square() + (y - 30).square() < 60).reshape(-1)
    samples = noisy((0.01,)) + 0.9 - 0.6 * shadow + hidden * 1e3 * noisy((1.0,), seed=1)
    found = sample_noise(Observation(samples, (~hidden).double()), (COLUMNS, ROWS))
    assert_close(found, torch.tensor([0.01], dtype=torch.float64), rtol=0.1, atol=0)


def test_photographs_of_a_batch_do_not_mix_and_nothing_seen_is_nan() -> None:
    samples = torch.stack([noisy((0.01, 0.02)), noisy((0.03, 0.04), seed=2)])
    weights = torch.stack([torch.ones(COLUMNS * ROWS), torch.zeros(COLUMNS * ROWS)]).double()
    found = sample_noise(Observation(samples, weights), (COLUMNS, ROWS))
    assert_close(found[0], sample_noise(everywhere(samples[0]), (COLUMNS, ROWS)))
    assert found[1].isnan().all()


def test_another_number_of_samples_is_an_error() -> None:
    with pytest.raises(ShapeError, match="48 x 48"):
        sample_noise(everywhere(noisy((0.1,))), (48, 48))
