"""The solvers' front door: torch can differentiate, map and compile what goes through it.

To torch a solve is one operation, `torchlight::solve`, and its gradient another, `torchlight::solve_adjoint` (implicit
differentiation, `implicit_adjoint`). Neither is looked into: no step of a solver is recorded, whatever their number.
Both are custom operators, which is what `torch.compile` wants, called from functions of `torch.autograd`, which is what
`torch.func` wants. A solver travels as the name of its class and a list of numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, SolveError
from torchlight.solvers.adam import ProjectedAdam
from torchlight.solvers.implicit_adjoint import problem_gradients
from torchlight.solvers.nnls import NNLS
from torchlight.solvers.problem import LeastSquares
from torchlight.solvers.ridge import Ridge
from torchlight.solvers.solution import Solution
from torchlight.solvers.solver import Solver
from torchlight.solvers.synthesis import NonnegativeSynthesis

DIFFERENTIABLE = (NNLS, NonnegativeSynthesis, ProjectedAdam, Ridge)


def solve_differentiably(
    matrix: Float[Tensor, "points coeffs"],
    samples: Float[Tensor, "*batch channels points"],
    weights: Float[Tensor, "*batch points"],
    synthesis: Float[Tensor, "texels coeffs"] | None,
    solver: Solver,
) -> Solution:
    """Returns solver.solve(LeastSquares(matrix, samples, weights, synthesis)), bit by bit, with gradients.

    The coefficients have exact gradients with respect to matrix, samples and weights; status, steps and certificates
    have none. A solver of another kind than `DIFFERENTIABLE` is called as it is: torch differentiates its own code.

    Raises:
        ShapeError: as `LeastSquares`.
        ConfigError: a gradient is asked for with respect to the synthesis.
        SolveError: a second derivative is asked for.
    """
    if type(solver) not in DIFFERENTIABLE:
        return solver.solve(LeastSquares(matrix, samples, weights, synthesis))
    coefficients, status, steps, figures = Solve.apply(
        matrix, samples, weights, synthesis, type(solver).__name__, settings_of(solver)
    )
    return Solution(coefficients, status, steps, figures[..., 0], figures[..., 1], figures[..., 2])


def settings_of(solver: Any) -> list[float]:
    """Returns the settings of a solver in their order, NaN for None."""
    values = [getattr(solver, field.name) for field in fields(solver)]
    return [math.nan if value is None else float(value) for value in values]


def solver_of(kind: str, settings: Sequence[float]) -> Solver:
    """Returns the solver with these settings, the inverse of its class' name and `settings_of`."""
    cls = {one.__name__: one for one in DIFFERENTIABLE}[kind]
    values = {}
    for field, value in zip(fields(cls), settings, strict=True):
        whole = isinstance(field.default, int)
        values[field.name] = None if math.isnan(value) else int(value) if whole else value
    return cls(**values)


