"""Least squares whose synthesis must be non-negative: S x >= 0, for coefficients that are not radiance themselves."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.solvers.active_set import Limits
from torchlight.solvers.certificate import nonzero_norm
from torchlight.solvers.nnls import NNLS, Pool, nonnegative_item, unit_pool
from torchlight.solvers.problem import LeastSquares
from torchlight.solvers.solution import Solution
from torchlight.solvers.system import Answer, System, by_weights, solve_systems

DUAL_TOLERANCE = 1e-13  # as far as float64 goes: what is left is the violation of S x >= 0


@dataclass(frozen=True)
class NonnegativeSynthesis:
    """Minimises |W^(1/2) (A x - b)|^2 / 2 over S x >= 0, exactly, by proximal steps (Rockafellar, 1976).

    Every round adds proximity s_1^2 |x - x_previous|^2 / 2 (s_1: the largest singular value of W^(1/2) A, x_previous
    = 0 at first), which makes the program strictly convex however ill-conditioned A is. Its dual is a non-negative
    least-squares problem with one row per coefficient and one column per texel, solved by the active set of `NNLS`;
    the primal answer is its residual. The rounds converge to a minimiser of the program itself; ties go to the one
    next to the minimum norm.

    kkt_residual is the largest of |A'(A x - b) - S'u| / (s_1 |b|) (stationarity, u >= 0 the multipliers),
    max_i -(S x)_i / max(max_i |(S x)_i|, |b| / s_1) (primal feasibility) and |u'S x| / |b|^2 (complementarity);
    A and b carry the weights' roots, the rows of S are scaled to norm 1. gap comes from the dual point u:
    (q'(A'A)^+ q + 2 u'S x) / |b|^2 with q the stationarity residual; NaN while q has a part that A does not see. On an
    ill-conditioned A it is a loose bound.

    Attributes:
        proximity: see above; smaller takes fewer rounds, but below 1e-14 the dual is singular to float64.
        tolerance: on kkt_residual.
        max_rounds: an item that needs more is STOPPED_SHORT.
        max_steps: factorisations per item, likewise.
    """

    proximity: float = 1e-13
    tolerance: float = 1e-9
    max_rounds: int = 100
    max_steps: int = 10_000

    def __post_init__(self) -> None:
        if not 0.0 < self.proximity < float("inf"):
            raise ConfigError(f"NonnegativeSynthesis.proximity: expected a positive number, got {self.proximity}")
        if not 0.0 < self.tolerance < 1.0:
            raise ConfigError(f"NonnegativeSynthesis.tolerance: expected a number in (0, 1), got {self.tolerance}")
        if self.max_rounds < 1 or self.max_steps < 1:
            raise ConfigError(
                f"NonnegativeSynthesis: expected max_rounds and max_steps of at least 1, "
                f"got {self.max_rounds} and {self.max_steps}"
            )

    def solve(self, problem: LeastSquares) -> Solution:
        """Returns the solution of every item; without a synthesis that of `NNLS`."""
        synthesis = problem.synthesis
        if synthesis is None:
            return NNLS(tolerance=self.tolerance, max_steps=self.max_steps).solve(problem)
        return solve_systems(problem, lambda system: self._solve_system(system, synthesis), by_weights)

    def _solve_system(self, system: System, synthesis: Float[Tensor, "texels coeffs"]) -> Answer:
        program = diagonalized(system, synthesis.to(torch.float64), self.proximity)
        u, steps, figures, converged = self._solve_items(program, system.targets)
        x = u @ program.right
        residual = torch.linalg.vector_norm(system.targets - system.predict(x), dim=-1)
        return Answer(
            coefficients=x,
            steps=steps,
            relative_residual=residual / nonzero_norm(system.targets),
            kkt_residual=figures[:, 0],
            gap=figures[:, 1],
            converged=converged,
        )

    def _solve_items(
        self, program: Diagonal, targets: Float[Tensor, "items points"]
    ) -> tuple[Float[Tensor, "items coeffs"], Int[Tensor, " items"], Float[Tensor, "items 2"], Bool[Tensor, " items"]]:
        if targets.device.type != "cpu":
            from torchlight.solvers.device_synthesis import lockstep_synthesis  # it takes from here what both share

            return lockstep_synthesis(self, program, targets)
        pool = unit_pool(program.cone)
        items = [self._solve_item(program, pool, target) for target in targets]
        u, steps, figures, converged = (torch.stack(part) for part in zip(*items, strict=True))
        return u, steps, figures, converged

    def _solve_item(
        self, program: Diagonal, pool: Pool, target: Float[Tensor, " points"]
    ) -> tuple[Float[Tensor, " coeffs"], Tensor, Float[Tensor, "2"], Tensor]:
        size = nonzero_norm(target[None])[0]
        seen = target / size @ program.left
        u = torch.zeros_like(program.values)
        figures = torch.full_like(u[:1], torch.inf).expand(2)
        steps = 0
        for _ in range(self.max_rounds):
            center = (program.values * seen + program.shift * u) / program.scale
            u, multipliers, spent = project(program, pool, center, self.max_steps - steps)
            steps += spent
            figures = torch.stack(optimality(program, seen, u, multipliers))
            if figures[0] <= self.tolerance or steps >= self.max_steps:
                break
        return u * size, torch.tensor(steps, device=u.device), figures, figures[0] <= self.tolerance


@dataclass(frozen=True, eq=False)
class Diagonal:
    """The program in coordinates u = V'x in which its objective is diagonal: |s u - U'b|^2 / 2.

    Attributes:
        left: U, with zeros where A has fewer rows than columns.
        values: s, all of them.
        right: V'.
        shift: proximity s_1^2.
        scale: (s^2 + shift)^(1/2): in y = scale u a round is a projection onto the cone.
        synthesis: S V, rows of norm 1, zero rows left out.
        cone: the columns (synthesis / scale)', of norm 1.
        cone_norms: what they were divided by.
    """

    left: Float[Tensor, "points coeffs"]
    values: Float[Tensor, " coeffs"]
    right: Float[Tensor, "coeffs coeffs"]
    shift: Float[Tensor, ""]
    scale: Float[Tensor, " coeffs"]
    synthesis: Float[Tensor, "texels_used coeffs"]
    cone: Float[Tensor, "coeffs texels_used"]
    cone_norms: Float[Tensor, " texels_used"]


def diagonalized(system: System, synthesis: Float[Tensor, "texels coeffs"], proximity: float) -> Diagonal:
    """Returns the program in the coordinates of the singular vectors of W^(1/2) A."""
    matrix = system.matrix.to(torch.float64) * system.root[0, :, None]
    points, coeffs = matrix.shape
    padding = matrix.new_zeros(max(0, coeffs - points), coeffs)
    left, values, right = torch.linalg.svd(torch.cat([matrix, padding]), full_matrices=False)
    shift = proximity * torch.where(values[0] > 0, values[0].square(), 1.0)
    scale = (values.square() + shift).sqrt()
    norms = torch.linalg.vector_norm(synthesis, dim=1, keepdim=True)
    rows = (synthesis / torch.where(norms > 0, norms, 1.0))[norms[:, 0] > 0] @ right.T
    cone = rows / scale
    cone_norms = torch.linalg.vector_norm(cone, dim=1)
    return Diagonal(left[:points], values, right, shift, scale, rows, (cone / cone_norms[:, None]).T, cone_norms)


def project(
    program: Diagonal, pool: Pool, center: Float[Tensor, " coeffs"], max_steps: int
) -> tuple[Float[Tensor, " coeffs"], Float[Tensor, " texels_used"], int]:
    """Returns u of the point of the cone nearest to the center, the multipliers of S V u >= 0, and the steps.

    By Moreau's theorem y = center + C l with l >= 0 minimising |center + C l|, C the cone's columns.
    """
    ones = torch.ones_like(center)[None]
    norms = torch.ones_like(program.cone_norms)
    dual = System(program.cone, ones, -center[None])
    multipliers, steps, _ = nonnegative_item(dual, norms, pool, 0.0, Limits(DUAL_TOLERANCE, max_steps, most_entrants=1))
    y = center + program.cone @ multipliers
    return y / program.scale, multipliers / program.cone_norms, steps


def optimality(
    program: Diagonal,
    seen: Float[Tensor, "*items coeffs"],
    u: Float[Tensor, "*items coeffs"],
    multipliers: Float[Tensor, "*items texels_used"],
) -> tuple[Float[Tensor, "*items"], Float[Tensor, "*items"]]:
    """Returns kkt_residual and gap as `NonnegativeSynthesis` defines them, for |b| = 1."""
    s = program.values
    largest = torch.where(s[0] > 0, s[0], 1.0)
    radiance = u @ program.synthesis.T  # of no texel at all where every row of S is 0
    stationarity = s * (s * u - seen) - multipliers @ program.synthesis
    complementarity = (multipliers * radiance).sum(dim=-1)
    and_zero = torch.nn.functional.pad(radiance, (0, 1))
    violation = (-and_zero).amax(dim=-1) / torch.maximum(and_zero.abs().amax(dim=-1), 1 / largest)
    kkt = torch.stack([torch.linalg.vector_norm(stationarity, dim=-1) / largest, violation, complementarity.abs()])
    resolved = s > max(program.left.shape) * torch.finfo(s.dtype).eps * largest
    unseen = torch.linalg.vector_norm(torch.where(resolved, 0.0, stationarity), dim=-1) / largest
    gap = (stationarity / torch.where(resolved, s, torch.inf)).square().sum(dim=-1) + 2 * complementarity
    rounding = len(s) * torch.finfo(s.dtype).eps
    return kkt.amax(dim=0), torch.where(unseen <= rounding, gap.clamp(min=0), torch.nan)
