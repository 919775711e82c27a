"""Spherical harmonics at their best: degree and damping chosen on the photograph itself, and checked against numpy."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.light.bases import SphericalHarmonics
from torchlight.photo.observation import Observation
from torchlight.solvers import LeastSquares, Ridge
from torchlight.transfer import Transfer

from .setting import RECEIVER

DEGREES = (2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 18, 20, 24, 28)
DAMPINGS = (0.0, *(10.0**k for k in range(-10, 0)))


def chosen_harmonics(transfer: Transfer, received: Observation) -> tuple[SphericalHarmonics, Ridge]:
    """Returns the degree and damping of least error on held-out quarters of the photograph.

    The receiver is cut into four quarters; each is predicted from the other three, all channels together. Quarters
    rather than single pixels, because neighbours share their shadow and would give the answer away.
    """
    scores = {}
    for degree in DEGREES:
        matrix = transfer.project(SphericalHarmonics(degree, transfer.resolution))
        scores |= {(degree, damping): e for damping, e in zip(DAMPINGS, quarter_errors(matrix, received), strict=True)}
    degree, damping = min(scores, key=lambda key: scores[key])
    return SphericalHarmonics(degree, transfer.resolution), Ridge(damping=damping)


def quarter_errors(matrix: Float[Tensor, "points coeffs"], received: Observation) -> list[float]:
    """Returns the sum of squared errors on the left-out quarters for every damping of `DAMPINGS`."""
    total = torch.zeros(len(DAMPINGS), dtype=torch.float64)
    used = received.weights > 0
    for quarter in quarters():
        learn, score = used & ~quarter, used & quarter
        rows, samples = matrix[learn].double(), received.samples[:, learn].double()
        left, values, right = torch.linalg.svd(rows, full_matrices=False)
        across = samples @ left
        for k, damping in enumerate(DAMPINGS):
            x = (across * values / (values.square() + damping * values[0].square())) @ right
            total[k] += (x @ matrix[score].double().T - received.samples[:, score]).square().sum()
    return total.tolist()


def quarters() -> list[Bool[Tensor, " points"]]:
    """Returns the four quarters of the receiver's samples."""
    columns, rows = RECEIVER.samples
    right = (torch.arange(columns) >= columns // 2).expand(rows, columns).reshape(-1)
    upper = (torch.arange(rows) >= rows // 2)[:, None].expand(rows, columns).reshape(-1)
    return [(right == side) & (upper == half) for side in (False, True) for half in (False, True)]


def lstsq_difference(matrix: Float[Tensor, "points coeffs"], received: Observation) -> float:
    """Returns how far the objective |W^(1/2) (A x - b)|^2 of `Ridge()` lies from numpy.linalg.lstsq's, relative to it.

    Both in float64; the largest over the channels.
    """
    root = received.weights.double().sqrt()
    rows, samples = matrix.double() * root[:, None], received.samples.double() * root
    ours = Ridge().solve(LeastSquares(matrix.double(), received.samples.double(), received.weights.double()))
    theirs = np.linalg.lstsq(rows.numpy(), samples.T.numpy())[0]
    objectives = [(x @ rows.T - samples).square().sum(dim=-1) for x in (ours.coefficients, torch.from_numpy(theirs.T))]
    return ((objectives[0] - objectives[1]).abs() / objectives[1]).max().item()
