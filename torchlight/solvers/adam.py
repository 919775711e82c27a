"""Projected Adam: first-order non-negative least squares, for all items at once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.solvers.certificate import nonnegative_certificate, nonzero_norm
from torchlight.solvers.problem import LeastSquares, check_no_synthesis
from torchlight.solvers.solution import Solution
from torchlight.solvers.system import Answer, System, all_at_once, solve_systems

BETAS = (0.9, 0.99)
EPSILON = 1e-12  # of a gradient whose scale is 1


@dataclass(frozen=True)
class ProjectedAdam:
    """Approaches the minimiser of |W^(1/2) (A x - b)|^2 / 2 over x >= 0 by a fixed number of projected steps.

    Columns are scaled to norm 1; the start is the best multiple of the positive part of A'Wb; the learning rate falls
    to 0 along a half cosine. The two matrix products of a step run in the matrix's dtype. It approaches the minimum
    but rarely reaches it: kkt_residual and gap are the true ones (`certificate`), computed in float64 at the end, and
    an item whose kkt_residual exceeds the tolerance is STOPPED_SHORT.

    Attributes:
        steps: number of steps.
        learning_rate: first step, relative to the start's root mean square.
        tolerance: on kkt_residual.

    References:
        Kingma and Ba, Adam: a method for stochastic optimization, 2015, algorithm 1.
    """

    steps: int = 2000
    learning_rate: float = 0.1
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ConfigError(f"ProjectedAdam.steps: expected at least 1, got {self.steps}")
        if not 0.0 < self.learning_rate < float("inf"):
            raise ConfigError(f"ProjectedAdam.learning_rate: expected a positive number, got {self.learning_rate}")
        if not 0.0 < self.tolerance < 1.0:
            raise ConfigError(f"ProjectedAdam.tolerance: expected a number in (0, 1), got {self.tolerance}")

    def solve(self, problem: LeastSquares) -> Solution:
        """Returns an approximate non-negative solution of every item.

        Raises:
            ConfigError: if the problem has a synthesis (S x >= 0).
        """
        check_no_synthesis(problem, "ProjectedAdam")
        return solve_systems(problem, self._solve_system, all_at_once)

    def _solve_system(self, system: System) -> Answer:
        norms = system.column_norms()
        inverse = torch.where(norms > 0, 1 / norms, 0.0)
        size = nonzero_norm(system.targets)[:, None]
        scaled = Scaled(*(part.to(system.matrix) for part in (system.matrix, system.root, inverse)))
        x = self._descend(scaled, (system.targets / size).to(system.matrix)).to(torch.float64) * size * inverse
        certificate = nonnegative_certificate(system, x)
        return Answer(
            coefficients=x,
            steps=torch.full((x.shape[0],), self.steps, dtype=torch.int64, device=x.device),
            relative_residual=certificate.relative_residual,
            kkt_residual=certificate.kkt_residual,
            gap=certificate.gap,
            converged=certificate.kkt_residual <= self.tolerance,
        )

    def _descend(self, scaled: Scaled, targets: Float[Tensor, "items points"]) -> Float[Tensor, "items coeffs"]:
        z = best_multiple(scaled, scaled.correlate(targets).clamp(min=0), targets)
        rate = self.learning_rate * z.square().mean(dim=-1, keepdim=True).sqrt()
        mean, power = torch.zeros_like(z), torch.zeros_like(z)
        for step in range(1, self.steps + 1):
            gradient = scaled.correlate(scaled.predict(z) - targets)
            mean.lerp_(gradient, 1 - BETAS[0])
            power.lerp_(gradient.square(), 1 - BETAS[1])
            root = (power / (1 - BETAS[1] ** step)).sqrt_().add_(EPSILON)
            fall = (1 + math.cos(math.pi * (step - 1) / self.steps)) / 2 / (1 - BETAS[0] ** step)
            z = (z - rate * fall * mean / root).clamp_(min=0)
        return z


@dataclass(frozen=True, eq=False)
class Scaled:
    """W^(1/2) A with columns of norm 1, in the matrix's dtype, without forming it."""

    matrix: Float[Tensor, "points coeffs"]
    root: Float[Tensor, "#items points"]
    inverse_norms: Float[Tensor, "#items coeffs"]

    def predict(self, z: Float[Tensor, "items coeffs"]) -> Float[Tensor, "items points"]:
        """Returns the product with z."""
        return (z * self.inverse_norms) @ self.matrix.T * self.root

    def correlate(self, residual: Float[Tensor, "items points"]) -> Float[Tensor, "items coeffs"]:
        """Returns the adjoint product."""
        return (residual * self.root) @ self.matrix * self.inverse_norms


def best_multiple(
    scaled: Scaled, z: Float[Tensor, "items coeffs"], targets: Float[Tensor, "items points"]
) -> Float[Tensor, "items coeffs"]:
    """Returns t z with the t >= 0 of smallest residual; 0 where z is."""
    predicted = scaled.predict(z)
    power = predicted.square().sum(dim=-1, keepdim=True)
    along = (predicted * targets).sum(dim=-1, keepdim=True).clamp(min=0)
    return z * torch.where(power > 0, along / torch.where(power > 0, power, 1.0), 0.0)
