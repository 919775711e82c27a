"""Edges of a picture along given normals: where brightness changes fastest, to a fraction of a pixel.

Along the normal of each place the picture is read bilinearly every `STEP` pixels and convolved with the derivative of
a Gaussian of `BLUR` pixels. An edge is a maximum of the slope's size; a parabola through it and its neighbours gives
its place. A blur that is the same on both sides, such as a lens's, leaves a step's steepest point where it was.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import conv1d, grid_sample

STEP = 0.25  # pixels between values of a profile
BLUR = 1.0  # pixels
NOISE_SIGMAS = 6.0  # of the slopes: less is no edge
LEAST_SLOPE = 0.005  # of the brightest value read, per pixel: neither is less than that
CANDIDATES = 8  # per profile, the steepest
_HALF = int(3 * BLUR / STEP)


@dataclass(frozen=True, eq=False)
class Found:
    """The edges that cross each profile.

    Attributes:
        offsets: along the normal, in pixels; NaN where there are no more.
        slopes: size of the slope there; 0 where there are no more.
    """

    offsets: Float[Tensor, "places candidates"]
    slopes: Float[Tensor, "places candidates"]


def edges_across(
    grey: Float[Tensor, "height width"],
    places: Float[Tensor, "places 2"],
    normals: Float[Tensor, "places 2"],
    reach: float,
    noise: float,
) -> Found:
    """Returns the edges within `reach` pixels of each place along its normal.

    Args:
        grey: the picture, in proportion to light.
        places: x and y, pixel centres at integers.
        normals: unit vectors.
        reach: to each side.
        noise: standard deviation of a slope where there is no edge, from `slope_noise`.
    """
    slope, across = slopes(grey, places, normals, reach)
    size = slope.abs().nan_to_num()
    middle, before, after = size[:, 1:-1], size[:, :-2], size[:, 2:]
    least = max(NOISE_SIGMAS * noise, LEAST_SLOPE * float(grey.nan_to_num().max()))
    height = torch.where((middle > before) & (middle >= after) & (middle > least), middle, 0.0)
    count = min(CANDIDATES, height.shape[1])
    steepest, index = height.topk(count, dim=1)
    low, top, high = (part.gather(1, index) for part in (before, middle, after))
    curvature = (low - 2 * top + high).clamp(max=-torch.finfo(top.dtype).tiny)
    offsets = across[1:-1][index] + STEP * (0.5 * (low - high) / curvature)
    return Found(torch.where(steepest > 0, offsets, torch.nan), steepest)


def slope_noise(
    grey: Float[Tensor, "height width"],
    places: Float[Tensor, "places 2"],
    normals: Float[Tensor, "places 2"],
    reach: float,
) -> float:
    """Returns the standard deviation of slopes off the edges: 1.4826 times the median of their size."""
    slope, _ = slopes(grey, places, normals, reach)
    known = slope[slope.isfinite()]
    return 1.4826 * float(known.abs().median()) if len(known) else 0.0


def slopes(
    grey: Float[Tensor, "height width"],
    places: Float[Tensor, "places 2"],
    normals: Float[Tensor, "places 2"],
    reach: float,
) -> tuple[Float[Tensor, "places steps"], Float[Tensor, " steps"]]:
    """Returns the slope per pixel along each normal, NaN where the picture ends, and the offsets it is taken at."""
    half = int(reach / STEP) + 1
    across = STEP * torch.arange(-half - _HALF, half + _HALF + 1, dtype=torch.float64)
    spots = places[:, None] + across[:, None] * normals[:, None]
    height, width = grey.shape
    limits = torch.tensor([width - 1, height - 1], dtype=torch.float64)
    unit = spots / limits * 2 - 1
    values = grid_sample(grey.double()[None, None], unit[None].nan_to_num(-9.0), align_corners=True)[0, 0]
    inside = ((spots >= 0) & (spots <= limits)).all(dim=-1)
    values = torch.where(inside, values, torch.nan)
    offset = STEP * torch.arange(-_HALF, _HALF + 1, dtype=torch.float64)
    kernel = offset * torch.exp(-offset.square() / (2 * BLUR**2))
    kernel = kernel / (kernel * offset).sum()  # a ramp of 1 per pixel has the slope 1
    return conv1d(values[:, None], kernel[None, None])[:, 0], across[_HALF:-_HALF]
