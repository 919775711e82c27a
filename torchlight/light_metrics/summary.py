"""All measures of a light against its reference at once: `torchlight compare` in one function."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.light import latlong
from torchlight.light.environment import EnvironmentMap, irradiance, luminance
from torchlight.light.peaks import environment_peaks
from torchlight.light_metrics import radiance as errors
from torchlight.light_metrics.directions import PeakMatch, matched_peaks, mean_direction_error
from torchlight.light_metrics.grid import Part, check_height, common_height, resampled, sample_weights
from torchlight.light_metrics.radiance import Scaled

Fit = Literal["none", "irradiance", "scale", "channels"]


@dataclass(frozen=True, eq=False)
class Pair:
    """Two lights on one grid.

    Attributes:
        light: scaled by `scale`.
        reference: what it is compared with.
        scale: that the light has been multiplied by, per channel.
        part: "upper" = black below the horizon, both; "sphere" = as they are.
    """

    light: EnvironmentMap
    reference: EnvironmentMap
    scale: Float[Tensor, "*batch 3"]
    part: Part

    @property
    def weights(self) -> Float[Tensor, " samples"]:
        """Solid angle of every pixel that counts."""
        return sample_weights(self.light.height, self.part, device=self.light.radiance.device)


@dataclass(frozen=True, eq=False)
class Measures:
    """How far a light is from its reference; every formula is in docs/metrics.md.

    Attributes:
        rmse: in units of radiance.
        relative_rmse: by the reference's root mean square.
        scale_invariant: one free scale.
        channel_scale_invariant: one free scale per channel.
        log_rmse: in stops.
        colour_angle: in degrees.
        mean_direction: in degrees.
        peaks: strongest sources.
        irradiance: relative error of E on the plane, per channel.
        irradiance_luminance: likewise, of its luminance.
        power: relative error of the integral of L over the part that counts, per channel.
        power_luminance: likewise, of its luminance.
        irradiance_colour: angle between the RGB vectors of E, in degrees.
    """

    rmse: Float[Tensor, "*batch"]
    relative_rmse: Float[Tensor, "*batch"]
    scale_invariant: Scaled
    channel_scale_invariant: Scaled
    log_rmse: Float[Tensor, "*batch"]
    colour_angle: Float[Tensor, "*batch"]
    mean_direction: Float[Tensor, "*batch"]
    peaks: PeakMatch
    irradiance: Float[Tensor, "*batch 3"]
    irradiance_luminance: Float[Tensor, "*batch"]
    power: Float[Tensor, "*batch 3"]
    power_luminance: Float[Tensor, "*batch"]
    irradiance_colour: Float[Tensor, "*batch"]


def paired(
    light: EnvironmentMap,
    reference: EnvironmentMap,
    part: Part = "upper",
    height: int | None = None,
    fit: Fit = "none",
) -> Pair:
    """Returns two lights on one grid, in float64.

    Args:
        light: to be judged.
        reference: to be judged by.
        part: what counts; the rest is made black in both.
        height: rows of the grid; None = those of the coarser map, made even.
        fit: "irradiance" multiplies the light by the factor that gives the plane the reference's luminance, "scale" by
            that which makes the RMSE smallest, "channels" by one per channel that does.

    Raises:
        ConfigError: an odd or huge height.
    """
    height = common_height(light.height, reference.height) if height is None else height
    check_height(height)
    x, y = (kept(resampled(each.radiance.double(), height), part) for each in (light, reference))
    scale = fitted_scale(x, y, part, fit)
    x = x * scale[..., None, None]
    return Pair(_environment(x, light), _environment(y, reference), scale, part)


def kept(radiance: Float[Tensor, "*batch height width"], part: Part) -> Float[Tensor, "*batch height width"]:
    """Returns radiance with what does not count made black."""
    if part == "sphere":
        return radiance
    upper = torch.arange(radiance.shape[-2], device=radiance.device) < radiance.shape[-2] // 2
    return torch.where(upper[:, None], radiance, 0.0)


def fitted_scale(
    light: Float[Tensor, "*batch 3 height width"],
    reference: Float[Tensor, "*batch 3 height width"],
    part: Part,
    fit: Fit,
) -> Float[Tensor, "*batch 3"]:
    """Returns the factor of every channel."""
    if fit == "none":
        return light.new_ones(light.shape[:-2])
    if fit == "irradiance":
        weights = latlong.row_projected_solid_angles(light.shape[-2], device=light.device)
        received, wanted = (luminance((each.sum(dim=-1) @ weights)[..., None]) for each in (light, reference))
        return torch.where(received > 0, wanted / received, 0.0).expand(light.shape[:-2])
    x, y = light.flatten(start_dim=-2), reference.flatten(start_dim=-2)
    weights = sample_weights(light.shape[-2], part, device=light.device)
    if fit == "channels":
        return errors.channel_scale_invariant_rmse(x, y, weights).scale
    return errors.scale_invariant_rmse(x, y, weights).scale[..., None].expand(light.shape[:-2])


def measures(pair: Pair, log_offset: float = errors.LOG_OFFSET) -> Measures:
    """Returns every measure that needs the two lights alone.

    Args:
        pair: from `paired`.
        log_offset: of `log_rmse`, as a share of the reference's mean radiance.

    Raises:
        ConfigError: the offset is not positive.
    """
    if not 0 < log_offset < float("inf"):
        raise ConfigError(f"log offset: expected a positive share of the mean radiance, got {log_offset}")
    weights = pair.weights
    x, y = pair.light.radiance.flatten(start_dim=-2), pair.reference.radiance.flatten(start_dim=-2)
    received, wanted = irradiance(pair.light), irradiance(pair.reference)
    grey, grey_wanted = (luminance(value[..., None])[..., 0] for value in (received, wanted))
    tint, has_tint = errors.vector_angles(received, wanted)
    return Measures(
        rmse=errors.rmse(x, y, weights),
        relative_rmse=errors.relative_rmse(x, y, weights),
        scale_invariant=errors.scale_invariant_rmse(x, y, weights),
        channel_scale_invariant=errors.channel_scale_invariant_rmse(x, y, weights),
        log_rmse=errors.log_rmse(x, y, weights, log_offset),
        colour_angle=errors.colour_angle(x, y, weights),
        mean_direction=mean_direction_error(pair.light.radiance, pair.reference.radiance, weights),
        peaks=matched_peaks(environment_peaks(pair.light), environment_peaks(pair.reference)),
        irradiance=errors.relative_error(received, wanted),
        irradiance_luminance=errors.relative_error(grey, grey_wanted),
        power=errors.relative_error(x @ weights, y @ weights),
        power_luminance=errors.relative_error(luminance(x) @ weights, luminance(y) @ weights),
        irradiance_colour=torch.where(has_tint, tint, torch.nan),
    )


def _environment(radiance: Tensor, like: EnvironmentMap) -> EnvironmentMap:
    return replace(like, radiance=radiance, nonnegative=bool((radiance >= 0).all()))
