"""Exposures found from the photographs: closed forms, an independent search, and what cannot be told."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from scipy.optimize import minimize_scalar, nnls
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import SceneError, SolveError
from torchlight.inversion.scales import LEAST_NOISE, best_light, bright, compressed, find_scales, minimized
from torchlight.photo.observation import Observation

TRUE = (1.0, 0.6, 2.5)


def drawn(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def transports(count: int = 3, points: int = 120, texels: int = 30) -> list[Tensor]:
    """Visibility 0 or 1 times positive weights: as transports are, each photograph with shadows of its own."""
    return [(drawn(points, texels, seed=k) > 0.4) * (0.5 + drawn(texels, seed=99)) for k in range(count)]


def light(texels: int = 30) -> Tensor:
    return drawn(3, texels, seed=7) * (drawn(3, texels, seed=8) > 0.5)


def observed(noise: tuple[float, ...] = (0.0, 0.0, 0.0), seed: int = 0, scales: tuple[float, ...] = TRUE) -> list:
    """Photographs at their exposures, with noise as a share of their brightness."""
    shown = []
    for k, (matrix, scale, share) in enumerate(zip(transports(), scales, noise, strict=True)):
        values = scale * light() @ matrix.T
        level = bright(Observation(values, torch.ones(values.shape[1])))
        generator = torch.Generator().manual_seed(1000 * seed + k)
        values = values + share * level * torch.randn(values.shape, generator=generator, dtype=torch.float64)
        shown.append(Observation(values, torch.ones(values.shape[1], dtype=torch.float64)))
    return shown


def test_exposures_without_noise_are_exact() -> None:
    found = find_scales(transports(), observed(), [None, None, None])
    assert found.converged
    assert_close(found.values, torch.tensor(TRUE, dtype=torch.float64), rtol=1e-6, atol=0)
    assert found.deviations[0] == 0
    assert_close(found.noise, torch.full((3,), LEAST_NOISE, dtype=torch.float64))


def test_a_plane_without_shadows_tells_the_ratio_of_its_levels() -> None:
    """Every row is the same: E = pi L for constant light, and nothing but the level distinguishes two photographs."""
    matrix = torch.full((50, 4), math.pi / 4, dtype=torch.float64)
    seen = [Observation(torch.full((3, 50), level, dtype=torch.float64), torch.ones(50)) for level in (math.pi, 0.7)]
    found = find_scales([matrix, matrix], seen, [None, None])
    assert_close(found.values[1].item(), 0.7 / math.pi, rtol=1e-9, atol=0)


def test_the_unit_is_that_of_the_given_exposure() -> None:
    found = find_scales(transports(), observed(), [None, 3.0, None])
    assert_close(found.values, torch.tensor(TRUE, dtype=torch.float64) * 5, rtol=1e-6, atol=0)
    assert found.values[1] == 3.0
    assert (found.deviations == 0).tolist() == [False, True, False]


def test_given_exposures_are_kept_even_where_they_are_wrong() -> None:
    found = find_scales(transports(), observed(), [1.0, 1.0, 1.0])
    assert found.values.tolist() == [1.0, 1.0, 1.0]
    assert found.converged


def test_a_brighter_file_has_a_larger_exposure_and_nothing_else() -> None:
    noise = (0.01, 0.01, 0.01)
    one, other = (find_scales(transports(), observed(noise, scales=s), [None] * 3) for s in (TRUE, (1.0, 6.0, 2.5)))
    assert_close(other.values, one.values * torch.tensor([1.0, 10.0, 1.0]), rtol=1e-9, atol=0)
    assert_close(other.noise, one.noise, rtol=1e-9, atol=0)


def test_the_exposure_is_where_an_independent_search_finds_the_least_residual() -> None:
    """scipy's nnls on the rows themselves, and a search along the exposure by golden sections."""
    seen, matrices = observed((0.03, 0.03, 0.03)), transports()
    levels = [bright(item) for item in seen[:2]]
    rows = [compressed(m, o, level) for m, o, level in zip(matrices, seen, levels, strict=False)]
    logs = torch.zeros(2, dtype=torch.float64)
    fit, _, converged = minimized(rows, logs, torch.tensor([False, True]))
    assert converged

    def residual(log: float) -> float:
        matrix = np.vstack([matrices[0].numpy(), matrices[1].numpy() * math.exp(log)])
        targets = [
            np.concatenate([(o.samples[c] / level).numpy() for o, level in zip(seen, levels, strict=False)])
            for c in range(3)
        ]
        return sum(nnls(matrix, target)[1] ** 2 for target in targets)

    search: Any = minimize_scalar(residual, bracket=(-0.1, 0.1), tol=1e-10)
    assert_close(fit.logs[1].item(), float(search.x), rtol=0, atol=1e-6)
    assert_close(fit.residual, float(search.fun), rtol=1e-9, atol=0)
    assert_close(best_light(rows, logs).residual, residual(0.0), rtol=1e-9, atol=0)


def test_deviations_and_noise_are_those_of_repeated_photographs() -> None:
    noise = (0.01, 0.03, 0.02)
    runs = [find_scales(transports(), observed(noise, seed), [None] * 3) for seed in range(40)]
    errors = torch.stack([run.values / torch.tensor(TRUE) - 1 for run in runs])[:, 1:]
    stated = torch.stack([run.deviations for run in runs])[:, 1:]
    spread = (errors / stated).square().mean(dim=0).sqrt()
    assert ((spread > 0.7) & (spread < 1.35)).all(), spread  # 40 runs: a deviation is known to 11 %
    assert (errors.mean(dim=0).abs() < 3 * stated.mean(dim=0) / math.sqrt(40)).all()
    assert_close(torch.stack([run.noise for run in runs]).mean(dim=0), torch.tensor(noise).double(), rtol=0.03, atol=0)


def test_samples_of_weight_zero_do_not_count() -> None:
    seen = observed()
    weights = torch.ones(120, dtype=torch.float64)
    weights[:30] = 0
    spoiled = seen[1].samples.clone()
    spoiled[:, :30] = 50.0
    found = find_scales(transports(), [seen[0], Observation(spoiled, weights), seen[2]], [None] * 3)
    assert_close(found.values, torch.tensor(TRUE, dtype=torch.float64), rtol=1e-6, atol=0)


def test_photographs_that_share_no_light_are_refused_by_name() -> None:
    left, right = drawn(40, 10, seed=1), drawn(40, 10, seed=2)
    left[:, 5:], right[:, :5] = 0, 0
    seen = [Observation(torch.ones(3, 10).double() @ part.T, torch.ones(40)) for part in (left, right)]
    with pytest.raises(SolveError, match="photograph 2: its exposure cannot be told from the light"):
        find_scales([left, right], seen, [None, None])
    assert find_scales([left, right], seen, [1.0, 2.0]).values.tolist() == [1.0, 2.0]


@pytest.mark.parametrize("weights", [torch.ones(120), torch.zeros(120)], ids=["black", "unused"])
def test_a_photograph_without_light_is_refused_by_name(weights: Tensor) -> None:
    dark = Observation(torch.zeros(3, 120, dtype=torch.float64), weights)
    with pytest.raises(SceneError, match="photograph 2: black"):
        find_scales(transports(2), [observed()[0], dark], [None, None])
