"""How the answer of a solve turns when its problem does: one linear solve on the face where it lies.

Every solver here minimises f(x) + x'D x / 2, f(x) = |W^(1/2) (A x - b)|^2 / 2, over a cone. Near an answer with strict
complementarity the constraints that hold with equality stay the same, x = Z y stays in their null space Z, and

    Z'F(x, A, b, W) = 0,    F = A'W (A x - b) + D x

defines x as a function of A, b and W. With g the gradient of a loss by x, H = A'W A + D and the adjoint vector

    u = Z (Z'H Z)^-1 Z'g

the loss changes by -u'dF. `implicit_adjoint` turns u into gradients; this module finds it, solver by solver. Where
Z'H Z is singular the inverse is a pseudo-inverse: u is the one of smallest norm, so what the samples do not determine
carries no gradient, and nothing grows without bounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.solvers.ridge import Ridge
from torchlight.solvers.synthesis import NonnegativeSynthesis
from torchlight.solvers.system import System, same_rows

EPSILON = torch.finfo(torch.float64).eps
AT_BOUND = 100.0  # tolerances of the solver, on the primal feasibility that it certifies: so close to 0 is 0


@dataclass(frozen=True, eq=False)
class Adjoint:
    """u, and what D contributes since it depends on A and W itself. None = no such term.

    Attributes:
        u: see above.
        pair: p and q of a term W (A p) q' in the gradient by A and (A p)_i (A q)_i / 2 in that by W_i.
        own: c = ridge u x, entry by entry, of a term -2 W A diag(c) in the gradient by A and -sum_j c_j A_ij^2 in that
            by W_i.
    """

    u: Float[Tensor, "items coeffs"]
    pair: tuple[Float[Tensor, "items coeffs"], Float[Tensor, "items coeffs"]] | None = None
    own: Float[Tensor, "items coeffs"] | None = None


def joined(parts: Sequence[Adjoint]) -> Adjoint:
    """Returns the adjoints of one solver's items, group after group, as one."""
    u = torch.cat([part.u for part in parts])
    pairs = [part.pair for part in parts if part.pair is not None]
    own = [part.own for part in parts if part.own is not None]
    pair = (torch.cat([left for left, _ in pairs]), torch.cat([right for _, right in pairs])) if pairs else None
    return Adjoint(u, pair, torch.cat(own) if own else None)


def nonnegative_adjoint(
    system: System, x: Float[Tensor, "items coeffs"], gradient: Float[Tensor, "items coeffs"], ridge: float
) -> Adjoint:
    """Returns the adjoint over x >= 0 with D = ridge diag(|a_j|^2): on the columns with x_j > 0.

    Solved for |a_j| u_j, so that a singular block gives the limit of ridge -> 0 on this face.

    Args:
        system: items that share their weights; its targets are not read.
        x: the answers; a coefficient of exactly 0 is at its bound.
        gradient: g.
        ridge: as in `NNLS`.
    """
    free = x > 0
    index = free.any(dim=0).nonzero()[:, 0]
    columns = system.columns(index)
    gram = columns.T @ columns
    norms = gram.diagonal().sqrt()
    inverse = torch.where(norms > 0, 1 / norms, 0.0)
    gram = gram * inverse[:, None] * inverse
    gram.diagonal().add_(ridge)
    free, right = free[:, index], gradient[:, index] * inverse
    turned = torch.zeros_like(right)
    for items in same_rows(free.to(torch.float64)):
        face = free[items[0]].nonzero()[:, 0]
        block = gram[face][:, face]
        turned[items[:, None], face] = semidefinite_solve(block, right[items[:, None], face].T).T
    u = torch.zeros_like(x)
    u[:, index] = turned * inverse
    return Adjoint(u, own=ridge * u * x)


