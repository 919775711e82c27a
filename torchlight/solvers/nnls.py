"""Non-negative least squares, exact to float64."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.solvers.active_set import Limits, minimize_nonnegative
from torchlight.solvers.batch import batch_minimizers
from torchlight.solvers.certificate import nonnegative_certificate, nonzero_norm
from torchlight.solvers.problem import LeastSquares, check_no_synthesis
from torchlight.solvers.shared_gram import largest_norms, shared_gram
from torchlight.solvers.solution import Solution
from torchlight.solvers.system import Answer, System, all_at_once, same_rows, solve_systems

FULL_GRAM_COLUMNS = 4096
COLUMNS_PER_ROUND = 256
MAX_POOL = 6144
INNER_TOLERANCE = 1e-2  # of the tolerance asked for: complementarity sums over columns, and Gram matrices round


@dataclass(frozen=True)
class NNLS:
    """Minimises |W^(1/2) (A x - b)|^2 / 2 over x >= 0 by an active set, thousands of items on one Gram matrix.

    The minimiser of a rank-deficient problem is not unique: ties go to minimum norm of the contributions |a_j| x_j,
    by the term ridge sum_j |a_j|^2 x_j^2 / 2 (for columns of one norm a, ridge a^2 |x|^2 / 2). It raises the
    objective by at most ridge sum_j |a_j|^2 x_j^2 / 2, so by at most ridge |b|^2 where A >= 0, and costs no time.
    With ridge 0 a tie goes to some minimiser.

    kkt_residual is `certificate.kkt_residual` of the objective with the ridge; an item is CONVERGED where it is
    within tolerance.
    gap is `certificate.duality_gap`, without the ridge; NaN unless A is non-negative or nearly so.

    Up to 4,096 columns the Gram matrix is formed once, under the weights that most photographs have, and updated for
    the samples that another weighs differently; the entries of an updated matrix are exact to 1e-13 of the lengths of
    their columns. Supports are guessed for many items at once (`modulus`), and an exact method, in compiled code on a
    CPU, ends each. An item gets the same bits alone and among others of the same weights, on any number of threads;
    among other weights its objective is the same to 1e-12 of |b|^2. Beyond 4,096 columns only those that have
    looked promising are in a Gram matrix, and every round of columns is followed by a gradient over all of them.

    Attributes:
        ridge: see above; 1e-12 is the least that keeps the factors of dependent columns stable in float64.
        tolerance: on kkt_residual.
        max_steps: factorisations per item; an item that needs more is STOPPED_SHORT.
    """

    ridge: float = 1e-12
    tolerance: float = 1e-9
    max_steps: int = 5000

    def __post_init__(self) -> None:
        if not 0.0 <= self.ridge < float("inf"):
            raise ConfigError(f"NNLS.ridge: expected a finite number of at least 0, got {self.ridge}")
        if not 0.0 < self.tolerance < 1.0:
            raise ConfigError(f"NNLS.tolerance: expected a number in (0, 1), got {self.tolerance}")
        if self.max_steps < 1:
            raise ConfigError(f"NNLS.max_steps: expected at least 1, got {self.max_steps}")

    def solve(self, problem: LeastSquares) -> Solution:
        """Returns the non-negative solution of every item.

        Raises:
            ConfigError: if the problem has a synthesis (S x >= 0).
        """
        check_no_synthesis(problem, "NNLS")
        return solve_systems(problem, self._solve_system, all_at_once)

    def _solve_system(self, system: System) -> Answer:
        x, steps = nonnegative_items(system, self.ridge, Limits(self.tolerance * INNER_TOLERANCE, self.max_steps))
        certificate = nonnegative_certificate(system, x, self.ridge)
        return Answer(
            coefficients=x,
            steps=steps,
            relative_residual=certificate.relative_residual,
            kkt_residual=certificate.kkt_residual,
            gap=certificate.gap,
            converged=certificate.kkt_residual <= self.tolerance,
        )


@dataclass(frozen=True, eq=False)
class Pool:
    """Columns whose Gram matrix is at hand.

    Attributes:
        index: which columns of the system, in order of arrival.
        unit_columns: those columns divided by their norms.
        gram: their inner products.
    """

    index: Int[Tensor, " k"]
    unit_columns: Float[Tensor, "points k"]
    gram: Float[Tensor, "k k"]


def nonnegative_items(
    system: System, ridge: float, limits: Limits
) -> tuple[Float[Tensor, "items coeffs"], Int[Tensor, " items"]]:
    """Returns the minimiser over x >= 0 and the steps of every item; columns of norm 0 get 0."""
    x = torch.zeros(system.targets.shape[0], system.matrix.shape[1], dtype=torch.float64, device=system.root.device)
    norms = largest_norms(system)
    if int((norms > 0).sum()) <= FULL_GRAM_COLUMNS:
        shared = shared_gram(system, norms)
        x[:, shared.index], steps = batch_minimizers(system, shared, ridge, limits)
        return x, steps
    steps = torch.zeros(x.shape[0], dtype=torch.int64, device=x.device)
    for items in same_rows(system.root.expand(x.shape[0], -1)):
        root = system.root[:1] if system.root.shape[0] == 1 else system.root[items[:1]]
        norms = System(system.matrix, root, system.targets[:0]).column_norms()[0]
        pool = empty_pool(System(system.matrix, root, system.targets[:0]))
        for item in items.tolist():
            alone = System(system.matrix, root, system.targets[item : item + 1])
            x[item], steps[item], pool = nonnegative_item(alone, norms, pool, ridge, limits)
    return x, steps


def nonnegative_item(
    system: System, norms: Float[Tensor, " coeffs"], pool: Pool, ridge: float, limits: Limits
) -> tuple[Float[Tensor, " coeffs"], int, Pool]:
    """Returns the minimiser for a system of one item, the steps, and the pool with the columns it needed.

    Rounds: solve over the pool, take the gradient over all columns, let the most promising ones in. Each round starts
    at the last round's answer, so the objective falls until no column outside has a positive gradient.
    """
    size = nonzero_norm(system.targets)
    safe = torch.where(norms > 0, norms, 1.0)
    target = system.targets[0] / size
    pooled = torch.zeros_like(pool.unit_columns[0])
    steps = 0
    while True:
        if pool.index.shape[0] > 0:
            linear = target @ pool.unit_columns
            left = replace(limits, max_steps=max(1, limits.max_steps - steps))
            pooled, spent = minimize_nonnegative(pool.gram, linear, pooled, ridge, left)
            steps += spent
        residual = target - pool.unit_columns @ pooled
        w = system.correlate(residual[None])[0] / safe
        w[pool.index] = 0.0
        promise, candidates = torch.topk(w, min(COLUMNS_PER_ROUND, w.shape[0]))
        candidates = candidates[promise > limits.tolerance]
        if candidates.shape[0] == 0 or steps >= limits.max_steps:
            break
        if pool.index.shape[0] + candidates.shape[0] > MAX_POOL:
            pool, pooled = reduced(pool, pooled)
        pool = grown(pool, system, norms, candidates)
        pooled = torch.cat([pooled, torch.zeros_like(promise[: candidates.shape[0]])])
    x = torch.zeros_like(norms)
    x[pool.index] = pooled * size / norms[pool.index]
    return x, steps, pool


def empty_pool(system: System) -> Pool:
    """Returns a pool without columns."""
    none = torch.zeros(0, dtype=torch.int64, device=system.targets.device)
    return Pool(none, system.columns(none), system.root.new_zeros(0, 0))


def grown(pool: Pool, system: System, norms: Float[Tensor, " coeffs"], index: Int[Tensor, " k"]) -> Pool:
    """Returns the pool with these columns appended."""
    columns = system.columns(index) / norms[index]
    across = pool.unit_columns.T @ columns
    gram = torch.cat([torch.cat([pool.gram, across], dim=1), torch.cat([across.T, columns.T @ columns], dim=1)])
    return Pool(torch.cat([pool.index, index]), torch.cat([pool.unit_columns, columns], dim=1), gram)


def reduced(pool: Pool, x: Float[Tensor, " k"]) -> tuple[Pool, Float[Tensor, " j"]]:
    """Returns the pool and the answer without the columns whose coefficient is 0."""
    kept = x.nonzero()[:, 0]
    return Pool(pool.index[kept], pool.unit_columns[:, kept], pool.gram[kept][:, kept]), x[kept]


def unit_pool(unit_columns: Float[Tensor, "points coeffs"]) -> Pool:
    """Returns the pool to start with for columns of norm 1: all of them, or none where they are too many."""
    count = unit_columns.shape[1]
    kept = unit_columns[:, : count if count <= FULL_GRAM_COLUMNS else 0]
    return Pool(torch.arange(kept.shape[1], device=kept.device), kept, kept.T @ kept)
