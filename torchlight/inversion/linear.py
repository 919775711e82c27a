"""How light is found from one linear system: T c = E, with radiance S c that is nowhere negative where asked."""

from __future__ import annotations

from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.light.bases import Basis, HaarCubemap, Texels
from torchlight.photo.observation import Observation
from torchlight.solvers import NNLS, NonnegativeSynthesis, ProjectedAdam, Ridge, Solution, Solver
from torchlight.solvers.implicit import solve_differentiably
from torchlight.transfer import Transfer


def solve(
    matrix: Float[Tensor, "points coeffs"],
    observation: Observation,
    solver: Solver,
    synthesis: Float[Tensor, "texels coeffs"] | None = None,
) -> Solution:
    """Returns the coefficients that explain an observation: argmin |W^(1/2) (A x - b)|^2 / 2 under the solver's signs.

    The coefficients have first derivatives with respect to A, b and W. With g the gradient of a loss by x, P the
    columns with x_j > 0, H = A_P'W A_P + the solver's damping and u = H^-1 g_P:

        dL/db = W A_P u,    dL/dW_i = (A_P u)_i (b - A x)_i,    dL/dA = W ((b - A x) u' - (A_P u) x')

    plus what the damping contributes (`solvers.implicit_faces`). Exact where H is regular and P stays the same nearby
    (strict complementarity); elsewhere finite, of smallest norm. 0 for samples of weight 0 and for failed items.
    Works under `torch.func.vmap` and `grad`, and in `torch.compile(fullgraph=True)`.

    Args:
        matrix: A, the transport of the unknowns.
        observation: b and W, any batch axes, all channels at once.
        solver: settings that say which constraint and which algorithm.
        synthesis: S where the constraint is S x >= 0; it has no gradient.

    Raises:
        ShapeError: shapes disagree, or matrix, weights or synthesis hold forbidden values.
        SolveError: on the way back, where a second derivative is asked for.
    """
    samples = observation.samples.to(matrix)
    return solve_differentiably(matrix, samples, observation.weights.to(matrix), synthesis, solver)


def solve_light(transfer: Transfer, basis: Basis, observation: Observation, solver: Solver) -> Solution:
    """Returns the coefficients of the light in a basis.

    A complete Haar basis spans the texels, and S c >= 0 is then the sign constraint on texels: that problem is solved
    on the texels and analysed, which is the same minimiser. For spherical harmonics non-negative radiance is a
    quadratic program over the texels above the plane.

    Raises:
        ConfigError: the solver cannot keep the radiance of this basis non-negative.
    """
    if isinstance(solver, NNLS | ProjectedAdam) and isinstance(basis, HaarCubemap):
        texels = solve(transfer.transport, observation, solver)
        return replace(texels, coefficients=basis.analysis(texels.coefficients))
    if isinstance(solver, NNLS | ProjectedAdam) and not isinstance(basis, Texels):
        raise ConfigError(
            f"{type(solver).__name__} constrains coefficients, not radiance, in the basis '{basis.name}'; "
            "use NonnegativeSynthesis() or Ridge()"
        )
    matrix = transfer.project(basis)
    if isinstance(solver, NonnegativeSynthesis):
        return solve(matrix, observation, solver, basis.synthesis_matrix(dtype=matrix.dtype, device=matrix.device))
    return solve(matrix, observation, solver)


def default_solver(basis: Basis) -> Solver:
    """Returns the exact solver that keeps radiance non-negative: NNLS, or a quadratic program for harmonics."""
    return NNLS() if isinstance(basis, Texels | HaarCubemap) else NonnegativeSynthesis()


def named_solver(name: str, basis: Basis) -> Solver:
    """Returns the solver behind a name of the command line: "nnls", "ridge" or "adam".

    Raises:
        ConfigError: the name is unknown, or "adam" is asked for spherical harmonics.
    """
    if name == "nnls":
        return default_solver(basis)
    if name == "ridge":
        return Ridge()
    if name == "adam":
        if not isinstance(basis, Texels | HaarCubemap):
            raise ConfigError("--solver adam works on texels and haar; use --solver nnls or ridge with --method sh")
        return ProjectedAdam()
    raise ConfigError(f"--solver: expected nnls, ridge or adam, got '{name}'")
