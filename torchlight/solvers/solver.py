"""What a solver is: frozen settings with one method."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from torchlight.solvers.problem import LeastSquares
from torchlight.solvers.solution import Solution


@runtime_checkable
class Solver(Protocol):
    """Anything that solves a `LeastSquares`: the settings object is the solver."""

    def solve(self, problem: LeastSquares) -> Solution:
        """Returns one solution per item; a failed item is a status, never an exception."""
        ...
