"""Where two lights come from: the mean direction of all of it, and the directions of its strongest sources."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.light.environment import luminance
from torchlight.light.peaks import Peaks
from torchlight.light_metrics.grid import first_moments
from torchlight.light_metrics.radiance import vector_angles


@dataclass(frozen=True, eq=False)
class PeakMatch:
    """Sources of a reference with those of a light that answer to them.

    Attributes:
        degrees: between the sources of a pair, in the order of the reference's; NaN where none is left to answer.
        shares: of the reference's flux, of each of its sources; 0 where there is no further one.
        strongest: between the strongest source of each, in degrees.
        missed: sources of the reference that have no partner.
        extra: sources of the light that have none.
    """

    degrees: Float[Tensor, "*batch peaks"]
    shares: Float[Tensor, "*batch peaks"]
    strongest: Float[Tensor, "*batch"]
    missed: Float[Tensor, "*batch"]
    extra: Float[Tensor, "*batch"]

    @property
    def mean(self) -> Float[Tensor, "*batch"]:
        """Mean angle of the pairs in degrees, each by its share of the reference's flux; NaN without a pair."""
        paired = ~self.degrees.isnan()
        weights = self.shares * paired
        return (torch.where(paired, self.degrees, 0.0) * weights).sum(dim=-1) / weights.sum(dim=-1)


def mean_vector(
    radiance: Float[Tensor, "*batch 3 height width"], weights: Float[Tensor, " samples"]
) -> Float[Tensor, "*batch 3"]:
    """Returns the integral of luminance times the unit vector, exact for light constant over pixels.

    Args:
        radiance: on a lat-long grid.
        weights: of its pixels; those of weight 0 are left out.
    """
    moments = first_moments(radiance.shape[-2], device=radiance.device) * (weights > 0)[:, None]
    return luminance(radiance.double().flatten(start_dim=-2)) @ moments


def mean_direction_error(
    light: Float[Tensor, "*batch 3 height width"],
    reference: Float[Tensor, "*batch 3 height width"],
    weights: Float[Tensor, " samples"],
) -> Float[Tensor, "*batch"]:
    """Returns the angle between the mean vectors of two lights in degrees; NaN where one has none."""
    angle, counts = vector_angles(mean_vector(light, weights), mean_vector(reference, weights))
    return torch.where(counts, angle, torch.nan)


def matched_peaks(light: Peaks, reference: Peaks) -> PeakMatch:
    """Returns the sources of two lights in pairs: the reference's, largest share first, take the nearest that is free.

    A source has at least 1 % of its light's flux on the plane (`light.peaks`).
    """
    found, wanted = _by_share(light), _by_share(reference)
    angles, both = vector_angles(
        wanted.directions.double()[..., :, None, :], found.directions.double()[..., None, :, :]
    )
    angles = torch.where(both & ~angles.isnan(), angles, torch.inf)
    strongest = torch.where(angles[..., 0, 0].isinf(), torch.nan, angles[..., 0, 0])
    free = torch.ones_like(angles[..., 0, :], dtype=torch.bool)
    degrees = []
    for row in angles.unbind(dim=-2):
        angle, free = _nearest(row, free)
        degrees.append(angle)
    paired = torch.stack(degrees, dim=-1)
    pairs = (~paired.isnan()).sum(dim=-1)
    missed, extra = (((peaks.shares > 0).sum(dim=-1) - pairs).double() for peaks in (wanted, found))
    return PeakMatch(paired, wanted.shares.double(), strongest, missed, extra)


def _nearest(
    angles: Float[Tensor, "*batch peaks"], free: Bool[Tensor, "*batch peaks"]
) -> tuple[Float[Tensor, "*batch"], Bool[Tensor, "*batch peaks"]]:
    """Returns the smallest angle to a free source, NaN where there is none, and which sources are free after that."""
    angle, place = torch.where(free, angles, torch.inf).min(dim=-1)
    taken = torch.nn.functional.one_hot(place, angles.shape[-1]).bool() & angle.isfinite()[..., None]
    return torch.where(angle.isinf(), torch.nan, angle), free & ~taken


def _by_share(peaks: Peaks) -> Peaks:
    order = peaks.shares.argsort(dim=-1, descending=True, stable=True)
    return Peaks(peaks.directions.take_along_dim(order[..., None], dim=-2), peaks.shares.take_along_dim(order, dim=-1))
