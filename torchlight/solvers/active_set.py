"""The active-set core of the exact solvers: a convex quadratic over x >= 0, given by its Gram matrix."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

SMALLEST_SHIFT = 1e-13  # just above the rounding of a float64 Gram matrix with unit diagonal
FEW = 4
AT_BOUND = 1e-10  # of its value before the step: a coefficient this small has reached 0
STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1, *(10.0**-k for k in range(2, 15)))


@dataclass(frozen=True)
class Limits:
    """When the core stops.

    Attributes:
        tolerance: largest w_j = (c - G x - ridge x)_j where x_j = 0, and largest |w_j| where x_j > 0.
        max_steps: number of factorisations.
        most_entrants: columns that may come in with one step. 1 keeps the passive columns independent (Lawson and
            Hanson's method), which is what matters where there are far fewer rows than columns.
    """

    tolerance: float
    max_steps: int
    most_entrants: int = 2**30


def minimize_nonnegative(
    gram: Float[Tensor, "n n"], linear: Float[Tensor, " n"], start: Float[Tensor, " n"], ridge: float, limits: Limits
) -> tuple[Float[Tensor, " n"], int]:
    """Returns the minimiser of x'Gx/2 - c'x + ridge |x|^2/2 over x >= 0, and the number of steps taken.

    Each step lets the most promising columns in, takes Newton's direction on the passive block (only that block is
    factored) and keeps the best of a few points of the projected path, so the objective falls at every step. Where it
    does not fall, fewer columns come in, down to one on a stationary face (Lawson and Hanson's step, which must fall).
    When neither that nor the face itself yields a gain, float64 is exhausted and the loop ends.

    Args:
        gram: G, symmetric, positive semidefinite to rounding, with unit diagonal.
        linear: c, of order one.
        start: x >= 0 to begin from.
        ridge: see above, at least 0.
        limits: when to stop.

    References:
        Lawson and Hanson, Solving Least Squares Problems, 1974, chapter 23.
        Bertsekas, Projected Newton methods for optimization problems with simple constraints, 1982 (the path).
    """
    x = start.clone()
    passive = (x > 0).nonzero()[:, 0]
    w = linear - x[passive] @ gram[passive] - ridge * x
    entrants, single_failed = min(limits.most_entrants, FEW), False
    for step in range(limits.max_steps):
        free = x > 0
        if violation(free, w) <= limits.tolerance:
            return x, step
        index = with_entrants(free, w, entrants)
        rows = gram[index]
        block = rows[:, index]
        block.diagonal().add_(ridge)
        move, gain = best_move(block, x[index], w[index], ridge)
        if gain > 0:
            x[index] += move
            w -= move @ rows
            w[index] -= ridge * move
            # in proportion to what is passive: a light of five texels would else drag hundreds in and out again
            most = min(limits.most_entrants, FEW + index.shape[0] // 2)
            entrants, single_failed = min(most, max(1, 2 * entrants)), False
        elif entrants > 0:
            entrants, single_failed = entrants // 4, entrants == 1
        elif single_failed:
            return x, step
        else:
            entrants = 1
    return x, limits.max_steps


def violation(free: Bool[Tensor, " n"], w: Float[Tensor, " n"]) -> float:
    """Returns how far w is from stationary: |w_j| where x_j > 0, the positive part elsewhere."""
    return torch.where(free, w.abs(), w.clamp(min=0)).max().item()


def with_entrants(free: Bool[Tensor, " n"], w: Float[Tensor, " n"], entrants: int) -> Int[Tensor, " k"]:
    """Returns the indices of the free columns and of at most `entrants` others, those of largest w > 0."""
    promise = torch.where(free, torch.zeros_like(w), w)
    chosen = torch.topk(promise, min(entrants, w.shape[0])).indices
    wanted = free.clone()
    wanted[chosen] |= promise[chosen] > 0
    return wanted.nonzero()[:, 0]


def best_move(
    block: Float[Tensor, "k k"], x: Float[Tensor, " k"], w: Float[Tensor, " k"], ridge: float
) -> tuple[Float[Tensor, " k"], float]:
    """Returns the best of a few moves along the projected Newton path, and by how much it lowers the objective.

    The gain is w'm - m'Bm/2, free of cancellation. The last point tried ends at the first bound that the path meets.
    """
    direction = torch.cholesky_solve(w[:, None], cholesky(block, ridge))[:, 0]
    towards_bound = (direction < 0) & (x > 0)
    reach = torch.where(towards_bound, -x / direction, torch.ones_like(x)).min().clamp(max=1.0)
    lengths = torch.cat([torch.tensor(STEP_LENGTHS, dtype=x.dtype, device=x.device), reach[None]])
    ends = x + lengths[:, None] * direction
    moves = torch.where(ends <= AT_BOUND * x, 0.0, ends) - x  # exactly 0, or the next step stops at the same bound
    gains = moves @ w - ((moves @ block) * moves).sum(-1) / 2
    best = int(gains.argmax().item())
    return moves[best], gains[best].item()


def cholesky(block: Float[Tensor, "k k"], ridge: float) -> Float[Tensor, "k k"]:
    """Returns the factor of the block plus the smallest shift that makes it positive definite.

    Dependent columns never raise: a shifted matrix still gives a direction of descent, and the steps that follow act
    as its iterative refinement.
    """
    shift = max(0.0, SMALLEST_SHIFT - ridge)
    while True:
        shifted = block.clone()
        shifted.diagonal().add_(shift)
        factor, info = torch.linalg.cholesky_ex(shifted)
        if info.item() == 0:
            return factor
        shift = max(10 * shift, SMALLEST_SHIFT)
