"""ProjectedAdam approaches the exact minimum and says how close it came."""

from __future__ import annotations

import pytest
import torch

from torchlight.errors import ConfigError
from torchlight.solvers import NNLS, LeastSquares, ProjectedAdam, Status


def problem(dtype: torch.dtype = torch.float64) -> LeastSquares:
    g = torch.Generator().manual_seed(0)
    matrix = torch.rand(60, 20, generator=g, dtype=torch.float64) * torch.logspace(-3, 3, 20, dtype=torch.float64)
    matrix[:, 7] = 0
    samples = torch.rand(2, 3, 60, generator=g, dtype=torch.float64)
    weights = torch.rand(2, 60, generator=g, dtype=torch.float64)
    return LeastSquares(matrix.to(dtype), samples.to(dtype), weights.to(dtype))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_objective_approaches_that_of_nnls(dtype):
    case = problem(dtype)
    exact, found = NNLS().solve(case), ProjectedAdam().solve(case)
    found.check()
    error = (found.relative_residual.square() - exact.relative_residual.square()).double()
    torch.testing.assert_close(error, torch.zeros(2, 3, dtype=torch.float64), rtol=0, atol=1e-6)
    assert found.coefficients.dtype == dtype
    assert found.coefficients.min().item() >= 0
    assert bool((found.coefficients[..., 7] == 0).all())
    assert bool((found.steps == 2000).all())


def test_kkt_residual_is_the_true_one():
    case = problem()
    assert case.weights is not None
    found = ProjectedAdam(steps=50).solve(case)
    for photo in range(2):
        root = case.weights[photo].sqrt()
        matrix, targets = case.matrix * root[:, None], case.samples[photo] * root
        x = found.coefficients[photo]
        w = (targets - x @ matrix.T) @ matrix
        norms, size = matrix.norm(dim=0), targets.norm(dim=-1)
        dual = (w / norms.where(norms > 0, torch.ones(()).double())).amax(dim=-1) / size
        expected = torch.maximum(dual, (x * w).abs().sum(dim=-1) / size**2)
        torch.testing.assert_close(found.kkt_residual[photo], expected)


def test_few_steps_are_reported_as_stopped_short():
    found = ProjectedAdam(steps=5).solve(problem())
    assert bool((found.status == Status.STOPPED_SHORT).all())
    assert found.kkt_residual.min().item() > 1e-4
    assert bool((found.steps == 5).all())


def test_batch_equals_one_by_one():
    case = problem()
    assert case.weights is not None
    together = ProjectedAdam(steps=100).solve(case)
    for photo in range(2):
        alone = ProjectedAdam(steps=100).solve(LeastSquares(case.matrix, case.samples[photo], case.weights[photo]))
        torch.testing.assert_close(together.coefficients[photo], alone.coefficients, rtol=1e-7, atol=1e-9)


def test_broken_and_dark_items_harm_no_other():
    case = problem()
    samples = case.samples.clone()
    samples[0, 0, 4] = torch.nan
    samples[1, 2] = 0.0
    found = ProjectedAdam(steps=100).solve(LeastSquares(case.matrix, samples, case.weights))
    sound = ProjectedAdam(steps=100).solve(case)
    assert found.status[0, 0].item() == Status.NOT_FINITE
    assert found.status[1, 2].item() == Status.CONVERGED
    assert bool((found.coefficients[0, 0] == 0).all() & (found.coefficients[1, 2] == 0).all())
    torch.testing.assert_close(found.coefficients[0, 1:], sound.coefficients[0, 1:], rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("settings", [{"steps": 0}, {"learning_rate": 0.0}, {"tolerance": 1.0}])
def test_settings_out_of_range_are_refused(settings):
    with pytest.raises(ConfigError, match=next(iter(settings))):
        ProjectedAdam(**settings)


def test_synthesis_is_refused():
    eye = torch.eye(3)
    with pytest.raises(ConfigError, match="use NonnegativeSynthesis"):
        ProjectedAdam().solve(LeastSquares(eye, torch.ones(1, 3), None, eye))
