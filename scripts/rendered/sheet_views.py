"""The photographs of the printed sheet: from where the camera looks, and what lies on the sheet under which light."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from jaxtyping import Float
from torch import Tensor

from torchlight.photo.target import Sheet

from .sheet import Lamp, card, looking_at

WHITE = 0.85  # of the lit paper in the file, linear
NOISE = 0.01  # of the file's white
DAYLIGHT = Lamp(40.0, 50.0)
BARE = Lamp(40.0, 50.0, ambient=0.0)  # no block: ambient light would change the exposure and nothing else


@dataclass(frozen=True)
class Case:
    """One photograph of the block.

    Attributes:
        name: in the table.
        lamp: its light.
        azimuth_degrees: from where the camera looks, counter-clockwise from x.
        roll_degrees: of the camera.
        white: of the lit paper in the file, linear.
        noise: of the file's white.
        hidden: objects that lie on the sheet.
    """

    name: str
    lamp: Lamp
    azimuth_degrees: float = -80.0
    roll_degrees: float = 0.0
    white: float = WHITE
    noise: float = NOISE
    hidden: dict[str, Any] = field(default_factory=dict)


def from_direction(
    azimuth: float, elevation: float, distance: float, at: tuple[float, float] = (0.0, 0.0), roll: float = 0.0
) -> Float[Tensor, "4 4"]:
    """Returns the pose of a camera at a distance from the origin, both angles in degrees, that looks at a point."""
    level, height = distance * math.cos(math.radians(elevation)), distance * math.sin(math.radians(elevation))
    place = (level * math.cos(math.radians(azimuth)), level * math.sin(math.radians(azimuth)), height)
    return looking_at(place, at, roll)


def calibration_poses(sheet: Sheet) -> list[Float[Tensor, "4 4"]]:
    """Returns twelve views: from three heights, all round, aimed beside the middle so that the page meets the rims."""
    distance = 1.45 * sheet.paper[1]
    beside, little = 0.16 * distance, 0.1 * distance
    aims = [(beside, little), (-beside, -little), (-little, beside), (little, -beside)]
    heights = (48.0, 62.0, 78.0)
    return [from_direction(30.0 * k + 7, heights[k % 3], distance, aims[k % 4], 22.5 * k) for k in range(12)]


def block_pose(case: Case, sheet: Sheet) -> Float[Tensor, "4 4"]:
    """Returns the view of the block: from a little less than twice the page's height."""
    return from_direction(case.azimuth_degrees, 62.0, 1.9 * sheet.paper[1], roll=case.roll_degrees)


def poses_at_a_metre() -> list[Float[Tensor, "4 4"]]:
    """Returns ten views whose camera is 1 m from the sheet's origin, 38 to 83 degrees above the sheet."""
    return [
        from_direction(36.0 * k + 11, 38.0 + 5 * k, 1000.0, (8.0 * k - 36, 30.0 - 6 * k), 36.5 * k) for k in range(10)
    ]


def cases(sheet: Sheet) -> list[Case]:
    """Returns the photographs of the block: four ordinary ones, and what goes wrong on a table."""
    upper = card((0.0, max(y for _, y in sheet.markers)), (sheet.paper[0], 1.3 * sheet.marker_size))
    return [
        Case("lamp at 40, 50 degrees", DAYLIGHT),
        Case("lamp at 160, 38 degrees", Lamp(160.0, 38.0)),
        Case("lamp at 285, 65 degrees", Lamp(285.0, 65.0), azimuth_degrees=140.0),
        Case("sheet turned by 20 degrees", Lamp(20.0, 50.0), azimuth_degrees=-100.0, roll_degrees=20.0),
        Case("lamp at 5, 25 degrees", Lamp(5.0, 25.0)),
        Case("upper row of markers hidden", DAYLIGHT, hidden=upper),
        Case("underexposed to 8 % of white, noise 1 %", DAYLIGHT, white=0.08),
    ]
