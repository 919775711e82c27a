"""A lat-long map as a few thousand rays that light a plane: fine where the light is, coarse where it is not.

The upper hemisphere is cut into rectangles of azimuth and polar angle. Each becomes one ray with the exact flux of
its rectangle, the integral of L max(0, z) d omega, so that the total is exact whatever their number. Rectangles may
be many pixels or a fraction of one: an unclipped sun of a few pixels is cut finer than its pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, ShapeError
from torchlight.light.directions import from_angles
from torchlight.light.environment import EnvironmentMap, flux, luminance

START_DEGREES = 8.0
BAND = 0.25  # each round cuts all cells within this factor of the worst: nearly greedy, in tens of rounds
PLASTIC = 1.32471795724474602596  # root of x^3 = x + 1: the two-dimensional golden ratio


@dataclass(frozen=True, eq=False)
class Cubature:
    """Rays that stand for the light on a plane z = 0.

    Attributes:
        directions: unit vectors towards the light.
        fluxes: integral of L max(0, z) d omega over each ray's cell; their sum is the unoccluded irradiance.
    """

    directions: Float[Tensor, "rays 3"]
    fluxes: Float[Tensor, "rays 3"]


@dataclass(frozen=True, eq=False)
class _FluxTable:
    """Sums of flux over all pixels above and left of each pixel corner: red, green, blue, luminance of |L|."""

    sums: Float[Tensor, "edges columns 4"]


def cubature(environment: EnvironmentMap, *, count: int = 32_768, tolerance: float = 0.0) -> Cubature:
    """Returns about `count` rays, fewer if every cell meets the tolerance first, in float64 on the map's device.

    Cells are cut in two along their longer side, those with the largest (share of the luminance flux of |L|) x
    (angular diameter in radians) first. Each ray is a point of a low-discrepancy sequence within its cell: the result
    is the same on every call, and cell centres do not line up.

    Args:
        environment: a single map.
        count: number of rays at which to stop.
        tolerance: share x diameter below which a cell is left alone.

    Raises:
        ShapeError: a batch of maps.
        ConfigError: a count or a tolerance below 0.

    Torch differentiates the fluxes, which are linear in the map where the cells stay the same; how the cells are cut
    follows the map's brightness in steps and has no derivative.
    """
    if environment.radiance.ndim != 3:
        raise ShapeError(f"cubature: expected one map [3, height, width], got {list(environment.radiance.shape)}")
    if count < 1 or not tolerance >= 0:
        raise ConfigError(f"cubature: expected count >= 1 and tolerance >= 0, got {count} and {tolerance}")
    table = _flux_table(environment)
    cells = _cut(table, count, tolerance)
    return Cubature(_ray_directions(cells), _cell_fluxes(table, cells)[:, :3])


@torch.no_grad()
def _cut(table: _FluxTable, count: int, tolerance: float) -> Float[Tensor, "cells 4"]:
    """Returns the cells (u0, u1, theta0, theta1)."""
    cells = _starting_cells(table.sums.device)
    fluxes = _cell_fluxes(table, cells)
    while len(cells) < count:
        error = _error(cells, fluxes)
        worst = error > torch.clamp(BAND * error.max(), min=tolerance)
        number = min(int(worst.sum()), count - len(cells))
        if number == 0:
            break
        order = error.argsort(descending=True)
        halves = _halves(cells[order[:number]])
        cells = torch.cat([cells[order[number:]], halves])
        fluxes = torch.cat([fluxes[order[number:]], _cell_fluxes(table, halves)])
    return cells


def _flux_table(environment: EnvironmentMap) -> _FluxTable:
    exact = EnvironmentMap(environment.radiance.double(), environment.nonnegative)
    pixels = flux(exact)
    brightness = luminance(pixels.abs().flatten(start_dim=-2)).unflatten(-1, pixels.shape[-2:])
    sums = torch.cat([pixels, brightness[None]]).cumsum(dim=-2).cumsum(dim=-1)
    return _FluxTable(torch.nn.functional.pad(sums, (1, 0, 1, 0)).permute(1, 2, 0).contiguous())


def _starting_cells(device: torch.device) -> Float[Tensor, "cells 4"]:
    """Returns (u0, u1, theta0, theta1) of cells of about 8 degrees; u = 1/2 - phi / 2 pi as in `latlong`."""
    rings = math.ceil(90 / START_DEGREES)
    edges = [math.pi / 2 * ring / rings for ring in range(rings + 1)]
    cells = []
    for top, bottom in pairwise(edges):
        parts = max(4, round(2 * math.pi * math.sin((top + bottom) / 2) / (bottom - top)))
        u = torch.arange(parts + 1, dtype=torch.float64, device=device) / parts
        theta = torch.tensor([top, bottom], dtype=torch.float64, device=device).expand(parts, 2)
        cells.append(torch.cat([u[:-1, None], u[1:, None], theta], dim=1))
    return torch.cat(cells)


def _cell_fluxes(table: _FluxTable, cells: Float[Tensor, "cells 4"]) -> Float[Tensor, "cells 4"]:
    """Returns the exact flux of each cell and channel, from the table's values at its four corners."""
    left, right, top, bottom = cells.unbind(dim=-1)
    sums = [_sum_to(table, u, theta) for theta in (bottom, top) for u in (right, left)]
    return sums[0] - sums[1] - sums[2] + sums[3]


