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


def map_height(basis: Basis) -> int:
    """Returns the rows of the lat-long map written for a basis: half of 8 N columns, but at least 512.

    Beyond 1024 columns 4 N are enough: a pixel is then as wide as a texel at the middle of a face.
    """
    return max(512, min(8 * basis.resolution, 1024), 4 * basis.resolution) // 2


def prepare_map(basis: Basis) -> None:
    """Finds how map pixels and texels share the sphere, once per process: `synthesize` then need not."""
    if not isinstance(basis, SphericalHarmonics):
        overlap.plane_overlap(basis.resolution, map_height(basis))


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
    """Returns pixel averages of a spherical harmonics expansion above the horizon, 0 below it.

    Y_lm separates into a function of z and cos(m phi) or sin(|m| phi): the first is averaged over each row by
    Gauss-Legendre points in z, the second in closed form, which multiplies it by sin(m d/2) / (m d/2), d the pixel's
    azimuth.
    """
    zonal = row_harmonics(degree, height)
    order = torch.cat([torch.arange(-l, l + 1) for l in range(degree + 1)])
    phi = torch.pi * (1 - (torch.arange(2 * height, dtype=torch.float64) + 0.5) / height)
    angle = order.abs()[:, None] * phi
    waves = torch.where(order[:, None] < 0, angle.sin(), angle.cos())
    waves *= torch.special.sinc(order[:, None].double() / (2 * height))
    weighted = coefficients.double()[..., None, :] * zonal.to(coefficients.device)
    values = weighted.new_zeros(*coefficients.shape[:-1], height, 2 * height)
    values[..., : height // 2, :] = weighted @ waves.to(coefficients.device)
    return values.to(coefficients)


def row_harmonics(degree: int, height: int) -> Float[Tensor, "rows coeffs"]:
    """Returns, for each row above the horizon, the mean over z of Y_lm's factor of z, for every (l, m)."""
    nodes = torch.tensor([-1.0, 1.0], dtype=torch.float64) / 3**0.5
    edges = latlong.row_boundaries(height)[: height // 2 + 1].cos()
    middle, half = (edges[1:] + edges[:-1]) / 2, (edges[:-1] - edges[1:]) / 2
    z = middle[:, None] + half[:, None] * nodes
    radius = (1 - z.square()).clamp(min=0).sqrt()
    meridian = real_spherical_harmonics(degree, torch.stack([radius, torch.zeros_like(z), z], dim=-1)).mean(dim=1)
    # on the meridian phi = 0 the factor of z is Y_l|m| itself; Y_l,-m has the same one
    index = torch.cat([l * (l + 1) + torch.arange(-l, l + 1).abs() for l in range(degree + 1)])
    return meridian[:, index]
