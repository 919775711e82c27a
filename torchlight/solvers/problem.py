"""The problem that every solver takes: weighted least squares, one matrix for all photographs and channels."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, ShapeError


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Minimise f(x) = |W^(1/2) (A x - b)|^2 / 2 for every photograph and channel.

    The weights multiply the *squared* residual: weight 2 equals the sample taken twice, weight 0 its absence (whatever
    the sample holds, NaN included). float32 problems are solved in float64 and cast back.

    Attributes:
        matrix: A, shared by all items, finite.
        samples: b. A sample that is not finite where its weight is positive costs its own item only.
        weights: the diagonal of W, finite and at least 0, shared by a photograph's channels; None = ones.
        synthesis: S. Solvers with a sign constraint demand S x >= 0, the others ignore it; None = identity.

    Raises:
        ShapeError: if shapes, dtypes or devices disagree, or the matrix, weights or synthesis hold forbidden values.
    """

    matrix: Float[Tensor, "points coeffs"]
    samples: Float[Tensor, "*batch channels points"]
    weights: Float[Tensor, "*batch points"] | None = None
    synthesis: Float[Tensor, "texels coeffs"] | None = None

    def __post_init__(self) -> None:
        check_matrix("matrix", self.matrix)
        check_like_matrix("samples", self.samples, self.matrix)
        points, coeffs = self.matrix.shape
        if self.samples.ndim < 2 or self.samples.shape[-1] != points:
            raise ShapeError(
                f"samples: expected shape [*batch, channels, {points}] to match the matrix's rows, "
                f"got {list(self.samples.shape)}"
            )
        if self.weights is not None:
            check_like_matrix("weights", self.weights, self.matrix)
            check_weights(self.weights, (*self.samples.shape[:-2], points))
        if self.synthesis is not None:
            check_like_matrix("synthesis", self.synthesis, self.matrix)
            check_matrix("synthesis", self.synthesis)
            if self.synthesis.shape[1] != coeffs:
                raise ShapeError(
                    f"synthesis: expected {coeffs} columns, as the matrix has, got {self.synthesis.shape[1]}"
                )


def check_matrix(name: str, matrix: Tensor) -> None:
    """Raises ShapeError unless this is a finite, non-empty float32 or float64 matrix."""
    if matrix.dtype not in (torch.float32, torch.float64):
        raise ShapeError(f"{name}: expected float32 or float64, got {matrix.dtype}; convert it with .float()")
    if matrix.ndim != 2 or 0 in matrix.shape:
        raise ShapeError(f"{name}: expected a matrix with at least one row and column, got {list(matrix.shape)}")
    if not bool(torch.isfinite(matrix).all()):
        raise ShapeError(f"{name}: holds NaN or infinite entries; the transport it came from is broken")


def check_like_matrix(name: str, tensor: Tensor, matrix: Tensor) -> None:
    """Raises ShapeError unless the tensor has the matrix's dtype and device."""
    if tensor.dtype != matrix.dtype or tensor.device != matrix.device:
        raise ShapeError(
            f"{name}: expected {matrix.dtype} on {matrix.device}, as the matrix is, "
            f"got {tensor.dtype} on {tensor.device}; convert one with .to()"
        )


def check_weights(weights: Tensor, shape: tuple[int, ...]) -> None:
    """Raises ShapeError unless the weights have this shape and are finite and at least 0."""
    if tuple(weights.shape) != shape:
        raise ShapeError(f"weights: expected shape {list(shape)} (no channel axis), got {list(weights.shape)}")
    if not bool((torch.isfinite(weights) & (weights >= 0)).all()):
        raise ShapeError("weights: some are negative, NaN or infinite; use 0 for samples that must not count")


def check_no_synthesis(problem: LeastSquares, solver: str) -> None:
    """Raises ConfigError if the sign constraint is on anything but the coefficients themselves."""
    if problem.synthesis is not None:
        raise ConfigError(f"{solver}: demands x >= 0, but the problem asks for S x >= 0; use NonnegativeSynthesis")
