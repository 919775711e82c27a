"""Ridge against numpy's lstsq and the damped normal equations."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from torchlight.errors import ConfigError
from torchlight.solvers import LeastSquares, Ridge, Status


def problem(rows: int, columns: int, rank: int, seed: int = 0) -> LeastSquares:
    g = torch.Generator().manual_seed(seed)
    left = torch.randn(rows, rank, generator=g, dtype=torch.float64)
    right = torch.randn(rank, columns, generator=g, dtype=torch.float64)
    samples = torch.randn(2, 3, rows, generator=g, dtype=torch.float64)
    return LeastSquares(left @ right, samples)


@pytest.mark.parametrize(("rows", "columns", "rank"), [(50, 12, 12), (50, 12, 7), (12, 50, 12), (12, 50, 5), (9, 9, 9)])
def test_without_damping_equals_numpy_lstsq(rows, columns, rank):
    case = problem(rows, columns, rank)
    solution = Ridge().solve(case)
    solution.check()
    targets = case.samples.reshape(-1, rows).numpy().T
    expected = np.linalg.lstsq(case.matrix.numpy(), targets)[0].T.reshape(2, 3, columns)
    np.testing.assert_allclose(solution.coefficients.numpy(), expected, rtol=1e-10, atol=1e-11)
    residual = np.linalg.norm(case.samples.numpy() - expected @ case.matrix.numpy().T, axis=-1)
    size = np.linalg.norm(case.samples.numpy(), axis=-1)
    np.testing.assert_allclose(solution.relative_residual.numpy(), residual / size, atol=1e-12)
    rounding = rounding_of_residual(case, expected)
    assert bool((solution.kkt_residual <= rounding).all())
    assert bool((solution.gap <= rounding.square()).all())


def rounding_of_residual(case: LeastSquares, x: np.ndarray) -> torch.Tensor:
    """Returns n eps |A| |x| / |b|, n the longer side of A: as far as rounding alone moves b - A x, relative to b.

    With r off by e, |a_j'e| / |a_j| <= |e| bounds the KKT residual and |U'e|^2 <= |e|^2 the gap.
    """
    largest = torch.linalg.matrix_norm(case.matrix, 2)
    sizes = torch.from_numpy(np.linalg.norm(x, axis=-1)) / torch.linalg.vector_norm(case.samples, dim=-1)
    return max(case.matrix.shape) * torch.finfo(torch.float64).eps * largest * sizes


def test_ill_conditioned_objective_equals_numpy_lstsq():
    g = torch.Generator().manual_seed(1)
    left = torch.linalg.qr(torch.randn(200, 25, generator=g, dtype=torch.float64)).Q
    right = torch.linalg.qr(torch.randn(25, 25, generator=g, dtype=torch.float64)).Q
    matrix = left * torch.logspace(0, -9, 25, dtype=torch.float64) @ right
    samples = torch.randn(1, 200, generator=g, dtype=torch.float64)
    x = Ridge().solve(LeastSquares(matrix, samples)).coefficients[0].numpy()
    reference = np.linalg.lstsq(matrix.numpy(), samples[0].numpy())[0]
    power = samples.square().sum().item()
    objective, expected = (np.sum((matrix.numpy() @ v - samples[0].numpy()) ** 2) / power for v in (x, reference))
    assert abs(objective - expected) <= 1e-8


def test_damping_is_relative_to_the_largest_singular_value():
    case = problem(30, 8, 8)
    gram = case.matrix.T @ case.matrix
    shift = 0.1 * torch.linalg.eigvalsh(gram)[-1] * torch.eye(8, dtype=torch.float64)
    expected = torch.linalg.solve(gram + shift, (case.samples @ case.matrix)[..., None])[..., 0]
    solution = Ridge(damping=0.1).solve(case)
    torch.testing.assert_close(solution.coefficients, expected, rtol=1e-11, atol=1e-12)
    assert solution.kkt_residual.max().item() < 1e-14
    larger = Ridge(damping=0.1).solve(LeastSquares(1e3 * case.matrix, case.samples))
    torch.testing.assert_close(1e3 * larger.coefficients, solution.coefficients, rtol=1e-11, atol=1e-12)


def test_tolerance_drops_small_singular_values():
    matrix = torch.diag(torch.tensor([1.0, 1e-3, 1e-6], dtype=torch.float64))
    samples = torch.ones(1, 3, dtype=torch.float64)
    kept = Ridge(tolerance=1e-4).solve(LeastSquares(matrix, samples)).coefficients
    torch.testing.assert_close(kept, torch.tensor([[1.0, 1e3, 0.0]], dtype=torch.float64))


def test_weights_per_photo_equal_weighted_rows():
    case = problem(30, 8, 8)
    weights = torch.rand(2, 30, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    weights[1, :7] = 0
    samples = case.samples.clone()
    samples[1, :, 3] = torch.nan  # weight 0 there
    together = Ridge().solve(LeastSquares(case.matrix, samples, weights))
    together.check()
    for photo in range(2):
        used = weights[photo] > 0
        root = weights[photo, used].sqrt()
        rows, targets = case.matrix[used] * root[:, None], case.samples[photo][:, used] * root
        expected = np.linalg.lstsq(rows.numpy(), targets.numpy().T)[0].T
        np.testing.assert_allclose(together.coefficients[photo].numpy(), expected, rtol=1e-10, atol=1e-11)


def test_float32_is_solved_in_float64():
    case = problem(30, 8, 8)
    single = LeastSquares(case.matrix.float(), case.samples.float())
    double = LeastSquares(single.matrix.double(), single.samples.double())
    found = Ridge().solve(single).coefficients
    assert found.dtype == torch.float32
    torch.testing.assert_close(found, Ridge().solve(double).coefficients.float(), rtol=0, atol=0)


def test_no_observations_and_nan_are_statuses():
    case = problem(30, 8, 8)
    samples, weights = case.samples.clone(), torch.ones(2, 30, dtype=torch.float64)
    samples[0, 1, 0] = torch.nan
    weights[1] = 0
    solution = Ridge().solve(LeastSquares(case.matrix, samples, weights))
    dark, bad, fine = int(Status.NO_OBSERVATIONS), int(Status.NOT_FINITE), int(Status.CONVERGED)
    assert solution.status.tolist() == [[fine, bad, fine], [dark, dark, dark]]
    assert bool((solution.coefficients[solution.status != fine] == 0).all())


def test_matrix_of_zeros_gives_zeros():
    solution = Ridge(damping=0.1).solve(LeastSquares(torch.zeros(4, 3), torch.ones(1, 4)))
    assert solution.coefficients.tolist() == [[0.0, 0.0, 0.0]]


@pytest.mark.parametrize("settings", [{"damping": -1.0}, {"damping": float("nan")}, {"tolerance": 1.5}])
def test_settings_out_of_range_are_refused(settings):
    with pytest.raises(ConfigError, match=next(iter(settings))):
        Ridge(**settings)
