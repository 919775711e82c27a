"""Damped least squares for photographs that lack some samples, by a factor no larger than these samples are many."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.solvers.modulus import Modulus
from torchlight.threads import single_threaded_map

ROWS_PER_TASK = 512


@dataclass(frozen=True, eq=False)
class Lacking:
    """What a group of items of equal weights lacks.

    Attributes:
        items: how many they are.
        samples: each once.
        taken: the weight that is missing there, positive.
    """

    items: int
    samples: Int[Tensor, " s"]
    taken: Float[Tensor, " s"]


@dataclass(frozen=True, eq=False)
class Filling:
    """(H + d 1)^-1 c for many H = G - C_s' D C_s, one set of samples s and weights D > 0 taken away each.

    With G = V diag(g) V' and B = C V (diag(g) + d 1)^(-1/2), made once, the matrix of Woodbury's identity is only as
    large as the samples are many:

        (H + d 1)^-1 = V (diag(g) + d 1)^(-1/2) (1 + B_s' (D^-1 - B_s B_s')^-1 B_s) (diag(g) + d 1)^(-1/2) V'.

    Attributes:
        basis: V (diag(g) + d 1)^(-1/2).
        rows: B.

    References:
        Woodbury, Inverting modified matrices, 1950.
    """

    basis: Float[Tensor, "k k"]
    rows: Float[Tensor, "points k"]

    def damped(self, lacking: list[Lacking], linear: Float[Tensor, "items k"]) -> Float[Tensor, "items k"]:
        """Returns (H + d 1)^-1 c of every row: products that the groups of items share are made once.

        Args:
            lacking: what each group lacks, one group after another.
            linear: c.
        """
        along = linear @ self.basis
        for group, part in zip(lacking, along.split([group.items for group in lacking]), strict=True):
            rows = self.rows[group.samples]
            inner = torch.diag(1 / group.taken).addmm_(rows, rows.T, alpha=-1)
            factor = torch.linalg.cholesky_ex(inner)[0]
            part.add_(torch.cholesky_solve(rows @ part.T, factor).T @ rows)
        return along @ self.basis.T


def filling_of(columns: Float[Tensor, "points k"], guess: Modulus, damping: float) -> Filling:
    """Returns what the photographs share, for the columns whose Gram matrix `guess` has."""
    basis = guess.vectors / (guess.values + damping).sqrt()
    rows = torch.empty_like(columns)

    def fill(start: int) -> None:
        torch.mm(columns[start : start + ROWS_PER_TASK], basis, out=rows[start : start + ROWS_PER_TASK])

    for _ in single_threaded_map(fill, range(0, columns.shape[0], ROWS_PER_TASK)):
        pass
    return Filling(basis, rows)
