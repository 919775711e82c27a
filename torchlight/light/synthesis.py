"""From coefficients to an environment map: every pixel the exact area average of the basis' light."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.light import latlong, overlap
from torchlight.light.bases import Basis, SphericalHarmonics
from torchlight.light.environment import EnvironmentMap
from torchlight.light.harmonics import real_spherical_harmonics

ROUNDING = 1e-6
PIXEL_NODES = 2  # Gauss points along each side of a pixel: harmonics are smooth over it


def map_height(basis: Basis) -> int:
    """Returns the rows of the lat-long map written for a basis: half of max(512, 8 N) columns."""
    return max(512, 8 * basis.resolution) // 2


def synthesize(basis: Basis, coefficients: Float[Tensor, "*batch 3 coeffs"]) -> EnvironmentMap:
    """Returns the light with the given coefficients as a lat-long map; radiance below the plane is 0.

    Texels and Haar functions are constant over texels, whose areas are shared out exactly among the pixels; spherical
    harmonics are averaged over each pixel by Gauss-Legendre points.
    """
    height = map_height(basis)
    if isinstance(basis, SphericalHarmonics):
        radiance = harmonics_to_latlong(coefficients, basis.degree, height)
    else:
        radiance = overlap.texels_to_latlong(basis.synthesis(coefficients), basis.resolution, height)
    radiance = without_rounding(radiance)
    return EnvironmentMap(radiance, nonnegative=not bool((radiance < 0).any()))


def without_rounding(radiance: Float[Tensor, "*batch 3 height width"]) -> Float[Tensor, "*batch 3 height width"]:
    """Returns the maps with negative values of less than a millionth of the map's largest set to 0.

    A Haar transform of non-negative texels is non-negative only up to rounding.
    """
    least = -ROUNDING * radiance.abs().amax(dim=(-3, -2, -1), keepdim=True)
    return torch.where(radiance > least, radiance.clamp(min=0), radiance)


def harmonics_to_latlong(
    coefficients: Float[Tensor, "*batch coeffs"], degree: int, height: int
) -> Float[Tensor, "*batch {height} {2*height}"]:
    """Returns pixel averages of a spherical harmonics expansion above the horizon, 0 below it."""
    upper = height // 2
    nodes = torch.tensor([-1.0, 1.0], dtype=torch.float64) / 3**0.5
    edges = latlong.row_boundaries(height)[: upper + 1].double().cos()
    middle, half = (edges[1:] + edges[:-1]) / 2, (edges[:-1] - edges[1:]) / 2
    z = middle[:, None] + half[:, None] * nodes
    step = torch.pi / height
    column = (torch.arange(2 * height, dtype=torch.float64) + 0.5) * step
    phi = torch.pi - (column[:, None] + nodes * step / 2)
    values = torch.zeros(*coefficients.shape[:-1], height, 2 * height, dtype=torch.float64)
    for a in range(PIXEL_NODES):
        for b in range(PIXEL_NODES):
            radius = (1 - z[:, a].square()).clamp(min=0).sqrt()[:, None]
            height_z = z[:, a, None].expand(upper, 2 * height)
            directions = torch.stack([radius * phi[:, b].cos(), radius * phi[:, b].sin(), height_z], dim=-1)
            harmonics = real_spherical_harmonics(degree, directions)
            values[..., :upper, :] += torch.einsum("...k,hwk->...hw", coefficients.double().cpu(), harmonics) / 4
    return values.to(coefficients)
