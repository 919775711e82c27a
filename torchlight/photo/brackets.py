"""Exposure brackets: one linear photograph of high dynamic range from several of different exposure.

    x(z)  relative exposure that a stored code z stands for (`Response`)
    L     = sum_j w_j t_j x(z_j) / sum_j w_j t_j^2,   w_j = taper(z_j) / x'(z_j)^2

Photograph j says x(z_j) = L t_j with a noise of equally many codes everywhere, that is x'(z_j) times as much in x; L is
the weighted least-squares estimate. A gamma curve makes such noise of shot noise, and quantisation is so by nature.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.errors import ConfigError, ShapeError
from torchlight.photo.observation import LinearPhoto
from torchlight.photo.radiometry import Response

TAPER_POWER = 12


@dataclass(frozen=True, eq=False)
class Exposed:
    """What one photograph of a bracket says of every pixel.

    Attributes:
        exposure: x, relative to that of the top code.
        weight: inverse variance of x up to a factor; 0 where the code is the lowest or the top one.
        saturated: where the exposure is a lower bound.
    """

    exposure: Float[Tensor, "3 height width"]
    weight: Float[Tensor, "3 height width"]
    saturated: Bool[Tensor, "3 height width"]


def exposed(pixels: Float[Tensor, "3 height width"], response: Response) -> Exposed:
    """Returns what an integer photograph says, its pixels in [0, 1] and its codes those of the response."""
    last = response.exposure.shape[-1] - 1
    codes = (pixels * last).round().long()
    weight = code_weights(response)
    look_up = [table.to(pixels.dtype) for table in (response.exposure, weight)]
    exposure, weight = (torch.stack([row[plane] for row, plane in zip(table, codes, strict=True)]) for table in look_up)
    return Exposed(exposure, weight, codes == last)


def exposed_linear(pixels: Float[Tensor, "3 height width"]) -> Exposed:
    """Returns what a linear float photograph says: equal noise everywhere, saturated where it is infinite."""
    finite = pixels.isfinite()
    clean = torch.where(finite, pixels, torch.ones_like(pixels))
    return Exposed(clean, finite.to(pixels), pixels == float("inf"))


def code_weights(response: Response) -> Float[Tensor, "3 codes"]:
    """Returns (1 - |2 z / top - 1|^12) / x'(z)^2, largest 1: inverse variance, faded out at both ends of the codes.

    The fade is G. Ward's broad hat (Reinhard et al., "High Dynamic Range Imaging", 2nd edition, section 5.7).
    """
    exposure = response.exposure
    place = torch.linspace(-1, 1, exposure.shape[-1], dtype=exposure.dtype)
    (slope,) = torch.gradient(exposure, dim=-1)
    weight = (1 - place.abs() ** TAPER_POWER) / slope**2
    return weight / weight.amax(dim=-1, keepdim=True)


def merge(photos: Iterable[tuple[Exposed, float]]) -> LinearPhoto:
    """Returns the radiance that photographs of one view say together, and where at least one of them measured it.

    Pixels too bright for all photographs hold the largest lower bound and those too dark for all the smallest value
    that one of them states; neither is usable. So is a pixel one of whose channels is not.

    Args:
        photos: each photograph with its exposure, any unit; they are read one at a time.

    Raises:
        ConfigError: no photograph, or exposures that are not positive.
        ShapeError: photographs of different size.
    """
    told = weight = bound = dark = None
    for photo, exposure in photos:
        if not 0 < exposure < float("inf"):
            raise ConfigError(f"exposure: expected a positive number, got {exposure}")
        radiance = photo.exposure / exposure
        if told is None or weight is None or bound is None or dark is None:
            told, weight, bound = (torch.zeros_like(radiance) for _ in range(3))
            dark = torch.full_like(radiance, float("inf"))
        if radiance.shape != told.shape:
            raise ShapeError(f"brackets of different size: {list(told.shape[1:])} and {list(radiance.shape[1:])}")
        told += photo.weight * exposure * photo.exposure
        weight += photo.weight * exposure**2
        bound = torch.where(photo.saturated, torch.maximum(bound, radiance), bound)
        dark = torch.where(photo.saturated, dark, torch.minimum(dark, radiance))
    if told is None or weight is None or bound is None or dark is None:
        raise ConfigError("no photograph to merge")
    measured = weight > 0
    unmeasured = torch.where(bound > 0, bound, dark)
    return LinearPhoto(torch.where(measured, told / weight, unmeasured), measured.all(dim=0))
