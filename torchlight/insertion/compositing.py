"""Putting the new object over the photograph, in linear light.

    composite = alpha O + (1 - alpha) P r

P is the photograph, r what the new shadow leaves of it, alpha the share of a pixel that the object covers, O its
radiance. The same as a layer to be put over the photograph elsewhere, exact for any r per channel:

    A = 1 - (1 - alpha) min r,     C A = alpha O + (1 - alpha) P (r - min r),     composite = C A + (1 - A) P

with min over the channels, and at most 1: a grey shadow is black with alpha, a coloured one keeps its colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Layer:
    """A picture to be put over another, linear.

    Attributes:
        colour: premultiplied: C A.
        alpha: A.
    """

    colour: Float[Tensor, "3 height width"]
    alpha: Float[Tensor, "height width"]

    @property
    def premultiplied(self) -> Float[Tensor, "4 height width"]:
        """C A and A."""
        return torch.cat([self.colour, self.alpha[None]])

    @property
    def straight(self) -> Float[Tensor, "4 height width"]:
        """C and A; C is 0 where A is."""
        some = self.alpha > 0
        colour = torch.where(some, self.colour / torch.where(some, self.alpha, 1.0), torch.zeros_like(self.colour))
        return torch.cat([colour, self.alpha[None]])


def layer_of(
    photo: Float[Tensor, "3 height width"],
    object_radiance: Float[Tensor, "3 height width"],
    coverage: Float[Tensor, "height width"],
    ratio: Float[Tensor, "3 height width"],
) -> Layer:
    """Returns the object and its shadow as one layer.

    Args:
        photo: P.
        object_radiance: O.
        coverage: alpha.
        ratio: r; above 1 only where a pixel shows something brighter than before (`unmixing`).
    """
    least = ratio.amin(dim=0).clamp(max=1)
    tinted = torch.where(ratio > least, photo * (ratio - least), torch.zeros_like(photo))
    colour = coverage * object_radiance + (1 - coverage) * tinted
    return Layer(colour, 1 - (1 - coverage) * least)


def over(layer: Layer, photo: Float[Tensor, "3 height width"]) -> Float[Tensor, "3 height width"]:
    """Returns the layer over a photograph; where the layer is empty the photograph is as it was, bit by bit."""
    return torch.where(layer.alpha > 0, layer.colour + (1 - layer.alpha) * photo, photo)


def premultiplied_of(straight: Float[Tensor, "4 height width"]) -> Float[Tensor, "4 height width"]:
    """Returns C A and A of C and A."""
    return torch.cat([straight[:3] * straight[3:], straight[3:]])
