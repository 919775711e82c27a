"""What a photograph says about the receiver: one value and one weight per sample."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.errors import ShapeError


@dataclass(frozen=True, eq=False)
class LinearPhoto:
    """A photograph in linear radiometric units.

    Attributes:
        radiance: linear values, relative or absolute.
        usable: pixels that may be used: finite, not saturated, not masked.
    """

    radiance: Float[Tensor, "*batch 3 height width"]
    usable: Bool[Tensor, "*batch height width"]


def linear_photo(radiance: Float[Tensor, "*batch 3 height width"]) -> LinearPhoto:
    """Returns a linear photograph all of whose finite pixels may be used."""
    if radiance.ndim < 3 or radiance.shape[-3] != 3:
        raise ShapeError(f"photograph: expected [..., 3, height, width], got {list(radiance.shape)}")
    return LinearPhoto(radiance, torch.isfinite(radiance).all(dim=-3))


@dataclass(frozen=True, eq=False)
class Observation:
    """The receiver's samples as a photograph shows them.

    Attributes:
        samples: v = albedo E / pi, averaged over each footprint; 0 where the weight is 0.
        weights: 1 where the whole footprint is seen and usable, else 0; multiplies the squared residual.
    """

    samples: Float[Tensor, "*batch channels points"]
    weights: Float[Tensor, "*batch points"]
