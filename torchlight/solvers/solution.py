"""What a solve returns: coefficients, and for every item how it ended and how good it provably is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import SolveError

MAX_NAMED_ITEMS = 5


class Status(IntEnum):
    """How the solve of one item ended."""

    CONVERGED = 0
    STOPPED_SHORT = 1
    NOT_FINITE = 2
    NO_OBSERVATIONS = 3


CAUSE_AND_CURE = {
    Status.STOPPED_SHORT: "stopped short of its tolerance; raise the solver's step limit or its tolerance",
    Status.NOT_FINITE: "has samples that are NaN, infinite or too large; give those samples weight 0",
    Status.NO_OBSERVATIONS: "has no sample of positive weight; check its mask and the camera's view",
}


@dataclass(frozen=True, eq=False)
class Solution:
    """Coefficients and certificates of every item. A failed item has zeros and its status; it harms no other.

    All figures are dimensionless and refer to the float64 result, before it is rounded to the samples' dtype;
    NaN means "not certified".

    Attributes:
        coefficients: x, dtype and device of the samples; 0 where an item is NOT_FINITE or has NO_OBSERVATIONS.
        status: a `Status` per item.
        steps: factorisations or iterations spent.
        relative_residual: |W^(1/2) (A x - b)| / |W^(1/2) b|, 0 for b = 0.
        kkt_residual: distance from the optimality conditions; each solver's docstring gives its formula.
        gap: upper bound of (f(x) - min f) / (|W^(1/2) b|^2 / 2) from a dual point; NaN where no dual point is known.
    """

    coefficients: Float[Tensor, "*batch channels coeffs"]
    status: Int[Tensor, "*batch channels"]
    steps: Int[Tensor, "*batch channels"]
    relative_residual: Float[Tensor, "*batch channels"]
    kkt_residual: Float[Tensor, "*batch channels"]
    gap: Float[Tensor, "*batch channels"]

    def check(self) -> None:
        """Returns if every item converged.

        Raises:
            SolveError: one line that names the items (their indices), the cause and the cure.
        """
        failed = torch.nonzero(self.status != Status.CONVERGED)
        if failed.shape[0] == 0:
            return
        first = Status(int(self.status[tuple(failed[0])].item()))
        alike = failed[self.status[tuple(failed.T)] == first]
        named = ", ".join(str(tuple(item.tolist())) for item in alike[:MAX_NAMED_ITEMS])
        more = f" and {alike.shape[0] - MAX_NAMED_ITEMS} more" if alike.shape[0] > MAX_NAMED_ITEMS else ""
        others = f" ({failed.shape[0] - alike.shape[0]} others failed otherwise)" if len(alike) < len(failed) else ""
        raise SolveError(f"item (photo, channel) {named}{more}: {CAUSE_AND_CURE[first]}{others}")