@torch.library.custom_op(
    "torchlight::solve",
    mutates_args=(),
    schema="(Tensor matrix, Tensor samples, Tensor weights, Tensor? synthesis, str kind, float[] settings)"
    " -> (Tensor coefficients, Tensor status, Tensor steps, Tensor figures)",
)
def solve_operator(
    matrix: Tensor, samples: Tensor, weights: Tensor, synthesis: Tensor | None, kind: str, settings: Sequence[float]
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Returns the parts of the solution; the last axis of the figures is residual, KKT residual, gap."""
    constraint = None if synthesis is None else synthesis.detach()
    found = solver_of(kind, settings).solve(
        LeastSquares(matrix.detach(), samples.detach(), weights.detach(), constraint)
    )
    figures = torch.stack([found.relative_residual, found.kkt_residual, found.gap], dim=-1)
    return found.coefficients, found.status, found.steps, figures


@torch.library.custom_op(
    "torchlight::solve_adjoint",
    mutates_args=(),
    schema="(Tensor gradient, Tensor coefficients, Tensor status, Tensor matrix, Tensor samples, Tensor weights,"
    " Tensor? synthesis, str kind, float[] settings, bool with_matrix)"
    " -> (Tensor matrix, Tensor samples, Tensor weights)",
)
def adjoint_operator(  # noqa: PLR0913, PLR0917  (the schema's arguments)
    gradient: Tensor,
    coefficients: Tensor,
    status: Tensor,
    matrix: Tensor,
    samples: Tensor,
    weights: Tensor,
    synthesis: Tensor | None,
    kind: str,
    settings: Sequence[float],
    with_matrix: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    """Returns the gradients by matrix, samples and weights in their dtypes and shapes; an empty matrix without it."""
    parts = [part.detach() for part in (matrix, samples, weights)]
    problem = LeastSquares(*parts, synthesis=None if synthesis is None else synthesis.detach())
    found = problem_gradients(
        problem, solver_of(kind, settings), coefficients.detach(), status, gradient.detach(), with_matrix
    )
    by_matrix = matrix.new_empty(0, 0) if found.matrix is None else found.matrix.to(matrix)
    by_samples = found.samples.to(samples).reshape(samples.shape)
    return by_matrix, by_samples, found.weights.to(weights).reshape(weights.shape)


@solve_operator.register_fake
def _(
    matrix: Tensor, samples: Tensor, weights: Tensor, synthesis: Tensor | None, kind: str, settings: Sequence[float]
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    items = samples.shape[:-1]
    counts = samples.new_empty(items, dtype=torch.int64)
    coefficients = samples.new_empty(*items, matrix.shape[1])
    return coefficients, counts, torch.empty_like(counts), samples.new_empty(*items, 3)


@adjoint_operator.register_fake
def _(  # noqa: PLR0913, PLR0917
    gradient: Tensor,
    coefficients: Tensor,
    status: Tensor,
    matrix: Tensor,
    samples: Tensor,
    weights: Tensor,
    synthesis: Tensor | None,
    kind: str,
    settings: Sequence[float],
    with_matrix: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    by_matrix = matrix.new_empty(matrix.shape if with_matrix else (0, 0))
    return by_matrix, samples.new_empty(samples.shape), weights.new_empty(weights.shape)


class Solve(torch.autograd.Function):
    """`torchlight::solve` with its gradient."""

    generate_vmap_rule = True

    @staticmethod
    def forward(
        matrix: Tensor, samples: Tensor, weights: Tensor, synthesis: Tensor | None, kind: str, settings: Sequence[float]
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        return solve_operator(matrix, samples, weights, synthesis, kind, settings)

    @staticmethod
    def setup_context(ctx, inputs, output) -> None:
        matrix, samples, weights, synthesis, kind, settings = inputs
        coefficients, status, steps, figures = output
        ctx.mark_non_differentiable(status, steps, figures)
        ctx.save_for_backward(coefficients, status, matrix, samples, weights, synthesis)
        ctx.solver = (kind, settings)

    @staticmethod
    def backward(ctx, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        if ctx.needs_input_grad[3]:
            raise ConfigError("synthesis: the constraint S x >= 0 is taken as given and has no gradient; detach it")
        with_matrix = ctx.needs_input_grad[0]
        by_matrix, by_samples, by_weights = SolveAdjoint.apply(
            gradients[0], *ctx.saved_tensors, *ctx.solver, with_matrix
        )
        return by_matrix if with_matrix else None, by_samples, by_weights, None, None, None


class SolveAdjoint(torch.autograd.Function):
    """`torchlight::solve_adjoint`, which has no gradient itself."""

    generate_vmap_rule = True

    @staticmethod
    def forward(  # noqa: PLR0913, PLR0917
        gradient: Tensor,
        coefficients: Tensor,
        status: Tensor,
        matrix: Tensor,
        samples: Tensor,
        weights: Tensor,
        synthesis: Tensor | None,
        kind: str,
        settings: Sequence[float],
        with_matrix: bool,
    ) -> tuple[Tensor, Tensor, Tensor]:
        return adjoint_operator(
            gradient, coefficients, status, matrix, samples, weights, synthesis, kind, settings, with_matrix
        )

    @staticmethod
    def setup_context(ctx, inputs, output) -> None:
        pass

    @staticmethod
    def backward(ctx, *gradients: Tensor) -> None:
        raise SolveError("solve: has first derivatives only; a derivative of its gradient was asked for")


@solve_operator.register_vmap
def _(info, in_dims: Sequence[Any], matrix, samples, weights, synthesis, kind, settings):
    tensors = (matrix, samples, weights, synthesis)
    if in_dims[0] is None and in_dims[3] is None:
        batch = [in_front(part, axis, info.batch_size) for part, axis in zip(tensors[1:3], in_dims[1:3], strict=True)]
        return solve_operator(matrix, *batch, synthesis, kind, settings), (0, 0, 0, 0)
    each = [
        solve_operator(*one, kind, settings) for one in one_by_one(tensors, in_dims[: len(tensors)], info.batch_size)
    ]
    return tuple(torch.stack(parts) for parts in zip(*each, strict=True)), (0, 0, 0, 0)


@adjoint_operator.register_vmap
def _(info, in_dims: Sequence[Any], *arguments):
    *tensors, kind, settings, with_matrix = arguments
    if not with_matrix and in_dims[3] is None and in_dims[6] is None:
        gradient, coefficients, status, samples, weights = (
            in_front(tensors[place], in_dims[place], info.batch_size) for place in (0, 1, 2, 4, 5)
        )
        batch = (gradient, coefficients, status, tensors[3], samples, weights, tensors[6])
        return adjoint_operator(*batch, kind, settings, with_matrix), (None, 0, 0)
    batch = one_by_one(tensors, in_dims[: len(tensors)], info.batch_size)
    each = [adjoint_operator(*one, kind, settings, with_matrix) for one in batch]
    return tuple(torch.stack(parts) for parts in zip(*each, strict=True)), (0, 0, 0)


def in_front(part: Tensor, axis: int | None, count: int) -> Tensor:
    """Returns the tensor with the mapped axis first, repeated where it has none."""
    return part.expand(count, *part.shape) if axis is None else part.movedim(axis, 0)


def one_by_one(tensors: Sequence[Tensor | None], axes: Sequence[int | None], count: int) -> list[list[Tensor | None]]:
    """Returns the arguments of every element of a mapped call."""
    columns = [
        [part] * count if part is None or axis is None else list(part.unbind(axis))
        for part, axis in zip(tensors, axes, strict=True)
    ]
    return [list(one) for one in zip(*columns, strict=True)]
