"""The sampling theorem on the sphere: light of bandwidth B from its radiance in B x (2B - 1) directions.

B Gauss-Legendre nodes in cos(theta) times 2B - 1 equal azimuths integrate the product of two functions of bandwidth B
exactly, so the coefficients of such a light are finite sums over these directions. Turning the whole set changes
nothing of that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, ShapeError
from torchlight.light.harmonics import real_spherical_harmonics

MAX_BANDWIDTH = 32
MAX_ROTATIONS = 10_000


@dataclass(frozen=True, eq=False)
class SamplingSet:
    """Directions and weights that integrate products of two functions of bandwidth B exactly.

    Attributes:
        directions: unit vectors.
        weights: 2 pi w_i / (2B - 1), in steradians; they sum to 4 pi.
    """

    directions: Float[Tensor, "*batch nodes 3"]
    weights: Float[Tensor, " nodes"]


def sampling_set(
    bandwidth: int, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> SamplingSet:
    """Returns the B x (2B - 1) directions of Fig. 2, ring by ring from the lowest.

    Raises:
        ConfigError: the bandwidth is not from 1 to 32.

    References:
        Okabe, Sato and Sato (2004), eq. 7 and appendix; Driscoll and Healy (1994).
    """
    check_bandwidth(bandwidth)
    azimuths = 2 * bandwidth - 1
    nodes, weights = (torch.from_numpy(part) for part in np.polynomial.legendre.leggauss(bandwidth))
    z = nodes[:, None].expand(-1, azimuths)
    phi = (2 * math.pi / azimuths) * torch.arange(azimuths, dtype=torch.float64).expand(bandwidth, -1)
    radius = torch.sqrt(1 - z * z)
    directions = torch.stack([radius * phi.cos(), radius * phi.sin(), z], dim=-1).reshape(-1, 3)
    steradians = (2 * math.pi / azimuths) * weights.repeat_interleave(azimuths)
    return SamplingSet(directions.to(dtype=dtype, device=device), steradians.to(dtype=dtype, device=device))


def rotated(sampling: SamplingSet, rotations: Float[Tensor, "*batch 3 3"]) -> SamplingSet:
    """Returns the set turned by one or many rotations, which act on column vectors."""
    return SamplingSet(sampling.directions @ rotations.transpose(-1, -2).to(sampling.directions), sampling.weights)


def harmonic_coefficients(
    radiance: Float[Tensor, "*batch nodes"], sampling: SamplingSet, bandwidth: int
) -> Float[Tensor, "*batch {bandwidth**2}"]:
    """Returns L_lm of light of bandwidth B from its radiance in the directions of one set (eq. 7, real harmonics).

        L_lm = sum over ij of 2 pi w_i / (2B - 1) L(theta_i, phi_j) Y_lm(theta_i, phi_j),   l < B

    Args:
        radiance: L in the set's directions, in their order.
        sampling: `sampling_set(bandwidth)`, turned or not.
        bandwidth: B.
    """
    if radiance.shape[-1] != bandwidth * (2 * bandwidth - 1):
        raise ShapeError(
            f"radiance: bandwidth {bandwidth} needs {bandwidth * (2 * bandwidth - 1)} directions, "
            f"got {radiance.shape[-1]}; take them from sampling_set({bandwidth})"
        )
    harmonics = real_spherical_harmonics(bandwidth - 1, sampling.directions)
    return (radiance * sampling.weights) @ harmonics


def random_rotations(
    count: int, seed: int, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, "{count} 3 3"]:
    """Returns rotations drawn uniformly from SO(3); the same seed gives the same rotations on any device.

    The first is not special: the untouched set is not among them. A normal vector of four numbers has a uniform
    direction, and unit quaternions cover SO(3) evenly (Shoemake 1992).

    Raises:
        ConfigError: fewer than 1 or more than 10,000.
    """
    if not 1 <= count <= MAX_ROTATIONS:
        raise ConfigError(f"rotations: expected 1 to {MAX_ROTATIONS:,}, got {count}; the paper takes 300")
    generator = torch.Generator().manual_seed(seed)
    drawn = torch.randn(count, 4, generator=generator, dtype=torch.float64)
    w, x, y, z = torch.nn.functional.normalize(drawn, dim=-1).unbind(dim=-1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], dim=-1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], dim=-1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=-1),
    ]
    return torch.stack(rows, dim=-2).to(dtype=dtype, device=device)


def check_bandwidth(bandwidth: int) -> None:
    """Raises ConfigError unless the bandwidth is from 1 to 32."""
    if not 1 <= bandwidth <= MAX_BANDWIDTH:
        raise ConfigError(f"bandwidth: expected 1 to {MAX_BANDWIDTH}, got {bandwidth}; l < B, so B = 1 is constant")
