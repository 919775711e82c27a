"""Where non-negative least squares is likely to end, for many right-hand sides at once by matrix products alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

Stages = tuple[tuple[float, int], ...]

RELAXATION = 1.8
# penalties, of which the unit diagonal of the Gram matrix is the scale, and how many steps are taken with each
THOROUGH: Stages = ((1e-2, 20), (1e-3, 20), (1e-4, 20), (1e-5, 20), (1e-6, 20), (1e-7, 20))
QUICK: Stages = ((1e-2, 20), (1e-3, 15), (1e-4, 10), (1e-5, 10))  # where columns on the wrong side cost little


@dataclass(frozen=True, eq=False)
class Modulus:
    """Rough minimisers of x'Gx/2 - c'x over x >= 0, whose supports are mostly those of the true ones.

    The alternating direction method of multipliers (ADMM) keeps y = (G + p 1)^-1 (c + p (z - u)), z >= 0 and u. Both
    z and u live in one vector t: z = max(t, 0), u = min(t, 0), so that z - u = |t|, and a step is one product:

        t <- (1 - a/2) t + a y_0 + (a p (G + p 1)^-1 - a/2 1) |t|,    y_0 = (G + p 1)^-1 c.

    The penalty p falls by stages: directions whose eigenvalues are far above p have converged. float32 suffices, for
    the products have norm at most 1 whatever the condition of G.

    Attributes:
        vectors: eigenvectors of G, float64.
        values: eigenvalues of G.
        products: a p (G + p 1)^-1 - a/2 1 of every stage, float32.
        stages: the penalties p, and how many steps are taken with each.

    References:
        Boyd et al., Distributed optimization and statistical learning via ADMM, 2011, sections 3.4.1 and 3.4.3.
        Bai, Modulus-based matrix splitting iteration methods for linear complementarity problems, 2010 (|t|).
    """

    vectors: Float[Tensor, "n n"]
    values: Float[Tensor, " n"]
    products: Float[Tensor, "stages n n"]
    stages: Stages

    def minimizers(self, linear: Float[Tensor, "items n"]) -> Float[Tensor, "items n"]:
        """Returns z for every row c."""
        t = torch.zeros_like(linear, dtype=torch.float32)
        modulus = torch.empty_like(t)
        along = linear @ self.vectors
        before = self.stages[0][0]
        for (penalty, steps), product in zip(self.stages, self.products, strict=True):
            t = t.clamp(min=0) + t.clamp(max=0) * (before / penalty)
            before = penalty
            advance = (along * (RELAXATION / (self.values + penalty)) @ self.vectors.T).to(torch.float32)
            for _ in range(steps):
                torch.abs(t, out=modulus)
                t.mul_(1 - RELAXATION / 2).add_(advance).addmm_(modulus, product)
        return t.clamp(min=0).to(linear)


def modulus_of(gram: Float[Tensor, "n n"], stages: Stages = THOROUGH) -> Modulus:
    """Returns the iteration for a positive semidefinite G with unit diagonal."""
    values, vectors = torch.linalg.eigh(gram)
    values = values.clamp(min=0)
    products = torch.stack(list(_products(values.to(torch.float32), vectors.to(torch.float32), stages)))
    return Modulus(vectors, values, products, stages)


def _products(
    values: Float[Tensor, " n"], vectors: Float[Tensor, "n n"], stages: Stages
) -> Iterator[Float[Tensor, "n n"]]:
    for penalty, _ in stages:
        yield vectors * (RELAXATION * penalty / (values + penalty) - RELAXATION / 2) @ vectors.T
