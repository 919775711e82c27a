"""Gradients of a solve by its matrix, samples and weights, from the adjoint vectors of `implicit_faces`.

With r = b - A x and the adjoint vector u of an item, -u'dF is, item by item,

    dL/db_i = W_i (A u)_i
    dL/dW_i = (A u)_i r_i
    dL/dA   = W (r u' - (A u) x')

and the terms of D that `Adjoint` lists. A serves all items, W all channels of a photograph: those are sums. A sample of
weight 0 is absent, whatever it holds: it, its weight and its row of A get the gradient 0. A failed item (NOT_FINITE,
NO_OBSERVATIONS) contributes 0. Everything is computed in float64.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.solvers.adam import ProjectedAdam
from torchlight.solvers.implicit_faces import Adjoint, joined, nonnegative_adjoint, ridge_adjoint, synthesis_adjoint
from torchlight.solvers.nnls import NNLS
from torchlight.solvers.problem import LeastSquares
from torchlight.solvers.ridge import Ridge
from torchlight.solvers.solution import Status
from torchlight.solvers.solver import Solver
from torchlight.solvers.synthesis import NonnegativeSynthesis
from torchlight.solvers.system import System, by_weights, photo_weights


@dataclass(frozen=True, eq=False)
class Gradients:
    """Gradients of a loss, float64.

    Attributes:
        matrix: by A; None where it was not asked for.
        samples: by b.
        weights: by W.
    """

    matrix: Float[Tensor, "points coeffs"] | None
    samples: Float[Tensor, "photos channels points"]
    weights: Float[Tensor, "photos points"]


def problem_gradients(
    problem: LeastSquares,
    solver: Solver,
    coefficients: Float[Tensor, "*batch channels coeffs"],
    status: Int[Tensor, "*batch channels"],
    gradient: Float[Tensor, "*batch channels coeffs"],
    with_matrix: bool,
) -> Gradients:
    """Returns the gradients of a loss from its gradient by the coefficients.

    Args:
        problem: what was solved.
        solver: by which settings.
        coefficients: what came out.
        status: how each item ended.
        gradient: of the loss by the coefficients.
        with_matrix: whether the gradient by A is wanted: it is as large as A, in float64.
    """
    weights = photo_weights(problem)
    channels, points = problem.samples.shape[-2:]
    shape = (len(weights), channels, problem.matrix.shape[1])
    solved = ((status == Status.CONVERGED) | (status == Status.STOPPED_SHORT)).reshape(-1, channels, 1)
    x = torch.where(solved, exact(problem, solver, coefficients).reshape(shape).to(torch.float64), 0.0)
    g = torch.where(solved, gradient.reshape(shape).to(torch.float64), 0.0)
    samples = problem.samples.reshape(-1, channels, points).to(torch.float64)
    samples = torch.where(solved & (weights[:, None, :] > 0), samples, 0.0)
    by_matrix = torch.zeros_like(problem.matrix, dtype=torch.float64) if with_matrix else None
    result = Gradients(by_matrix, torch.zeros_like(samples), torch.zeros_like(weights))
    groups = [photos for photos in by_weights(weights) if bool(solved[photos].any())]
    if groups:
        parts = [
            adjoint_of(
                solver,
                problem.synthesis,
                System(problem.matrix, weights[photos[:1]].sqrt(), samples[photos].flatten(end_dim=1)),
                x[photos].flatten(end_dim=1),
                g[photos].flatten(end_dim=1),
            )
            for photos in groups
        ]
        order = torch.cat(groups)
        add_gradients(result, order, problem.matrix, weights[order], samples[order], x[order], joined(parts))
    return result


def exact(
    problem: LeastSquares, solver: Solver, coefficients: Float[Tensor, "*batch channels coeffs"]
) -> Float[Tensor, "*batch channels coeffs"]:
    """Returns the coefficients with the digits that tell which constraints hold with equality.

    For x >= 0 those are the zeros, which survive rounding. S x >= 0 in float32 no longer tells: it is solved again.
    """
    bounded = isinstance(solver, NonnegativeSynthesis) and problem.synthesis is not None
    if not bounded or problem.matrix.dtype == torch.float64:
        return coefficients
    parts = {field.name: getattr(problem, field.name) for field in fields(problem)}
    doubled = {name: part.to(torch.float64) for name, part in parts.items() if part is not None}
    return solver.solve(LeastSquares(**doubled)).coefficients


def adjoint_of(
    solver: Solver,
    synthesis: Float[Tensor, "texels coeffs"] | None,
    system: System,
    x: Float[Tensor, "items coeffs"],
    gradient: Float[Tensor, "items coeffs"],
) -> Adjoint:
    """Returns the adjoint of items that share their weights, for the program that the solver's settings stand for.

    Args:
        solver: the settings.
        synthesis: S.
        system: A, the root of the weights, and b itself as targets.
        x: the answers.
        gradient: of the loss by them.
    """
    match solver:
        case Ridge():
            return ridge_adjoint(system, x, gradient, solver)
        case NonnegativeSynthesis() if synthesis is not None:
            return synthesis_adjoint(system, synthesis.to(torch.float64), x, gradient, solver)
        case NonnegativeSynthesis():
            return nonnegative_adjoint(system, x, gradient, NNLS().ridge)
        case NNLS():
            return nonnegative_adjoint(system, x, gradient, solver.ridge)
        case ProjectedAdam():
            return nonnegative_adjoint(system, x, gradient, 0.0)
        case _:
            raise ConfigError(f"{type(solver).__name__}: its gradient is not known; expected a solver of torchlight")


def add_gradients(
    result: Gradients,
    photos: Int[Tensor, " some"],
    matrix: Float[Tensor, "points coeffs"],
    weights: Float[Tensor, "some points"],
    samples: Float[Tensor, "some channels points"],
    x: Float[Tensor, "some channels coeffs"],
    adjoint: Adjoint,
) -> None:
    """Sets what these photographs contribute, in place; of the adjoint's items each photograph has one per channel."""
    weight = weights.repeat_interleave(samples.shape[1], dim=0)
    x = x.flatten(end_dim=1)
    system = System(matrix, (weight > 0).to(weight), samples.flatten(end_dim=1))  # A, absent rows 0
    through = system.predict(adjoint.u)
    residual = system.targets - system.predict(x)
    by_weight = through * residual
    products = [(residual, adjoint.u), (through, -x)]
    if adjoint.pair is not None:
        along = system.predict(adjoint.pair[0])
        by_weight = by_weight + along * system.predict(adjoint.pair[1]) / 2
        products.append((along, adjoint.pair[1]))
    if adjoint.own is not None:
        by_weight = by_weight - squares(system, adjoint.own)
    result.samples[photos] = (weight * through).reshape(samples.shape)
    result.weights[photos] = by_weight.reshape(samples.shape).sum(dim=1)
    if result.matrix is not None:
        for rows, columns in products:
            result.matrix.addmm_((weight * rows).T, columns)
        if adjoint.own is not None:
            result.matrix.sub_(2 * matrix * (weight.T @ adjoint.own))


def squares(system: System, own: Float[Tensor, "items coeffs"]) -> Float[Tensor, "items points"]:
    """Returns sum_j own_j A_ij^2, 0 where the system's root is."""
    parts = [own @ rows.to(torch.float64).square().T for rows in system.matrix.split(system.rows_per_chunk)]
    return torch.cat(parts, dim=1) * system.root
