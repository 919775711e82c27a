"""Batched least squares, with and without sign constraints. Nothing here knows about light."""

from torchlight.solvers.adam import ProjectedAdam
from torchlight.solvers.certificate import Certificate, kkt_residual, nonnegative_certificate
from torchlight.solvers.nnls import NNLS
from torchlight.solvers.problem import LeastSquares
from torchlight.solvers.ridge import Ridge
from torchlight.solvers.solution import Solution, Status
from torchlight.solvers.solver import Solver
from torchlight.solvers.synthesis import NonnegativeSynthesis

__all__ = [
    "NNLS",
    "Certificate",
    "LeastSquares",
    "NonnegativeSynthesis",
    "ProjectedAdam",
    "Ridge",
    "Solution",
    "Solver",
    "Status",
    "kkt_residual",
    "nonnegative_certificate",
]