def _sum_to(table: _FluxTable, u: Float[Tensor, " cells"], theta: Float[Tensor, " cells"]) -> Float[Tensor, "cells 4"]:
    """Returns the flux above and left of a point.

    Within a pixel the flux is linear in u and in sin^2 theta, the integral of 2 cos sin: bilinear interpolation in
    these coordinates is exact.
    """
    height = table.sums.shape[0] - 1
    step = math.pi / height
    row = (theta / step).floor().long().clamp(0, (height + 1) // 2 - 1)
    column = (u * (2 * height)).floor().long().clamp(0, 2 * height - 1)
    # sin^2 a - sin^2 b = sin(a - b) sin(a + b); a row that straddles the horizon ends there.
    upper, lower = row.double() * step, ((row + 1).double() * step).clamp(max=math.pi / 2)
    part = torch.sin(theta - upper) * torch.sin(theta + upper)
    down = (part / (torch.sin(lower - upper) * torch.sin(lower + upper)))[:, None]
    along = (u * (2 * height) - column)[:, None]
    above = torch.lerp(table.sums[row, column], table.sums[row, column + 1], along)
    below = torch.lerp(table.sums[row + 1, column], table.sums[row + 1, column + 1], along)
    return torch.lerp(above, below, down)


def _error(cells: Float[Tensor, "cells 4"], fluxes: Float[Tensor, "cells 4"]) -> Float[Tensor, " cells"]:
    """Returns the share of the luminance flux of |L| times the angular diameter, in radians."""
    width, height = _sides(cells)
    brightness = fluxes[:, 3].clamp(min=0)
    total = brightness.sum()
    return brightness / torch.where(total > 0, total, 1) * torch.hypot(width, height)


def _sides(cells: Float[Tensor, "cells 4"]) -> tuple[Float[Tensor, " cells"], Float[Tensor, " cells"]]:
    """Returns the angular width, at the cell's widest latitude, and height of each cell."""
    left, right, top, bottom = cells.unbind(dim=-1)
    return (right - left) * (2 * math.pi) * bottom.sin(), bottom - top


def _halves(cells: Float[Tensor, "cells 4"]) -> Float[Tensor, "halves 4"]:
    """Returns the two halves of each cell, cut across its longer side; first halves first."""
    width, height = _sides(cells)
    start = torch.where(width > height, 0, 2)[:, None]
    ends = torch.cat([cells.gather(1, start), cells.gather(1, start + 1)], dim=1)
    middle = ends.mean(dim=1, keepdim=True)
    return torch.cat([cells.scatter(1, start + 1, middle), cells.scatter(1, start, middle)])


def _ray_directions(cells: Float[Tensor, "cells 4"]) -> Float[Tensor, "cells 3"]:
    """Returns one point per cell from the R2 sequence, uniform in u and in sin^2 theta.

    References:
        M. Roberts, The unreasonable effectiveness of quasirandom sequences (2018).
    """
    left, right, top, bottom = cells.unbind(dim=-1)
    index = torch.arange(1, len(cells) + 1, dtype=torch.float64, device=cells.device)
    across, down = torch.frac(0.5 + index / PLASTIC), torch.frac(0.5 + index / PLASTIC**2)
    phi = math.pi * (1 - 2 * torch.lerp(left, right, across))
    sine = torch.sqrt(torch.lerp(top.sin() ** 2, bottom.sin() ** 2, down))
    return from_angles(torch.asin(sine.clamp(max=1)), phi)
