"""How far noise moves a light that has been found: the deviation of every radiance, from the equations themselves.

    W^(1/2) b = W^(1/2) A x + e,   e white with deviation s

Of the radiances that are free to move, the covariance is s^2 (A'W A)^-1 over their columns. A radiance that the solver
holds at 0 can only rise: beside the free ones its least-squares value is N(m, d^2), m = w / h <= 0, d^2 = s^2 / h, with
w the slope of the residual along its column and h what of the column's square the free ones do not explain. Its
deviation is the root mean square of that normal distribution above 0: how far above 0 the photograph lets it be.

Columns are scaled to length 1, and the ridge of the solvers, 1e-12, is added: no deviation exceeds a million times that
of a radiance which stands alone. What no sample sees has an infinite one. Everything in float64.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

RIDGE = 1e-12  # on columns of length 1
HELD = 1e-6  # contributions below this part of the largest count as 0: rounding of a float32 transform
RANK = 1e-9  # singular values of the rows held at 0 below this part of the largest are rounding


def radiance_deviation(
    gram: Float[Tensor, "n n"], slopes: Float[Tensor, " n"], values: Float[Tensor, " n"], sigma: float
) -> Float[Tensor, " n"]:
    """Returns the deviation of radiances that were found under x >= 0.

    Args:
        gram: A'W A.
        slopes: A'W (b - A x).
        values: x.
        sigma: deviation of a sample of weight 1.
    """
    norms = gram.diagonal().clamp(min=0).sqrt()
    safe = torch.where(norms > 0, norms, 1.0)
    scaled = gram / (safe[:, None] * safe)
    shares = values * norms
    free = (norms > 0) & (shares > HELD * shares.abs().max())
    held = (norms > 0) & ~free
    inverse = inverse_factor(scaled[free][:, free])
    left = 1 - (inverse @ scaled[free][:, held]).square().sum(dim=0)
    deviation = torch.full_like(values, torch.inf)
    deviation[free] = torch.linalg.vector_norm(inverse, dim=0)
    deviation[held] = above_zero((slopes / (safe * sigma))[held], left.clamp(min=RIDGE))
    return deviation * sigma / safe


def inverse_factor(gram: Float[Tensor, "n n"]) -> Float[Tensor, "n n"]:
    """Returns L^-1 with L L' = G + ridge, so that (G + ridge)^-1 = L^-T L^-1; G has a unit diagonal."""
    identity = torch.eye(gram.shape[0], dtype=gram.dtype, device=gram.device)
    factor = torch.linalg.cholesky(gram + RIDGE * identity)
    return torch.linalg.solve_triangular(factor, identity, upper=False)


def above_zero(slopes: Float[Tensor, " n"], curvature: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Returns the root mean square of N(w / h, 1 / h) above 0.

    With t = w / sqrt(h) and the ratio r = phi(t) / Phi(t): (1 + t^2 + t r) / h, which for t << 0 is 2 / (t^2 h).
    """
    t = (slopes / curvature.sqrt()).clamp(max=0.0)
    ratio = math.sqrt(2 / math.pi) / torch.special.erfcx(-t / math.sqrt(2))
    near = 1 + t.square() + t * ratio
    far = 2 / t.square().clamp(min=1.0)  # its first term: 1 + t^2 + t r loses all digits there
    return (torch.where(t > -30.0, near, far) / curvature).sqrt()


def spanned_deviation(
    gram: Float[Tensor, "k k"],
    synthesis: Float[Tensor, "n k"],
    held: Bool[Tensor, " n"],
    sigma: float,
) -> Float[Tensor, " n"]:
    """Returns the deviation of radiances S c that few functions span, those held at 0 among them.

    The free ones move within the coefficients that keep S c = 0 where it is held: with F a basis of these,
    s^2 S F (F'G F)^-1 F'S'. Of those held, an upper bound: what they could be were none held.

    Args:
        gram: of the functions' columns, A'W A.
        synthesis: S.
        held: where S c = 0 is held.
        sigma: deviation of a sample of weight 1.
    """
    rows = synthesis[held]
    _, values, right = torch.linalg.svd(rows, full_matrices=True)
    rank = int((values > RANK * values.max()).sum()) if rows.shape[0] else 0
    within = right[rank:].T
    deviation = _spread(within.T @ gram @ within, synthesis @ within, sigma)
    return torch.where(held, _spread(gram, synthesis, sigma), deviation)


def damped_deviation(
    gram: Float[Tensor, "k k"], damping: float, sigma: float, synthesis: Float[Tensor, "n k"] | None = None
) -> Float[Tensor, " n"]:
    """Returns the posterior deviation of radiances S c under ridge regression: s^2 S (G + damping g I)^-1 S'.

    g is the largest eigenvalue of G. It is what least squares damped by `Ridge` mean: coefficients that are N(0, s^2 /
    (damping g)) beforehand. Damping below 1e-12 counts as that.

    Args:
        gram: G = A'W A.
        damping: of `Ridge`.
        sigma: deviation of a sample of weight 1.
        synthesis: S; None = 1.
    """
    shift = max(damping, RIDGE) * torch.linalg.eigvalsh(gram)[-1]
    identity = torch.eye(gram.shape[0], dtype=gram.dtype, device=gram.device)
    factor = torch.linalg.cholesky(gram + shift * identity)
    rows = identity if synthesis is None else synthesis.T
    return sigma * torch.linalg.vector_norm(torch.linalg.solve_triangular(factor, rows, upper=False), dim=0)


def _spread(gram: Float[Tensor, "k k"], synthesis: Float[Tensor, "n k"], sigma: float) -> Float[Tensor, " n"]:
    """Returns s sqrt(diag(S G^-1 S'))."""
    if gram.shape[0] == 0:
        return torch.zeros_like(synthesis[:, :0].sum(dim=1))
    norms = gram.diagonal().clamp(min=0).sqrt()
    safe = torch.where(norms > 0, norms, 1.0)
    inverse = inverse_factor(gram / (safe[:, None] * safe))
    return sigma * torch.linalg.vector_norm(inverse @ (synthesis / safe).T, dim=0)
