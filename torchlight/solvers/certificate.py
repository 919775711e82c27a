"""How far an answer is from optimal, whoever computed it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.solvers.system import System

SMALLEST_RESIDUAL = 1e-6  # of |b|


@dataclass(frozen=True, eq=False)
class Certificate:
    """The figures of `Solution`, one row per item."""

    relative_residual: Float[Tensor, " items"]
    kkt_residual: Float[Tensor, " items"]
    gap: Float[Tensor, " items"]


def nonnegative_certificate(system: System, x: Float[Tensor, "items coeffs"], ridge: float = 0.0) -> Certificate:
    """Returns residual, KKT residual and duality gap of x as an answer to min |A x - b|^2 / 2 over x >= 0.

    A and b carry the weights' roots; everything in float64, from A itself rather than its Gram matrix. The KKT
    residual is that of the objective plus ridge sum_j |a_j|^2 x_j^2 / 2; the gap is without that term.
    """
    residual = system.targets - system.predict(x)
    w = system.correlate(residual)
    size = nonzero_norm(system.targets)
    once, which = weights_once(system)
    norms, reach = once.column_norms()[which], once.correlate(once.root)[which]
    return Certificate(
        relative_residual=torch.linalg.vector_norm(residual, dim=-1) / size,
        kkt_residual=kkt_residual(x, w - ridge * norms.square() * x, norms, size),
        gap=gap_along(system.targets, residual, w, norms, reach, system.root),
    )


def weights_once(system: System) -> tuple[System, Int[Tensor, " items"]]:
    """Returns the first of neighbouring items of equal weights, and which of these each item's weights are."""
    new = torch.cat([torch.ones_like(system.root[:1, 0]) > 0, (system.root[1:] != system.root[:-1]).any(dim=1)])
    which = (new.cumsum(dim=0) - 1).expand(system.targets.shape[0])
    return System(system.matrix, system.root[new], system.targets[: len(new)][new]), which


def kkt_residual(
    x: Float[Tensor, "*items coeffs"],
    w: Float[Tensor, "*items coeffs"],
    norms: Float[Tensor, "*#items coeffs"],
    size: Float[Tensor, "*items"],
) -> Float[Tensor, "*items"]:
    """Returns the largest violation of the optimality conditions of non-negative least squares, dimensionless.

    The largest of: max_j w_j / (|a_j| |b|) (dual feasibility), max_j -x_j |a_j| / |b| (primal feasibility) and
    sum_j |x_j w_j| / |b|^2 (complementarity), with w = A'(b - A x). It is 0 at the minimiser and does not
    change when A, one of its columns or b is scaled.

    Args:
        x: the answer.
        w: negative gradient.
        norms: |a_j|; columns of norm 0 do not count.
        size: |b|, or 1 where b = 0.
    """
    safe = torch.where(norms > 0, norms, 1.0)
    dual = (w / safe).amax(dim=-1).clamp(min=0) / size
    primal = (-x * norms).amax(dim=-1).clamp(min=0) / size
    complementarity = (x * w).abs().sum(dim=-1) / size / size
    return torch.stack([dual, primal, complementarity]).amax(dim=0)


def kkt_cosine(
    z: Float[Tensor, "*items coeffs"], w: Float[Tensor, "*items coeffs"], residual: Float[Tensor, "*items points"]
) -> Float[Tensor, "*items"]:
    """Returns the largest cosine of an angle that should be a right one, between the residual and a column.

    At the minimum the residual r is orthogonal to columns in use, and no other column points along it: the largest of
    |w_j| / |r| where x_j > 0 and w_j / |r| elsewhere, with w_j = a_j'r / |a_j|. It does not change when A, one of its
    columns or b is scaled. It is stricter than `kkt_residual` where the fit is good, for |b| stands there for |r|. A
    residual below 1e-6 |b| counts as 1e-6 |b|: below it rounding has the say.

    Args:
        z: the answer, at least 0.
        w: inner products of the residual with the columns scaled to norm 1.
        residual: b - A x, for |b| = 1.
    """
    violation = torch.where(z > 0, w.abs(), w.clamp(min=0)).amax(dim=-1)
    return violation / torch.linalg.vector_norm(residual, dim=-1).clamp(min=SMALLEST_RESIDUAL)


def duality_gap(
    system: System,
    residual: Float[Tensor, "items points"],
    w: Float[Tensor, "items coeffs"],
    norms: Float[Tensor, "#items coeffs"],
) -> Float[Tensor, " items"]:
    """Returns an upper bound of (f(x) - min f) / (|b|^2 / 2) from a dual point; NaN where none is at hand.

    The dual of min |A x - b|^2 / 2 over x >= 0 is max theta'b - |theta|^2 / 2 over A' theta <= 0. The residual itself
    is almost feasible: theta = t (r - s v) with v = W^(1/2) 1 and the smallest s >= 0 that makes it so, which exists if
    A'v > 0 in every non-zero column (a transport is non-negative); t >= 0 is optimal.
    """
    return gap_along(system.targets, residual, w, norms, system.correlate(system.root), system.root)


def gap_along(
    targets: Float[Tensor, "*items points"],
    residual: Float[Tensor, "*items points"],
    w: Float[Tensor, "*items coeffs"],
    norms: Float[Tensor, "*#items coeffs"],
    v_columns: Float[Tensor, "*#items coeffs"],
    v: Float[Tensor, "*#items points"],
) -> Float[Tensor, "*items"]:
    """Returns `duality_gap` from its parts: b, r, w, |a_j|, A'v and v."""
    positive = v_columns > 0
    s = torch.where(positive, w / torch.where(positive, v_columns, 1.0), 0.0).amax(dim=-1).clamp(min=0)
    exists = (s == 0) & (w <= 0).all(dim=-1) | (positive | (norms == 0)).all(dim=-1)
    theta = residual - s[..., None] * v
    size = nonzero_norm(targets)
    along = (theta * targets).sum(-1).clamp(min=0) / nonzero_norm(theta)
    # |b| scales both terms, so that the difference of squares is taken as a product and keeps its digits.
    primal = torch.linalg.vector_norm(residual, dim=-1) / size
    dual = along / size
    gap = ((primal - dual) * (primal + dual)).clamp(min=0)
    return torch.where(exists, gap, torch.nan)


def nonzero_norm(vectors: Float[Tensor, "*items points"]) -> Float[Tensor, "*items"]:
    """Returns the length of each vector, 1 where it is 0."""
    norm = torch.linalg.vector_norm(vectors, dim=-1)
    return torch.where(norm > 0, norm, 1.0)
