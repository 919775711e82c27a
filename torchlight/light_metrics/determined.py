"""The error of a light, split into what a photograph of a scene determines and what no photograph of it can tell.

Lights are functions over the upper hemisphere with the inner product <f, g> = integral of f g d omega. The difference
d of two lights falls into three parts that are orthogonal to each other, so that their squares add:

    d = finer + texels,     texels = area averages over the texels k of a cube map, of solid angle o_k
    texels = determined + null

With u = sqrt(o) d the inner product is the ordinary one, and the photograph changes by A u, A = T diag(1/sqrt(o)).
Of the singular value decomposition A = U S V', a direction v_j of light counts as determined where

    s_j sqrt(2 pi / n) >= noise max over samples of (T 1),      n texels

that is where v_j's share of a sky whose n patterns together have an RMS of the mean radiance changes the photograph by
at least the noise of one sample: the prior of `analysis.observability`, and its 0.5. `determined` is the projection of
u on those v_j, `null` the rest. The scene, the noise and the texels alone decide which directions these are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.analysis.observability import texel_solid_angles, whitened
from torchlight.light import overlap
from torchlight.light_metrics.grid import sample_weights
from torchlight.light_metrics.radiance import mean_square
from torchlight.transfer import Transfer


@dataclass(frozen=True, eq=False)
class Determined:
    """An orthonormal basis of the lights that a photograph determines.

    Attributes:
        vectors: v_j, of sqrt(solid angle) times radiance.
        singular_values: of A, in units of the noise, descending; all of them.
        resolution: texels along a cube map face's edge.
    """

    vectors: Float[Tensor, "texels rank"]
    singular_values: Float[Tensor, " values"]
    resolution: int

    @property
    def rank(self) -> int:
        """How many directions of light are determined."""
        return self.vectors.shape[1]


@dataclass(frozen=True, eq=False)
class Split:
    """RMS over the upper hemisphere and the channels of a difference and of its parts: total^2 = the sum of squares.

    Attributes:
        total: of the difference.
        determined: of the part that the photograph determines.
        null: of the part on the texels that it does not determine.
        finer: of the part that is finer than the texels.
        determined_pattern: radiance.
        null_pattern: radiance.
    """

    total: Float[Tensor, "*batch"]
    determined: Float[Tensor, "*batch"]
    null: Float[Tensor, "*batch"]
    finer: Float[Tensor, "*batch"]
    determined_pattern: Float[Tensor, "*batch 3 texels"]
    null_pattern: Float[Tensor, "*batch 3 texels"]


def determined_directions(transfer: Transfer, used: Bool[Tensor, " points"], noise: float) -> Determined:
    """Returns the directions of light that the used samples determine at a noise, in float64.

    Args:
        transfer: of the scene.
        used: samples that a photograph shows.
        noise: standard deviation per sample, as a share of the brightest under uniform light.

    Raises:
        ConfigError: the noise is not positive.
        SceneError: no sample is used, or no light reaches any.
    """
    rows = whitened(transfer, used, noise).transport
    rows = rows / texel_solid_angles(transfer.resolution).to(rows).sqrt()
    small = torch.linalg.qr(rows, mode="r").R if rows.shape[0] > rows.shape[1] else rows
    _, values, vectors = torch.linalg.svd(small, full_matrices=False)
    kept = values * math.sqrt(2 * math.pi / rows.shape[1]) >= 1
    return Determined(vectors[kept].T, values, transfer.resolution)


def split(
    light: Float[Tensor, "*batch 3 height width"],
    reference: Float[Tensor, "*batch 3 height width"],
    basis: Determined,
) -> Split:
    """Returns the parts of light - reference, both on one even lat-long grid."""
    difference = (light - reference).double()
    angles = texel_solid_angles(basis.resolution).to(difference)
    texels = overlap.latlong_to_texels(difference, basis.resolution)
    scaled = texels * angles.sqrt()
    seen = (scaled @ basis.vectors) @ basis.vectors.T / angles.sqrt()
    weights = sample_weights(light.shape[-2], "upper", device=difference.device)
    total = mean_square(difference.flatten(start_dim=-2), weights)
    squares = [mean_square(part, angles) for part in (seen, texels - seen, texels)]
    finer = (total - squares[2]).clamp(min=0)
    return Split(total.sqrt(), squares[0].sqrt(), squares[1].sqrt(), finer.sqrt(), seen, texels - seen)
