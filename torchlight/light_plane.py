"""Light that stands on a plane over the receiver, as distant light on a stretched object.

Let all light come from the plane z = h. The projective map about a point c of the receiver

    M(x, y, z) = (c + ((x, y) - c) / (1 - k z),  z / (1 - k z)),     k = 1 / h,

leaves every point of z = 0 where it is, takes straight lines to straight lines and sends the point c + h (u, v, 1) to
infinity in the direction (u, v, 1). So a triangle below the plane of the light hides that point from a sample exactly
where the mapped triangle hides the direction (u, v, 1). k = 0 is distant light.

A light on the plane is therefore written as what is seen of it from c: radiance by direction. Another c shears the
mapped object and shifts (u, v) by k (c' - c); it says the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import SceneError

CLEARANCE = 1.1  # of the object's height: below that the stretched object grows beyond all bounds


@dataclass(frozen=True)
class LightPlane:
    """The plane on which all light stands, parallel to the receiver.

    Attributes:
        height: h, over the receiver, in the scene's unit.
        center: c, x and y of the point of the receiver from which directions are counted.
    """

    height: float
    center: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not (0.0 < self.height < math.inf and all(map(math.isfinite, self.center))):
            raise SceneError(
                f"light: expected a height above 0 and a finite center, got {self.height:g} and {list(self.center)}"
            )

    def __str__(self) -> str:
        x, y = self.center
        return f"at the height {self.height:g} over ({x:g}, {y:g})"

    def check_above(self, top: float) -> None:
        """Raises SceneError unless the light stands clear of an object of a height."""
        if not self.height >= CLEARANCE * top:
            raise SceneError(
                f"light.height: {self.height:g} is not clear of the occluders, whose top is at {top:g}; "
                f"the light must stand at {CLEARANCE * top:g} or higher"
            )

    def stretch(self, points: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
        """Returns M of points below the plane, float64."""
        return stretched(points, torch.tensor(self.center, dtype=torch.float64), 1 / self.height)


def stretched(
    points: Float[Tensor, "*batch 3"], center: Float[Tensor, "2"], curvature: float
) -> Float[Tensor, "*batch 3"]:
    """Returns M of points, all of them below the height 1 / curvature, float64.

    Args:
        points: in the world.
        center: c.
        curvature: k, per unit of length.
    """
    corners = points.double()
    factor = 1 / (1 - curvature * corners[..., 2:])
    plane = center + (corners[..., :2] - center) * factor
    return torch.cat([plane, corners[..., 2:] * factor], dim=-1)
