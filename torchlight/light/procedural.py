"""Light made from formulas, for demonstrations and tests: nothing here comes from a photograph."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.light import cubemap, latlong
from torchlight.light.directions import from_angles
from torchlight.light.environment import EnvironmentMap
from torchlight.light.grids import CubeGrid
from torchlight.light.sampled import SampledLight

SUN_AZIMUTH, SUN_ELEVATION, SUN_RADIUS = math.radians(35), math.radians(50), math.radians(2.5)
SUN_RADIANCE = (480.0, 420.0, 320.0)
WINDOW_AZIMUTH, WINDOW_ELEVATION = math.radians(-125), math.radians(25)
WINDOW_WIDTH, WINDOW_HEIGHT = math.radians(30), math.radians(20)
WINDOW_RADIANCE = (6.5, 8.0, 10.5)
ZENITH_RADIANCE, HORIZON_RADIANCE = (0.16, 0.28, 0.55), (0.55, 0.60, 0.66)
GROUND_RADIANCE = (0.10, 0.085, 0.07)
_SUBSAMPLES = 4
_ROWS_AT_ONCE = 32


def sun_and_window_radiance(directions: Float[Tensor, "*points 3"]) -> Float[Tensor, "3 *points"]:
    """Returns the radiance of a clear sky with a soft, warm sun, a cool window low on the other side, and dim ground.

    The sun is a disc of 2.5 degrees radius at 50 degrees elevation whose brightness falls to 0 as 1 - (r / R)^4;
    the window is a rectangle in azimuth and elevation. Directions are unit vectors.
    """
    x, y, z = directions.unbind(dim=-1)
    sky = _mix(HORIZON_RADIANCE, ZENITH_RADIANCE, z.clamp(0, 1).sqrt())
    sky = torch.where(z > 0, sky, _mix(GROUND_RADIANCE, GROUND_RADIANCE, z))
    sky = torch.where(_in_window(x, y, z), _mix(WINDOW_RADIANCE, WINDOW_RADIANCE, z), sky)
    angles = torch.tensor([math.pi / 2 - SUN_ELEVATION, SUN_AZIMUTH], dtype=torch.float64)
    sun = from_angles(angles[0], angles[1]).to(directions)
    # The chord keeps its digits where acos of a cosine near 1 loses half of them.
    distance = 2 * torch.asin((torch.linalg.vector_norm(directions - sun, dim=-1) / 2).clamp(max=1))
    profile = (1 - (distance / SUN_RADIUS) ** 4).clamp(min=0)
    return sky + _mix((0.0, 0.0, 0.0), SUN_RADIANCE, profile)


def sun_and_window(
    height: int = 256, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> EnvironmentMap:
    """Returns `sun_and_window_radiance` as a lat-long map, averaged over 4 x 4 directions per pixel."""
    rows = [_average_rows(rows, height) for rows in torch.arange(height).split(_ROWS_AT_ONCE)]
    return EnvironmentMap(torch.cat(rows, dim=1).to(dtype=dtype, device=device))


def axis_colours(
    height: int = 64, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> EnvironmentMap:
    """Returns a map that tells all axes apart: within 45 degrees of +X red, -X cyan, +Y green, -Y magenta,
    +Z blue, -Z yellow; brighter towards (1, 2, 3), which no turn or mirror image preserves.
    """
    return EnvironmentMap(axis_radiance(latlong.pixel_directions(height)).to(dtype=dtype, device=device))


def axis_faces(
    resolution: int = 64, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> SampledLight:
    """Returns `axis_colours` on a cube map, where colours change exactly at the edges of the faces."""
    radiance = axis_radiance(cubemap.texel_directions(resolution)).to(dtype=dtype, device=device)
    return SampledLight(radiance, CubeGrid(resolution))


def axis_radiance(directions: Float[Tensor, "*points 3"]) -> Float[Tensor, "3 *points"]:
    """Returns the radiance of `axis_colours` from unit vectors."""
    rows = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1], [1, 0, 1], [1, 1, 0]]
    colours = torch.tensor(rows, dtype=directions.dtype, device=directions.device)
    axis = torch.cat([directions, -directions], dim=-1).argmax(dim=-1)
    brightness = 1 + 0.2 * directions @ torch.tensor([1, 2, 3], dtype=directions.dtype, device=directions.device)
    return (colours[axis] * brightness[..., None]).movedim(-1, 0)


def _mix(
    start: tuple[float, float, float], end: tuple[float, float, float], amount: Float[Tensor, "*points"]
) -> Float[Tensor, "3 *points"]:
    """Returns the colour between two, per point."""
    channels = [a + (b - a) * amount for a, b in zip(start, end, strict=True)]
    return torch.stack(channels)


def _in_window(x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """Returns whether a direction lies in the window's rectangle of azimuth and elevation."""
    azimuth = torch.remainder(torch.atan2(y, x) - WINDOW_AZIMUTH + math.pi, 2 * math.pi) - math.pi
    elevation = torch.atan2(z, torch.hypot(x, y)) - WINDOW_ELEVATION
    return (azimuth.abs() < WINDOW_WIDTH / 2) & (elevation.abs() < WINDOW_HEIGHT / 2)


def _average_rows(rows: Int[Tensor, " rows"], height: int) -> Float[Tensor, "3 rows width"]:
    """Returns lat-long rows averaged over sub-directions of equal solid angle."""
    steps = (torch.arange(_SUBSAMPLES, dtype=torch.float64) + 0.5) / _SUBSAMPLES
    edges = torch.cos(latlong.row_boundaries(height))
    top, bottom = edges[rows][:, None], edges[rows + 1][:, None]
    theta = torch.acos(top + (bottom - top) * steps)[..., None]
    columns = (torch.arange(2 * height, dtype=torch.float64)[:, None] + steps).reshape(-1)
    radiance = sun_and_window_radiance(from_angles(theta, math.pi * (1 - columns / height)))
    return radiance.unflatten(-1, (2 * height, _SUBSAMPLES)).mean(dim=(2, 4))
