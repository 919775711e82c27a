"""Light from all directions as a lat-long image, always in torchlight's own convention (see `latlong`)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, ShapeError
from torchlight.light import latlong
from torchlight.light_plane import LightPlane

LUMINANCE = (0.2126, 0.7152, 0.0722)  # Rec.709


@dataclass(frozen=True, eq=False)
class EnvironmentMap:
    """Linear RGB radiance over the whole sphere: constant over each pixel, Rec.709 primaries.

    Attributes:
        radiance: row 0 is the zenith, the centre looks along +X, the left quarter along +Y; width = 2 height.
        nonnegative: whether the method that made the map rules negative radiance out.
        units: "relative" (radiance times an unknown factor) or the name of an absolute unit.
        plane: where the light stands, seen from the plane's center; None = far away.
    """

    radiance: Float[Tensor, "*batch channels=3 height width"]
    nonnegative: bool = True
    units: str = "relative"
    plane: LightPlane | None = None

    def __post_init__(self) -> None:
        shape = self.radiance.shape
        if len(shape) < 3 or shape[-3] != 3 or not self.radiance.is_floating_point():
            raise ShapeError(
                f"environment map: expected floating-point [..., 3, height, width], "
                f"got {list(shape)} of {self.radiance.dtype}"
            )
        latlong.check_latlong(shape[-2], shape[-1])
        check_radiance(self.radiance, self.nonnegative)

    @property
    def height(self) -> int:
        """Number of rows; half the number of columns."""
        return self.radiance.shape[-2]


def check_radiance(radiance: Float[Tensor, "*values"], nonnegative: bool) -> None:
    """Raises ConfigError for NaN, infinite, or, where declared non-negative, negative radiance."""
    if not bool(torch.isfinite(radiance).all()):
        raise ConfigError("environment map: NaN or infinite radiance; repair these pixels before loading the map")
    if nonnegative and bool((radiance < 0).any()):
        raise ConfigError(
            f"environment map: radiance down to {radiance.min().item():.3g} in a map declared non-negative; "
            "clamp it, or pass nonnegative=False"
        )


def radiance_at(environment: EnvironmentMap, directions: Float[Tensor, "*points 3"]) -> Float[Tensor, "*maps *points"]:
    """Returns the radiance of the pixel each direction falls into, of shape [*batch, 3, *points].

    The map is taken as constant over each pixel, here as in every integral over it, so that sums of this function
    converge to `irradiance` and `power`. Directions need not be unit vectors.
    """
    row, column = latlong.pixel_indices(directions.to(environment.radiance.device), environment.height)
    return environment.radiance[..., row, column]


def irradiance(environment: EnvironmentMap) -> Float[Tensor, "*batch 3"]:
    """Returns E of an unoccluded plane z = 0: the exact integral of L max(0, z) d omega. Constant L gives pi L."""
    weights = latlong.row_projected_solid_angles(environment.height, device=environment.radiance.device)
    return (environment.radiance.double().sum(dim=-1) @ weights).to(environment.radiance.dtype)


def power(environment: EnvironmentMap) -> Float[Tensor, "*batch 3"]:
    """Returns the exact integral of L d omega over the whole sphere. Constant L gives 4 pi L."""
    weights = latlong.row_solid_angles(environment.height, device=environment.radiance.device)
    return (environment.radiance.double().sum(dim=-1) @ weights).to(environment.radiance.dtype)


def flux(environment: EnvironmentMap) -> Float[Tensor, "*batch 3 height width"]:
    """Returns each pixel's share of `irradiance`: the exact integral of L max(0, z) d omega over the pixel."""
    radiance = environment.radiance
    weights = latlong.row_projected_solid_angles(environment.height, dtype=radiance.dtype, device=radiance.device)
    return radiance * weights[:, None]


def negative_share(environment: EnvironmentMap) -> Float[Tensor, "*batch"]:
    """Returns the part of the luminance flux that clipping at 0 would change: sum of max(0, -F) over sum of |F|."""
    values = luminance(flux(environment).flatten(start_dim=-2))
    total = values.abs().sum(dim=-1)
    return (-values).clamp(min=0).sum(dim=-1) / torch.where(total > 0, total, 1)


def luminance(rgb: Float[Tensor, "*batch 3 samples"]) -> Float[Tensor, "*batch samples"]:
    """Returns 0.2126 R + 0.7152 G + 0.0722 B (Rec.709)."""
    weights = torch.tensor(LUMINANCE, dtype=rgb.dtype, device=rgb.device)
    return torch.einsum("...cs,c->...s", rgb, weights)


def rotate_about_z(environment: EnvironmentMap, degrees: float) -> EnvironmentMap:
    """Returns the light turned counter-clockwise seen from +Z: what came from azimuth 0 now comes from `degrees`.

    Whole pixels are moved exactly; a fraction of a pixel averages two neighbours by area, so power is kept.
    """
    if not math.isfinite(degrees):
        raise ConfigError(f"rotate_about_z: expected a finite angle in degrees, got {degrees}")
    # Azimuth grows to the left.
    shift = -degrees * (2 * environment.height) / 360
    whole = math.floor(shift)
    fraction = shift - whole
    moved = environment.radiance.roll(whole, dims=-1)
    if fraction > 0:
        moved = torch.lerp(moved, moved.roll(1, dims=-1), fraction)
    return replace(environment, radiance=moved)
