"""Items of a problem that are solved together, in float64 and scaled to order one."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.solvers.problem import LeastSquares
from torchlight.solvers.solution import Solution, Status

CHUNK_ENTRIES = 2**24  # of the matrix converted to float64 at a time: 128 MiB


@dataclass(frozen=True, eq=False)
class System:
    """A' = W^(1/2) A without forming it, and right-hand sides of largest entry in [1/2, 1) (or all 0).

    Attributes:
        matrix: A in the problem's dtype, not copied.
        root: W^(1/2), float64; one row where the items share their weights.
        targets: W^(1/2) b, float64, divided by the item's scale.
    """

    matrix: Float[Tensor, "points coeffs"]
    root: Float[Tensor, "#items points"]
    targets: Float[Tensor, "items points"]

    def predict(self, x: Float[Tensor, "items coeffs"]) -> Float[Tensor, "items points"]:
        """Returns W^(1/2) A x."""
        predicted = [x @ rows.to(torch.float64).T for rows in self.matrix.split(self.rows_per_chunk)]
        return torch.cat(predicted, dim=1) * self.root

    def correlate(self, residual: Float[Tensor, "items points"]) -> Float[Tensor, "items coeffs"]:
        """Returns A' W^(1/2) r."""
        weighted = (residual * self.root).split(self.rows_per_chunk, dim=1)
        chunks = self.matrix.split(self.rows_per_chunk)
        result = weighted[0] @ chunks[0].to(torch.float64)
        for part, rows in zip(weighted[1:], chunks[1:], strict=True):
            result += part @ rows.to(torch.float64)
        return result

    def column_norms(self) -> Float[Tensor, "#items coeffs"]:
        """Returns |W^(1/2) a_j| of every column; one row where the items share their weights."""
        weights = self.root.square().split(self.rows_per_chunk, dim=1)
        chunks = self.matrix.split(self.rows_per_chunk)
        squares = [part @ rows.to(torch.float64).square() for part, rows in zip(weights, chunks, strict=True)]
        return torch.stack(squares).sum(dim=0).sqrt()

    def columns(self, index: Int[Tensor, " k"]) -> Float[Tensor, "points k"]:
        """Returns these columns of W^(1/2) A, for items that share their weights."""
        return self.matrix[:, index].to(torch.float64) * self.root[0, :, None]

    @property
    def rows_per_chunk(self) -> int:
        """Number of rows converted to float64 at a time."""
        return max(1, CHUNK_ENTRIES // max(1, self.matrix.shape[1]))


@dataclass(frozen=True, eq=False)
class Answer:
    """What a solver found for the items of one system; the figures are those of `Solution`."""

    coefficients: Float[Tensor, "items coeffs"]
    steps: Int[Tensor, " items"]
    relative_residual: Float[Tensor, " items"]
    kkt_residual: Float[Tensor, " items"]
    gap: Float[Tensor, " items"]
    converged: Bool[Tensor, " items"]


def solve_systems(
    problem: LeastSquares,
    solve_system: Callable[[System], Answer],
    split: Callable[[Tensor], list[Tensor]],
) -> Solution:
    """Returns the solution put together from systems of photographs.

    Args:
        problem: what to solve.
        solve_system: the solver proper; it sees only items that have finite samples and some positive weight.
        split: weights per photograph -> lists of photographs to solve together, `by_weights` or `all_at_once`.
    """
    *_, channels, points = problem.samples.shape
    weights = photo_weights(problem)
    samples = problem.samples.reshape(-1, channels, points).to(torch.float64)
    samples = torch.where(weights[:, None, :] > 0, samples, 0.0)
    status = initial_status(samples, weights)
    columns = problem.matrix.shape[1]
    found = torch.zeros(*status.shape, columns + 3, dtype=torch.float64, device=samples.device)
    found[..., columns:] = torch.nan
    steps = torch.zeros_like(status)
    for photos in split(weights):
        solvable = torch.zeros_like(status, dtype=torch.bool)
        solvable[photos] = status[photos] == Status.CONVERGED
        photo, channel = solvable.nonzero(as_tuple=True)
        if photo.shape[0] == 0:
            continue
        scale = binary_scale(samples[photo, channel])
        root = weights[photo].sqrt()
        targets = samples[photo, channel] / scale * root
        shared = bool((root == root[:1]).all())
        answer = solve_system(System(problem.matrix, root[:1] if shared else root, targets))
        figures = torch.stack([answer.relative_residual, answer.kkt_residual, answer.gap], dim=-1)
        found[photo, channel] = torch.cat([answer.coefficients * scale, figures], dim=-1)
        steps[photo, channel] = answer.steps
        status[photo, channel] = torch.where(answer.converged, int(Status.CONVERGED), int(Status.STOPPED_SHORT))
    return assemble(problem.samples, found, status, steps)


def by_weights(weights: Float[Tensor, "photos points"]) -> list[Tensor]:
    """Returns the photographs grouped by equal weights: a factor or Gram matrix serves a whole group."""
    return same_rows(weights)


def same_rows(rows: Float[Tensor, "rows points"]) -> list[Int[Tensor, " some"]]:
    """Returns the numbers of the rows, those of equal rows together, in the order in which they first appear."""
    groups: dict[Hashable, list[int]] = {}
    for number, key in enumerate(row_keys(rows)):
        groups.setdefault(key, []).append(number)
    return [torch.tensor(numbers, device=rows.device) for numbers in groups.values()]


def row_keys(rows: Float[Tensor, "rows points"]) -> Iterable[Hashable]:
    """Returns something for each row that equal rows share; of rows on a device only that leaves it."""
    if rows.device.type == "cpu":
        return (row.tobytes() for row in rows.contiguous().numpy() + 0.0)  # -0 equals 0
    return torch.unique(rows, dim=0, return_inverse=True)[1].tolist()


def all_at_once(weights: Float[Tensor, "photos points"]) -> list[Tensor]:
    """Returns all photographs as one group, each with its own weights."""
    return [torch.arange(weights.shape[0], device=weights.device)]


def photo_weights(problem: LeastSquares) -> Float[Tensor, "photos points"]:
    """Returns the weights of every photograph in float64, ones where the problem has none."""
    points = problem.samples.shape[-1]
    if problem.weights is not None:
        return problem.weights.reshape(-1, points).to(torch.float64)
    photos = problem.samples.shape[:-2].numel()
    return torch.ones(1, points, dtype=torch.float64, device=problem.samples.device).expand(photos, points)


def initial_status(
    samples: Float[Tensor, "photos channels points"], weights: Float[Tensor, "photos points"]
) -> Int[Tensor, "photos channels"]:
    """Returns the status of the items that cannot be solved, CONVERGED (until proven otherwise) for the others."""
    status = torch.zeros(samples.shape[:2], dtype=torch.int64, device=samples.device)
    status[~torch.isfinite(samples).all(dim=-1)] = int(Status.NOT_FINITE)
    status[~(weights > 0).any(dim=-1)] = int(Status.NO_OBSERVATIONS)
    return status


def binary_scale(samples: Float[Tensor, "items points"]) -> Float[Tensor, "items 1"]:
    """Returns the power of two that brings each item to order one without rounding; 1 for all-zero items."""
    largest = samples.abs().amax(dim=-1, keepdim=True)
    exponent = torch.frexp(largest).exponent.clamp(-1000, 1000)
    return torch.ldexp(torch.ones_like(largest), exponent)


def assemble(
    samples: Float[Tensor, "*batch channels points"],
    found: Float[Tensor, "photos channels columns_and_figures"],
    status: Int[Tensor, "photos channels"],
    steps: Int[Tensor, "photos channels"],
) -> Solution:
    """Returns the solution in the shape and dtype of the samples; an item that overflows there is NOT_FINITE."""
    columns = found.shape[-1] - 3
    items = samples.shape[:-1]
    coefficients = found[..., :columns].to(samples)
    overflow = ~torch.isfinite(coefficients).all(dim=-1)
    status = torch.where(overflow, int(Status.NOT_FINITE), status)
    figures = torch.where(overflow[..., None], torch.nan, found[..., columns:]).to(samples)
    return Solution(
        coefficients=torch.where(overflow[..., None], 0.0, coefficients).reshape(*items, columns),
        status=status.reshape(items),
        steps=steps.reshape(items),
        relative_residual=figures[..., 0].reshape(items),
        kkt_residual=figures[..., 1].reshape(items),
        gap=figures[..., 2].reshape(items),
    )
