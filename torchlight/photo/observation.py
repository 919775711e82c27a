"""What a photograph says about the receiver: one value and one weight per sample."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchlight.errors import ShapeError
from torchlight.precision import check_precision


@dataclass(frozen=True, eq=False)
class LinearPhoto:
    """A photograph in linear radiometric units.

    Attributes:
        radiance: linear values, relative or absolute.
        usable: pixels that may be used: finite, not saturated, not masked.
        saturated: pixels that could be used, were they not saturated; None = not known.
    """

    radiance: Float[Tensor, "*batch 3 height width"]
    usable: Bool[Tensor, "*batch height width"]
    saturated: Bool[Tensor, "*batch height width"] | None = None

    def __post_init__(self) -> None:
        check_precision("photograph", self.radiance)


def linear_photo(radiance: Float[Tensor, "*batch 3 height width"]) -> LinearPhoto:
    """Returns a linear photograph all of whose finite pixels may be used."""
    if radiance.ndim < 3 or radiance.shape[-3] != 3:
        raise ShapeError(f"photograph: expected [..., 3, height, width], got {list(radiance.shape)}")
    return LinearPhoto(radiance, torch.isfinite(radiance).all(dim=-3))


class Rejection(IntEnum):
    """Why a sample that the camera sees has the weight 0."""

    NONE = 0
    SATURATED = 1  # a pixel of its footprint is: dropped, though its value is a lower bound
    SPECULAR = 2  # brighter than a diffuse plane can be
    ROBUST = 3  # no light explains it


@dataclass(frozen=True, eq=False)
class Observation:
    """The receiver's samples as a photograph shows them.

    Attributes:
        samples: v = albedo E / pi, averaged over each footprint; 0 where the weight is 0.
        weights: 1 where the whole footprint is seen and usable, else 0; multiplies the squared residual.
        rejected: `Rejection` of every sample; None = nothing is known of it.
    """

    samples: Float[Tensor, "*batch channels points"]
    weights: Float[Tensor, "*batch points"]
    rejected: UInt8[Tensor, "*batch points"] | None = None

    def __post_init__(self) -> None:
        check_precision("samples", self.samples)

    @property
    def rejections(self) -> UInt8[Tensor, "*batch points"]:
        """`rejected`, NONE where nothing is known."""
        return torch.zeros_like(self.weights, dtype=torch.uint8) if self.rejected is None else self.rejected

    def without(self, marked: Bool[Tensor, "*batch points"], why: Rejection) -> Observation:
        """Returns the observation with the weight 0 for the marked samples, and why of those that had another."""
        lost = marked & (self.weights > 0)
        weights = torch.where(lost, torch.zeros_like(self.weights), self.weights)
        return Observation(self.samples, weights, torch.where(lost, why.value, self.rejections).to(torch.uint8))
