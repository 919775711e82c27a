"""One lamp from several photographs: do the directions found at known places meet?

A photograph at the place x finds a direction u to its strongest source; under one distant light all are alike, under a
lamp at p they are those of p - x. A thin pole hardly tells by the shape of its one shadow how far its lamp is, several
of its shadows do. Directions are compared by the tangents t = (u_x, u_y) / u_z, in which both models are linear:

    distant   t = a                        2 unknowns
    near      t = (p_xy - x) / h = a - k x     3 unknowns,  k = 1 / h

The two are compared by F with 1 and 2 m - 3 degrees of freedom, m being the number of photographs; errors of the
tangents are taken as independent and alike. The test is one-sided: k > 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from scipy import stats
from torch import Tensor

from torchlight.errors import SceneError, ShapeError
from torchlight.near_light.angles import widest_degrees

FALSE_ALARMS = 0.01
LEAST_PLACES = 3


@dataclass(frozen=True, eq=False)
class Lamp:
    """Where one lamp stands, by several photographs.

    Attributes:
        flagged: whether it is near: p_value < `FALSE_ALARMS`.
        p_value: chance that a distant light's directions drift as much.
        position: of the lamp, in the scene's unit; infinite where the directions do not meet above the plane.
        drift_degrees: the largest angle between the directions from two of the places to the lamp; 0 if distant.
        residual_degrees: root mean square angle between the directions found and those to the lamp.
    """

    flagged: bool
    p_value: float
    position: Float[Tensor, "3"]
    drift_degrees: float
    residual_degrees: float


def triangulate(places: Float[Tensor, "photos 2"], directions: Float[Tensor, "photos 3"]) -> Lamp:
    """Returns the lamp that explains the directions found at several places, and whether it is near.

    Args:
        places: x and y of the plane that each direction belongs to: the middle of the shadow's tip and the object's
            foot, say; the scene's unit.
        directions: towards the light, of any length, z > 0.

    Raises:
        ShapeError: fewer than three photographs, or not one place for each direction.
        SceneError: all places are one, or a direction is not above the plane.
    """
    places, directions = places.double(), directions.double()
    if places.shape != (len(directions), 2) or len(places) < LEAST_PLACES:
        raise ShapeError(f"triangulate: expected a place for each of 3 directions or more, got {list(places.shape)}")
    if not bool((directions[:, 2] > 0).all()):
        raise SceneError("triangulate: a direction is not above the plane; leave out photographs without a peak")
    centred = places - places.mean(dim=0)
    spread = float(centred.square().sum())
    if not spread > 0:
        raise SceneError("triangulate: all photographs have the object in one place; move it between them")
    tangents = directions[:, :2] / directions[:, 2:]
    mean = tangents.mean(dim=0)
    curvature = -float((centred * (tangents - mean)).sum()) / spread
    remaining = float((tangents - mean + curvature * centred).square().sum())
    freedom = 2 * len(places) - 3
    deviation = math.sqrt(max(remaining, 1e-30) / freedom / spread)
    p_value = float(stats.t.sf(curvature / deviation, freedom))
    bounded = max(curvature, 0.0)
    towards = torch.nn.functional.normalize(with_one(mean - bounded * centred), dim=-1)
    cosines = (torch.nn.functional.normalize(directions, dim=-1) * towards).sum(dim=-1)
    return Lamp(
        flagged=p_value < FALSE_ALARMS,
        p_value=p_value,
        position=position(places.mean(dim=0), mean, bounded),
        drift_degrees=widest_degrees(towards),
        residual_degrees=math.degrees(float(cosines.clamp(-1, 1).acos().square().mean().sqrt())),
    )


def position(place: Float[Tensor, "2"], tangents: Float[Tensor, "2"], curvature: float) -> Float[Tensor, "3"]:
    """Returns the point at the height 1 / k in a direction from a place; infinite for k = 0."""
    if curvature == 0:
        return torch.full((3,), torch.inf, dtype=torch.float64)
    foot = torch.cat([place, torch.zeros(1, dtype=torch.float64)])
    return foot + with_one(tangents[None])[0] / curvature


def with_one(tangents: Float[Tensor, "photos 2"]) -> Float[Tensor, "photos 3"]:
    """Returns (x, y, 1) of every (x, y)."""
    return torch.cat([tangents, torch.ones_like(tangents[:, :1])], dim=1)
