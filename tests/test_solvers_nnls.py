"""NNLS against scipy's, and the laws that every exact solution obeys."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.optimize import nnls as scipy_nnls

from torchlight.errors import ConfigError
from torchlight.solvers import NNLS, LeastSquares, Status
from torchlight.solvers import nnls as nnls_module

SHAPES = ((60, 20), (20, 60), (40, 40), (100, 30), (12, 50))
KINDS = ("signed", "transport-like", "low rank", "duplicate and zero columns", "badly scaled columns")


def random_problem(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    m, n = SHAPES[seed // len(KINDS) % len(SHAPES)]
    kind = KINDS[seed % len(KINDS)]
    matrix = rng.random((m, n)) if kind == "transport-like" else rng.normal(size=(m, n))
    if kind == "low rank":
        matrix = rng.normal(size=(m, n // 3)) @ rng.normal(size=(n // 3, n))
    if kind == "duplicate and zero columns":
        matrix[:, n // 2 :] = matrix[:, : n - n // 2]
        matrix[:, rng.integers(n, size=3)] = 0
    if kind == "badly scaled columns":
        matrix *= 10.0 ** rng.uniform(-6, 6, size=n)
    matrix *= 10.0 ** rng.uniform(-6, 6)
    target = rng.normal(size=m) if seed % 3 else matrix @ np.maximum(0, rng.normal(size=n))
    return matrix, target * 10.0 ** rng.uniform(-6, 6)


def scipy_solution(matrix: np.ndarray, target: np.ndarray) -> np.ndarray:
    """scipy on unit columns and a unit target: its tolerance is absolute."""
    norms = np.linalg.norm(matrix, axis=0)
    norms[norms == 0] = 1
    size = np.linalg.norm(target)
    return scipy_nnls(matrix / norms, target / size, maxiter=10_000)[0] / norms * size


@pytest.mark.parametrize("seed", range(200))
def test_objective_and_prediction_equal_scipy(seed):
    matrix, target = random_problem(seed)
    solution = NNLS().solve(LeastSquares(torch.from_numpy(matrix), torch.from_numpy(target)[None]))
    x, reference = solution.coefficients[0].numpy(), scipy_solution(matrix, target)
    power = float(target @ target)
    gap = (np.sum((matrix @ x - target) ** 2) - np.sum((matrix @ reference - target) ** 2)) / power
    solution.check()
    assert x.min() >= 0
    assert abs(gap) <= 1e-10
    # |A (x - x*)|^2 <= gap |b|^2: a gap of 1e-10 would allow 1e-5.
    np.testing.assert_allclose(matrix @ x, matrix @ reference, rtol=0, atol=1e-6 * power**0.5)
    assert solution.kkt_residual.item() <= 1e-9
    np.testing.assert_allclose(
        solution.relative_residual.item(), np.linalg.norm(matrix @ x - target) / power**0.5, atol=1e-12
    )


def batch_problem(dtype: torch.dtype = torch.float64) -> LeastSquares:
    """Four photographs in two rows, three channels, each photograph with its own weights; 40 of 50 columns depend."""
    g = torch.Generator().manual_seed(3)
    matrix = torch.rand(80, 10, generator=g, dtype=torch.float64) @ torch.rand(10, 50, generator=g, dtype=torch.float64)
    samples = torch.randn(2, 2, 3, 80, generator=g, dtype=torch.float64) + 3 * torch.rand(80, generator=g).double()
    weights = torch.rand(2, 2, 80, generator=g, dtype=torch.float64)
    weights[0, 1] = weights[0, 0]
    weights[1, 0, ::3] = 0
    return LeastSquares(matrix.to(dtype), samples.to(dtype), weights.to(dtype))


def prediction(problem: LeastSquares, coefficients: torch.Tensor) -> torch.Tensor:
    return coefficients @ problem.matrix.T


def test_photo_in_a_batch_gets_the_prediction_it_gets_alone():
    problem = batch_problem()
    together = NNLS().solve(problem)
    assert problem.weights is not None
    for i in range(2):
        for j in range(2):
            alone = NNLS().solve(LeastSquares(problem.matrix, problem.samples[i, j], problem.weights[i, j]))
            torch.testing.assert_close(
                prediction(problem, together.coefficients[i, j]),
                prediction(problem, alone.coefficients),
                rtol=1e-9,
                atol=1e-9,
            )


@pytest.mark.parametrize("batch", [(), (4,), (2, 2)])
def test_leading_batch_axes_are_kept(batch):
    problem = batch_problem()
    samples = problem.samples.reshape(4, 3, 80)[: max(1, int(np.prod(batch)))].reshape(*batch, 3, 80)
    solution = NNLS().solve(LeastSquares(problem.matrix, samples))
    flat = NNLS().solve(LeastSquares(problem.matrix, samples.reshape(-1, 3, 80)))
    assert solution.coefficients.shape == (*batch, 3, 50)
    assert solution.status.shape == solution.steps.shape == solution.gap.shape == (*batch, 3)
    torch.testing.assert_close(solution.coefficients.reshape(-1, 3, 50), flat.coefficients)


def test_float32_gives_the_float64_answer_rounded():
    # The float32 problem itself differs by 6e-8 from the float64 one: solve the same numbers in both.
    single = batch_problem(torch.float32)
    assert single.weights is not None
    double = LeastSquares(single.matrix.double(), single.samples.double(), single.weights.double())
    found, expected = NNLS().solve(single), NNLS().solve(double)
    assert found.coefficients.dtype == found.gap.dtype == torch.float32
    assert bool((found.status == Status.CONVERGED).all())
    torch.testing.assert_close(found.coefficients, expected.coefficients.float())


@pytest.mark.parametrize("factor", [1e-12, 0.37, 1e9])
def test_scaling_the_samples_scales_the_coefficients(factor):
    problem = batch_problem()
    once = NNLS().solve(problem)
    scaled = NNLS().solve(LeastSquares(problem.matrix, factor * problem.samples, problem.weights))
    torch.testing.assert_close(scaled.coefficients / factor, once.coefficients, rtol=1e-5, atol=1e-7)


def test_weight_zero_removes_the_row_and_weight_two_doubles_it():
    problem = batch_problem()
    samples = problem.samples[0, 0]
    weights = torch.ones(80, dtype=torch.float64)
    weights[:10], weights[10:20] = 0.0, 2.0
    rows = torch.cat([torch.arange(10, 80), torch.arange(10, 20)])
    weighted = NNLS().solve(LeastSquares(problem.matrix, samples, weights))
    explicit = NNLS().solve(LeastSquares(problem.matrix[rows], samples[:, rows]))
    torch.testing.assert_close(
        prediction(problem, weighted.coefficients), prediction(problem, explicit.coefficients), rtol=1e-8, atol=1e-8
    )
    torch.testing.assert_close(weighted.relative_residual, explicit.relative_residual, rtol=1e-10, atol=0)


def test_ties_between_equal_columns_are_split_evenly():
    g = torch.Generator().manual_seed(0)
    half = torch.rand(30, 4, generator=g, dtype=torch.float64)
    samples = half @ torch.tensor([1.0, 2.0, 0.0, 3.0], dtype=torch.float64)
    solution = NNLS().solve(LeastSquares(torch.cat([half, half], dim=1), samples[None]))
    expected = torch.tensor([[0.5, 1.0, 0.0, 1.5, 0.5, 1.0, 0.0, 1.5]], dtype=torch.float64)
    torch.testing.assert_close(solution.coefficients, expected, rtol=0, atol=1e-3)  # ties are resolved by 1e-12


def test_a_broken_photo_gets_its_status_and_harms_no_other():
    problem = batch_problem()
    assert problem.weights is not None
    samples, weights = problem.samples.clone(), problem.weights.clone()
    samples[0, 0, 1, 5] = torch.nan
    samples[0, 1, 2, 7] = torch.inf
    weights[1, 1] = 0.0
    samples[1, 0, :, 0] = torch.nan  # weight 0 there
    broken, sound = NNLS().solve(LeastSquares(problem.matrix, samples, weights)), NNLS().solve(problem)
    expected = torch.zeros(2, 2, 3, dtype=torch.int64)
    expected[0, 0, 1] = expected[0, 1, 2] = int(Status.NOT_FINITE)
    expected[1, 1] = int(Status.NO_OBSERVATIONS)
    assert broken.status.tolist() == expected.tolist()
    fine = expected == 0
    torch.testing.assert_close(
        prediction(problem, broken.coefficients[fine]), prediction(problem, sound.coefficients[fine])
    )
    assert bool((broken.coefficients[~fine] == 0).all())
    assert bool(broken.relative_residual[~fine].isnan().all())


def test_dark_photo_is_solved_by_darkness():
    problem = batch_problem()
    solution = NNLS().solve(LeastSquares(problem.matrix, torch.zeros(1, 3, 80, dtype=torch.float64)))
    solution.check()
    for figure in (solution.coefficients, solution.gap, solution.kkt_residual, solution.relative_residual):
        assert bool((figure == 0).all())


def test_negative_samples_give_zero_light():
    matrix = torch.rand(20, 5, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    solution = NNLS().solve(LeastSquares(matrix, -torch.ones(1, 20, dtype=torch.float64)))
    assert solution.status.item() == Status.CONVERGED
    assert bool((solution.coefficients == 0).all())
    assert solution.gap.item() == 0


def test_matrix_of_zeros_is_solved_by_zero():
    solution = NNLS().solve(LeastSquares(torch.zeros(4, 3, dtype=torch.float64), torch.ones(1, 4, dtype=torch.float64)))
    assert solution.status.item() == Status.CONVERGED
    assert solution.coefficients.tolist() == [[0.0, 0.0, 0.0]]
    assert solution.relative_residual.item() == 1


def test_extreme_samples_neither_overflow_nor_vanish():
    matrix = torch.eye(3, dtype=torch.float64)
    samples = torch.tensor([[1e300, 2e300, 0.0], [1e-300, 2e-300, 0.0]], dtype=torch.float64)
    solution = NNLS().solve(LeastSquares(matrix, samples))
    solution.check()
    torch.testing.assert_close(solution.coefficients, samples, rtol=1e-11, atol=0)


def test_columns_fetched_in_rounds_give_the_answer_of_the_full_gram_matrix(monkeypatch):
    problem = batch_problem()
    full = NNLS().solve(problem)
    monkeypatch.setattr(nnls_module, "FULL_GRAM_COLUMNS", 10)
    monkeypatch.setattr(nnls_module, "COLUMNS_PER_ROUND", 4)
    monkeypatch.setattr(nnls_module, "MAX_POOL", 24)  # so that the pool is emptied on the way
    rounds = NNLS().solve(problem)
    rounds.check()
    torch.testing.assert_close(
        prediction(problem, rounds.coefficients), prediction(problem, full.coefficients), rtol=1e-7, atol=1e-7
    )


def test_too_few_steps_are_reported():
    problem = batch_problem()
    solution = NNLS(max_steps=1).solve(LeastSquares(problem.matrix, problem.samples))
    assert bool((solution.status == Status.STOPPED_SHORT).any())
    assert bool((solution.steps <= 1).all())
    assert bool((solution.kkt_residual[solution.status == Status.STOPPED_SHORT] > 1e-9).all())


@pytest.mark.parametrize("settings", [{"ridge": -1.0}, {"tolerance": 0.0}, {"max_steps": 0}])
def test_settings_out_of_range_are_refused(settings):
    with pytest.raises(ConfigError, match=next(iter(settings))):
        NNLS(**settings)


def test_synthesis_is_refused():
    eye = torch.eye(3)
    with pytest.raises(ConfigError, match="use NonnegativeSynthesis"):
        NNLS().solve(LeastSquares(eye, torch.ones(1, 3), None, eye))
