"""Non-negative least squares of one matrix for photographs that keep coming: what they share is made once."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ConfigError, ShapeError
from torchlight.solvers.active_set import Limits
from torchlight.solvers.batch import ITEMS_PER_TASK, minimize
from torchlight.solvers.certificate import gap_along, kkt_cosine, nonzero_norm
from torchlight.solvers.device_steps import alike, minimizers
from torchlight.solvers.modulus import QUICK, THOROUGH, Modulus, modulus_of
from torchlight.solvers.nnls import FULL_GRAM_COLUMNS, INNER_TOLERANCE, NNLS
from torchlight.solvers.problem import check_like_matrix, check_matrix, check_weights
from torchlight.solvers.shared_gram import UnitGram, unit_gram, weighted_gram
from torchlight.solvers.solution import Solution, Status
from torchlight.solvers.system import assemble, binary_scale
from torchlight.threads import single_threaded_map

RIDGE = NNLS().ridge
LIMITS = Limits(NNLS().tolerance * INNER_TOLERANCE, NNLS().max_steps)
COSINE_KEPT = 0.5  # of the tolerance asked for: the Gram matrix rounds what the samples are then held against


@dataclass(frozen=True, eq=False)
class PreparedNNLS:
    """Minimises |W^(1/2) (A x - b)|^2 / 2 over x >= 0 for one A and one W, block of photographs by block.

    Every photograph is solved for itself: its support is guessed by matrix products (`modulus`), the minimum on it is
    found by a Cholesky factor, and columns change sides until the certificate holds. Nothing is carried from one
    photograph to the next (`scripts/bench/stream.py` measures what that would save, or cost).

    Attributes:
        seen: the samples of positive weight.
        index: which columns of A are not zero there.
        norms: |W^(1/2) a_j| of those.
        root: W^(1/2) of the samples seen.
        columns: W^(1/2) a_j / |W^(1/2) a_j|, float64.
        reach: their sums W^(1/2) 1, from which the duality gap is taken.
        gram: their inner products.
        guess: rough minimisers under that Gram matrix.
        matrix: A, not copied.
    """

    seen: Int[Tensor, " seen"]
    index: Int[Tensor, " k"]
    norms: Float[Tensor, " k"]
    root: Float[Tensor, " seen"]
    columns: Float[Tensor, "seen k"]
    reach: Float[Tensor, " k"]
    gram: UnitGram
    guess: Modulus
    matrix: Float[Tensor, "points coeffs"]

    def solve(self, samples: Float[Tensor, "*batch channels points"], tolerance: float) -> Solution:
        """Returns the non-negative solution of every photograph and channel.

        kkt_residual is `certificate.kkt_cosine`, from the samples in float64: the largest cosine between the residual
        and a column that should be at right angles with it. An item is CONVERGED where it is within the tolerance.
        A photograph with a sample that is not finite where it counts is NOT_FINITE and has zeros.

        Args:
            samples: b, of the matrix's dtype.
            tolerance: on kkt_residual.

        Raises:
            ShapeError: the samples do not fit the matrix.
        """
        check_like_matrix("samples", samples, self.matrix)
        points, coeffs = self.matrix.shape
        if samples.ndim < 2 or samples.shape[-1] != points:
            raise ShapeError(f"samples: expected shape [*batch, channels, {points}], got {list(samples.shape)}")
        items = samples.reshape(-1, points)
        found = self.norms.new_empty(items.shape[0], coeffs + 3)
        steps, status = (torch.zeros(items.shape[0], dtype=torch.int64, device=items.device) for _ in range(2))

        def fill(part: slice) -> None:
            found[part], steps[part], status[part] = self._solved(items[part], tolerance)

        whole = [slice(0, items.shape[0])]
        shares = parts(items.shape[0], torch.get_num_threads()) if items.device.type == "cpu" else whole
        for _ in single_threaded_map(fill, shares):
            pass
        photos = (-1, samples.shape[-2])
        return assemble(samples, found.unflatten(0, photos), status.reshape(photos), steps.reshape(photos))

    def _solved(
        self, samples: Float[Tensor, "items points"], tolerance: float
    ) -> tuple[Float[Tensor, "items coeffs_and_figures"], Int[Tensor, " items"], Int[Tensor, " items"]]:
        """Returns coefficients and figures, steps and status."""
        b = samples[:, self.seen].to(torch.float64)
        finite = torch.isfinite(b).all(dim=-1)
        b = torch.where(finite[:, None], b, 0.0)
        scale = binary_scale(b)
        target = b / scale * self.root
        size = nonzero_norm(target)
        target /= size[:, None]
        linear = target @ self.columns
        start = self.guess.minimizers(linear)
        if b.device.type == "cpu":
            z, steps = minimize(self.gram, linear, start, RIDGE, LIMITS, cosine=COSINE_KEPT * tolerance)
        else:
            z, steps = minimizers(alike(self.gram.gram, linear), start, RIDGE, LIMITS)  # exact: no step is saved
        residual = target - z @ self.columns.T
        w = residual @ self.columns
        ones = torch.ones_like(self.norms)
        cosine = kkt_cosine(z, w, residual)
        gap = gap_along(target, residual, w, ones, self.reach, self.root)
        coeffs = self.matrix.shape[1]
        found = b.new_zeros(b.shape[0], coeffs + 3)
        found[:, self.index] = z * (size[:, None] * scale) / self.norms
        found[:, coeffs:] = torch.stack([torch.linalg.vector_norm(residual, dim=-1), cosine, gap], dim=-1)
        found[~finite, coeffs:] = torch.nan
        ended = torch.where(cosine <= tolerance, int(Status.CONVERGED), int(Status.STOPPED_SHORT))
        return found, steps, torch.where(finite, ended, int(Status.NOT_FINITE))


def prepare(matrix: Float[Tensor, "points coeffs"], weights: Float[Tensor, " points"] | None = None) -> PreparedNNLS:
    """Returns what every photograph under one matrix and one set of weights needs.

    Args:
        matrix: A; at most 4,096 of its columns may be seen.
        weights: the diagonal of W; None = ones.

    Raises:
        ShapeError: matrix or weights hold forbidden values.
        ConfigError: the matrix has no column that is seen, or too many.
    """
    check_matrix("matrix", matrix)
    weights = torch.ones_like(matrix[:, 0]) if weights is None else weights
    check_like_matrix("weights", weights, matrix)
    check_weights(weights, matrix.shape[:1])
    seen = weights.nonzero()[:, 0]
    root = weights[seen].to(torch.float64).sqrt()
    columns = matrix[seen].to(torch.float64) * root[:, None]
    norms, index = torch.linalg.vector_norm(columns, dim=0).sort(descending=True, stable=True)
    index, norms = index[norms > 0], norms[norms > 0]
    if not 0 < index.shape[0] <= FULL_GRAM_COLUMNS:
        raise ConfigError(
            f"prepare: expected 1 to {FULL_GRAM_COLUMNS} columns that are not 0 under the weights, got {index.shape[0]}"
        )
    columns = columns[:, index] / norms
    gram = unit_gram(weighted_gram(columns, torch.ones_like(root)))
    guess = modulus_of(gram.gram, QUICK if matrix.device.type == "cpu" else THOROUGH)
    return PreparedNNLS(seen, index, norms, root, columns, (root[None] @ columns)[0], gram, guess, matrix)


def parts(items: int, threads: int) -> list[slice]:
    """Returns the items in order, in as few parts as keep all threads busy with at most 48 items each."""
    most = min(ITEMS_PER_TASK, max(1, ceil(items / threads)))
    return [slice(start, min(start + most, items)) for start in range(0, items, most)]
