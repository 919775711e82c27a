"""How many directions of a band-limited light the samples leave undetermined (section 3.2 of the paper, eq. 8).

Light of bandwidth B is known from its radiance in the B x (2B - 1) directions of `sampling_set`. Substituted into
E(x) = sum of L_lm T_lm(x), it gives one linear equation per sample,

    E(x) = sum over ij of a_ij(x) L(theta_i, phi_j),   a_ij(x) = 2 pi w_i / (2B - 1) sum over lm of Y_lm T_lm(x)

whose unknowns are the directions above the plane. Nullity = unknowns - rank of a. The set is not uniform over the
sphere, so the nullity is averaged over random turns of the whole set.

a = T W with W of B^2 rows, and T = Q R with orthonormal columns Q: the singular values of a are those of R W, a matrix
of at most B^2 x B^2 or so instead of one with a row per sample. R is triangular and T's columns are ordered by degree,
so one factorisation serves every bandwidth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.analysis.sampling import check_bandwidth, rotated, sampling_set
from torchlight.errors import SceneError, ShapeError
from torchlight.light.harmonics import real_spherical_harmonics

MATLAB = "MATLAB"
ABSOLUTE_TOLERANCES = (1e-6, 1e-4, 1e-3)
TOLERANCE = 1e-4  # of the recommended bandwidth; a pattern of this singular value s stands out of the noise when
# noise < s sqrt(samples): 1 % per sample and 10,000 samples
CONSIDERABLY_LESS_THAN_1 = 0.75


@dataclass(frozen=True, eq=False)
class Nullity:
    """Nullity against bandwidth, for several tolerances of the rank.

    Attributes:
        counts: unknowns - rank, for bandwidths 1, 2, ...
        unknowns: directions above the plane.
        tolerances: "MATLAB", then absolute ones.
    """

    counts: Int[Tensor, "tolerances bandwidths rotations"]
    unknowns: Int[Tensor, "bandwidths rotations"]
    tolerances: tuple[str | float, ...]

    @property
    def mean(self) -> Float[Tensor, "tolerances bandwidths"]:
        """Mean over the rotations."""
        return self.counts.double().mean(dim=-1)

    @property
    def deviation(self) -> Float[Tensor, "tolerances bandwidths"]:
        """Standard deviation over the rotations."""
        return self.counts.double().std(dim=-1, correction=0)

    def recommended(self, tolerance: str | float = TOLERANCE) -> int:
        """Returns the recommended bandwidth at one tolerance; see `recommended_bandwidth`."""
        return recommended_bandwidth(self.mean[self.tolerances.index(tolerance)])


def recommended_bandwidth(mean_nullity: Float[Tensor, " bandwidths"]) -> int:
    """Returns the largest B such that the mean nullity is below 0.75 for B and every smaller bandwidth; 0 if none.

    One rule for all scenes. It is the paper's "considerably less than 1" in numbers. At a fixed absolute tolerance the
    mean nullity never falls when samples are removed, so a larger hidden area never raises the result.
    """
    passed = mean_nullity < CONSIDERABLY_LESS_THAN_1
    return int(passed.long().cumprod(dim=0).sum().item())


def equations(harmonics: Float[Tensor, "points coeffs"], receiver_points: int) -> Float[Tensor, "points coeffs"]:
    """Returns T_lm / (pi sqrt(receiver's samples)), the rows that `nullity` expects.

    In these units a singular value of a is the RMS change of the photograph, over all of the receiver's samples and
    relative to an unoccluded sample under unit light, that a light pattern of unit norm makes. The scale does not
    depend on which samples are kept. Rows of several scenes, each scaled by its own receiver, may be stacked.
    """
    if receiver_points < 1:
        raise SceneError(f"receiver: expected at least one sample, got {receiver_points}; see receiver.samples")
    return harmonics / (math.pi * math.sqrt(receiver_points))


def nullity(
    rows: Float[Tensor, "points coeffs"],
    rotations: Float[Tensor, "rotations 3 3"],
    tolerances: tuple[float, ...] = ABSOLUTE_TOLERANCES,
) -> Nullity:
    """Returns the nullity for B = 1 .. sqrt(coeffs), in float64.

    Args:
        rows: T_lm per sample, scaled by `equations`, l < the largest B.
        rotations: of the sampling set.
        tolerances: absolute ones, in the units of `equations`; MATLAB's comes first in any case.

    Raises:
        ShapeError: the number of columns is not a square.
        SceneError: no sample, or no light reaches any.
    """
    bandwidth_max = math.isqrt(rows.shape[1])
    if bandwidth_max**2 != rows.shape[1]:
        raise ShapeError(f"rows: expected B^2 columns, got {rows.shape[1]}")
    check_bandwidth(bandwidth_max)
    check_rows(rows)
    factor = torch.linalg.qr(rows.double(), mode="r").R
    per_bandwidth = [_counts(factor, len(rows), b, rotations, tolerances) for b in range(1, bandwidth_max + 1)]
    counts, unknowns = (torch.stack(part, dim=-2) for part in zip(*per_bandwidth, strict=True))
    return Nullity(counts, unknowns, (MATLAB, *tolerances))


def check_rows(rows: Float[Tensor, "points columns"]) -> None:
    """Raises SceneError where there is nothing to analyse: no sample, or samples that no light reaches."""
    if len(rows) == 0:
        raise SceneError("no sample of the receiver is left to analyse; check the camera's pose and the mask")
    if not bool((rows != 0).any()):
        raise SceneError("no light reaches any sample that is left: the occluders cover them; check the scene's units")


def coupling(
    rows: Float[Tensor, "points coeffs"], bandwidth: int, rotation: Float[Tensor, "3 3"]
) -> Float[Tensor, "points unknowns"]:
    """Returns eq. 8's matrix a for one rotation, a column per direction above the plane."""
    sampling = rotated(sampling_set(bandwidth, device=rows.device), rotation)
    above = sampling.directions[:, 2] > 0
    harmonics = real_spherical_harmonics(bandwidth - 1, sampling.directions[above])
    return rows[:, : bandwidth**2].double() @ (harmonics * sampling.weights[above, None]).T


def _counts(
    factor: Float[Tensor, "rank coeffs"],
    points: int,
    bandwidth: int,
    rotations: Float[Tensor, "rotations 3 3"],
    tolerances: tuple[float, ...],
) -> tuple[Int[Tensor, "tolerances rotations"], Int[Tensor, " rotations"]]:
    """Returns unknowns - rank per tolerance and rotation, and the unknowns."""
    coefficients = bandwidth**2
    weighted, above = _above_plane(bandwidth, rotations.to(factor))
    unknowns = above.sum(dim=1)
    small = factor[:coefficients, :coefficients] @ weighted
    values = torch.linalg.svdvals(small)
    matlab = unknowns.clamp(min=points).to(values) * torch.finfo(values.dtype).eps * values[:, 0]
    levels = [matlab, *(torch.full_like(matlab, tolerance) for tolerance in tolerances)]
    return torch.stack([unknowns - (values > level[:, None]).sum(dim=1) for level in levels]), unknowns


def _above_plane(
    bandwidth: int, rotations: Float[Tensor, "rotations 3 3"]
) -> tuple[Float[Tensor, "rotations coeffs columns"], Bool[Tensor, "rotations nodes"]]:
    """Returns W over the directions above the plane, filled up with zero columns, which change no singular value."""
    sampling = rotated(sampling_set(bandwidth, device=rotations.device), rotations)
    above = sampling.directions[..., 2] > 0
    columns = max(1, int(above.sum(dim=1).max().item()))
    order = above.long().argsort(dim=1, descending=True, stable=True)[:, :columns]
    directions = sampling.directions.gather(1, order[..., None].expand(-1, -1, 3))
    weights = torch.where(above, sampling.weights, 0.0).gather(1, order)
    harmonics = real_spherical_harmonics(bandwidth - 1, directions) * weights[..., None]
    return harmonics.transpose(1, 2), above
