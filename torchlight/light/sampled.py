"""Light on any grid of the sphere, and its way from one to another; `environment` is the case of a lat-long."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ShapeError
from torchlight.light.environment import EnvironmentMap, check_radiance
from torchlight.light.formats import grid_as_fine
from torchlight.light.grids import Grid, LatlongGrid
from torchlight.light.resampling import Progress, resample
from torchlight.light.rotations import is_about_z
from torchlight.light_plane import LightPlane


@dataclass(frozen=True, eq=False)
class SampledLight:
    """Linear RGB radiance, constant over each pixel of a grid, Rec.709 primaries.

    Attributes:
        radiance: per pixel of the grid, flat.
        grid: how the sphere is parted.
        nonnegative: whether what made the light rules negative radiance out.
        units: as of `EnvironmentMap`.
        plane: where the light stands; None = far away.
    """

    radiance: Float[Tensor, "channels=3 pixels"]
    grid: Grid
    nonnegative: bool = True
    units: str = "relative"
    plane: LightPlane | None = None

    def __post_init__(self) -> None:
        if self.radiance.shape != (3, math.prod(self.grid.shape)) or not self.radiance.is_floating_point():
            raise ShapeError(
                f"light: expected floating-point [3, {math.prod(self.grid.shape)}], "
                f"got {list(self.radiance.shape)} of {self.radiance.dtype}"
            )
        check_radiance(self.radiance, self.nonnegative)


def sampled(environment: EnvironmentMap) -> SampledLight:
    """Returns one lat-long map as light on its grid."""
    if environment.radiance.ndim != 3:
        raise ShapeError(f"sampled: expected one map [3, height, width], got {list(environment.radiance.shape)}")
    radiance = environment.radiance.flatten(start_dim=-2)
    grid = LatlongGrid(environment.height)
    return SampledLight(radiance, grid, environment.nonnegative, environment.units, environment.plane)


def to_environment(light: SampledLight, height: int | None = None) -> EnvironmentMap:
    """Returns light as a lat-long map, of the height that keeps its detail or of another; each pixel's flux is kept."""
    moved = converted(light, grid_as_fine("torchlight", light.grid) if height is None else LatlongGrid(height))
    radiance = moved.radiance.unflatten(-1, moved.grid.shape)
    return EnvironmentMap(radiance, nonnegative=moved.nonnegative, units=moved.units, plane=moved.plane)


def converted(
    light: SampledLight,
    grid: Grid,
    rotation: Float[Tensor, "3 3"] | None = None,
    progress: Progress | None = None,
) -> SampledLight:
    """Returns light on another grid, turned on the way: what came from d then comes from rotation @ d.

    Each pixel's flux is kept (see `resampling`). A plane of the light turns with it about its own center, which a turn
    about z allows; any other turn gives light that is far away.
    """
    radiance = resample(light.radiance, light.grid, grid, rotation, progress)
    plane = light.plane if rotation is None or is_about_z(rotation) else None
    return replace(light, radiance=radiance, grid=grid, plane=plane)


def sphere_power(light: SampledLight) -> Float[Tensor, "3"]:
    """Returns the integral of L d omega over the whole sphere, float64."""
    return light.radiance.double() @ light.grid.solid_angles().to(light.radiance.device)


def clipped_share(light: SampledLight) -> float:
    """Returns the part of the flux that clipping at 0 changes: sum of max(0, -L) d omega over sum of |L| d omega."""
    flux = light.radiance.double() * light.grid.solid_angles().to(light.radiance.device)
    total = flux.abs().sum().item()
    return (-flux).clamp(min=0).sum().item() / total if total > 0 else 0.0
