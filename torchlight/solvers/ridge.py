"""Least squares without a sign constraint, damped or of minimum norm."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from torchlight.errors import ConfigError
from torchlight.solvers.certificate import nonzero_norm
from torchlight.solvers.problem import LeastSquares
from torchlight.solvers.solution import Solution
from torchlight.solvers.system import Answer, System, by_weights, solve_systems


@dataclass(frozen=True)
class Ridge:
    """Minimises |W^(1/2) (A x - b)|^2 / 2 + damping s_1^2 |x|^2 / 2, with s_1 the largest singular value of W^(1/2) A.

    By a singular value decomposition in float64, once per distinct weight vector. Singular values of at most
    tolerance s_1 count as 0, so that damping 0 gives the least-squares solution of minimum norm.
    kkt_residual is max_j |g_j| / (|a_j| |b|), g the gradient of the damped objective; gap is exact for the singular
    values kept: sum_k (v_k'g)^2 / (s_k^2 + damping s_1^2) / |b|^2. Every item with observations is CONVERGED.

    Attributes:
        damping: at least 0; free of scale.
        tolerance: relative to s_1; None = max(points, coeffs) times float64's epsilon, as numpy.linalg.lstsq.
    """

    damping: float = 0.0
    tolerance: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.damping < float("inf"):
            raise ConfigError(f"Ridge.damping: expected a finite number of at least 0, got {self.damping}")
        if self.tolerance is not None and not 0.0 <= self.tolerance < 1.0:
            raise ConfigError(f"Ridge.tolerance: expected a number in [0, 1) or None, got {self.tolerance}")

    def solve(self, problem: LeastSquares) -> Solution:
        """Returns the (damped) least-squares solution of every item; the problem's synthesis is ignored."""
        return solve_systems(problem, self._solve_system, by_weights)

    def _solve_system(self, system: System) -> Answer:
        matrix = system.matrix.to(torch.float64) * system.root[0, :, None]
        left, values, right = torch.linalg.svd(matrix, full_matrices=False)
        tolerance = max(matrix.shape) * torch.finfo(torch.float64).eps if self.tolerance is None else self.tolerance
        kept = values > tolerance * values[0]
        left, values, right = left[:, kept], values[kept], right[kept]
        shift = self.damping * values[:1].square()
        x = (system.targets @ left * (values / (values.square() + shift))) @ right
        residual = system.targets - x @ matrix.T
        gradient = x * shift.sum() - residual @ matrix
        size = nonzero_norm(system.targets)
        norms = torch.linalg.vector_norm(matrix, dim=0)
        curvature = values.square() + shift
        return Answer(
            coefficients=x,
            steps=torch.ones(x.shape[0], dtype=torch.int64, device=x.device),
            relative_residual=torch.linalg.vector_norm(residual, dim=-1) / size,
            kkt_residual=(gradient / torch.where(norms > 0, norms, 1.0)).abs().amax(dim=-1) / size,
            gap=((gradient @ right.T).square() / curvature).sum(dim=-1) / size / size,
            converged=torch.ones(x.shape[0], dtype=torch.bool, device=x.device),
        )
