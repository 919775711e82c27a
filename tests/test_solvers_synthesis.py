"""The quadratic program S x >= 0 against scipy's SLSQP, NNLS and its own dual."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.optimize import minimize

from torchlight.errors import ConfigError
from torchlight.solvers import NNLS, LeastSquares, NonnegativeSynthesis, Status
from torchlight.solvers.synthesis import diagonalized, optimality
from torchlight.solvers.system import System


def orthogonal(size: int, seed: int) -> torch.Tensor:
    g = torch.Generator().manual_seed(seed)
    return torch.linalg.qr(torch.randn(size, size, generator=g, dtype=torch.float64)).Q


def cone_problem(seed: int, condition: float = 1e2, points: int = 60, coeffs: int = 6, texels: int = 40):
    """Rows of S are a constant plus noise, as a few spherical harmonics on texels would be."""
    g = torch.Generator().manual_seed(seed)
    left = torch.linalg.qr(torch.randn(points, coeffs, generator=g, dtype=torch.float64)).Q
    values = torch.logspace(0, -float(np.log10(condition)), coeffs, dtype=torch.float64)
    synthesis = 0.3 * torch.randn(texels, coeffs, generator=g, dtype=torch.float64)
    synthesis[:, 0] = 1.0
    matrix = left * values @ orthogonal(coeffs, seed)
    samples = torch.randn(2, coeffs, generator=g, dtype=torch.float64) @ matrix.T
    samples += 0.1 * torch.randn(2, points, generator=g, dtype=torch.float64)
    return LeastSquares(matrix, samples, None, synthesis)


def slsqp(matrix: np.ndarray, target: np.ndarray, synthesis: np.ndarray) -> np.ndarray:
    return minimize(
        lambda x: 0.5 * np.sum((matrix @ x - target) ** 2),
        np.zeros(matrix.shape[1]),
        jac=lambda x: matrix.T @ (matrix @ x - target),
        constraints={"type": "ineq", "fun": lambda x: synthesis @ x, "jac": lambda x: synthesis},
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 500},
    ).x


@pytest.mark.parametrize("seed", range(10))
def test_equals_slsqp_on_small_programs(seed):
    problem = cone_problem(seed, condition=10)
    solution = NonnegativeSynthesis().solve(problem)
    solution.check()
    assert problem.synthesis is not None
    for x, target in zip(solution.coefficients.numpy(), problem.samples.numpy(), strict=True):
        reference = slsqp(problem.matrix.numpy(), target, problem.synthesis.numpy())
        np.testing.assert_allclose(x, reference, atol=1e-5)  # SLSQP's own accuracy
        found, expected = (np.sum((problem.matrix.numpy() @ v - target) ** 2) for v in (x, reference))
        assert abs(found - expected) <= 1e-8 * target @ target
    assert bool(((solution.gap >= 0) & (solution.gap < 1e-9)).all())


@pytest.mark.parametrize("seed", range(6))
def test_gram_of_condition_1e12_is_solved_to_its_certificate(seed):
    problem = cone_problem(seed, condition=1e6, points=300, coeffs=(25, 49)[seed % 2], texels=400)
    solution = NonnegativeSynthesis().solve(problem)
    solution.check()
    assert problem.synthesis is not None
    radiance = solution.coefficients @ problem.synthesis.T
    violation = (-radiance).amax(dim=-1) / radiance.abs().amax(dim=-1)
    assert violation.max().item() <= 1e-9
    assert solution.kkt_residual.max().item() <= 1e-9
    assert bool(((solution.gap >= 0) & (solution.gap <= 1e-6)).all())


def test_gap_bounds_the_error_of_a_solve_that_stopped_short():
    problem = cone_problem(3, condition=1e3)
    exact = NonnegativeSynthesis().solve(problem)
    rough = NonnegativeSynthesis(proximity=1e-2, max_rounds=1).solve(problem)
    error = rough.relative_residual.square() - exact.relative_residual.square()
    assert bool((rough.status == Status.STOPPED_SHORT).all())
    assert bool(((error > 1e-8) & (error <= rough.gap)).all())


def test_rounds_remove_the_bias_of_the_proximal_term():
    problem = cone_problem(2, condition=3)
    exact = NonnegativeSynthesis().solve(problem)
    rounds = NonnegativeSynthesis(proximity=1e-2).solve(problem)
    rounds.check()
    torch.testing.assert_close(rounds.coefficients, exact.coefficients, rtol=1e-6, atol=1e-7)


def test_gap_is_objective_minus_dual_objective():
    # A = S = I: f(x) = |x - b|^2 / 2 and the dual of u is |b|^2 / 2 - |b + u|^2 / 2.
    eye = torch.eye(3, dtype=torch.float64)
    b, x, u = torch.tensor([[0.6, -0.8, 0.0], [0.5, 0.1, 0.2], [0.0, 0.3, 0.4]], dtype=torch.float64)
    program = diagonalized(System(eye, torch.ones(1, 3, dtype=torch.float64), b[None]), eye, 1e-3)
    _, gap = optimality(program, b @ program.left, program.right @ x, u)
    dual = (b.square().sum() - (b + u).square().sum()) / 2
    torch.testing.assert_close(gap, 2 * ((x - b).square().sum() / 2 - dual))


def rotated_problem() -> tuple[LeastSquares, torch.Tensor]:
    g = torch.Generator().manual_seed(4)
    matrix = torch.randn(50, 12, generator=g, dtype=torch.float64)
    weights = torch.rand(2, 50, generator=g, dtype=torch.float64)
    return LeastSquares(matrix, torch.randn(2, 3, 50, generator=g, dtype=torch.float64), weights), orthogonal(12, 5)


def test_orthogonal_synthesis_equals_nnls_rotated():
    texels, rotation = rotated_problem()
    expected = NNLS().solve(texels).coefficients
    coefficients = LeastSquares(texels.matrix @ rotation, texels.samples, texels.weights, rotation)
    found = NonnegativeSynthesis().solve(coefficients)
    found.check()
    torch.testing.assert_close(found.coefficients @ rotation.T, expected, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("synthesis", [None, torch.eye(12, dtype=torch.float64)])
def test_identity_synthesis_equals_nnls(synthesis):
    texels, _ = rotated_problem()
    found = NonnegativeSynthesis().solve(LeastSquares(texels.matrix, texels.samples, texels.weights, synthesis))
    torch.testing.assert_close(found.coefficients, NNLS().solve(texels).coefficients, rtol=1e-8, atol=1e-9)


def test_inactive_constraint_leaves_least_squares():
    problem = cone_problem(0)
    loose = LeastSquares(problem.matrix, problem.samples, None, torch.zeros(3, 6, dtype=torch.float64))
    with_one = torch.zeros(3, 6, dtype=torch.float64)
    expected = torch.linalg.lstsq(problem.matrix, problem.samples.T).solution.T
    with_one[1] = expected[0]  # positive at the unconstrained answer of the first item
    for synthesis in (loose.synthesis, with_one):
        found = NonnegativeSynthesis().solve(LeastSquares(problem.matrix, problem.samples, None, synthesis))
        # KKT to 1e-9 and condition 1e2 (1e4 of the Gram matrix).
        torch.testing.assert_close(found.coefficients[0], expected[0], rtol=1e-6, atol=1e-6)


def test_more_coefficients_than_points_and_repeated_texels():
    g = torch.Generator().manual_seed(9)
    matrix = torch.rand(8, 12, generator=g, dtype=torch.float64)
    synthesis = torch.randn(20, 12, generator=g, dtype=torch.float64)
    synthesis[:, 0] = 3.0
    samples = torch.randn(1, 8, generator=g, dtype=torch.float64)
    found = NonnegativeSynthesis().solve(LeastSquares(matrix, samples, None, torch.cat([synthesis, synthesis])))
    found.check()
    assert (found.coefficients @ synthesis.T).min().item() >= -1e-9 * found.coefficients.abs().max().item()


def test_scale_batch_float32_and_failures():
    problem = cone_problem(1)
    once = NonnegativeSynthesis().solve(problem)
    samples = torch.stack([1e6 * problem.samples, problem.samples, 0 * problem.samples])
    samples[1, 1, 0] = torch.nan
    found = NonnegativeSynthesis().solve(LeastSquares(problem.matrix, samples, None, problem.synthesis))
    torch.testing.assert_close(found.coefficients[0] / 1e6, once.coefficients, rtol=1e-7, atol=1e-9)
    torch.testing.assert_close(found.coefficients[1, 0], once.coefficients[0], rtol=1e-7, atol=1e-9)
    assert found.status.tolist() == [[0, 0], [0, int(Status.NOT_FINITE)], [0, 0]]
    assert bool((found.coefficients[2] == 0).all())
    assert problem.synthesis is not None
    single = LeastSquares(problem.matrix.float(), problem.samples.float(), None, problem.synthesis.float())
    rounded = NonnegativeSynthesis().solve(single)
    assert rounded.coefficients.dtype == torch.float32
    # The inputs are rounded to 6e-8 and the matrix has condition 1e2.
    torch.testing.assert_close(rounded.coefficients.double(), once.coefficients, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("settings", [{"proximity": 0.0}, {"tolerance": 2.0}, {"max_rounds": 0}, {"max_steps": 0}])
def test_settings_out_of_range_are_refused(settings):
    with pytest.raises(ConfigError, match=next(iter(settings))):
        NonnegativeSynthesis(**settings)
