"""The noise of a photograph's samples, found from the photograph."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ShapeError
from torchlight.photo.noise import LEAST_NOISE, LEAST_PLACES, brightest_used, noise_share, sample_noise
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


def test_the_share_is_of_the_brightest_used_sample() -> None:
    """sqrt((0.01^2 + 0.02^2 + 0.02^2) / 3) over a brightest of 2; what is not used is neither bright nor noisy."""
    samples = 0.5 + noisy((0.01, 0.02, 0.02))
    samples[1, 5], samples[0, 9] = 2.0, 1e3
    observation = everywhere(samples)
    observation.weights[9] = 0.0
    assert brightest_used(observation).item() == 2.0
    own = sample_noise(observation, (COLUMNS, ROWS))
    assert noise_share(observation, (COLUMNS, ROWS)).item() == pytest.approx(own.square().mean().sqrt().item() / 2)
    assert noise_share(observation, (COLUMNS, ROWS)).item() == pytest.approx(0.03 / 3**0.5 / 2, rel=0.06)


def test_the_share_is_that_of_rounding_where_less_or_nothing_is_measured() -> None:
    quiet, black = 0.5 + noisy((1e-5,)), torch.zeros(1, COLUMNS * ROWS, dtype=torch.float64)
    unseen = Observation(quiet, torch.zeros(COLUMNS * ROWS, dtype=torch.float64))
    for observation in (everywhere(quiet), everywhere(black), unseen):
        assert noise_share(observation, (COLUMNS, ROWS)).item() == LEAST_NOISE == pytest.approx(0.4 / 255)


def test_few_samples_tell_nothing() -> None:
    """A mask of weights leaves one place too few, or just enough; lines of samples have no places at all."""
    samples = noisy((0.1,))
    for places, told in ((LEAST_PLACES - 1, False), (LEAST_PLACES, True)):
        weights = torch.zeros(ROWS, COLUMNS, dtype=torch.float64)
        rows, rest = divmod(places, 25)
        weights[: rows + 2, :27] = 1.0
        weights[rows + 2, : rest + 2 if rest else 0] = 1.0
        found = sample_noise(Observation(samples, weights.reshape(-1)), (COLUMNS, ROWS))
        assert bool(found.isfinite().all()) == told
    assert sample_noise(everywhere(samples), (COLUMNS * ROWS // 2, 2)).isnan().all()
    assert sample_noise(everywhere(samples), (COLUMNS * ROWS, 1)).isnan().all()


def test_alone_and_in_a_batch_the_bits_are_the_same() -> None:
    samples = torch.stack([noisy((0.01, 0.02), seed).float() for seed in range(7)]).reshape(7, 1, 2, -1)
    weights = (torch.rand(7, 1, COLUMNS * ROWS, generator=torch.Generator().manual_seed(3)) > 0.02).float()
    batch = noise_share(Observation(samples, weights), (COLUMNS, ROWS))
    assert batch.shape == (7, 1)
    assert batch.dtype == torch.float32
    for k in range(7):
        assert torch.equal(batch[k, 0], noise_share(Observation(samples[k, 0], weights[k, 0]), (COLUMNS, ROWS)))


def test_brightness_of_any_unit() -> None:
    samples = 0.5 + noisy((0.01, 0.02))
    one, other = (noise_share(everywhere(factor * samples), (COLUMNS, ROWS)) for factor in (1.0, 1024.0))
    assert torch.equal(one, other)
