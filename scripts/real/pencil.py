"""A pencil under a desk lamp: the recovered peak against the direction that the photograph shows.

The truth is the direction from the shadow's tip to the pencil's top: both ends of the shadow are labelled in the
photographs, and the pencil is 132.8 mm long. A second, faint lamp throws a shadow whose tip lies outside the frame:
such a shadow tells the azimuth and a highest elevation, but not how low the lamp hangs.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.camera import Camera, pixel_directions
from torchlight.errors import CalibrationError, FormatError
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.io.images import read_photo
from torchlight.io.scene_file import load_scene
from torchlight.near_light.triangulation import Lamp, triangulate
from torchlight.observing import linearize
from torchlight.pipeline import Estimate, estimate

SCENES = Path(__file__).resolve().parents[2] / "configs" / "scenes" / "desk_pencil"
PHOTOGRAPHS = range(1, 7)
SECOND_LAMP = (1, 2)  # the photographs whose publisher's description names a second shadow
PENCIL_LENGTH = 132.8  # mm


@dataclass(frozen=True, eq=False)
class Pencil:
    """What one photograph tells.

    Attributes:
        name: of the photograph.
        photo: its file.
        scene: pencil, paper, camera.
        found: the light by the default settings.
        truth: unit vector from the shadow's tip to the pencil's top.
    """

    name: str
    photo: Path
    scene: Scene
    found: Estimate
    truth: Float[Tensor, "3"]

    @property
    def peak(self) -> Float[Tensor, "3"]:
        """Returns the direction of the strongest source."""
        return self.found.peaks.directions[0].double()

    @property
    def off_degrees(self) -> float:
        """Returns the angle between the peak and the truth."""
        return angle_degrees(self.peak, self.truth)

    @property
    def second(self) -> Float[Tensor, "4"]:
        """Returns direction and share of the flux of the second strongest source, as `Peaks` orders them, or NaN."""
        return torch.cat([self.found.peaks.directions[1], self.found.peaks.shares[1:2]]).double()


def pencils(data: Path) -> Iterator[Pencil]:
    """Returns what each of the six photographs tells, one setting for all: the default.

    Raises:
        FormatError: the data are not there.
    """
    folder = data / "photos" / "desk_pencil"
    if not (folder / "params.json").exists():
        raise FormatError(f"no params.json in '{folder}'; pass --data DIR or set TORCHLIGHT_DATA")
    labels = json.loads((folder / "params.json").read_text())["labels"]
    for number in PHOTOGRAPHS:
        photo = folder / "light" / f"light_{number}.jpg"
        scene = load_scene(SCENES / f"light_{number}.yaml")
        if scene.camera is None:
            raise CalibrationError(f"light_{number}.yaml has no camera")
        found = estimate(linearize(read_photo(photo), scene), scene, solver=AdaptiveHaar())
        yield Pencil(photo.stem, photo, scene, found, towards_top(scene.camera, labels[photo.name]))


def towards_top(camera: Camera, label: dict[str, list[float]]) -> Float[Tensor, "3"]:
    """Returns the unit vector from the shadow's tip to the pencil's top."""
    foot, tip = plane_point(camera, label["base_px"]), plane_point(camera, label["shadow_tip_px"])
    top = torch.stack([foot[0], foot[1], torch.tensor(PENCIL_LENGTH, dtype=torch.float64)])
    return torch.nn.functional.normalize(top - tip, dim=0)


def plane_point(camera: Camera, pixel: list[float]) -> Float[Tensor, "3"]:
    """Returns where a pixel's ray meets the plane z = 0."""
    direction = pixel_directions(camera, torch.tensor([pixel], dtype=torch.float64))[0]
    position = camera.position.double()
    return position - position[2] / direction[2] * direction


def angle_degrees(one: Float[Tensor, "3"], other: Float[Tensor, "3"]) -> float:
    """Returns the angle between unit vectors; exact for small angles too."""
    return math.degrees(2 * math.atan2((one - other).norm().item(), (one + other).norm().item()))


def azimuth_elevation(direction: Float[Tensor, "3"]) -> tuple[float, float]:
    """Returns azimuth and elevation in degrees."""
    x, y, z = direction.tolist()
    return math.degrees(math.atan2(y, x)), math.degrees(math.atan2(z, math.hypot(x, y)))


def between_azimuths(one: float, other: float) -> float:
    """Returns the angle between two azimuths in degrees, at most 180."""
    return abs((one - other + 180) % 360 - 180)


def table(found: list[Pencil]) -> str:
    """Returns a line per photograph: how far the peak is off, and the second source."""
    lines = ["| photograph | peak off by, degrees | second source: azimuth, elevation, share |", "| --- | --- | --- |"]
    for each in found:
        azimuth, elevation = azimuth_elevation(each.second[:3])
        second = f"{azimuth:.1f}, {elevation:.1f}, {each.second[3]:.1%}" if each.second[3] > 0 else "none"
        lines.append(f"| {each.name} | {each.off_degrees:.2f} | {second} |")
    angles = sorted(each.off_degrees for each in found)
    median = (angles[(len(angles) - 1) // 2] + angles[len(angles) // 2]) / 2
    return "\n".join([*lines, f"median {median:.2f}, worst {angles[-1]:.2f} degrees"])


def one_lamp(found: list[Pencil]) -> Lamp:
    """Returns the lamp that all peaks together point at, each from the shadow's tip that it implies."""
    directions = torch.stack([each.peak for each in found])
    feet = torch.stack([each.scene.triangles[..., :2].double().mean(dim=(0, 1)) for each in found])
    return triangulate(feet - PENCIL_LENGTH * directions[:, :2] / directions[:, 2:], directions)


def second_lamp(found: list[Pencil]) -> tuple[float, float]:
    """Returns how far apart the second lamp lies in the two photographs that show it: azimuth, and whole direction."""
    one, other = (found[number - 1].second[:3] for number in SECOND_LAMP)
    azimuths = azimuth_elevation(one)[0], azimuth_elevation(other)[0]
    return between_azimuths(*azimuths), angle_degrees(one, other)
