"""Glints that were put on a plane are found; noise, halos, lamps nearby and lit gaps are none."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.photo.observation import Observation, Rejection
from torchlight.photo.specular import glints, local_median, without_glints

COLUMNS, ROWS = 48, 40
GRID = sample_centers(Receiver((0.0, 0.0), (float(COLUMNS), float(ROWS)), (COLUMNS, ROWS)))  # one sample = 1
X, Y = GRID.unbind(dim=-1)


def shadowed(noise: float = 0.01, seed: int = 0) -> Tensor:
    """A round shadow with a penumbra 6 samples wide."""
    away = ((X + 8).square() + Y.square()).sqrt() - 8
    light = (0.2 + 0.8 * ((away / 6 + 1) / 2).clamp(0, 1)).expand(3, -1)
    generator = torch.Generator().manual_seed(seed)
    return light * (1 + noise * torch.randn(light.shape, generator=generator, dtype=torch.float64))


def bump(x: float, y: float, width: float = 1.0) -> Tensor:
    return torch.exp(-((X - x).square() + (Y - y).square()) / (2 * width**2))


def found(values: Tensor, weights: Tensor | None = None) -> Tensor:
    used = torch.ones(values.shape[-1], dtype=torch.float64) if weights is None else weights
    return glints(Observation(values, used.expand(*values.shape[:-2], -1)), (COLUMNS, ROWS))


def test_a_glint_is_taken_whole_and_nothing_else() -> None:
    glint = 0.5 * bump(12.5, 7.5)
    marked = found(shadowed() + glint)
    assert bool(marked[glint > 0.1].all())
    assert not bool(marked[glint < 1e-4].any())


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.01, 0.03])
def test_noise_and_shadows_are_no_glints(noise: float) -> None:
    both = torch.stack([shadowed(noise, seed) for seed in range(20)])
    flat = both / torch.stack([shadowed(0.0)] * 20)
    assert not bool(found(both).any())
    assert not bool(found(flat).any())


def test_each_photograph_of_a_batch_is_judged_alone() -> None:
    both = torch.stack([shadowed(), shadowed(seed=1) + 0.5 * bump(12.5, 7.5)])
    assert_close(found(both), torch.stack([found(one) for one in both]))


def test_what_is_bright_but_no_small_patch_is_kept() -> None:
    halo = 0.3 * torch.exp(-((((X + 8).square() + Y.square()).sqrt() - 16) / 0.7).square())
    near_lamp = 0.5 * bump(10.0, 5.0, 9.0)
    streak = 0.3 * (X.abs() < 1)
    at_the_rim = 0.5 * bump(COLUMNS / 2, 5.0)
    for extra in (halo, near_lamp, streak, at_the_rim):
        assert not bool(found(shadowed() + extra).any())


def test_lit_gaps_in_a_shadow_are_no_glints() -> None:
    gaps = torch.where(((X + 10).abs() < 1.1) & (Y.remainder(8) < 2.2), 1.0, 0.3)
    light = torch.where(X < 0, gaps, torch.ones_like(gaps)).expand(3, -1)
    assert not bool(found(light).any())


def test_what_is_not_used_is_no_glint_and_hides_none() -> None:
    weights = torch.where(X > 18, 0.0, 1.0)
    values = shadowed() + 0.5 * bump(12.5, 7.5) + 5.0 * (X > 18)
    assert bool(found(values, weights).any())
    assert not bool((found(values, weights) & (weights == 0)).any())
    assert not bool(found(torch.zeros(3, COLUMNS * ROWS)).any())


def test_the_weight_goes_and_the_reason_stays() -> None:
    values, weights = shadowed() + 0.5 * bump(12.5, 7.5), torch.ones(COLUMNS * ROWS)
    weights[:5] = 0
    given = Observation(values, weights, torch.where(weights == 0, 1, 0).to(torch.uint8))
    left = without_glints(given, (COLUMNS, ROWS))
    marked = found(values, weights)
    assert_close(left.samples, values)
    assert_close(left.weights, torch.where(marked, 0.0, weights))
    assert_close(left.rejections == Rejection.SPECULAR, marked)
    assert int((left.rejections == Rejection.SATURATED).sum()) == 5
    assert without_glints(Observation(shadowed(), weights), (COLUMNS, ROWS)).rejected is None


def test_local_median_by_hand() -> None:
    picture = torch.arange(81.0, dtype=torch.float64).reshape(9, 9)
    median = local_median(picture)
    assert median[4, 4] == 40
    assert bool(median[0, 0].isnan())  # 25 samples of 81
    picture[4, 4] = torch.nan
    assert local_median(picture)[4, 4] == 39  # of 80, the lower middle one
