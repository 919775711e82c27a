"""Errors of radiance: weighted root mean squares, with and without a free scale, and of logarithms.

    <f> = sum of w_p f_pc / (channels sum of w_p)       w_p = solid angle of a sample, or 1 for pixels of a picture

All take samples x of the light and y of the reference, [*batch, channels, samples], and compute in float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

LOG_OFFSET = 1e-3  # of the reference's mean radiance


@dataclass(frozen=True, eq=False)
class Scaled:
    """An error after the best scale.

    Attributes:
        rmse: root mean square of a x - y.
        scale: a; 0 where the light is black.
    """

    rmse: Float[Tensor, "*batch"]
    scale: Float[Tensor, "*scales"]


def mean_square(
    values: Float[Tensor, "*batch channels samples"], weights: Float[Tensor, " samples"]
) -> Float[Tensor, "*batch"]:
    """Returns <v^2>."""
    return values.double().square().mean(dim=-2) @ weights.double() / weights.double().sum()


def rmse(
    light: Float[Tensor, "*batch channels samples"],
    reference: Float[Tensor, "*batch channels samples"],
    weights: Float[Tensor, " samples"],
) -> Float[Tensor, "*batch"]:
    """Returns sqrt <(x - y)^2>, in units of radiance."""
    return mean_square(light.double() - reference.double(), weights).sqrt()


def relative_rmse(
    light: Float[Tensor, "*batch channels samples"],
    reference: Float[Tensor, "*batch channels samples"],
    weights: Float[Tensor, " samples"],
) -> Float[Tensor, "*batch"]:
    """Returns sqrt(<(x - y)^2> / <y^2>); 1 for a black light, NaN or infinite for a black reference."""
    return rmse(light, reference, weights) / mean_square(reference, weights).sqrt()


def scale_invariant_rmse(
    light: Float[Tensor, "*batch channels samples"],
    reference: Float[Tensor, "*batch channels samples"],
    weights: Float[Tensor, " samples"],
) -> Scaled:
    """Returns sqrt <(a x - y)^2> with the one a of all channels that makes it smallest, <x y> / <x^2>."""
    x, y = light.double(), reference.double()
    scale = _ratio(((x * y) @ weights.double()).sum(dim=-1), ((x * x) @ weights.double()).sum(dim=-1))
    return Scaled(rmse(scale[..., None, None] * x, y, weights), scale)


def channel_scale_invariant_rmse(
    light: Float[Tensor, "*batch channels samples"],
    reference: Float[Tensor, "*batch channels samples"],
    weights: Float[Tensor, " samples"],
) -> Scaled:
    """Returns sqrt <(a_c x - y)^2> with the a_c of every channel that makes it smallest."""
    x, y = light.double(), reference.double()
    scale = _ratio((x * y) @ weights.double(), (x * x) @ weights.double())
    return Scaled(rmse(scale[..., None] * x, y, weights), scale)


def log_rmse(
    light: Float[Tensor, "*batch channels samples"],
    reference: Float[Tensor, "*batch channels samples"],
    weights: Float[Tensor, " samples"],
    offset: float = LOG_OFFSET,
) -> Float[Tensor, "*batch"]:
    """Returns sqrt <(log2(max(x, 0) + e) - log2(max(y, 0) + e))^2>, in stops, with e = offset <max(y, 0)>.

    e keeps black finite: radiance far below it counts as equal. NaN for a black reference.
    """
    x, y = light.double().clamp(min=0), reference.double().clamp(min=0)
    level = offset * (y.mean(dim=-2) @ weights.double() / weights.double().sum())[..., None, None]
    level = torch.where(level > 0, level, torch.nan)
    return rmse((x + level).log2(), (y + level).log2(), weights)


def relative_error(light: Float[Tensor, "*batch"], reference: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Returns x / y - 1, for totals such as irradiance and power; 0.1 = ten percent too bright."""
    return light.double() / reference.double() - 1


def colour_angle(
    light: Float[Tensor, "*batch channels samples"],
    reference: Float[Tensor, "*batch channels samples"],
    weights: Float[Tensor, " samples"],
) -> Float[Tensor, "*batch"]:
    """Returns the mean angle between the RGB vectors of x and y in degrees, over samples where neither is black.

    0 = the same chromaticity at any brightness; 90 = no channel in common. NaN where no sample is left.
    """
    angle, counts = vector_angles(light.double().mT, reference.double().mT)
    valid = counts * weights.double()
    return (torch.where(counts, angle, 0.0) * valid).sum(dim=-1) / valid.sum(dim=-1)


def vector_angles(
    first: Float[Tensor, "*#batch axes"], second: Float[Tensor, "*#batch axes"]
) -> tuple[Float[Tensor, "*batch"], Bool[Tensor, "*batch"]]:
    """Returns the angle between two vectors in degrees, and whether both have a length.

    2 atan2(|a - b|, |a + b|) of the unit vectors: exact near 0, where the arc cosine loses half of its digits (Kahan).
    """
    lengths = torch.linalg.vector_norm(first, dim=-1), torch.linalg.vector_norm(second, dim=-1)
    counts = (lengths[0] > 0) & (lengths[1] > 0)
    a, b = (v / torch.where(n > 0, n, 1.0)[..., None] for v, n in zip((first, second), lengths, strict=True))
    half = torch.atan2(torch.linalg.vector_norm(a - b, dim=-1), torch.linalg.vector_norm(a + b, dim=-1))
    return torch.rad2deg(2 * half), counts


def _ratio(cross: Float[Tensor, "*batch"], square: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    return torch.where(square > 0, cross / torch.where(square > 0, square, 1.0), 0.0)
