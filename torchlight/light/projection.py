"""Spherical harmonic coefficients of a lat-long map, and the map of coefficients: exact integrals over pixels.

Radiance is constant over each pixel, and a harmonic parts into a function of theta and one of phi:

    c_lm = sum over pixels of L integral of Y_lm d omega,   integral = [theta part of the row] [phi part of the column].

The phi part is elementary; the theta part is Gauss's rule in cos theta. Back, a pixel gets the mean of sum c_lm Y_lm
over its area. Truncation keeps no peak, but Y_00 is constant: sqrt(4 pi) c_00 is the map's power, exactly, both ways.

Irradiance of a surface with normal n is E(n) = sum A_l c_lm Y_lm(n) with A = pi, 2 pi / 3, pi / 4, 0, -pi / 24, 0, ...

References:
    Ramamoorthi and Hanrahan, An efficient representation for irradiance environment maps (2001), equation 8.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, ShapeError
from torchlight.light import latlong
from torchlight.light.directions import from_angles
from torchlight.light.harmonics import real_spherical_harmonics

MAX_DEGREE = 64
_NODES = 4  # per row, and as many more as waves of the highest degree are higher than a row


def project(radiance: Float[Tensor, "*batch height width"], degree: int) -> Float[Tensor, "*batch {(degree+1)**2}"]:
    """Returns the coefficients of a lat-long map for l = 0 .. degree, at index l (l + 1) + m."""
    height, width = radiance.shape[-2:]
    latlong.check_latlong(height, width)
    theta, phi, order = _parts(height, degree)
    rows = radiance.to(device="cpu", dtype=torch.float64) @ phi  # [.., height, 2 degree + 1]
    return torch.einsum("...hc,hc->...c", rows[..., order], theta).to(radiance)


def expand(coefficients: Float[Tensor, "*batch coeffs"], height: int) -> Float[Tensor, "*batch {height} {2*height}"]:
    """Returns the lat-long map of coefficients: each pixel is the mean of the sum over its area."""
    degree = degree_of(coefficients.shape[-1])
    theta, phi, order = _parts(height, degree)
    weighted = coefficients.to(device="cpu", dtype=torch.float64)[..., None, :] * theta
    by_order = weighted.new_zeros(*weighted.shape[:-1], phi.shape[1]).index_add(-1, order, weighted)
    return (by_order @ phi.T / latlong.row_solid_angles(height)[:, None]).to(coefficients)


def degree_of(count: int) -> int:
    """Returns the degree of a number of coefficients; raises ShapeError unless it is a square."""
    degree = math.isqrt(count) - 1
    if count < 1 or (degree + 1) ** 2 != count:
        raise ShapeError(f"spherical harmonics: {count} coefficients are not (degree + 1)^2 of any degree")
    return degree


def cosine_factors(
    degree: int, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, "{(degree+1)**2}"]:
    """Returns A_l for every coefficient: the convolution with max(0, cos). Odd l above 1 give 0."""
    factors = []
    for l in range(degree + 1):
        if l == 1:
            value = 2 * math.pi / 3
        elif l % 2:
            value = 0.0
        else:
            shape = math.factorial(l) / (2**l * math.factorial(l // 2) ** 2)
            value = 2 * math.pi * (-1) ** (l // 2 + 1) / ((l + 2) * (l - 1)) * shape
        factors += [value] * (2 * l + 1)
    return torch.tensor(factors, dtype=dtype, device=device)


def check_degree(degree: int) -> None:
    """Raises ConfigError for a degree outside 0 .. 64."""
    if not 0 <= degree <= MAX_DEGREE:
        raise ConfigError(f"degree: expected 0 to {MAX_DEGREE}, got {degree}")


def _parts(height: int, degree: int) -> tuple[Float[Tensor, "height coeffs"], Float[Tensor, "width orders"], Tensor]:
    """Returns integrals over rows of the theta part, over columns of the phi part, and each coefficient's column of it.

    The theta part is the harmonic of m >= 0 on the meridian phi = 0, where cos m phi is 1; that of -m is the same.
    """
    check_degree(degree)
    l = torch.cat([torch.full((2 * k + 1,), k) for k in range(degree + 1)])
    m = torch.arange((degree + 1) ** 2) - l * (l + 1)
    nodes = _NODES + -(-2 * degree // height)
    points, weights = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(nodes))
    z = torch.cos(latlong.row_boundaries(height))
    middle, half = (z[:-1] + z[1:])[:, None] / 2, (z[:-1] - z[1:])[:, None] / 2
    polar = torch.acos((middle + half * points).clamp(-1, 1))
    values = real_spherical_harmonics(degree, from_angles(polar, torch.zeros_like(polar)))
    theta = torch.einsum("hnc,hn->hc", values, half * weights)[:, l * (l + 1) + m.abs()]
    return theta, _column_integrals(2 * height, degree), m + degree


def _column_integrals(width: int, degree: int) -> Float[Tensor, "{width} {2*degree+1}"]:
    """Returns the integral over each column of cos m phi (m >= 0) or sin |m| phi (m < 0), at index m + degree."""
    edges = latlong.column_boundaries(width)
    middle, half = (edges[:-1] + edges[1:])[:, None] / 2, math.pi / width
    order = torch.arange(-degree, degree + 1, dtype=torch.float64)
    length = 2 * half * torch.sinc(order * half / math.pi)
    return length * torch.where(order < 0, torch.sin(-order * middle), torch.cos(order * middle))
