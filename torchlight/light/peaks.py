"""Where the light comes from: the directions of its strongest sources.

A peak is found in the map of luminance flux L max(0, z) d omega: the flux-weighted mean direction within 12 degrees
of the element of largest flux. Which element that is depends on the elements' sizes. A method that solves for texels
should use `texel_peaks` on them: they are what the photograph determined. On the lat-long image of the same light,
all pixels of a texel tie but for the pixels' own areas, which shrink to 0 at the zenith. Light without texels is
averaged to texels by `environment_peaks`, for the same reason.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ShapeError
from torchlight.light import cubemap, latlong, overlap
from torchlight.light.environment import EnvironmentMap, flux, luminance

RADIUS_DEGREES = 12.0
MINIMUM_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class Peaks:
    """The strongest sources of a light, in the order of their brightest elements.

    Attributes:
        directions: unit vectors towards the light; NaN where there is no further peak.
        shares: luminance flux within 12 degrees of the peak's element and of no earlier peak's, divided by the whole;
            0 where there is no further peak.
    """

    directions: Float[Tensor, "*batch peaks 3"]
    shares: Float[Tensor, "*batch peaks"]


def texel_peaks(values: Float[Tensor, "*batch 3 texels"], resolution: int, *, count: int = 8) -> Peaks:
    """Returns the peaks of light given by a plane's visible texels.

    Args:
        values: linear radiance of `cubemap.visible_texels`.
        resolution: texels along a face's edge.
        count: number of peaks looked for.
    """
    if values.shape[-1] != cubemap.texel_count(resolution):
        raise ShapeError(
            f"texel_peaks: resolution {resolution} has {cubemap.texel_count(resolution)} visible texels, "
            f"got {values.shape[-1]}; pass the resolution the values were made for"
        )
    cells = cubemap.texel_cells(resolution, 1, device=values.device)
    directions = cubemap.cell_directions(cells)[:, 0].to(values.dtype)
    weights = cubemap.cell_cosine_weights(cells)[:, 0].to(values.dtype)
    return flux_peaks(directions, luminance(values) * weights, count=count)


def environment_peaks(environment: EnvironmentMap, *, resolution: int = 16, count: int = 8) -> Peaks:
    """Returns the peaks of a lat-long map averaged to texels: 16 per face edge are 4 to 7 degrees wide."""
    return texel_peaks(overlap.latlong_to_texels(environment.radiance, resolution), resolution, count=count)


def pixel_peaks(environment: EnvironmentMap, *, count: int = 8) -> Peaks:
    """Returns the peaks of a lat-long map in its own pixels, for maps finer than any texel, such as a measured sun."""
    radiance = environment.radiance
    directions = latlong.pixel_directions(environment.height, dtype=radiance.dtype, device=radiance.device)
    pixels = flux(environment).flatten(start_dim=-2)
    return flux_peaks(directions.reshape(-1, 3), luminance(pixels), count=count)


def peak_direction(peaks: Peaks) -> Float[Tensor, "*batch 3"]:
    """Returns the unit vector towards the strongest source; NaN for light that is nowhere positive."""
    return peaks.directions[..., 0, :]


def flux_peaks(
    directions: Float[Tensor, "samples 3"], weights: Float[Tensor, "*batch samples"], *, count: int = 8
) -> Peaks:
    """Returns the peaks of luminance flux given on a set of directions.

    Negative flux is set to 0: it would push a mean direction outside its own neighbourhood.

    Args:
        directions: unit vectors.
        weights: luminance flux.
        count: number of peaks looked for; those with less than 1 % of the flux are left out.
    """
    remaining = weights.clamp(min=0)
    total = remaining.sum(dim=-1)
    cosine = math.cos(math.radians(RADIUS_DEGREES))
    found, shares = [], []
    for _ in range(count):
        centre = directions[remaining.argmax(dim=-1)]
        near = (centre @ directions.T) >= cosine
        local = torch.where(near, remaining, 0)
        remaining = torch.where(near, 0, remaining)
        share = local.sum(dim=-1) / total
        enough = share >= MINIMUM_SHARE
        mean = torch.nn.functional.normalize(local @ directions, dim=-1)
        found.append(torch.where(enough[..., None], mean, torch.nan))
        shares.append(torch.where(enough, share, 0))
    # Where the brightest element was dim, later peaks may still count: absent ones go last.
    order = (torch.stack(shares, dim=-1) == 0).long().argsort(dim=-1, stable=True)
    directions_found = torch.stack(found, dim=-2).take_along_dim(order[..., None], dim=-2)
    return Peaks(directions_found, torch.stack(shares, dim=-1).take_along_dim(order, dim=-1))