def semidefinite_solve(block: Float[Tensor, "k k"], right: Float[Tensor, "k n"]) -> Float[Tensor, "k n"]:
    """Returns the solution of smallest norm of a positive semidefinite system: by Cholesky unless it is singular."""
    if block.shape[0] == 0:
        return right
    factor, info = torch.linalg.cholesky_ex(block)
    least = block.shape[0] * EPSILON * block.diagonal().max()
    if info.item() == 0 and bool(factor.diagonal().square().min() > least):
        return torch.cholesky_solve(right, factor)
    values, vectors = torch.linalg.eigh(block)
    kept = values > block.shape[0] * EPSILON * values[-1]
    values, vectors = values[kept], vectors[:, kept]
    return vectors @ ((vectors.T @ right) / values[:, None])


def ridge_adjoint(
    system: System, x: Float[Tensor, "items coeffs"], gradient: Float[Tensor, "items coeffs"], settings: Ridge
) -> Adjoint:
    """Returns the adjoint without a constraint, D = damping s_1^2.

    By the singular values s_k and vectors v_k of W^(1/2) A that `Ridge` keeps, n the part of g that they do not span:

        u = sum_k v_k v_k'g / (s_k^2 + damping s_1^2) + n / (damping s_1^2).

    With damping 0 the last term is left out, and its share of the derivative by A, which has a limit wherever the rank
    stays the same, is the pair (H^+ x, n). With damping s_1 itself turns with A and W (it must be simple).
    """
    matrix = system.matrix.to(torch.float64) * system.root[0, :, None]
    _, values, right = torch.linalg.svd(matrix, full_matrices=False)
    tolerance = max(matrix.shape) * EPSILON if settings.tolerance is None else settings.tolerance
    kept = values > tolerance * values[0]
    values, right = values[kept], right[kept]
    shift = (settings.damping * values[:1].square()).sum()
    seen = gradient @ right.T
    unseen = gradient - seen @ right
    u = seen / (values.square() + shift) @ right
    if shift == 0:
        return Adjoint(u, pair=((x @ right.T) / values.square() @ right, unseen))
    u = u + unseen / shift
    first = right[:1].expand_as(u)
    return Adjoint(u, pair=(first, -2 * settings.damping * (u * x).sum(dim=-1, keepdim=True) * first))


def synthesis_adjoint(
    system: System,
    synthesis: Float[Tensor, "texels coeffs"],
    x: Float[Tensor, "items coeffs"],
    gradient: Float[Tensor, "items coeffs"],
    settings: NonnegativeSynthesis,
) -> Adjoint:
    """Returns the adjoint over S x >= 0, D = 0: in the null space of the rows of S that x makes 0."""
    matrix = system.matrix.to(torch.float64) * system.root[0, :, None]
    _, values, right = torch.linalg.svd(matrix, full_matrices=False)
    root = values[:, None] * right  # root'root = A'W A, with no more rows than columns
    norms = torch.linalg.vector_norm(synthesis, dim=1, keepdim=True)
    rows = (synthesis / torch.where(norms > 0, norms, 1.0))[norms[:, 0] > 0]
    radiance = x @ rows.T
    size = torch.linalg.vector_norm(system.targets * system.root, dim=-1, keepdim=True)
    peak = torch.maximum(radiance.abs().amax(dim=-1, keepdim=True), size / torch.where(values[:1] > 0, values[:1], 1.0))
    bound = radiance <= AT_BOUND * settings.tolerance * peak
    u = torch.zeros_like(x)
    for items in same_rows(bound.to(torch.float64)):
        basis = null_space(rows[bound[items[0]]])
        face = root @ basis
        inverse = torch.linalg.pinv(face, rtol=max(system.matrix.shape) * EPSILON)
        u[items] = gradient[items] @ (basis @ inverse @ inverse.T @ basis.T)
    return Adjoint(u)


def null_space(rows: Float[Tensor, "rows coeffs"]) -> Float[Tensor, "coeffs free"]:
    """Returns orthonormal columns that span what is orthogonal to the rows."""
    coeffs = rows.shape[1]
    if rows.shape[0] == 0:
        return torch.eye(coeffs, dtype=rows.dtype, device=rows.device)
    _, values, right = torch.linalg.svd(rows)
    rank = int((values > max(rows.shape) * EPSILON * values[0]).sum())
    return right[rank:].T
