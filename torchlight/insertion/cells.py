"""A light as directions with powers, for surfaces that face anywhere."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.light import latlong
from torchlight.light.cubature import cubature
from torchlight.light.environment import EnvironmentMap
from torchlight.light_plane import LightPlane

CELLS = 8192
MAX_CELLS = 2**20
FINEST_ROWS = 256


@dataclass(frozen=True, eq=False)
class Cells:
    """Directions that stand for a light above the plane.

    Attributes:
        directions: unit vectors towards the light, all above the horizon.
        powers: integral of L d omega over the cell that each stands for.
    """

    directions: Float[Tensor, "cells 3"]
    powers: Float[Tensor, "cells 3"]


def light_cells(environment: EnvironmentMap, count: int = CELLS) -> Cells:
    """Returns about `count` directions, dense where the light is strong, for any surface above the plane.

    `cubature` cuts a map by its flux through the plane, the integral of L max(0, z) d omega. Given L' = L a / b, with a
    the solid angle of a pixel above the horizon and b its integral of max(0, z), it cuts by the power of L instead, and
    the power of every pixel is exact. Within a pixel it still leans upwards: pixels are cut into rows of less than a
    degree first.

    Raises:
        ConfigError: a count below 1 or above `MAX_CELLS`.
    """
    if not 1 <= count <= MAX_CELLS:
        raise ConfigError(f"rays: expected 1 to {MAX_CELLS:,}, got {count:,}; {CELLS:,} is usual")
    parts = math.ceil(FINEST_ROWS / environment.height)
    radiance = environment.radiance.detach().cpu().double()
    radiance = radiance.repeat_interleave(parts, dim=-1).repeat_interleave(parts, dim=-2)
    height = radiance.shape[-2]
    edges = latlong.row_boundaries(height).clamp(max=math.pi / 2)
    # cos a - cos b = 2 sin((a + b) / 2) sin((b - a) / 2)
    angles = (math.pi / height) * 2 * ((edges[1:] + edges[:-1]) / 2).sin() * ((edges[1:] - edges[:-1]) / 2).sin()
    projected = latlong.row_projected_solid_angles(height)
    factor = torch.where(projected > 0, angles / projected.clamp(min=1e-300), 0.0)
    upright = EnvironmentMap(radiance * factor[:, None], environment.nonnegative)
    cut = cubature(upright, count=count)
    return Cells(cut.directions.float(), cut.fluxes.float())


def as_seen_from(cells: Cells, plane: LightPlane | None, point: Float[Tensor, "3"]) -> Cells:
    """Returns the cells in the directions in which a point sees them; as they are where the light is far away.

    A light on the plane z = h is written as what the plane's center c sees of it: the direction d stands for the place
    c + h d / z(d). Powers are kept, so that the fall-off of the light with distance is not modelled, here as on the
    receiver.
    """
    if plane is None:
        return cells
    x, y = plane.center
    center = torch.tensor([x, y, 0.0], dtype=torch.float64)
    d = cells.directions.double()
    towards = center + plane.height * d / d[:, 2:].clamp(min=1e-9) - point.double()
    return Cells(torch.nn.functional.normalize(towards, dim=-1).float(), cells.powers)
