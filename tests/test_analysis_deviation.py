"""Predicted deviations: closed forms, other people's distributions, and many noisy photographs."""

from __future__ import annotations

import math

import pytest
import torch
from scipy.stats import truncnorm
from shadows import block_transfer, coarsened
from torch import Tensor
from torch.testing import assert_close

from torchlight.analysis.deviation import above_zero, damped_deviation, radiance_deviation, spanned_deviation
from torchlight.inversion.linear import solve
from torchlight.light.bases import SphericalHarmonics
from torchlight.photo.observation import Observation
from torchlight.solvers import NNLS, Ridge

DRAWS = 4000
SPREAD = 4.5 / math.sqrt(2 * DRAWS)  # a deviation from n draws is off by 1 / sqrt(2 n); the largest of dozens


def gram_and_slopes(rows: Tensor, target: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    return rows.T @ rows, rows.T @ (target - rows @ values)


def test_columns_that_do_not_meet_stand_alone() -> None:
    rows = torch.diag(torch.tensor([2.0, 0.5, 0.0], dtype=torch.float64))
    values = torch.tensor([3.0, 1.0, 0.0], dtype=torch.float64)
    found = radiance_deviation(*gram_and_slopes(rows, rows @ values, values)[:2], values, 0.1)
    assert_close(found, torch.tensor([0.05, 0.2, math.inf], dtype=torch.float64), rtol=1e-9, atol=0)


@pytest.mark.parametrize("cosine", [0.0, 0.6, 0.99])
def test_two_columns_that_meet_are_the_less_certain(cosine: float) -> None:
    rows = torch.tensor([[1.0, cosine], [0.0, math.sqrt(1 - cosine**2)]], dtype=torch.float64)
    values = torch.ones(2, dtype=torch.float64)
    found = radiance_deviation(rows.T @ rows, torch.zeros_like(values), values, 0.3)
    assert_close(found, torch.full_like(values, 0.3 / math.sqrt(1 - cosine**2)), rtol=1e-6, atol=0)


def test_the_same_column_twice_is_not_known_but_finite() -> None:
    values = torch.ones(2, dtype=torch.float64)
    found = radiance_deviation(torch.ones(2, 2, dtype=torch.float64), torch.zeros_like(values), values, 1.0)
    assert_close(found, torch.full_like(values, math.sqrt(0.5e12)), rtol=1e-3, atol=0)


@pytest.mark.parametrize("slope", [0.0, -0.3, -2.0, -20.0, -29.0, -31.0, -500.0])
@pytest.mark.parametrize("curvature", [1.0, 0.25])
def test_what_is_held_at_zero_is_a_normal_distribution_cut_off_there(slope: float, curvature: float) -> None:
    mean, deviation = slope / curvature, 1 / math.sqrt(curvature)
    if slope > -30:
        expected = math.sqrt(truncnorm.moment(2, -mean / deviation, math.inf, loc=mean, scale=deviation))
    else:
        expected = math.sqrt(2) / abs(slope)  # of the exponential tail
    found = above_zero(torch.tensor([slope], dtype=torch.float64), torch.tensor([curvature], dtype=torch.float64))
    assert_close(found.item(), expected, rtol=5e-3, atol=0)  # the tail's next term is 5 / t^2


def test_a_column_held_at_zero_is_told_beside_the_free_ones() -> None:
    generator = torch.Generator().manual_seed(0)
    rows = torch.rand(12, 4, generator=generator, dtype=torch.float64)
    values = torch.tensor([1.0, 2.0, 0.0, 0.5], dtype=torch.float64)
    target = rows @ values - 0.02 * rows[:, 2]
    gram = rows.T @ rows
    slopes = torch.tensor([0.0, 0.0, -0.01, 0.0], dtype=torch.float64)
    others = rows[:, [0, 1, 3]]
    left = rows[:, 2] - others @ torch.linalg.lstsq(others, rows[:, 2:3]).solution[:, 0]
    mean, deviation = -0.01 / left.square().sum().item(), 0.05 / left.norm().item()
    expected = math.sqrt(truncnorm.moment(2, -mean / deviation, math.inf, loc=mean, scale=deviation))
    assert target.isfinite().all()
    assert_close(radiance_deviation(gram, slopes, values, 0.05)[2].item(), expected, rtol=1e-6, atol=0)


def noisy(values: Tensor, sigma: float, seed: int, draws: int = DRAWS) -> Observation:
    generator = torch.Generator().manual_seed(seed)
    samples = values + sigma * torch.randn(draws, 1, len(values), generator=generator, dtype=torch.float64)
    return Observation(samples, torch.ones(draws, len(values), dtype=torch.float64))


def test_many_noisy_photographs_scatter_non_negative_texels_about_as_predicted() -> None:
    """A texel whose neighbour is at 0 in some draws and not in others scatters up to 1.4 times as far as predicted."""
    matrix = coarsened(block_transfer(8), 4).transport
    light = torch.rand(matrix.shape[1], generator=torch.Generator().manual_seed(1), dtype=torch.float64) + 0.5
    light[::5] = 0.0
    shown = matrix @ light
    sigma = 1e-3 * shown.max().item()
    drawn = noisy(shown, sigma, 2, 400)
    found = solve(matrix, drawn, NNLS()).coefficients[:, 0]
    gram = matrix.T @ matrix
    predicted = torch.stack(
        [
            radiance_deviation(gram, matrix.T @ (seen - matrix @ one), one, sigma)
            for seen, one in zip(drawn.samples[:40, 0], found, strict=False)
        ]
    )
    clear = (found > 0).all(dim=0) & (light > 5 * predicted.mean(dim=0))
    assert int(clear.sum()) >= 15
    ratio = (found.std(dim=0) / predicted.square().mean(dim=0).sqrt())[clear]
    assert_close(ratio.median().item(), 1.0, rtol=0, atol=0.08)
    assert_close(ratio, torch.ones_like(ratio), rtol=0, atol=0.5)
    above = found.square().mean(dim=0).sqrt() / predicted.square().mean(dim=0).sqrt()
    assert 0.4 < above[light == 0].min() < above[light == 0].max() < 1.5


def test_light_that_is_nowhere_dark_scatters_exactly_as_predicted() -> None:
    matrix = coarsened(block_transfer(8), 2).transport
    light = torch.rand(matrix.shape[1], generator=torch.Generator().manual_seed(1), dtype=torch.float64) + 0.5
    shown = matrix @ light
    sigma = 1e-3 * shown.max().item()
    found = solve(matrix, noisy(shown, sigma, 3), NNLS()).coefficients[:, 0]
    assert bool((found > 0).all())
    predicted = radiance_deviation(matrix.T @ matrix, torch.zeros_like(light), light, sigma)
    assert_close(found.std(dim=0) / predicted, torch.ones_like(light), rtol=0, atol=SPREAD)


@pytest.mark.parametrize("damping", [1e-2, 1e-4])
def test_ridge_errs_as_predicted_where_light_is_as_it_supposes(damping: float) -> None:
    matrix = coarsened(block_transfer(8), 4).transport
    gram = matrix.T @ matrix
    sigma = 0.05
    prior = sigma / math.sqrt(damping * torch.linalg.matrix_norm(gram, 2).item())
    generator = torch.Generator().manual_seed(4)
    light = prior * torch.randn(DRAWS, 1, matrix.shape[1], generator=generator, dtype=torch.float64)
    samples = light @ matrix.T
    samples = samples + sigma * torch.randn(samples.shape, generator=generator, dtype=torch.float64)
    seen = Observation(samples, torch.ones(DRAWS, matrix.shape[0], dtype=torch.float64))
    error = (solve(matrix, seen, Ridge(damping)).coefficients - light)[:, 0]
    predicted = damped_deviation(gram, damping, sigma)
    ratio = error.square().mean(dim=0).sqrt() / predicted
    assert_close(ratio, torch.ones_like(ratio), rtol=0, atol=SPREAD)


def test_harmonics_scatter_as_predicted_where_none_is_held() -> None:
    basis = SphericalHarmonics(1, 8)
    synthesis = basis.synthesis_matrix()
    matrix = block_transfer(8).transport @ synthesis
    coefficients = torch.tensor([3.0, 0.2, 0.5, -0.3], dtype=torch.float64)
    shown = matrix @ coefficients
    sigma = 2e-3 * shown.max().item()
    drawn = noisy(shown, sigma, 5).samples[:, 0]
    found = torch.linalg.lstsq(matrix, drawn.T).solution.T @ synthesis.T
    assert bool((found > 0).all())  # so that none is held
    nothing = torch.zeros(synthesis.shape[0], dtype=torch.bool)
    predicted = spanned_deviation(matrix.T @ matrix, synthesis, nothing, sigma)
    assert_close(found.std(dim=0) / predicted, torch.ones_like(predicted), rtol=0, atol=SPREAD)


def test_what_is_held_takes_away_freedom() -> None:
    synthesis = torch.tensor([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], dtype=torch.float64)
    held = torch.tensor([False, False, True])  # then c = (t, -t)
    found = spanned_deviation(torch.eye(2, dtype=torch.float64), synthesis, held, 1.0)
    expected = torch.tensor([math.sqrt(0.5), math.sqrt(0.5), math.sqrt(2)], dtype=torch.float64)
    assert_close(found, expected, rtol=1e-9, atol=0)
