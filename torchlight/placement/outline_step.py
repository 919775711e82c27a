"""A Gauss-Newton step on where the object stands, from how far its outline lies from the photograph's edges."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.shadow_fit import Pose

NEAR = 3.0  # pixels: an edge farther off is not the outline's
IMMOBILE = 0.05  # pixels per pixel, root mean square: a movement that leaves the outline where it is
HUBER = 1.345  # deviations
FINEST = 0.03  # pixels: edges are not told better than that
SECTORS = 12  # of the outline, within which residuals may be correlated


@dataclass(frozen=True, eq=False)
class Matched:
    """The outline of one pose and the photograph's edges along it.

    Attributes:
        pose: q in units of the frame.
        offsets: of the nearest edge, outwards in pixels; NaN where there is none within `NEAR`.
        rates: how far the outline moves per unit of the pose, in pixels.
        sector: that each sample lies in.
    """

    pose: Pose
    offsets: Float[Tensor, " samples"]
    rates: Float[Tensor, "samples 3"]
    sector: Float[Tensor, " samples"]

    @property
    def seen(self) -> float:
        """Share of the outline that has an edge."""
        return float(self.offsets.isfinite().double().mean()) if len(self.offsets) else 0.0

    @property
    def cost(self) -> float:
        """Mean of min(r^2 / NEAR^2, 1) over the outline."""
        return float((self.offsets / NEAR).square().nan_to_num(1.0).mean()) if len(self.offsets) else 1.0

    @property
    def rms(self) -> float | None:
        """Root mean square of the distances to edges; None without edges."""
        known = self.offsets[self.offsets.isfinite()]
        return float(known.square().mean().sqrt()) if len(known) else None


@dataclass(frozen=True, eq=False)
class Normal:
    """The normal equations of one pose, in units of the frame.

    Attributes:
        change: the Gauss-Newton step, along what is determined.
        covariance: of the pose; enormous along what is not determined.
        axes: orthonormal directions that are determined, in columns.
    """

    change: Pose
    covariance: Float[Tensor, "3 3"]
    axes: Float[Tensor, "3 axes"]


def normal_equations(found: Matched) -> Normal:
    """Returns the Gauss-Newton step from a pose, with Huber's weights, and its covariance.

    The covariance is s^2 H^-1 with H = sum w J'J and s^2 the weighted residual's variance, plus what leaving out one
    sector of the outline after the other says (`jackknife`): the first is what noise does, the second what a whole side
    does that is not where the scene's object has it.
    """
    used = found.offsets.isfinite()
    r, J = found.offsets[used], found.rates[used]
    size = max(FINEST, 1.4826 * float(r.abs().median())) if len(r) else 1.0
    w = (HUBER * size / r.abs().clamp(min=1e-300)).clamp(max=1)
    values, vectors = torch.linalg.eigh((J * w[:, None]).T @ J)
    values = values.clamp(min=1e-12)
    variance = max(FINEST**2, float((w * r.square()).sum()) / max(1.0, float(w.sum()) - 3))
    mobile = values > IMMOBILE**2 * max(1.0, float(w.sum()))
    axes = vectors[:, mobile & (variance / values < 1)]
    K = J @ axes
    sector = found.sector[used].long()
    H = sums(w[:, None, None] * K[:, :, None] * K[:, None, :], sector)
    g = sums(w[:, None] * K * r[:, None], sector)
    change = axes @ torch.linalg.solve(H.sum(dim=0), g.sum(dim=0))
    covariance = variance * (vectors / values) @ vectors.T + axes @ jackknife(H, g) @ axes.T
    return Normal(change, covariance, axes)


def sums(values: Float[Tensor, "samples *shape"], sector: Int[Tensor, " samples"]) -> Float[Tensor, "sectors *shape"]:
    """Returns the sums over each sector of the outline."""
    return values.new_zeros(SECTORS + 1, *values.shape[1:]).index_add_(0, sector, values)


def jackknife(H: Float[Tensor, "sectors axes axes"], g: Float[Tensor, "sectors axes"]) -> Float[Tensor, "axes axes"]:
    """Returns the covariance (n - 1) / n sum (q_i - mean q)(q_i - mean q)' of the steps q_i without one sector each.

    n sectors have edges; Quenouille, Biometrika 43 (1956). What the others do not determine is infinitely unsure, here
    a million pixels.
    """
    axes, some = H.shape[-1], H.diagonal(dim1=-2, dim2=-1).sum(dim=-1) > 0
    if axes == 0 or int(some.sum()) < 2:
        return 1e12 * torch.eye(axes, dtype=H.dtype)
    without, rest = (H.sum(dim=0) - H)[some], (g.sum(dim=0) - g)[some]
    values, vectors = torch.linalg.eigh(without)
    along = (vectors.mT @ rest[..., None])[..., 0]
    known = values > 1e-6 * values.amax(dim=-1, keepdim=True)
    steps = (vectors @ torch.where(known, along / values, 1e6)[..., None])[..., 0]
    away = steps - steps.mean(dim=0)
    count = len(steps)
    return (count - 1) / max(1, count) * away.T @ away


def reach_of(pose: Float[Tensor, "*poses 3"]) -> Float[Tensor, "*poses"]:
    """Returns how far a point of the object moves at most, in pixels, about."""
    return torch.hypot(pose[..., 0], pose[..., 1]) + pose[..., 2].abs()
