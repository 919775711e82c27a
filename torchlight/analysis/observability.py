"""Which directions of the light a photograph determines: a linear Gaussian model over the texels of a cube map.

    E = T x + e,   e white with deviation s,   x with prior deviation tau

The resolution matrix R = (T'T / s^2 + I / tau^2)^-1 T'T / s^2 says how the best linear estimate answers to the truth:
R_ii is the share of texel i's own radiance that comes back, 1 where the photograph determines it, 0 where only the
prior speaks. The posterior covariance is tau^2 (I - R). That light is not negative is not part of the model; it can
only help.

The light is not known beforehand, so radiance is counted in units of its mean: tau = 1, and s is `noise` times the
brightest sample under uniform light 1.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.analysis.nullity import check_rows
from torchlight.errors import ConfigError, ShapeError
from torchlight.light import cubemap
from torchlight.transfer import Transfer

DETERMINED = 0.5  # R_ii from which a texel counts as determined
PRIOR = 1.0  # tau: radiance in units of its mean


@dataclass(frozen=True, eq=False)
class Observability:
    """What the photographs say about each visible texel.

    Attributes:
        diagonal: R_ii.
        deviation: posterior standard deviation, in units of the mean radiance; tau where nothing is known.
        reached: False where no light of the texel reaches any sample that is used.
        singular_values: of T / s, stacked over the scenes, descending.
        resolution: texels along a cube map face's edge.
    """

    diagonal: Float[Tensor, " texels"]
    deviation: Float[Tensor, " texels"]
    reached: Bool[Tensor, " texels"]
    singular_values: Float[Tensor, " values"]
    resolution: int

    @property
    def degrees_of_freedom(self) -> float:
        """Trace of R: how many numbers the photographs effectively determine at this noise."""
        return self.diagonal.sum().item()

    def share(self, texels: Bool[Tensor, " texels"]) -> float:
        """Returns the share of the upper hemisphere's solid angle that some texels cover."""
        angles = texel_solid_angles(self.resolution).to(self.diagonal)
        return ((angles * texels).sum() / angles.sum()).item()

    @property
    def determined(self) -> Bool[Tensor, " texels"]:
        """Where R_ii >= 0.5."""
        return self.diagonal >= DETERMINED


@functools.lru_cache(maxsize=4)
def texel_solid_angles(resolution: int) -> Float[Tensor, " texels"]:
    """Returns the solid angle of every visible texel, in steradians; they sum to 2 pi."""
    return cubemap.cell_solid_angles(cubemap.texel_cells(resolution))[:, 0]


def whitened(transfer: Transfer, used: Bool[Tensor, " points"], noise: float) -> Transfer:
    """Returns T / s over the samples that are used, in float64: equations with noise of deviation 1.

    s = noise x the brightest used sample under uniform light.

    Raises:
        ConfigError: the noise is not positive.
        SceneError: no sample, or no light reaches any.
    """
    if not 0 < noise < float("inf"):
        raise ConfigError(f"noise: expected a positive share of the brightest sample, got {noise}; 0.01 is usual")
    rows = transfer.transport[used].double()
    check_rows(rows)
    return Transfer(rows / (noise * rows.sum(dim=1).max()), transfer.resolution)


def stacked(transfers: Sequence[Transfer]) -> Transfer:
    """Returns the equations of several scenes under one light.

    Raises:
        ShapeError: there is none, or their resolutions differ.
    """
    resolutions = sorted({transfer.resolution for transfer in transfers})
    if len(resolutions) != 1:
        found = " and ".join(map(str, resolutions)) if resolutions else "no scene"
        raise ShapeError(f"stacked scenes: expected one resolution, got {found}; precompute all at the same")
    return Transfer(torch.cat([transfer.transport for transfer in transfers]), resolutions[0])


def observability(equations: Transfer, prior: float = PRIOR) -> Observability:
    """Returns what whitened equations (`whitened`, `stacked`) say about each texel.

    With the singular values d_j of T / s and the right singular vectors V,

        R_ii = sum over j of V_ij^2 tau^2 d_j^2 / (tau^2 d_j^2 + 1),   posterior deviation = tau sqrt(1 - R_ii)

    Raises:
        ConfigError: the prior deviation is not positive.
    """
    if not 0 < prior < float("inf"):
        raise ConfigError(f"prior: expected a positive deviation in units of the mean radiance, got {prior}")
    rows = equations.transport.double()
    small = torch.linalg.qr(rows, mode="r").R if rows.shape[0] > rows.shape[1] else rows
    _, values, vectors = torch.linalg.svd(small, full_matrices=False)
    energy = (prior * values).square()
    diagonal = (energy / (energy + 1)) @ vectors.square()
    reached = (rows != 0).any(dim=0)
    diagonal = torch.where(reached, diagonal, 0.0).clamp(0, 1)
    return Observability(diagonal, prior * (1 - diagonal).sqrt(), reached, values, equations.resolution)


def resolution_diagonal(gram: Float[Tensor, "texels texels"], noise: float) -> Float[Tensor, " texels"]:
    """Returns R_ii for the prior tau = 1 from the inner products T'T of equations whose noise has this deviation.

    R = I - (T'T / s^2 + I)^-1, by a Cholesky factor: what `observability` gives, in a twentieth of the time.
    """
    identity = torch.eye(gram.shape[0], dtype=gram.dtype, device=gram.device)
    factor = torch.linalg.cholesky(gram / noise**2 + identity)
    left = torch.linalg.solve_triangular(factor, identity, upper=False).square().sum(dim=0)
    return torch.where(gram.diagonal() > 0, 1 - left, 0.0).clamp(0, 1)


def degrees_of_freedom(rows: Float[Tensor, "points coeffs"]) -> float:
    """Returns the trace of R for whitened rows and tau = 1, by a Cholesky factor of the smaller Gram matrix.

    trace R = n - trace (G + I)^-1 with G = T'T / s^2 or, the same trace, T T' / s^2.
    """
    wide = rows.double() if rows.shape[0] < rows.shape[1] else rows.double().T
    gram = wide @ wide.T
    identity = torch.eye(len(gram), dtype=gram.dtype, device=gram.device)
    factor = torch.linalg.cholesky(gram + identity)
    return len(gram) - torch.linalg.solve_triangular(factor, identity, upper=False).square().sum().item()


def coarsened(transfer: Transfer, resolution: int) -> Transfer:
    """Returns the same transport on coarser texels, each the sum of those it holds, in the transport's dtype.

    Raises:
        ShapeError: the finer resolution is not an even multiple of the coarser.
    """
    factor, rest = divmod(transfer.resolution, resolution)
    if rest or resolution % 2:
        raise ShapeError(f"resolution {transfer.resolution} cannot be summed to {resolution}; use powers of two")
    parent = _parents(transfer.resolution, factor).to(transfer.transport.device)
    columns = cubemap.texel_count(resolution)
    sums = transfer.transport.new_zeros(len(transfer.transport), columns)
    return Transfer(sums.index_add_(1, parent, transfer.transport), resolution)


def _parents(resolution: int, factor: int) -> Int[Tensor, " texels"]:
    """Returns, for each visible texel, the place among the visible texels of the coarser texel that holds it."""
    coarse = resolution // factor
    index = cubemap.visible_texels(resolution)
    face, row, column = index // resolution**2, index // resolution % resolution, index % resolution
    parent = (face * coarse + row // factor) * coarse + column // factor
    return torch.searchsorted(cubemap.visible_texels(coarse), parent)
